"""Which slews to fly: the plan that determines what is asked for, within all limits.

A thousand random plans are scored with the smooth information forecast. The best are improved with
exact derivatives of goal and limits, averaged over draws of J and K from what is known. The winner
is flown: margins of every limit come from closed-loop flights with noise, each with its own truth.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_inertia.design.after_campaign import plan_after
from bayes_inertia.design.design_setup import DesignSetup, set_up_design
from bayes_inertia.design.goals import Goal, parse_goal
from bayes_inertia.design.limits import Limits
from bayes_inertia.design.margins import Margin, broken_limits, flown_margins, planned_margins
from bayes_inertia.design.operator_plan import best_plan
from bayes_inertia.design.plan_arrays import slew_arrays
from bayes_inertia.design.plan_search import improved_plans, random_plans
from bayes_inertia.errors import DesignError
from bayes_inertia.flight.follow_on import spacecraft_at
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan, paper_like_plan
from bayes_inertia.flight.plan_flight import fly
from bayes_inertia.inference.laplace import Estimate

# A limit that a plan comes this close to, of what its reserve leaves, is active.
_ACTIVE_SLACK = 0.01


@dataclass(frozen=True)
class Design:
    """A designed plan and what to expect of it.

    Parameters
    ----------
    plan : Plan
        To be flown.
    goal : Goal
        What it was designed for.
    limits : Limits
        What it had to respect.
    seed : int
        Of the search.
    reference : Plan
        Slews like the paper's in the same time and limits.
    value : float
        The goal's number for the plan, geometric mean over draws of J and K, in the goal's unit.
    reference_value : float
        The same for `reference`.
    best_random : float
        The smallest number among the feasible random plans; NaN if there was none.
    random_plans : int
        How many of the random plans were feasible.
    sd : dict of str to float
        {parameter: expected sd} for the mean of what is known, of the motion as planned. It is
        right to 1 % for the goal. Of parameters that hardly any slew shows, real flights tell more,
        see `expected_sd`.
    reference_sd : dict of str to float
        The same for `reference`.
    sd_before : dict of str to float
        {parameter: sd} before the plan is flown: of the prior, or of the campaign that counts.
    units : dict of str to str
        {parameter: unit of its sds}.
    margins : tuple of Margin
        What the planned motion leaves of every limit.
    flown : tuple of Margin
        The tightest of flights in the closed loop with noise, truths drawn from what is known.
    active : tuple of str
        Limits that hold the design back.
    history : tuple of tuple of float
        The (smooth) number during each descent.
    seconds : float
        Wall time of the design [s].
    """

    plan: Plan
    goal: Goal
    limits: Limits
    seed: int
    reference: Plan
    value: float
    reference_value: float
    best_random: float
    random_plans: int
    sd: dict[str, float]
    reference_sd: dict[str, float]
    sd_before: dict[str, float]
    units: dict[str, str]
    margins: tuple[Margin, ...]
    flown: tuple[Margin, ...]
    active: tuple[str, ...]
    history: tuple[tuple[float, ...], ...]
    seconds: float

    @property
    def gain(self) -> float:
        """How many times smaller the goal's number is than for slews like the paper's."""
        return self.reference_value / self.value

    @property
    def kept(self) -> bool:
        """Whether every limit was kept, planned and in every flight."""
        return not broken_limits((*self.margins, *self.flown))


def design_plan(
    mission: Mission,
    goal: str | Goal = "cross_terms",
    limits: Limits | None = None,
    *,
    base: Plan | None = None,
    n_slews: int = 5,
    seed: int = 0,
    candidates: int = 1000,
    starts: int = 14,
    draws: int = 3,
    after: Estimate | None = None,
    effects: Sequence[str] = (),
) -> Design:
    """Design a campaign.

    Parameters
    ----------
    mission : Mission
        Wheels and sensors, and what is known of J; J and K are the prior's.
    goal : str or Goal, optional
        What to determine, see `parse_goal`.
    limits : Limits, optional
        None for a planned rate of 1 deg/s, in the time that slews like the paper's take.
    base : Plan, optional
        Start attitude, wheel momentum, telemetry, rests and orbit; None for those of
        `paper_like_plan`.
    n_slews : int, optional
        How many slews the plan has.
    seed : int, optional
        Of random plans, truths and flights.
    candidates : int, optional
        How many random plans are scored.
    starts : int, optional
        How many of the best are improved.
    draws : int, optional
        Of J and K that the goal is averaged over.
    after : Estimate, optional
        The fit of a campaign that was flown before. What it tells counts, and J and K are drawn
        from it.
    effects : sequence of str, optional
        Names of effects that are fitted along, see `effects_named`; at their null in the forecast.

    Returns
    -------
    Design
        The plan and what to expect of it.

    Raises
    ------
    DesignError
        If no plan keeps the limits; it says which one binds.
    CampaignError, EffectError
        If goal or effects are no good.

    Examples
    --------
    >>> from bayes_inertia.flight.mission import most_like_mission
    >>> design_plan(most_like_mission(), limits=Limits(total_time=100.0))
    Traceback (most recent call last):
    bayes_inertia.errors.DesignError: limit total time: 5 slews need at least 1570 s, 100 s allowed
    (1470 s too few); allow more time, or fewer slews
    """
    began, parsed_goal = time.perf_counter(), parse_goal(goal)
    limits = limits or Limits(rate=math.radians(1.0) / (1.0 - Limits().rate_reserve))
    base = base or paper_like_plan()
    base = replace(base, start_attitude=limits.start_attitude or base.start_attitude)
    setup = set_up_design(
        mission,
        parsed_goal,
        limits,
        base,
        n_slews,
        seed=seed,
        draws=draws,
        after=after,
        effects=effects,
    )
    x, log_values, least_slacks = random_plans(setup.problem, n_slews, candidates, seed)
    improved, history = improved_plans(setup.problem, x, log_values, least_slacks, starts)
    base = replace(base, name=f"{n_slews} slew{'s' if n_slews > 1 else ''} for {parsed_goal}")
    craft = setup.missions[0].spacecraft
    plan = best_plan(setup.problem, improved, base, craft, setup.limits)
    design = _judged(plan, setup, seed, log_values[least_slacks >= 0.0], history)
    return replace(design, seconds=time.perf_counter() - began)


def next_slew(
    estimate: Estimate,
    limits: Limits | None = None,
    goal: str | Goal = "cross_terms",
    *,
    seed: int = 0,
) -> Design:
    """The best single slew to fly after a campaign, given all that its telemetry tells.

    Parameters
    ----------
    estimate : Estimate
        The campaign's fit.
    limits : Limits, optional
        None for 1.1 times the campaign's largest rate and twice the time of its longest slew.
    goal : str or Goal, optional
        Any but `separate`, for which there is `separating_slew`.
    seed : int, optional
        Of the search.

    Returns
    -------
    Design
        With a plan of one slew that begins where the campaign ended.

    Raises
    ------
    DesignError
        If no slew keeps the limits, or the goal is `separate`.

    Examples
    --------
    It searches for seconds to minutes, so this is no doctest::

        estimate = optimizer.estimate(Model(read_campaign("my_campaign")))
        design = next_slew(estimate, Limits(rate=0.02, total_time=120.0), "cross_terms")
        design.plan.slews
    """
    campaign = estimate.model.campaign
    if parse_goal(goal).kind == "separate":
        raise DesignError(
            "is another question for a single slew",
            where="goal separate",
            advice="use separating_slew",
        )
    longest = max(slew.duration for slew in campaign.slews)
    limits = limits or Limits(rate=1.1 * campaign.largest_rate(), total_time=2.0 * longest)
    return design_plan(
        Mission(spacecraft_at(campaign, estimate.theta), campaign.inertia),
        goal,
        limits,
        base=plan_after(estimate),
        n_slews=1,
        seed=seed,
        after=estimate,
    )


def _judged(
    plan: Plan,
    setup: DesignSetup,
    seed: int,
    feasible: np.ndarray,
    history: tuple[tuple[float, ...], ...],
) -> Design:
    """The design with what to expect of its plan and of the reference.

    `feasible` (n,) are the logarithms of the goal's number of the feasible random plans.
    """
    problem, limits = setup.problem, setup.limits
    flights = [fly(plan, mission, seed + i) for i, mission in enumerate(setup.missions)]
    x, x_reference = (problem.variables(slew_arrays(p)) for p in (plan, setup.reference))
    slacks, layout = problem.least_slacks(x), problem.forecast.layout
    return Design(
        plan=plan,
        goal=problem.goal,
        limits=limits,
        seed=seed,
        reference=setup.reference,
        value=problem.value(x),
        reference_value=problem.value(x_reference),
        best_random=float(np.exp(feasible.min())) if len(feasible) else math.nan,
        random_plans=len(feasible),
        sd=problem.parameter_sd(x),
        reference_sd=problem.parameter_sd(x_reference),
        sd_before=problem.sd_before(),
        units=dict(zip(layout.names, layout.units, strict=True)),
        margins=planned_margins(plan, setup.missions[0].spacecraft, limits),
        flown=_tightest([flown_margins(flight, limits) for flight in flights]),
        active=tuple(name for name, slack in slacks.items() if slack < _ACTIVE_SLACK),
        history=history,
        seconds=0.0,
    )


def _tightest(margins: Sequence[tuple[Margin, ...]]) -> tuple[Margin, ...]:
    """The smallest margin of each limit over several flights."""
    return tuple(min(same, key=lambda m: m.left) for same in zip(*margins, strict=True))
