"""Many campaigns: `fit-many` fits all of a folder, `history` and `fleet` ask them together."""

from __future__ import annotations

import io
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bayes_inertia.app import run_folder
from bayes_inertia.app.fit_campaign import fit
from bayes_inertia.app.result_folder import ResultFolder, write_json
from bayes_inertia.app.told_torques import refuse_impossible
from bayes_inertia.campaign.reader import campaign_sha256, read_campaign
from bayes_inertia.errors import (
    BayesInertiaError,
    OutputError,
    library_of_extra,
    require,
)
from bayes_inertia.files import write_atomically
from bayes_inertia.inference.likelihood_summary import (
    LikelihoodSummary,
    means_and_sds,
    product,
    summary_from_json,
)
from bayes_inertia.inference.settings import (
    FitContext,
    Settings,
    require_settings,
    usual_settings,
)
from bayes_inertia.maths.values import by_name, json_ready
from bayes_inertia.physics.named_effects import effects_named, pinned_names
from bayes_inertia.physics.parameters import base_names
from bayes_inertia.physics.slew_input import Drive
from bayes_inertia.progress import Progress, as_callback, silent, with_bar
from bayes_inertia.report.criteria import ratios_told
from bayes_inertia.report.formatting import listed
from bayes_inertia.report.series_sections import (
    fleet_answer,
    fleet_sections,
    history_answer,
    history_sections,
    series_notes,
)
from bayes_inertia.sealing import read_sealed_json, sha256_of
from bayes_inertia.series.fleet import Fleet, FleetSettings, disagreeing, fleet_of
from bayes_inertia.series.history import OF_PART, History, history_of
from bayes_inertia.studies.engine import Execution, Notice
from bayes_inertia.studies.work import Row, TaskFailure, Work, WorkResult
from bayes_inertia.studies.workers import Engine

FORMAT = "bayes-inertia-fit-many/1"
# What a row says of each parameter, beside its mean.
_STATISTICS = ("sd", "quoted_sd", "robust_sd", "q05", "q50", "q95")
_DIAGNOSTICS = ("nested_rhat_max", "ess_bulk_min", "ess_tail_min")
# Between a campaign's name and the digest of its files, in a task's id.
_AT = "@"


@dataclass(frozen=True)
class CampaignFit:
    """The task: fit one campaign of a folder."""

    folder: Path  # that holds the campaigns; workers see it under the same path
    effects: tuple[str, ...]  # names of effects to fit along
    drive: Drive | None  # what drives the model
    settings: Settings  # of the sampler; each campaign has its own seed
    as_stated: bool  # take telemetry and noise as they are stated
    anyway: bool  # fit also where the data are impossible under the stated conventions

    def __call__(self, task_id: str, seed: np.random.SeedSequence) -> Row:
        """The row of a campaign: posterior, gates, chi^2."""
        name, _, digest = task_id.rpartition(_AT)
        path = self.folder / name
        now = _digest(path)
        if now != digest:
            # Not one of the package's errors: the next command looks at the campaign again.
            raise RuntimeError(f"{path} was changed while it waited to be fitted")
        if not self.anyway:
            refuse_impossible(path, self.effects)
        number = int(seed.generate_state(1)[0])
        posterior = fit(
            read_campaign(path),
            effects=effects_named(self.effects),
            drive=self.drive,
            settings=replace(self.settings, seed=number),
            context=FitContext(digest),
            as_stated=self.as_stated,
            predict=False,
        )
        head = {"campaign": name, "sha256": digest, "seed": number}
        return head | _row_of(posterior.summary())


