"""Many campaigns: `fit-many` fits all of a folder, `history` and `fleet` ask them together."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from bayes_inertia.app import run_folder
from bayes_inertia.app.fit_campaign import fit
from bayes_inertia.app.result_folder import ResultFolder, write_json
from bayes_inertia.app.told_torques import refuse_impossible
from bayes_inertia.campaign.prior import SUMMARY_FILE
from bayes_inertia.campaign.reader import campaign_sha256, read_campaign
from bayes_inertia.errors import BayesInertiaError, OutputError, library_of_extra, require
from bayes_inertia.files import path_of, write_atomically
from bayes_inertia.inference.settings import FitContext, Settings, require_settings, usual_settings
from bayes_inertia.maths.values import by_name, json_ready, picked
from bayes_inertia.physics.named_effects import effects_named, pinned_names
from bayes_inertia.physics.parameters import base_names
from bayes_inertia.physics.slew_input import Drive
from bayes_inertia.progress import Progress, as_callback, silent, with_bar
from bayes_inertia.report.criteria import ratios_told
from bayes_inertia.report.series_sections import (
    fleet_answer,
    fleet_sections,
    history_answer,
    history_sections,
    series_notes,
)
from bayes_inertia.sealing import sha256_of
from bayes_inertia.series.fleet import Fleet, FleetSettings, fleet_told, told_by_craft
from bayes_inertia.series.history import OF_PART, History, history_told
from bayes_inertia.series.sources import FIT_MANY_FILE, FITS_FILE, Told, told_by
from bayes_inertia.studies.engine import Execution, Notice
from bayes_inertia.studies.work import DEPENDS_ON, Row, Work, WorkResult
from bayes_inertia.studies.workers import Engine

FORMAT = "bayes-inertia-fit-many/1"
# What a row says of each parameter, beside its mean.
_STATISTICS = ("sd", "quoted_sd", "robust_sd", "q05", "q50", "q95")
_DIAGNOSTICS = ("nested_rhat_max", "ess_bulk_min", "ess_tail_min")


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
        name, _, digest = task_id.rpartition(DEPENDS_ON)
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
    folder, out = path_of(campaigns, "campaigns").resolve(), path_of(out, "out")
    # Before hours of fits.
    library_of_extra("pyarrow", "parquet", where=str(out / FITS_FILE), error=OutputError)
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
        _write_table(result, out / FITS_FILE)
    write_json(out / FIT_MANY_FILE, fits_json(result))
    return result


def fits_json(result: WorkResult) -> dict[str, Any]:
    """Content of `fit-many --json`."""
    rows = [{k: v for k, v in row.items() if k != "task" and v is not None} for row in result.rows]
    failures = [{"campaign": f.name, "error": f.error, "reason": f.reason} for f in result.failures]
    return json_ready({"format": FORMAT, "campaigns": rows, "failures": failures})


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
    return tuple(
        f"{path.relative_to(folder).as_posix()}{DEPENDS_ON}{_digest(path)}" for path in folders
    )


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
    row["includes_wheel_spin"] = summary.get("includes_wheel_spin")
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


def run_history(
    sources: Sequence[Path], folder: Path, *, seed: int = 0, progress: Progress = silent
) -> History:
    """J and K over campaigns in the order given; writes history.json and history.html.

    `sources`: folders of runs, of fits of many, or of campaigns, which are fitted in `folder`/runs.
    """
    told: list[Told] = []
    for k, source in enumerate(sources, 1):
        run = folder / "runs" / f"{k:02d}_{source.resolve().name}"
        told += told_by(_fitted(source, run, seed, progress))
    progress("weighing how J and K may have changed", 0, 0)
    history = history_told(told)
    owner = _owner(folder, HISTORY, HISTORY_FORMAT, "history", told)
    sections = history_sections(history)
    owner.write(history_json(history), "J and K over campaigns", sections, *sources)
    return history


def run_fleet(fits: Path, folder: Path, *, seed: int = 0, progress: Progress = silent) -> Fleet:
    """J and K of a fleet; writes fleet.json and fleet.html.

    `fits`: what `fit-many` wrote. The first folder of a campaign's path is its spacecraft.
    """
    require((fits / FITS_FILE).is_file(), str(fits), f"no {FITS_FILE}", "run `fit-many` first")
    crafts = told_by_craft(fits)
    progress("sampling the spread of the fleet", 0, 0)
    fleet = fleet_told(crafts, FleetSettings(seed=seed))
    owner = _owner(folder, FLEET, FLEET_FORMAT, "fleet", chain.from_iterable(crafts.values()))
    title = f"Fleet of {len(fleet.spacecraft)} spacecraft"
    owner.write(fleet_json(fleet), title, fleet_sections(fleet), fits)
    return fleet


def _owner(
    folder: Path, files: tuple[str, str], form: str, work: str, told: Iterable[Told]
) -> ResultFolder:
    """The claim on a folder of what these campaigns tell."""
    digest = sha256_of(json.dumps([one.summary.json() for one in told if one.summary]))
    return ResultFolder(folder, work, files[0], form, digest, {}, files[1:])


def _fitted(source: Path, run: Path, seed: int, progress: Progress) -> Path:
    """A folder of fits; a campaign is fitted in the folder of a run."""
    if (source / FITS_FILE).is_file() or (source / SUMMARY_FILE).is_file():
        return source
    # As `fit` does: impossible data are no campaign of a series.
    refuse_impossible(source)
    run_folder.start(source, run, settings=usual_settings((), seed=seed))
    run_folder.finish(run, report=False, progress=progress)
    return run


def history_json(history: History) -> dict[str, Any]:
    """What `history --json` prints."""
    names = history.names
    content = {
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
        **picked(history, "wanders", "changed"),
        "left_out": history.left_out,
        "notes": series_notes(history),
    }
    return json_ready(content)


def fleet_json(fleet: Fleet) -> dict[str, Any]:
    """What `fleet --json` prints."""
    names = fleet.names
    low, high = fleet.spread_low, fleet.spread_high
    content = {
        "answer": fleet_answer(fleet),
        "fleet": _values(fleet.mean, fleet.sd),
        "spread": by_name(names, q50=fleet.spread, q05=low, q95=high),
        "spacecraft": [
            {"name": name, "parameters": _values(fleet.craft_mean[k], fleet.craft_sd[k])}
            for k, name in enumerate(fleet.spacecraft)
        ],
        "left_out": fleet.left_out,
        "disagree": fleet.disagree,
        "notes": series_notes(fleet),
    }
    return json_ready(content)


def _values(mean: np.ndarray, sd: np.ndarray) -> dict[str, dict[str, float]]:
    return by_name(base_names(mean.size), mean=mean, quoted_sd=sd)
