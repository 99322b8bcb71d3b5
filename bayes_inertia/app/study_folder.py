"""`study` on a folder: do the uncertainties hold that fits of a plan's campaigns state?

The plan is flown again and again with noise, each time with another J, K and bias from the
campaign's prior. Each campaign is fitted as real data would be. If the stated sds are right,
errors over sds are standard normal, and intervals hold the truth as often as they say. Campaigns
are kept in shards: a killed study goes on where it was.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from scipy import stats

from bayes_inertia.app.named_plans import PAPER, plan_sha256, plans_named, prior_mission
from bayes_inertia.app.result_folder import ResultFolder
from bayes_inertia.campaign.reader import campaign_sha256, read_campaign
from bayes_inertia.design.simulated_fits import AchievedErrors, fit_simulated_campaigns
from bayes_inertia.errors import CampaignError
from bayes_inertia.files import write_atomically
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan
from bayes_inertia.inference.sampler import Progress
from bayes_inertia.physics.parameters import BASE_NAMES
from bayes_inertia.report.pictures.figure_file import write_png
from bayes_inertia.report.pictures.study import draw_coverage

FORMAT = "bayes-inertia-study/1"
LEVELS = (0.68, 0.95)
_SHARD_SIZE = 25  # campaigns a task and a file
# Probability that sound uncertainties are called too small, any of the nine.
_FALSE_ALARM = 0.01


@dataclass(frozen=True)
class Study:
    """What n simulated campaigns of one plan say about the uncertainties that are stated of it.

    Parameters
    ----------
    plan : Plan
        That was flown.
    achieved : AchievedErrors
        Errors and stated sds of every campaign.
    """

    plan: Plan
    achieved: AchievedErrors

    @property
    def z(self) -> np.ndarray:
        """Errors in units of the stated sd (n, 9)."""
        return self.achieved.errors / self.achieved.stated

    def coverage(self, level: float) -> list[tuple[float, float, float]]:
        """For each parameter: how often the central interval of this level held the truth.

        Parameters
        ----------
        level : float
            Between 0 and 1.

        Returns
        -------
        list of (float, float, float)
            The share, and its 95 % interval.
        """
        held = np.abs(self.z) < stats.norm.ppf(0.5 + 0.5 * level)
        tests = [stats.binomtest(int(h.sum()), len(h)) for h in held.T]
        intervals = [t.proportion_ci(method="exact") for t in tests]
        return [
            (float(t.statistic), float(i.low), float(i.high))
            for t, i in zip(tests, intervals, strict=True)
        ]

    @property
    def too_small(self) -> tuple[str, ...]:
        """Parameters whose errors are larger than their stated sds allow.

        By chi^2 of all errors, Bonferroni over the parameters.
        """
        p = stats.chi2.sf(np.sum(self.z**2, axis=0), len(self.z))
        limit = _FALSE_ALARM / len(BASE_NAMES)
        return tuple(name for name, value in zip(BASE_NAMES, p, strict=True) if value < limit)


def run_study(
    campaign: Path,
    folder: Path,
    plan: str = PAPER,
    *,
    campaigns: int = 200,
    seed: int = 0,
    jobs: int = 1,
    progress: Progress | None = None,
) -> Study:
    """Simulate and fit campaigns of one plan, and write study.json and study.png.

    Parameters
    ----------
    campaign : Path
        Folder of the campaign whose hardware and prior are taken.
    folder : Path
        Where to write. Shards of 25 campaigns that are there already are read.
    plan : str
        File of the plan, or `paper`.
    campaigns : int
        How many, at least 2.
    seed : int
        Fixes everything.
    jobs : int
        Processes.
    progress : callable or None
        Called with (what, done, of).

    Returns
    -------
    Study
        Errors and stated sds of all.

    Raises
    ------
    CampaignError
        If campaign or plan is no good.
    OutputError
        If the folder holds something else.
    """
    given, digest = read_campaign(campaign), campaign_sha256(campaign)
    (chosen,) = plans_named([plan], given).values()
    if campaigns < 2:
        raise CampaignError(
            f"{campaigns} campaign tells nothing of scatter",
            where="campaigns",
            advice="ask for 200",
        )
    options = {"plan": plan_sha256(chosen), "seed": seed}
    owner = ResultFolder(folder, "study", "study_of.json", FORMAT, digest, options, flat=True)
    owner.claim()
    shards = []
    tasks = _tasks(folder, chosen, prior_mission(given), seed, campaigns)
    for shard in _in_parallel(tasks, jobs):
        shards.append(shard)
        if progress is not None:
            progress("campaigns", sum(len(s.errors) for s in shards), campaigns)
    joined = (np.concatenate([getattr(s, f.name) for s in shards]) for f in fields(AchievedErrors))
    study = Study(chosen, AchievedErrors(*joined))
    write_png(draw_coverage(BASE_NAMES, study.achieved, study.z), folder / "study.png")
    content = {"format": FORMAT, "campaign_sha256": digest, **options, **_content(study)}
    write_atomically(folder / "study.json", json.dumps(content, indent=1, allow_nan=False) + "\n")
    return study


def _tasks(
    folder: Path,
    plan: Plan,
    mission: Mission,
    seed: int,
    campaigns: int,
) -> list[tuple]:
    """Arguments of `_shard`, for shards that hold all campaigns."""
    starts = range(0, campaigns, _SHARD_SIZE)
    spans = [range(i, min(i + _SHARD_SIZE, campaigns)) for i in starts]
    return [
        (folder / f"shard_{s.start:05d}_{s.stop:05d}.npz", plan, mission, seed, s) for s in spans
    ]


def _in_parallel(tasks: list[tuple], jobs: int) -> Iterator[AchievedErrors]:
    """The shards in order, each as soon as it is there."""
    backend, threads = ("loky", 1) if jobs > 1 else ("sequential", None)
    with joblib.parallel_config(backend, n_jobs=jobs, inner_max_num_threads=threads):
        yield from joblib.Parallel(return_as="generator")(
            joblib.delayed(_shard)(*task) for task in tasks
        )


def _shard(
    path: Path,
    plan: Plan,
    mission: Mission,
    seed: int,
    span: range,
) -> AchievedErrors:
    """Campaigns of these numbers, from their file or made and written."""
    if not path.exists():
        made = fit_simulated_campaigns(plan, mission, span, seed)
        arrays = {f.name: getattr(made, f.name) for f in fields(AchievedErrors)}

        def save(temporary: Path) -> None:
            with open(temporary, "wb") as file:
                np.savez(file, **arrays)

        write_atomically(path, save)
    with np.load(path) as stored:
        return AchievedErrors(**{f.name: stored[f.name] for f in fields(AchievedErrors)})


def _content(study: Study) -> dict[str, Any]:
    z, achieved = study.z, study.achieved
    rows = {}
    for i, name in enumerate(BASE_NAMES):
        rows[name] = {
            "achieved_sd": float(achieved.sd[i]),
            "achieved_sd_standard_error": float(achieved.sd_error[i]),
            "stated_sd": float(np.sqrt(np.mean(achieved.stated[:, i] ** 2))),
            "mean_z": float(z[:, i].mean()),
            "sd_z": float(np.sqrt(np.mean(z[:, i] ** 2))),
            "coverage": {f"{100 * level:.0f}": study.coverage(level)[i] for level in LEVELS},
        }
    return {
        "campaigns": len(z),
        "parameters": rows,
        "too_small": list(study.too_small),
        "reduced_chi2": float(achieved.chi2.mean()),
    }
