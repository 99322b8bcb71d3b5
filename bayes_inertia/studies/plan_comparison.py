"""Plans side by side: what to expect of each, what simulated campaigns of it achieve, each fitted
in full, and what they cost.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import joblib
import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.design.comparison import (
    AchievedErrors,
    Contender,
    assess_plan,
    fit_simulated_campaign,
)
from bayes_inertia.design.limits import Limits
from bayes_inertia.errors import StudyError, members, require
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan
from bayes_inertia.maths.values import whole_number
from bayes_inertia.progress import Progress, as_callback, with_bar
from bayes_inertia.studies.engine import Notice, run_work
from bayes_inertia.studies.work import Row, Work, WorkResult
from bayes_inertia.studies.workers import IN_PROCESS, Engine, Workers, open_workers

_LOOK = "look at the plan and at the campaign's prior"


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
    campaigns: int,
    seed: int = 0,
    *,
    options: Mapping[str, Any] | None = None,
) -> Work:
    """So many campaigns of one plan as the tasks of a study.

    Campaign i of two plans has the same truth for the same seed. `options` tell plan and mission
    from others where rows are kept in a folder.
    """
    ids = tuple(map(str, range(campaigns)))
    return Work("campaigns", SimulatedFit(plan, mission), ids, seed, options or {})


def achieved_errors(result: WorkResult, least: int = 1) -> AchievedErrors:
    """The rows of `simulated_fits` as arrays; StudyError if fewer than `least` could be fitted."""
    if (fitted := len(result.rows)) < least:
        first = result.failures[0].reason
        what = f"{fitted} campaigns could be fitted; the first that could not: {first}"
        raise StudyError(what, where="simulated campaigns", advice=_LOOK)
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
        failed = f"{len(result.failures)} of {len(work.ids)} campaigns could not be fitted"
        what = f"{failed}, the first because of: {first.reason}"
        raise StudyError(what, where=f"{plan}campaign {first.task}", advice=_LOOK)
    return achieved_errors(result)


@with_bar
def compare_plans(
    plans: Sequence[Plan] | Mapping[str, Plan],
    mission: Mission | Campaign,
    *,
    limits: Limits | None = None,
    simulated: int = 0,
    seed: int = 0,
    jobs: int = 1,
    engine: Engine | None = None,
    scheduler: str | None = None,
    folder: str | Path | None = None,
    progress: Progress | bool | None = None,
    notice: Notice | None = None,
) -> tuple[Contender, ...]:
    """Compare plans of one mission.

    Parameters
    ----------
    plans : sequence of Plan, or mapping of str to Plan
        Under their own names, or under those given.
    mission : Mission or Campaign
        Wheels and sensors, J to expect, and how well it is known; or a campaign that states them.
    limits : Limits, optional
        None for those of the hardware alone.
    simulated : int, optional
        Campaigns to fly and fit in full for each plan, each with its own J, K and bias from the
        prior; all plans meet the same.
    seed : int, optional
        Of those.
    jobs : int, optional
        How many processes share the work.
    engine : {"process", "joblib", "dask"} or None, optional
        Where campaigns are fitted; None for this process or joblib's, by `jobs`.
    scheduler : str or None, optional
        Address of a dask scheduler.
    folder : str or Path or None, optional
        Where fits are kept, so that a comparison that was killed goes on.
    progress : bool or callable, optional
        True for a bar; or called with (stage, done, of), `of` 0 where a stage is not counted.
    notice : callable or None, optional
        Called with what should be known of files and failures.

    Returns
    -------
    tuple of Contender
        In the order of the plans.

    Raises
    ------
    CampaignError
        If there is no plan, or two have one name.
    StudyError
        If a campaign could not be fitted, or the workers are lost.

    Examples
    --------
    >>> from bayes_inertia.flight.mission import most_like_mission
    >>> compare_plans([], most_like_mission())
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: plans: no plan to compare; give each its own name
    """
    seed, folder = whole_number(seed, "seed"), None if folder is None else Path(folder)
    plans = plans if isinstance(plans, Mapping) else members(plans, Plan, "key plans")
    named = dict(plans) if isinstance(plans, Mapping) else {plan.name: plan for plan in plans}
    what = "no plan to compare" if not named else "two plans have one name"
    known_apart = bool(named) and len(named) == len(plans)
    require(known_apart, "plans", what, "give each its own name")
    mean = Mission.of(mission).at_prior_mean()
    mean = replace(mean, spacecraft=replace(mean.spacecraft, bias=None))
    limits = limits or Limits(angle=None)
    contenders = list[Contender]()
    if not simulated:
        for name, plan in named.items():
            as_callback(progress)("flying each once, plans", len(contenders), len(named))
            contenders.append(assess_plan(name, plan, mean, limits, seed=seed))
        return tuple(contenders)
    callbacks: dict[str, Any] = {"progress": as_callback(progress), "notice": notice}
    with open_workers(engine, jobs, scheduler) as workers:
        for name, plan in named.items():
            digests = {"plan": joblib.hash(plan), "mission": joblib.hash(mean)}
            work = simulated_fits(plan, mean, simulated, seed, options=digests)
            kept_in = None if folder is None else folder / digests["plan"]
            achieved = fit_simulated_campaigns(work, workers, kept_in, **callbacks)
            contenders.append(assess_plan(name, plan, mean, limits, seed=seed, achieved=achieved))
    return tuple(contenders)
