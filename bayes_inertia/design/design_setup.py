"""What a design searches for: the problem, its limits, the plan to compare with, the truths."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.design.after_campaign import forecast_after, missions_after
from bayes_inertia.design.expected_accuracy import likely_missions
from bayes_inertia.design.feasibility import require_feasible
from bayes_inertia.design.feasible_region import FeasibleRegion, region_within
from bayes_inertia.design.goals import Goal
from bayes_inertia.design.information_forecast import prepare_forecast
from bayes_inertia.design.limits import Limits, hardware_limits
from bayes_inertia.design.plan_problem import PlanProblem
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan, PlannedSlew, paper_like_plan
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.named_effects import effects_named
from bayes_inertia.physics.parameters import ParameterSpace

# The paper's angular acceleration [rad/s^2].
_PAPER_ACCELERATION = math.radians(0.05)
# By what factor, and how often at most, angles are reduced until a plan fits its time.
_REDUCTION, _MOST_REDUCTIONS = 0.93, 60
# Smallest angle [rad] of a slew like the paper's.
_SMALLEST_ANGLE = 1e-3


class DesignSetup(NamedTuple):
    """What a design searches for.

    Parameters
    ----------
    problem : PlanProblem
        Goal, forecast, truths and region.
    limits : Limits
        As asked for, with a total time.
    reference : Plan
        Slews like the paper's within the same limits.
    missions : list of Mission
        The truths to expect; the first is the mean of what is known.
    """

    problem: PlanProblem
    limits: Limits
    reference: Plan
    missions: list[Mission]


def set_up_design(
    mission: Mission,
    goal: Goal,
    limits: Limits,
    base: Plan,
    n_slews: int,
    *,
    seed: int,
    draws: int,
    after: Estimate | None = None,
    effects: Sequence[str] = (),
) -> DesignSetup:
    """Set up the search for a plan.

    Parameters
    ----------
    mission : Mission
        Wheels, sensors and prior.
    goal : Goal
        What the plan is to determine.
    limits : Limits
        What it must respect; without a total time, that of slews like the paper's is taken.
    base : Plan
        Start, telemetry and rests; its slews are not used.
    n_slews : int
        How many slews the plan has.
    seed : int
        Of the truths.
    draws : int
        How many truths.
    after : Estimate, optional
        The fit of a campaign flown before; what it tells counts.
    effects : sequence of str, optional
        Names of effects that are fitted along.

    Returns
    -------
    DesignSetup
        What `improved_plans` needs.

    Raises
    ------
    DesignError
        If no plan can keep the limits.
    """
    spacecraft = mission.spacecraft
    known = np.array(spacecraft.rate_sensor.scale_factor_sigma) if after is None else after.sd[6:9]
    region = region_within(
        limits, hardware_limits(spacecraft), scale_factor_sigma=float(np.max(known))
    )
    if limits.total_time is None:
        like = paper_like_reference(base, region, n_slews, math.inf)
        limits = replace(limits, total_time=like.starts[-1] + like.durations[-1])
    total_time = limits.total_time or math.inf
    region = region._replace(time=total_time)
    require_feasible(spacecraft, base, region, limits, n_slews)
    reference = paper_like_reference(base, region, n_slews, total_time)
    fitted = effects_named(tuple(dict.fromkeys((*goal.effects, *effects))))
    goal = replace(goal, effects=tuple(e.name for e in fitted[: len(goal.effects)]))
    forecast = prepare_forecast(reference, mission, fitted)
    if after is None:
        missions = likely_missions(reference, mission, draws, seed)
    else:
        missions = missions_after(after, draws, seed)
        forecast = forecast_after(forecast, after)
    nulls = _nulls(fitted, planned_campaign(reference, mission.without_effects()))
    thetas = np.array([np.concatenate([truth.theta, nulls]) for truth in missions])
    end = None if limits.end_attitude is None else np.array(limits.end_attitude)
    return DesignSetup(
        PlanProblem(goal, forecast, thetas, region, end), limits, reference, missions
    )


def _nulls(effects: tuple[Effect, ...], campaign: Campaign) -> np.ndarray:
    """The values (d,) at which effects do nothing."""
    named = tuple((e.name, p) for e in effects for p in e.parameters(campaign))
    return ParameterSpace(named).nulls


def paper_like_reference(base: Plan, region: FeasibleRegion, n: int, total_time: float) -> Plan:
    """Slews about the paper's axes at the largest rate, with its gentle ramps.

    Parameters
    ----------
    base : Plan
        Start, telemetry and rests; its slews are not used.
    region : FeasibleRegion
        It holds largest rate, acceleration and angle.
    n : int
        How many slews.
    total_time : float
        What the plan may last [s]; angles are reduced until it fits.

    Returns
    -------
    Plan
        The plan with the largest angles that fit, or with very small ones if none do.
    """
    paper = [paper_like_plan().slews[i % 5] for i in range(n)]
    acceleration = min(_PAPER_ACCELERATION, region.acceleration)
    share = 1.0
    for _ in range(_MOST_REDUCTIONS):
        angles = [max(min(share * s.angle, region.angles[1]), _SMALLEST_ANGLE) for s in paper]
        slews = tuple(
            PlannedSlew(slew.axis_B, angle, rate=region.rate, acceleration=acceleration)
            for slew, angle in zip(paper, angles, strict=True)
        )
        plan = replace(base, name=f"{n} slews like the paper's", slews=slews)
        if plan.starts[-1] + plan.durations[-1] <= total_time + 1e-9:
            break
        share *= _REDUCTION
    return plan
