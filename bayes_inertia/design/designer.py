"""Which slews to fly: the plan that determines what is asked for, within all limits.

A thousand random plans are scored in batches with the smooth information forecast. The best are
improved by sequential quadratic programming with exact derivatives of goal and limits, averaged
over draws of J and K from what is known. The winner is flown: margins of every limit come from
closed-loop flights with noise, each with its own truth. The plan is in digits that an operator can
read. A plan's design variables are (slews, 5) as in `feasible_region`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import optimize

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.design.after_campaign import forecast_after, mission_after, plan_after
from bayes_inertia.design.comparison import likely_missions
from bayes_inertia.design.feasible_region import (
    FeasibleRegion,
    draw_variables,
    is_driven,
    region_within,
    require_feasible,
    strongest_ramps,
)
from bayes_inertia.design.goals import Goal, parse_goal, require_goal
from bayes_inertia.design.information_forecast import planned_model, prepare_forecast
from bayes_inertia.design.limits import Limits, hardware_limits, limits_of_next_slew
from bayes_inertia.design.margins import Margin, broken_limits, flown_margins, planned_margins
from bayes_inertia.design.numerics import NUMERICS
from bayes_inertia.design.plan_problem import PlanProblem
from bayes_inertia.design.result import Design
from bayes_inertia.errors import DesignError, members, require, require_kind
from bayes_inertia.flight.mission import Mission, following_plan
from bayes_inertia.flight.plan import Plan, PlannedSlew, paper_like_plan
from bayes_inertia.flight.plan_flight import fly
from bayes_inertia.flight.planned_motion import RigidBody, planned_slews, rigid_body, slew_arrays
from bayes_inertia.flight.spacecraft import Spacecraft
from bayes_inertia.inference.laplace import Estimate, model_of
from bayes_inertia.maths.printed import counted
from bayes_inertia.maths.values import whole_number
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.named_effects import effects_named
from bayes_inertia.progress import Progress, as_callback, silent, with_bar


def random_plans(
    problem: PlanProblem, slews: int, n: int, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random plans with their scores.

    Returns `x` (n, slews, 5); `log_values` (n,): logarithm of the goal's number of each; infinite
    where it is no number; `least_slacks` (n,): the least that each leaves of any limit.
    """
    rng = np.random.default_rng([seed, 7])
    body = problem.forecast.body(problem.thetas[0])
    x = draw_variables(rng, n, slews, problem.region, problem.forecast.layout.times, body)
    return x, *_scored(problem, x)