@with_bar
def fit_many(
    campaigns: str | Path,
    out: str | Path,
    *,
    effects: Sequence[str] = (),
    drive: Drive | None = None,
    seed: int = 0,
    settings: Settings | None = None,
    as_stated: bool = False,
    anyway: bool = False,
    engine: Engine | None = None,
    jobs: int = 1,
    scheduler: str | None = None,
    progress: Progress | bool | None = None,
    notice: Notice | None = None,
) -> WorkResult:
    """Fit every campaign in a folder, and write fits.parquet and fit_many.json.

    What is there already is kept; campaigns that were added or changed are fitted. A call that was
    killed goes on. The `seed` in a row gives the same numbers in `fit`.

    Parameters
    ----------
    campaigns : str or Path
        Folder with a campaign folder for each spacecraft or year, at any depth.
    out : str or Path
        Where to write.
    effects : sequence of str, optional
        Names of effects to fit along, in all campaigns.
    drive : {"commanded", "measured"} or None, optional
        What drives the model; None for each campaign's best.
    seed : int, optional
        Fixes everything.
    settings : Settings or None, optional
        Of the sampler; None for the usual ones.
    as_stated : bool, optional
        Take telemetry and noise as they are stated.
    anyway : bool, optional
        Fit also where the data are impossible under the stated conventions.
    engine : {"process", "joblib", "dask"} or None, optional
        Where campaigns are fitted; None for this process or joblib's, by `jobs`.
    jobs : int, optional
        Processes.
    scheduler : str or None, optional
        Address of a dask scheduler, whose workers see the same folders.
    progress : bool or callable, optional
        Called with (what, done, of).
    notice : callable or None, optional
        Called with what should be known of files and failures.

    Returns
    -------
    WorkResult
        A row a campaign, in the order of their names, and those that could not be fitted.

    Raises
    ------
    CampaignError
        If the folder holds no campaign.
    EffectError
        If an effect is unknown.
    OutputError
        If `out` holds something else, or pyarrow (the extra `parquet`) is not installed.
    StudyError
        If the workers are lost.

    Examples
    --------
    It takes ten seconds a campaign, so this is no doctest::

        result = fit_many("fleet", "fleet_fits", jobs=2)
        [(row["campaign"], row["trusted"]) for row in result.rows]
    """
    folder, out = Path(campaigns).resolve(), Path(out)
    # Before hours of fits.
    library_of_extra("pyarrow", "parquet", where=str(out / "fits.parquet"), error=OutputError)
    names = pinned_names(effects)
    settings = require_settings(settings, usual_settings(effects_named(names)))
    settings = replace(settings, seed=seed, threads=1)
    task = CampaignFit(folder, names, drive, settings, as_stated, anyway)
    options = {key: value for key, value in asdict(task).items() if key != "folder"}
    work = Work("campaigns", task, _ids(folder, out), seed, options)
    # Rows belong to the campaigns' contents: the folder may get more of them.
    owner = ResultFolder(out, "fit of many", "fits_of.json", FORMAT, "", options)
    owner.claim()
    execution = Execution(engine, jobs, scheduler, as_callback(progress), notice)
    result = execution.run(work, out)
    if result.rows:
        _write_table(result, out / "fits.parquet")
    write_json(out / "fit_many.json", fits_json(result))
    return result


def fits_json(result: WorkResult) -> dict[str, Any]:
    """Content of `fit-many --json`."""
    rows = [{k: v for k, v in row.items() if k != "task" and v is not None} for row in result.rows]
    failures = [
        {"campaign": campaign_of(f), "error": f.error, "reason": f.reason} for f in result.failures
    ]
    return json_ready({"format": FORMAT, "campaigns": rows, "failures": failures})


def campaign_of(failure: TaskFailure) -> str:
    """The campaign that could not be fitted."""
    return failure.task.rpartition(_AT)[0]


def _ids(folder: Path, out: Path) -> tuple[str, ...]:
    """A task for every campaign below a folder."""
    require(folder.is_dir(), str(folder), "no such folder", "give a folder of campaign folders")
    results = out.resolve()
    folders = sorted(path.parent for path in folder.rglob("campaign.toml"))
    folders = [
        path
        for path in folders
        if not (path.is_relative_to(results) or _is_copy_of_run(path, folder))
    ]
    what, advice = "holds no campaign.toml, at any depth", "give a folder of campaign folders"
    require(bool(folders), str(folder), what, advice)
    return tuple(f"{path.relative_to(folder).as_posix()}{_AT}{_digest(path)}" for path in folders)


def _is_copy_of_run(path: Path, folder: Path) -> bool:
    """Whether a campaign lies in the folder of a run, which keeps a copy of what it fitted."""
    between = path.relative_to(folder).parents
    return any((folder / run / "run.json").is_file() for run in between if run != Path())


def _digest(path: Path) -> str:
    """Digest of a campaign's files; of what is wrong with them where they cannot be read."""
    try:
        return campaign_sha256(path)
    except BayesInertiaError as error:
        return "unreadable-" + sha256_of(str(error))


