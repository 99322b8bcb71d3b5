"""`history` and `fleet`: series of campaigns, and sister spacecraft, from fits that were made."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bayes_inertia.app import run_folder
from bayes_inertia.app.result_folder import ResultFolder, write_page
from bayes_inertia.conventions.check import refuse_impossible
from bayes_inertia.errors import CampaignError, library_of_extra
from bayes_inertia.inference.likelihood_summary import (
    LikelihoodSummary,
    means_and_sds,
    product,
    summary_from_json,
)
from bayes_inertia.inference.settings import usual_settings
from bayes_inertia.maths.values import json_ready
from bayes_inertia.physics.parameters import BASE_NAMES
from bayes_inertia.progress import Progress, silent
from bayes_inertia.report.section import Section
from bayes_inertia.report.series_sections import (
    fleet_answer,
    fleet_sections,
    history_answer,
    history_sections,
)
from bayes_inertia.sealing import read_sealed_json, sha256_of
from bayes_inertia.series.fleet import Fleet, FleetSettings, fleet_of
from bayes_inertia.series.history import OF_PART, History, history_of

HISTORY_FORMAT, FLEET_FORMAT = "bayes-inertia-history/1", "bayes-inertia-fleet/1"
HISTORY, FLEET = ("history.json", "history.html"), ("fleet.json", "fleet.html")
_RESUME = "write it again with `bayes-inertia resume RUN`"


def run_history(
    sources: Sequence[Path], folder: Path, *, seed: int = 0, progress: Progress = silent
) -> tuple[History, tuple[str, ...]]:
    """J and K over campaigns in the order given; writes history.json and history.html.

    `sources`: folders of runs, of fits of many, or of campaigns, which are fitted in `folder`/runs.
    Returns: the history; the campaigns that were left out, because their result must not be used.
    """
    told = [
        one
        for k, source in enumerate(sources, 1)
        for one in _told(
            source, folder / "runs" / f"{k:02d}_{source.resolve().name}", seed, progress
        )
    ]
    usable = _named_apart([summary for _, summary in told if summary is not None])
    if len(usable) < 2:
        raise CampaignError(
            f"{len(usable)} of {len(told)} campaigns have a result that can be used",
            where=str(folder),
            advice="give at least two whose fit is trusted",
        )
    progress("weighing how J and K may have changed", 0, 0)
    history = history_of(usable)
    left_out = tuple(name for name, summary in told if summary is None)
    content = history_json(history) | {"left_out": left_out}
    names = HISTORY, HISTORY_FORMAT, "history"
    sections = history_sections(history, left_out)
    _write(folder, names, usable, content, sections, "J and K over campaigns")
    return history, left_out


def run_fleet(
    fits: Path, folder: Path, *, seed: int = 0, progress: Progress = silent
) -> tuple[Fleet, np.ndarray, tuple[str, ...]]:
    """J and K of a fleet; writes fleet.json and fleet.html.

    `fits`: what `fit-many` wrote. The first folder of a campaign's path is its spacecraft. Returns:
    the fleet; sds (craft, 9) of each craft alone; the campaigns that were left out, because their
    result must not be used.
    """
    crafts: dict[str, list[LikelihoodSummary]] = {}
    told_by = _of_many(fits)
    for name, summary in told_by:
        if summary is not None:
            crafts.setdefault(name.split("/")[0], []).append(summary)
    if len(crafts) < 2:
        raise CampaignError(
            f"holds {len(crafts)} spacecraft with a result that can be used",
            where=str(fits),
            advice="a fleet needs at least two: put the campaigns of each craft in a folder",
        )
    summaries = [replace(product(told), campaign=name) for name, told in crafts.items()]
    progress("sampling the spread of the fleet", 0, 0)
    fleet = fleet_of(summaries, FleetSettings(seed=seed))
    alone, alone_sd = means_and_sds(summaries)
    left_out = tuple(name for name, summary in told_by if summary is None)
    content = fleet_json(fleet, alone_sd) | {"left_out": left_out}
    sections = fleet_sections(fleet, alone, alone_sd, left_out)
    names = FLEET, FLEET_FORMAT, "fleet"
    _write(folder, names, summaries, content, sections, f"Fleet of {len(crafts)} spacecraft")
    return fleet, alone_sd, left_out


def _write(
    folder: Path,
    names: tuple[tuple[str, str], str, str],
    summaries: Sequence[LikelihoodSummary],
    content: Mapping[str, Any],
    sections: list[Section],
    title: str,
) -> None:
    (file, page), form, work = names
    text = json.dumps([summary.json() for summary in summaries])
    digest = sha256_of(text)
    owner = ResultFolder(folder, work, file, form, digest, {}, (page,))
    owner.claim(json_ready(content))
    write_page(folder / page, title, (), folder, sections, digest)


def _told(
    source: Path, run: Path, seed: int, progress: Progress
) -> list[tuple[str, LikelihoodSummary | None]]:
    """Names and summaries of one source; a campaign is fitted in the folder of a run."""
    if (source / "fits.parquet").is_file():
        return _of_many(source)
    if (source / "summary.json").is_file():
        content = read_sealed_json(source / "summary.json", _RESUME)
        return [(str(content.get("campaign")), _summary(content, source))]
    # As `fit` does: impossible data are no campaign of a series.
    refuse_impossible(source)
    run_folder.start(source, run, settings=usual_settings((), seed=seed))
    posterior = run_folder.finish(run, report=False, progress=progress)
    return [(str(posterior.attributes.get("campaign")), posterior.likelihood)]


def _named_apart(series: list[LikelihoodSummary]) -> list[LikelihoodSummary]:
    """The series; campaigns of one name get their number."""
    names = [summary.campaign for summary in series]
    return [
        summary
        if names.count(summary.campaign) == 1
        else replace(summary, campaign=f"{summary.campaign} ({k})")
        for k, summary in enumerate(series, 1)
    ]


def _summary(content: Mapping[str, Any], source: Path) -> LikelihoodSummary | None:
    if "likelihood" not in content:
        raise CampaignError(
            "the run was made by an older version: summary.json has no key likelihood",
            where=str(source),
            advice=_RESUME,
        )
    told = content["likelihood"]
    return None if told is None else summary_from_json(told)


def _of_many(fits: Path) -> list[tuple[str, LikelihoodSummary | None]]:
    path = fits / "fits.parquet"
    if not path.is_file():
        raise CampaignError("no fits.parquet", where=str(fits), advice="run `fit-many` first")
    pq = library_of_extra("pyarrow.parquet", "parquet", where=str(path))
    return [
        (row["campaign"], _summary(_likelihood_in(row), fits))
        for row in pq.read_table(path).to_pylist()
    ]


def _likelihood_in(row: Mapping[str, Any]) -> dict[str, Any]:
    """The key `likelihood` of summary.json, as a row of fits.parquet holds it."""
    return {"likelihood": json.loads(row["likelihood"])} if row.get("likelihood") else {}


def history_json(history: History) -> dict[str, Any]:
    """What `history --json` prints."""
    return {
        "answer": history_answer(history),
        "campaigns": [
            {"campaign": name, "parameters": _values(history.mean[k], history.sd[k])}
            for k, name in enumerate(history.campaigns)
        ],
        "jumps": [
            {
                "between": history.campaigns[jump.after : jump.after + 2],
                "part": jump.part,
                "probability": jump.probability,
                "size": {
                    name: {"mean": float(size), "sd": float(sd)}
                    for name, size, sd in zip(
                        BASE_NAMES[OF_PART[jump.part]], jump.size, jump.sd, strict=True
                    )
                },
            }
            for jump in history.jumps
        ],
        "wanders": history.wanders,
    }


def fleet_json(fleet: Fleet, alone_sd: np.ndarray) -> dict[str, Any]:
    """What `fleet --json` prints."""
    spread = zip(BASE_NAMES, fleet.spread, fleet.spread_low, fleet.spread_high, strict=True)
    return {
        "answer": fleet_answer(fleet, alone_sd),
        "fleet": _values(fleet.mean, fleet.sd),
        "spread": {
            name: {"q50": float(middle), "q05": float(low), "q95": float(high)}
            for name, middle, low, high in spread
        },
        "spacecraft": [
            {"name": name, "parameters": _values(fleet.craft_mean[k], fleet.craft_sd[k])}
            for k, name in enumerate(fleet.names)
        ],
    }


def _values(mean: np.ndarray, sd: np.ndarray) -> dict[str, dict[str, float]]:
    parts = zip(BASE_NAMES, mean, sd, strict=True)
    return {name: {"mean": float(m), "quoted_sd": float(s)} for name, m, s in parts}
