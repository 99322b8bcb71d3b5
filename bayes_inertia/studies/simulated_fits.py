"""Simulated campaigns of a plan, each fitted in full: what their errors say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from bayes_inertia.design.simulated_fits import AchievedErrors, fit_simulated_campaign
from bayes_inertia.errors import StudyError
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan
from bayes_inertia.progress import Progress
from bayes_inertia.studies.engine import Notice, run_work
from bayes_inertia.studies.work import Row, Work, WorkResult
from bayes_inertia.studies.workers import IN_PROCESS, Workers


@dataclass(frozen=True)
class SimulatedFit:
    """The task: fly a plan with a truth from the prior, and fit it."""

    plan: Plan
    mission: Mission

    def __call__(self, task_id: str, seed: np.random.SeedSequence) -> Row:
        """Errors and stated sds of one campaign."""
        return fit_simulated_campaign(self.plan, self.mission, seed)


def simulated_fits(
    plan: Plan,
    mission: Mission,
    campaigns: int | range,
    seed: int = 0,
    *,
    options: Mapping[str, Any] | None = None,
) -> Work:
    """Campaigns of one plan (how many, or which numbers) as the tasks of a study.

    Campaign i of two plans has the same truth for the same seed. `options` tell plan and mission
    from others where rows are kept in a folder.
    """
    numbers = range(campaigns) if isinstance(campaigns, int) else campaigns
    ids = tuple(str(number) for number in numbers)
    return Work("campaigns", SimulatedFit(plan, mission), ids, seed, options or {})


def achieved_errors(result: WorkResult, least: int = 1) -> AchievedErrors:
    """The rows of `simulated_fits` as arrays; StudyError if fewer than `least` could be fitted."""
    if len(result.rows) < least:
        raise StudyError(
            f"{len(result.rows)} campaigns could be fitted; the first that could not: "
            f"{result.failures[0].reason}",
            where="simulated campaigns",
            advice="look at the plan and at the campaign's prior",
        )
    return AchievedErrors(*(result.column(field.name) for field in fields(AchievedErrors)))


def fit_simulated_campaigns(
    work: Work,
    workers: Workers = IN_PROCESS,
    folder: Path | None = None,
    *,
    progress: Progress | None = None,
    notice: Notice | None = None,
) -> AchievedErrors:
    """Do the work of `simulated_fits`; StudyError if a campaign could not be fitted."""
    result = run_work(work, workers, folder, progress=progress, notice=notice)
    if result.failures:
        first, task = result.failures[0], work.task
        plan = f"{task.plan.name}, " if isinstance(task, SimulatedFit) else ""
        raise StudyError(
            f"{len(result.failures)} of {len(work.ids)} campaigns could not be fitted, the first "
            f"because of: {first.reason}",
            where=f"{plan}campaign {first.task}",
            advice="look at the plan and at the campaign's prior",
        )
    return achieved_errors(result)
