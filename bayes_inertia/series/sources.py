"""What campaigns tell of J and K, read from whatever holds it: a fit, a run, a fit of many."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from bayes_inertia.errors import library_of_extra, members, require
from bayes_inertia.files import path_of
from bayes_inertia.inference.likelihood_summary import LikelihoodSummary, summary_from_json
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.maths.printed import listed
from bayes_inertia.sealing import read_sealed_json

FITS_FILE, SUMMARY_FILE = "fits.parquet", "summary.json"
Source = Posterior | str | Path
_AGAIN = "write it again with `bayes-inertia resume RUN`"


class Told(NamedTuple):
    """What one fit tells."""

    campaign: str  # its name
    summary: LikelihoodSummary | None  # None where the result must not be used


def told_by(sources: Source | Iterable[Source]) -> list[Told]:
    """What fits tell, or one of them; a folder of `fit-many` holds several."""
    given = (sources,) if isinstance(sources, Source) else members(sources, Source, "sources")
    return [one for source in given for one in _told(source)]


def _told(source: Source) -> list[Told]:
    if isinstance(source, Posterior):
        return [Told(str(source.attributes.get("campaign")), source.likelihood)]
    path = path_of(source, "sources")
    if path.is_file():
        return _told(Posterior.load(path))
    if (path / FITS_FILE).is_file():
        return _of_many(path)
    if (path / SUMMARY_FILE).is_file():
        content = read_sealed_json(path / SUMMARY_FILE, _AGAIN)
        return [Told(str(content.get("campaign")), _summary(content, path))]
    stored, what = path / "posterior.nc", "no finished fit is here"
    advice = "give a Posterior, or the folder that `fit -o` or `fit-many -o` wrote"
    require(stored.is_file(), str(path), what, advice)
    return _told(Posterior.load(stored))


def _summary(content: Mapping[str, Any], source: Path) -> LikelihoodSummary | None:
    what = "the run was made by an older version: summary.json has no key likelihood"
    require("likelihood" in content, str(source), what, _AGAIN)
    told = content["likelihood"]
    return None if told is None else summary_from_json(told)


def _of_many(fits: Path) -> list[Told]:
    """What every campaign of `fit-many` tells."""
    path = fits / FITS_FILE
    pq = library_of_extra("pyarrow.parquet", "parquet", where=str(path))
    return [
        Told(row["campaign"], _summary(_likelihood_in(row), fits))
        for row in pq.read_table(path).to_pylist()
    ]


def _likelihood_in(row: Mapping[str, Any]) -> dict[str, Any]:
    """The key `likelihood` of summary.json, as a row of fits.parquet holds it."""
    return {"likelihood": json.loads(row["likelihood"])} if row.get("likelihood") else {}


def usable(told: Sequence[Told]) -> tuple[list[LikelihoodSummary], tuple[str, ...]]:
    """What may be used, and the names of what may not; telemetry that counts twice is refused."""
    # All sds would be too small.
    of_each = {k: one.summary.learnt_from for k, one in enumerate(told) if one.summary}
    slews = Counter(chain.from_iterable(of_each.values()))
    twice = [told[k].campaign for k, own in of_each.items() if any(slews[x] > 1 for x in own)]
    what = f"{listed(twice)} hold the same telemetry, which would count twice"
    require(not twice, "campaigns", what, "give each slew once")
    left_out = tuple(one.campaign for one in told if one.summary is None)
    return [one.summary for one in told if one.summary is not None], left_out
