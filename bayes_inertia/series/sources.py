"""What campaigns tell of J and K, read from whatever holds it: a fit, a run, a fit of many."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from bayes_inertia.campaign.prior import SUMMARY_FILE
from bayes_inertia.errors import library_of_extra, members, require
from bayes_inertia.files import path_of
from bayes_inertia.inference.likelihood_summary import LikelihoodSummary, summary_from_json
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.maths.printed import listed
from bayes_inertia.sealing import read_sealed_json

FITS_FILE, FIT_MANY_FILE = "fits.parquet", "fit_many.json"
Source = Posterior | str | Path
_AGAIN = "write it again with `bayes-inertia resume RUN`"


class Told(NamedTuple):
    """What one fit tells."""

    campaign: str  # its name
    summary: LikelihoodSummary | None  # None where the result must not be used
    # Whether its J holds the spin inertia of the wheels; None where nobody told.
    includes_wheel_spin: bool | None = None


def told_by(sources: Source | Iterable[Source]) -> list[Told]:
    """What fits tell, or one of them; a folder of `fit-many` holds several."""
    given = (sources,) if isinstance(sources, Source) else members(sources, Source, "sources")
    return [one for source in given for one in _told(source)]


def _told(source: Source) -> list[Told]:
    if isinstance(source, Posterior):
        attributes = source.attributes
        spin = attributes.get("includes_wheel_spin")
        return [Told(str(attributes.get("campaign")), source.likelihood, spin)]
    path = path_of(source, "sources")
    if path.is_file():
        return _told(Posterior.load(path))
    if (path / FITS_FILE).is_file():
        return _of_many(path)
    file, what = path / SUMMARY_FILE, "no finished fit is here"
    advice = "give a Posterior, or the folder that `fit -o` or `fit-many -o` wrote; "
    advice += "`bayes-inertia resume RUN` finishes a run"
    require(file.is_file(), str(path), what, advice)
    content = read_sealed_json(file, _AGAIN)
    spin = content.get("includes_wheel_spin")
    return [Told(str(content.get("campaign")), _summary(content, path), spin)]


def _summary(content: Mapping[str, Any], source: Path) -> LikelihoodSummary | None:
    what = "the run was made by an older version: summary.json has no key likelihood"
    require("likelihood" in content, str(source), what, _AGAIN)
    told = content["likelihood"]
    return None if told is None else summary_from_json(told)


def _of_many(fits: Path) -> list[Told]:
    """What every campaign of `fit-many` tells; those that could not be fitted tell nothing."""
    path = fits / FITS_FILE
    pq = library_of_extra("pyarrow.parquet", "parquet", where=str(path))
    told = [
        Told(row["campaign"], _summary(_likelihood_in(row), fits), row.get("includes_wheel_spin"))
        for row in pq.read_table(path).to_pylist()
    ]
    overview = fits / FIT_MANY_FILE
    advice = "run `fit-many` again: what is fitted stays"
    found = read_sealed_json(overview, advice) if overview.is_file() else {}
    told += [Told(failure["campaign"], None) for failure in found.get("failures", ())]
    return sorted(told, key=lambda one: one.campaign)


def _likelihood_in(row: Mapping[str, Any]) -> dict[str, Any]:
    """The key `likelihood` of summary.json, as a row of fits.parquet holds it."""
    return {"likelihood": json.loads(row["likelihood"])} if row.get("likelihood") else {}


def usable(told: Sequence[Told]) -> tuple[list[LikelihoodSummary], tuple[str, ...]]:
    """What may be used, and the names of what may not.

    Telemetry that would count twice is refused: all sds would be too small.
    """
    used = [(one.campaign, one.summary) for one in told if one.summary is not None]
    slews = Counter(chain.from_iterable(summary.learnt_from for _, summary in used))
    twice = [name for name, summary in used if any(slews[x] > 1 for x in summary.learnt_from)]
    what = f"{listed(twice)} hold the same telemetry, which would count twice"
    require(not twice, "campaigns", what, "give each slew once")
    spins = {one.includes_wheel_spin for one in told if one.summary} - {None}
    what = "some results hold the wheels' spin inertia in J, others do not"
    advice = "state includes_wheel_spin alike in all campaigns, and fit them again"
    require(len(spins) < 2, "campaigns", what, advice)
    left_out = tuple(one.campaign for one in told if one.summary is None)
    return [summary for _, summary in used], left_out