def _row_of(summary: dict[str, Any]) -> dict[str, Any]:
    row: dict[str, Any] = {"trusted": summary["trusted"]}
    row |= {gate["name"]: gate["passed"] for gate in summary["gates"]}
    row["reasons"] = "; ".join(summary["reasons"])
    for name, parameter in summary["parameters"].items():
        row[name] = parameter["mean"]
        row |= {f"{name}_{key}": parameter[key] for key in _STATISTICS}
    for name, moment in (summary["derived"] | ratios_told(summary)).items():
        row |= {name: moment["mean"], f"{name}_sd": moment["sd"]}
        row |= {f"{name}_{key}": moment.get(key) for key in ("quoted_sd", "robust_sd")}
    # What `history` and `fleet` read.
    row["likelihood"] = json.dumps(summary["likelihood"])
    chi2 = summary["fit"]["reduced_chi2"]
    row |= {f"reduced_chi2_{channel}": value for channel, value in chi2.items()}
    row["n_data"] = summary["fit"]["n_data"]
    return row | {key: summary["diagnostics"][key] for key in _DIAGNOSTICS}


def _write_table(result: WorkResult, path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    names = dict.fromkeys(key for row in result.rows for key in row if key != "task")
    table = pa.table({name: [row.get(name) for row in result.rows] for name in names})
    sink = io.BytesIO()
    pq.write_table(table, sink)
    write_atomically(path, sink.getvalue())


HISTORY_FORMAT, FLEET_FORMAT = "bayes-inertia-history/1", "bayes-inertia-fleet/1"
HISTORY, FLEET = ("history.json", "history.html"), ("fleet.json", "fleet.html")
_RESUME = "write it again with `bayes-inertia resume RUN`"


def run_history(
    sources: Sequence[Path], folder: Path, *, seed: int = 0, progress: Progress = silent
) -> tuple[History, tuple[str, ...]]:
    """J and K over campaigns in the order given; writes history.json and history.html.

    `sources`: folders of runs, of fits of many, or of campaigns, which are fitted in `folder`/runs.
    Returns: the history; what must be known of its numbers, see `series_notes`.
    """
    told = []
    for k, source in enumerate(sources, 1):
        run = folder / "runs" / f"{k:02d}_{source.resolve().name}"
        told += _told(source, run, seed, progress)
    _refuse_twice(told)
    usable = _named_apart([one.summary for one in told if one.summary is not None])
    what = f"{len(usable)} of {len(told)} campaigns have a result that can be used"
    require(len(usable) >= 2, str(folder), what, "give at least two whose fit is trusted")
    progress("weighing how J and K may have changed", 0, 0)
    history = history_of(usable)
    left_out = tuple(one.campaign for one in told if one.summary is None)
    notes = series_notes(history, left_out)
    content = history_json(history) | {"left_out": left_out, "notes": notes}
    owner = _owner(folder, HISTORY, HISTORY_FORMAT, "history", usable)
    sections = history_sections(history, notes)
    owner.write(json_ready(content), "J and K over campaigns", sections, *sources)
    return history, notes


def run_fleet(
    fits: Path, folder: Path, *, seed: int = 0, progress: Progress = silent
) -> tuple[Fleet, np.ndarray, tuple[str, ...]]:
    """J and K of a fleet; writes fleet.json and fleet.html.

    `fits`: what `fit-many` wrote. The first folder of a campaign's path is its spacecraft. Returns:
    the fleet; sds (craft, n) of each craft alone; what must be known, see `series_notes`.
    """
    crafts: dict[str, list[LikelihoodSummary]] = {}
    told_by = _of_many(fits)
    _refuse_twice(told_by)
    for one in told_by:
        if one.summary is not None:
            crafts.setdefault(one.campaign.split("/")[0], []).append(one.summary)
    what = f"holds {len(crafts)} spacecraft with a result that can be used"
    advice = "a fleet needs at least two: put the campaigns of each craft in a folder"
    require(len(crafts) >= 2, str(fits), what, advice)
    summaries = [replace(product(told), campaign=name) for name, told in crafts.items()]
    settings = FleetSettings(seed=seed)
    progress("sampling the spread of the fleet", 0, 0)
    fleet = replace(fleet_of(summaries, settings), disagree=disagreeing(crafts, settings))
    alone, alone_sd = means_and_sds(summaries)
    left_out = tuple(one.campaign for one in told_by if one.summary is None)
    notes = series_notes(fleet, left_out)
    content = fleet_json(fleet, alone_sd)
    content |= {"left_out": left_out, "disagree": fleet.disagree, "notes": notes}
    owner = _owner(folder, FLEET, FLEET_FORMAT, "fleet", summaries)
    sections = fleet_sections(fleet, alone, alone_sd, notes)
    owner.write(json_ready(content), f"Fleet of {len(crafts)} spacecraft", sections, fits)
    return fleet, alone_sd, notes


def _owner(
    folder: Path,
    files: tuple[str, str],
    form: str,
    work: str,
    summaries: Sequence[LikelihoodSummary],
) -> ResultFolder:
    """The claim on a folder of what these summaries tell."""
    digest = sha256_of(json.dumps([summary.json() for summary in summaries]))
    return ResultFolder(folder, work, files[0], form, digest, {}, files[1:])


class Told(NamedTuple):
    """What one fit tells."""

    campaign: str  # its name
    summary: LikelihoodSummary | None  # None where the result must not be used


def _refuse_twice(told: Sequence[Told]) -> None:
    """Refuse telemetry that would count twice: all sds would be too small."""
    of_each = {k: one.summary.learnt_from for k, one in enumerate(told) if one.summary}
    slews = Counter(chain.from_iterable(of_each.values()))
    twice = [told[k].campaign for k, own in of_each.items() if any(slews[x] > 1 for x in own)]
    what = f"{listed(twice)} hold the same telemetry, which would count twice"
    require(not twice, "campaigns", what, "give each slew once")


def _told(source: Path, run: Path, seed: int, progress: Progress) -> list[Told]:
    """What one source tells; a campaign is fitted in the folder of a run."""
    if (source / "fits.parquet").is_file():
        return _of_many(source)
    if (source / "summary.json").is_file():
        content = read_sealed_json(source / "summary.json", _RESUME)
        return [Told(str(content.get("campaign")), _summary(content, source))]
    # As `fit` does: impossible data are no campaign of a series.
    refuse_impossible(source)
    run_folder.start(source, run, settings=usual_settings((), seed=seed))
    posterior = run_folder.finish(run, report=False, progress=progress)
    return [Told(str(posterior.attributes.get("campaign")), posterior.likelihood)]


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
    what = "the run was made by an older version: summary.json has no key likelihood"
    require("likelihood" in content, str(source), what, _RESUME)
    told = content["likelihood"]
    return None if told is None else summary_from_json(told)


def _of_many(fits: Path) -> list[Told]:
    """What every campaign of `fit-many` tells."""
    path = fits / "fits.parquet"
    require(path.is_file(), str(fits), "no fits.parquet", "run `fit-many` first")
    pq = library_of_extra("pyarrow.parquet", "parquet", where=str(path))
    return [
        Told(row["campaign"], _summary(_likelihood_in(row), fits))
        for row in pq.read_table(path).to_pylist()
    ]


def _likelihood_in(row: Mapping[str, Any]) -> dict[str, Any]:
    """The key `likelihood` of summary.json, as a row of fits.parquet holds it."""
    return {"likelihood": json.loads(row["likelihood"])} if row.get("likelihood") else {}


def history_json(history: History) -> dict[str, Any]:
    """What `history --json` prints."""
    names = base_names(history.mean.shape[1])
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
                "size": by_name(names[OF_PART[jump.part]], mean=jump.size, sd=jump.sd),
            }
            for jump in history.jumps
        ],
        "wanders": history.wanders,
    }


def fleet_json(fleet: Fleet, alone_sd: np.ndarray) -> dict[str, Any]:
    """What `fleet --json` prints."""
    names = base_names(fleet.mean.size)
    low, high = fleet.spread_low, fleet.spread_high
    return {
        "answer": fleet_answer(fleet, alone_sd),
        "fleet": _values(fleet.mean, fleet.sd),
        "spread": by_name(names, q50=fleet.spread, q05=low, q95=high),
        "spacecraft": [
            {"name": name, "parameters": _values(fleet.craft_mean[k], fleet.craft_sd[k])}
            for k, name in enumerate(fleet.names)
        ],
    }


def _values(mean: np.ndarray, sd: np.ndarray) -> dict[str, dict[str, float]]:
    return by_name(base_names(mean.size), mean=mean, quoted_sd=sd)