def _scored(problem: PlanProblem, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of each plan the logarithm of the goal's number, and the least that it leaves of any limit.

    `x` (n, slews, 5). Returns (n,), infinite where it is no number, and (n,).
    """
    values, slacks, *_ = problem.score(x)
    least = [part.reshape(len(x), -1).min(axis=1, initial=np.inf) for part in slacks.values()]
    return np.where(np.isfinite(values), values, np.inf), np.min(least, axis=0)


def _best_first(log_values: np.ndarray, least_slacks: np.ndarray) -> np.ndarray:
    """Order of plans: feasible ones by the goal's number, then the nearest misses."""
    return np.lexsort((log_values, -np.minimum(least_slacks, 0.0)))


def improved_plan(
    problem: PlanProblem, x: np.ndarray, steps: int, truths: int
) -> tuple[np.ndarray, tuple[float, ...]]:
    """A plan improved by sequential quadratic programming (Kraft 1988).

    `x` (slews, 5). `truths`: over how many of the first truths the goal is averaged. Returns `x`
    (slews, 5): design variables of the improved plan; `history`: the smooth goal's number at every
    evaluation.
    """
    shape, history = x.shape, []

    def value(flat: np.ndarray) -> tuple[float, np.ndarray]:
        log_value, gradient = problem.log_value_and_gradient(flat.reshape(shape), truths)
        history.append(float(np.exp(log_value)))
        return log_value, gradient.ravel()

    def slacks(flat: np.ndarray) -> np.ndarray:
        values = problem.slacks_and_jacobian(flat.reshape(shape))[0]
        return np.minimum(values, NUMERICS.unlimited_slack) - NUMERICS.limit_clearance

    def jacobian(flat: np.ndarray) -> np.ndarray:
        slopes = problem.slacks_and_jacobian(flat.reshape(shape))[1]
        return np.nan_to_num(slopes).reshape(-1, flat.size)

    fractions = [(smallest, 1.0) for smallest in NUMERICS.smallest_fractions]
    optimum = optimize.minimize(
        value,
        x.ravel(),
        jac=True,
        method="SLSQP",
        bounds=([(-np.pi, np.pi)] * 3 + fractions) * len(x),
        constraints={"type": "ineq", "fun": slacks, "jac": jacobian},
        options={"maxiter": steps, "ftol": 1e-5},
    )
    return optimum.x.reshape(shape), tuple(history)


def improved_plans(
    problem: PlanProblem,
    x: np.ndarray,
    log_values: np.ndarray,
    least_slacks: np.ndarray,
    starts: int,
    say: Progress = silent,
) -> tuple[list[np.ndarray], tuple[tuple[float, ...], ...]]:
    """Plans improved from the best of random ones.

    `x` (n, slews, 5); `log_values` (n,); `least_slacks` (n,). Returns `plans` (slews, 5): best
    first. The first is the best one, improved once more over all truths; `histories`: the smooth
    goal's number during each descent.
    """
    order = _best_first(log_values, least_slacks)[:starts]
    descents: list[tuple[np.ndarray, tuple[float, ...]]] = []
    for k in order:
        say("improving the best, plans", len(descents), len(order) + 1)
        descents.append(improved_plan(problem, x[k], NUMERICS.descent_steps, 1))
    say("improving the best, plans", len(order), len(order) + 1)
    scores = _scored(problem, np.array([plan for plan, _ in descents]))
    best = [descents[k][0] for k in _best_first(*scores)]
    final = improved_plan(problem, best[0], NUMERICS.descent_steps, len(problem.thetas))
    return [final[0], *best], (*(history for _, history in descents), final[1])


@with_bar
def design_plan(
    mission: Mission | Campaign | Model | Estimate,
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
    progress: Progress | bool | None = None,
) -> Design:
    """Design a campaign.

    Parameters
    ----------
    mission : Mission, Campaign, Model or Estimate
        Wheels and sensors, and what is known of J; J and K are the prior's. After a campaign the
        plan begins where it ended; after an estimate, what the campaign tells counts too.
    goal : str or Goal, optional
        What to determine, see `parse_goal`.
    limits : Limits, optional
        None for a planned rate of 1 deg/s, in the time that slews like the paper's take.
    base : Plan, optional
        How the plan starts, telemetry, rests and orbit; None for those of the
        campaign, without one of `paper_like_plan`.
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
    progress : bool or callable, optional
        True for a bar; or called with (stage, done, of), `of` 0 where a stage is not counted.

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
    began, parsed_goal, seed = time.perf_counter(), parse_goal(goal), whole_number(seed, "seed")
    limits = _checked(limits, base, after, (n_slews, candidates, starts, draws))
    mission, base, after = _begin(mission, base, after)
    say = as_callback(progress)
    say("preparing the forecast", 0, 0)
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
        effects=members(effects, str, "key effects"),
    )
    say(f"scoring {candidates} random plans", 0, 0)
    x, log_values, least_slacks = random_plans(setup.problem, n_slews, candidates, seed)
    improved, history = improved_plans(setup.problem, x, log_values, least_slacks, starts, say)
    base = replace(base, name=f"{counted(n_slews, 'slew')} for {parsed_goal}")
    plan = best_plan(setup.problem, improved, base, setup.missions[0].spacecraft, setup.limits)
    say("flying the plan", 0, 0)
    design = _judged(plan, setup, seed, log_values[least_slacks >= 0.0], history)
    return replace(design, seconds=time.perf_counter() - began)


def _checked(
    limits: Limits | None, base: Plan | None, after: Estimate | None, counts: tuple[int, ...]
) -> Limits:
    """The limits, if any; an error for what is no count, or of another kind."""
    for key, count in zip(("n_slews", "candidates", "starts", "draws"), counts, strict=True):
        whole_number(count, key, 1)
    require_kind(limits, Limits | None, "key limits")
    require_kind(base, Plan | None, "key base")
    require_kind(after, Estimate | None, "key after")
    return limits or Limits(rate=NUMERICS.default_rate / (1.0 - Limits().rate_reserve))


def _begin(
    source: Mission | Campaign | Model | Estimate, base: Plan | None, after: Estimate | None
) -> tuple[Mission, Plan, Estimate | None]:
    """The mission, where its plan begins, and the fit that counts, of whatever was given."""
    if isinstance(source, Mission):
        mission, plan = source, paper_like_plan()
        if len(mission.spacecraft.wheels) != len(plan.wheel_momentum):
            plan = replace(plan, wheel_momentum=())
    else:
        after = after or (source if isinstance(source, Estimate) else None)
        campaign = model_of(source).campaign
        mission = Mission.of(campaign)
        plan = following_plan(campaign) if after is None else plan_after(after)
    return mission, base or plan, after


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
        None for 1.1 times the campaign's largest rate (1 deg/s if it rested) and twice the time of
        its longest slew.
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
    require_kind(estimate, Estimate, "key estimate")
    require_kind(limits, Limits | None, "key limits")
    single = parse_goal(goal).kind != "separate"
    what = "is another question for a single slew"
    require(single, "goal separate", what, "use separating_slew", error=DesignError)
    limits = limits or limits_of_next_slew(estimate.model.campaign)
    base = plan_after(estimate)
    return design_plan(estimate, goal, limits, base=base, n_slews=1, seed=seed)


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
    both = np.array([problem.variables(slew_arrays(p)) for p in (plan, setup.reference)])
    x, x_reference = both
    slacks, layout = problem.least_slacks(x), problem.forecast.layout
    # Those that `assess_plan` flies.
    drawn = likely_missions(plan, setup.missions[0], NUMERICS.expected_flights + 1, 1)[1:]
    sd, reference_sd = problem.parameter_sds(both, np.array([m.theta for m in drawn]))
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
        sd=sd,
        reference_sd=reference_sd,
        sd_before=problem.sd_before(),
        units=dict(zip(layout.names, layout.units, strict=True)),
        margins=planned_margins(plan, setup.missions[0].spacecraft, limits),
        flown=_tightest([flown_margins(flight, limits) for flight in flights]),
        active=tuple(name for name, slack in slacks.items() if slack < NUMERICS.active_slack),
        history=history,
        seconds=0.0,
    )


def _tightest(margins: Sequence[tuple[Margin, ...]]) -> tuple[Margin, ...]:
    """The smallest margin of each limit over several flights."""
    return tuple(min(same, key=lambda m: m.left) for same in zip(*margins, strict=True))


class DesignSetup(NamedTuple):
    """Task of a design."""

    problem: PlanProblem  # goal, forecast, truths and region
    limits: Limits  # as asked for, with a total time
    reference: Plan  # slews like the paper's within the same limits
    missions: list[Mission]  # the truths to expect; the first is the mean of what is known


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

    `limits`: what it must respect; without a total time, that of slews like the paper's is taken.
    `base`: start, telemetry and rests; its slews are not used. `after`: the fit of a campaign flown
    before; what it tells counts, and J, K and noise are as it found them.
    """
    mission = mission if after is None else mission_after(mission, after)
    spacecraft = mission.spacecraft
    region = _region(mission, goal, limits)
    body = rigid_body(mission.at_prior_mean().spacecraft)
    if limits.total_time is None:
        like = paper_like_reference(base, region, n_slews, math.inf, body)
        limits = replace(limits, total_time=like.starts[-1] + like.durations[-1])
    total_time = limits.total_time or math.inf
    region = region._replace(time=total_time)
    require_feasible(spacecraft, base, region, limits, n_slews)
    reference = paper_like_reference(base, region, n_slews, total_time, body)
    fitted = effects_named(tuple(dict.fromkeys((*goal.effects, *effects))))
    goal = replace(goal, effects=tuple(e.name for e in fitted[: len(goal.effects)]))
    forecast = prepare_forecast(reference, mission, fitted)
    forecast = forecast if after is None else forecast_after(forecast, after)
    missions = likely_missions(reference, mission, draws, seed)
    rest = planned_model(reference, mission, fitted).expected
    n_base = len(mission.theta)
    thetas = np.array([np.concatenate([truth.theta, rest[n_base:]]) for truth in missions])
    end = None if limits.end_attitude is None else np.array(limits.end_attitude)
    return DesignSetup(
        PlanProblem(goal, forecast, thetas, region, end), limits, reference, missions
    )


def _region(mission: Mission, goal: Goal, limits: Limits) -> FeasibleRegion:
    """Where a goal's plans may lie, or `CampaignError` where the goal is not for the spacecraft."""
    n_base = len(mission.theta)
    require_goal(goal, n_base)
    largest = float(np.max(mission.base.sd[6:n_base], initial=0.0))
    return region_within(limits, hardware_limits(mission.spacecraft), scale_factor_sigma=largest)


def paper_like_reference(
    base: Plan, region: FeasibleRegion, n: int, total_time: float, body: RigidBody
) -> Plan:
    """Slews about the paper's axes at the largest rate, with its gentle ramps, that can be driven.

    `base`: start, telemetry and rests; its slews are not used. `total_time`: what the plan may last
    [s]. Rates and ramps are reduced until wheels can drive them, and angles until the plan fits its
    time, or where no rate is slow enough. Returns: the plan with the largest that fit, or with very
    small ones if none do. Where the start alone asks too much of wheels, only the time counts.
    """
    paper = [paper_like_plan().slews[i % 5] for i in range(n)]
    axes_B = np.array([slew.axis_B for slew in paper])
    ramps = np.minimum(strongest_ramps(axes_B, region, body), NUMERICS.paper_acceleration)

    def reduced(share: float, pace: float) -> Plan:
        slews = tuple(
            PlannedSlew(
                slew.axis_B,
                max(min(share * slew.angle, region.angles[1]), NUMERICS.paper_smallest_angle),
                pace * region.rate,
                pace * ramp,
            )
            for slew, ramp in zip(paper, ramps.tolist(), strict=True)
        )
        return replace(base, name=f"{counted(n, 'slew')} like the paper's", slews=slews)

    plan, share, pace = reduced(1.0, 1.0), 1.0, 1.0
    slowest, _ = NUMERICS.smallest_fractions
    smallest = reduced(0.0, slowest).slews
    still = tuple(replace(slew, angle=NUMERICS.negligible_angle) for slew in smallest)
    in_vain = not is_driven(replace(plan, slews=still), region, body)  # the start breaks a limit
    for _ in range(2 * NUMERICS.most_reductions):
        driven = in_vain or is_driven(plan, region, body)
        in_time = plan.starts[-1] + plan.durations[-1] <= total_time + 1e-9
        if driven and in_time:
            break
        slower_helps = not driven and is_driven(reduced(share, slowest), region, body)
        pace *= NUMERICS.reduction if slower_helps else 1.0
        share *= 1.0 if in_time and (driven or slower_helps) else NUMERICS.reduction
        plan = reduced(share, pace)
    return plan


def best_plan(
    problem: PlanProblem,
    candidates: Sequence[np.ndarray],
    base: Plan,
    spacecraft: Spacecraft,
    limits: Limits,
) -> Plan:
    """The first of several plans that keeps all limits, in an operator's digits.

    `candidates` (slews, 5). `base`: name, start, telemetry and rests; its slews are not used.
    Returns: with rounded slews if these keep the limits, else with exact ones.
    """
    nearest = (-math.inf, "", base)
    for x in candidates:
        exact = planned_slews(problem.slews(x))
        for slews in (rounded_slews(exact, problem), exact):
            plan = replace(base, slews=slews)
            slacks = problem.least_slacks(problem.variables(slew_arrays(plan)))
            binding = min(slacks, key=slacks.__getitem__)
            enough = slacks[binding] >= -NUMERICS.rounding_slack
            if enough and not broken_limits(planned_margins(plan, spacecraft, limits)):
                return plan
            nearest = max(nearest, (slacks[binding], binding, plan), key=lambda n: n[0])
    slack, binding, plan = nearest
    margins = planned_margins(plan, spacecraft, limits)
    said = [m.says for m in margins if m.limit.startswith(binding.removeprefix("wheel "))]
    what = "no plan was found that keeps it; the nearest misses it, with its reserve, by"
    what += f" {-100 * slack:.2g} %" + (f" ({said[0]})" if said else "")
    advice = "loosen it, or ask for fewer slews or more time"
    raise DesignError(what, where=f"limit {binding}", advice=advice)


def rounded_slews(slews: Sequence[PlannedSlew], problem: PlanProblem) -> tuple[PlannedSlew, ...]:
    """Slews with axes to 3 digits, angles to 0.1 deg, rates and accelerations rounded down.

    `problem`: where it says how the plan ends, the last slew stays exact.
    """
    out = [
        PlannedSlew(
            (round(x, 3) + 0.0, round(y, 3) + 0.0, round(z, 3) + 0.0),
            max(_rounded_down(slew.angle, 1), math.radians(0.1)),
            _rounded_down(slew.rate, 3) or slew.rate,
            _rounded_down(slew.acceleration, 4) or slew.acceleration,
        )
        for slew in slews
        for x, y, z in [slew.axis_B]
    ]
    if problem.end_attitude is not None:
        x = problem.variables(slew_arrays(replace(paper_like_plan(), slews=tuple(out))))
        out[-1] = planned_slews(problem.slews(x))[-1]
    return tuple(out)


def _rounded_down(value: float, digits: int) -> float:
    """A value [rad, or with time] rounded down to digits after the point in degrees."""
    return math.radians(math.floor(math.degrees(value) * 10**digits + 1e-9) / 10**digits)
