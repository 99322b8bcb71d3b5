"""Which slews to fly: the plan that determines what is asked for, within all limits.

Thousands of random plans are scored with the smooth forecast of `forecast`, the best are improved with exact derivatives of
criterion and limits (`search`), averaged over draws of J and K from what is known. The winner is flown:
margins of every limit come from closed-loop flights with noise, each with its own truth.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_inertia.design.after_campaign import plan_after
from bayes_inertia.design.feasible_region import FeasibleRegion, region_within
from bayes_inertia.design.goals import Goal, parse_goal
from bayes_inertia.design.information import Forecast, forecast
from bayes_inertia.design.limits import Limits, hardware_limits
from bayes_inertia.design.margins import Margin, broken_limits, flown_margins, planned_margins
from bayes_inertia.design.plan_search import (
    PlanProblem,
    improved_plans,
    random_plans,
)
from bayes_inertia.design.planned_motion import planned_slews, slew_arrays
from bayes_inertia.design.rehearsal import likely_truths
from bayes_inertia.errors import DesignError
from bayes_inertia.flight.follow_on import spacecraft_at
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan, PlannedSlew, paper_like_plan
from bayes_inertia.flight.plan_flight import fly
from bayes_inertia.flight.spacecraft import Spacecraft, spin_tensor
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.objective import N_BIAS
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.linear_algebra import inverse
from bayes_inertia.maths.physical_draws import draw_physical
from bayes_inertia.physics.effects import by_name

# A limit that a plan comes this close to, of what its reserve leaves, is active.
_ACTIVE = 0.01
# How far rounding to an operator's digits may reach into a reserve [fraction of the limit].
_SLACK = 2e-3


@dataclass(frozen=True)
class Design:
    """A designed plan and what to expect of it.

    Attributes
    ----------
    plan, goal, limits, seed : what was designed, for what. reference : slews like the paper's in the same time and limits.
    value, reference_value : the goal's number for both, geometric mean over draws of J and K.
    best_random : the smallest number among the `random_plans` feasible ones that were scored.
    sd, reference_sd : {parameter: expected sd} for the mean of what is known, by the forecast: of the motion as planned.
        It is right to 1 % for the goal; of parameters that hardly any slew shows, real flights tell more (`expectation.expected_sd`).
    margins : planned; flown : the tightest of flights in the closed loop with noise, truths drawn from what is known.
    active : limits that hold the design back. history : the (smooth) number during each search. seconds : all this took.
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
) -> Design:
    """Design a campaign.

    Parameters
    ----------
    mission : wheels and sensors, and what is known of J (J and K are the prior's).
    goal : see `criterion.goal`. limits : None for a planned rate of 1 deg/s, in the time that slews like the paper's take.
    base : start attitude, wheel momentum, telemetry, rests and orbit; None for those of `paper_like_plan`.
    candidates : random plans. starts : how many of the best are improved. draws : of J and K that the criterion is averaged over.
    after : the estimate of a campaign that was flown before; what it tells counts, and J and K are drawn from it.

    Raises
    ------
    DesignError : no plan keeps the limits (it says which binds). CampaignError, EffectError : goal or effects are no good.

    >>> from bayes_inertia.flight.mission import most_like_mission
    >>> design_plan(most_like_mission(), limits=Limits(total_time=100.0))
    Traceback (most recent call last):
    bayes_inertia.errors.DesignError: limit total time: 5 slews need at least 1570 s, 100 s allowed (1470 s too few); allow more time, or fewer slews
    """
    began, wanted = time.perf_counter(), parse_goal(goal)
    limits = limits or Limits(rate=math.radians(1.0) / (1.0 - Limits().rate_reserve))
    base = base or paper_like_plan()
    base = replace(base, start_attitude=limits.start_attitude or base.start_attitude)
    problem, limits, reference, truths = problem_for(
        mission, wanted, limits, base, n_slews, seed, draws, after
    )
    x, values, left = random_plans(problem, n_slews, candidates, seed)
    found, history = improved_plans(problem, x, values, left, starts)
    plan = _best_plan(
        problem,
        found,
        base,
        truths[0].spacecraft,
        limits,
        f"{n_slews} slew{'s' if n_slews > 1 else ''} for {wanted}",
    )
    flights = [fly(plan, truth, seed + i) for i, truth in enumerate(truths)]
    numbers = [problem.variables(slew_arrays(p)) for p in (plan, reference)]
    feasible = values[left >= 0.0]
    return Design(
        plan=plan,
        goal=wanted,
        limits=limits,
        seed=seed,
        reference=reference,
        value=problem.value(numbers[0]),
        reference_value=problem.value(numbers[1]),
        best_random=float(np.exp(feasible.min())) if len(feasible) else math.nan,
        random_plans=len(feasible),
        sd=problem.parameter_sd(numbers[0]),
        reference_sd=problem.parameter_sd(numbers[1]),
        margins=planned_margins(plan, truths[0].spacecraft, limits),
        flown=_tightest([flown_margins(flight, limits) for flight in flights]),
        active=tuple(
            name for name, left in problem.least_slacks(numbers[0]).items() if left < _ACTIVE
        ),
        history=history,
        seconds=time.perf_counter() - began,
    )


def next_slew(
    at: Estimate, limits: Limits | None = None, goal: str | Goal = "cross_terms", *, seed: int = 0
) -> Design:
    """The best single slew to fly after a campaign, given all that its telemetry tells.

    Parameters
    ----------
    at : the campaign's estimate. limits : None for the campaign's own largest rate and twice the time of its longest slew. goal : but
        `separate`, for which there is `separation.separating_slew`.

    Raises
    ------
    DesignError : no slew keeps the limits, or the goal is `separate`.
    """
    campaign = at.model.campaign
    if parse_goal(goal).kind == "separate":
        raise DesignError(
            "is another question for a single slew",
            where="goal separate",
            advice="use separating_slew",
        )
    limits = limits or Limits(
        rate=1.1 * campaign.largest_rate(), total_time=2.0 * max(s.duration for s in campaign.slews)
    )
    return design_plan(
        Mission(spacecraft_at(campaign, at.theta), campaign.inertia),
        goal,
        limits,
        base=plan_after(at),
        n_slews=1,
        seed=seed,
        candidates=1000,
        after=at,
    )


def problem_for(
    mission: Mission,
    wanted: Goal,
    limits: Limits,
    base: Plan,
    n: int,
    seed: int,
    draws: int,
    after: Estimate | None = None,
) -> tuple[PlanProblem, Limits, Plan, list[Mission]]:
    """What `design` searches for: the problem, the limits with their time, the reference plan, and the truths to expect; arguments as there."""
    spacecraft = mission.spacecraft
    known = np.array(spacecraft.rate_sensor.scale_factor_sigma) if after is None else after.sd[6:9]
    region = region_within(
        limits, hardware_limits(spacecraft), scale_factor_sigma=float(np.max(known))
    )
    if limits.total_time is None:
        like = _like_paper(base, region, n, math.inf)
        limits = replace(limits, total_time=like.starts[-1] + like.durations[-1])
        region = region._replace(time=limits.total_time)
    _possible(spacecraft, base, region, limits, n)
    reference = _like_paper(base, region, n, limits.total_time)
    ahead = forecast(reference, mission, by_name(wanted.effects))
    truths = (
        likely_truths(reference, mission, draws, seed)
        if after is None
        else _truths_after(after, draws, seed)
    )
    ahead = ahead if after is None else _told(ahead, after)
    nothing = np.zeros(len(ahead.shape.names) - 9)
    thetas = np.array([np.concatenate([truth.theta, nothing]) for truth in truths])
    end = None if limits.end_attitude is None else np.array(limits.end_attitude)
    return PlanProblem(wanted, ahead, thetas, region, end), limits, reference, truths


def _like_paper(base: Plan, region: FeasibleRegion, n: int, total: float) -> Plan:
    """n slews about the paper's axes at the largest rate, with its gentle ramps, of angles that fit the time."""
    paper = [paper_like_plan().slews[i % 5] for i in range(n)]
    settings = {"rate": region.rate, "acceleration": min(math.radians(0.05), region.acceleration)}
    share = 1.0
    for _ in range(60):
        slews = tuple(
            PlannedSlew(s.axis_B, max(min(share * s.angle, region.angles[1]), 1e-3), **settings)
            for s in paper
        )
        plan = replace(base, name=f"{n} slews like the paper's", slews=slews)
        if plan.starts[-1] + plan.durations[-1] <= total + 1e-9:
            return plan
        share *= 0.93
    return plan


def _possible(
    spacecraft: Spacecraft, base: Plan, region: FeasibleRegion, limits: Limits, n: int
) -> None:
    """Raise for what no plan can keep, before any search."""
    axes = np.linalg.matrix_rank(spacecraft.wheel_axes_B, tol=1e-6) if spacecraft.wheels else 0
    if axes < 3:
        raise DesignError(
            f"the wheels turn the spacecraft about {axes} of three axes",
            where="wheels",
            advice="slews are designed for three",
        )
    least = PlannedSlew((1.0, 0.0, 0.0), region.angles[0], region.rate, region.acceleration)
    one = replace(base, slews=(least,) * n)
    needed = one.starts[-1] + one.durations[-1]
    if needed > limits.total_time + 1e-9:
        short = needed - limits.total_time
        what = f"{n} slew{'s' if n > 1 else ''} need at least {math.ceil(needed)} s, {limits.total_time:.6g} s allowed ({math.ceil(short)} s too few)"
        raise DesignError(what, where="limit total time", advice="allow more time, or fewer slews")
    # Turning by nothing shows what the start alone demands.
    still = planned_margins(
        replace(base, slews=(replace(least, angle=1e-6),)),
        spacecraft,
        replace(limits, end_attitude=None, start_attitude=None),
    )
    for margin in broken_limits([m for m in still if m.limit.startswith(("keep-out", "momentum"))]):
        raise DesignError(
            f"broken before the first slew: {margin.says}",
            where="start",
            advice="start in another attitude, or with slower wheels",
        )
    if limits.end_attitude is not None:
        there = replace(
            base, start_attitude=limits.end_attitude, slews=(replace(least, angle=1e-6),)
        )
        ends = planned_margins(there, spacecraft, Limits(keep_out=limits.keep_out))
        for margin in broken_limits([m for m in ends if m.limit.startswith("keep-out")]):
            raise DesignError(
                f"the end attitude itself breaks a limit: {margin.says}",
                where="limit end attitude",
                advice="end in another attitude",
            )


def _best_plan(
    problem: PlanProblem,
    found: Sequence[np.ndarray],
    base: Plan,
    spacecraft: Spacecraft,
    limits: Limits,
    name: str,
) -> Plan:
    """The best of the plans found that keeps all limits, in an operator's digits.

    Raises `DesignError` naming the limit that binds if none does.
    """
    nearest = (-math.inf, "", base)
    for x in found:
        exact = planned_slews(problem.slews(x))
        for chosen in (_readable(exact, problem, limits), exact):
            plan = replace(base, name=name, slews=chosen)
            left = problem.least_slacks(problem.variables(slew_arrays(plan)))
            binding = min(left, key=left.__getitem__)
            if left[binding] >= -_SLACK and not broken_limits(
                planned_margins(plan, spacecraft, limits)
            ):
                return plan
            nearest = max(nearest, (left[binding], binding, plan), key=lambda n: n[0])
    left, binding, plan = nearest
    own = [m.says for m in planned_margins(plan, spacecraft, limits) if _kind(m.limit) == binding]
    what = (
        f"no plan was found that keeps it; the nearest misses it, with its reserve, by {-100 * left:.2g} %"
        + (f" ({own[0]})" if own else "")
    )
    raise DesignError(
        what, where=f"limit {binding}", advice="loosen it, or ask for fewer slews or more time"
    )


def _kind(limit: str) -> str:
    """A margin's name as `region.room` calls its kind.

    >>> _kind("torque of wheel_x"), _kind("keep-out Sun"), _kind("rate")
    ('wheel torque', 'keep-out', 'rate')
    """
    first = limit.partition(" of ")[0].partition(" ")[0]
    return {"torque": "wheel torque", "momentum": "wheel momentum", "keep-out": "keep-out"}.get(
        first, limit
    )


def _readable(
    slews: Sequence[PlannedSlew], problem: PlanProblem, limits: Limits
) -> tuple[PlannedSlew, ...]:
    """The slews with axes to 3 digits, angles to 0.1 deg, rates and accelerations rounded down; the last one exact where the end is given."""

    def down(value: float, digits: int) -> float:
        return math.radians(math.floor(math.degrees(value) * 10**digits + 1e-9) / 10**digits)

    out = []
    for slew in slews:
        axis = tuple(round(x, 3) for x in slew.axis_B)
        angle = max(down(slew.angle, 1), math.radians(0.1))
        out.append(
            PlannedSlew(
                axis,
                angle,
                down(slew.rate, 3) or slew.rate,
                down(slew.acceleration, 4) or slew.acceleration,
            )
        )
    if limits.end_attitude is not None:
        x = problem.variables(slew_arrays(replace(paper_like_plan(), slews=tuple(out))))
        out[-1] = planned_slews(problem.slews(x))[-1]
    return tuple(out)


def _told(ahead: Forecast, at: Estimate) -> Forecast:
    """The forecast with what a campaign told in place of the prior of J, K and bias."""
    known = np.concatenate([np.arange(9), len(at.free) + np.arange(N_BIAS)])
    told = inverse(at.joint_covariance[np.ix_(known, known)])
    prior = np.array(ahead.given.prior)
    place = np.concatenate([np.arange(9), len(ahead.shape.names) + np.arange(N_BIAS)])
    prior[np.ix_(place, place)] = told
    return replace(ahead, given=ahead.given._replace(prior=prior))


def _truths_after(at: Estimate, n: int, seed: int) -> list[Mission]:
    rng = np.random.default_rng([seed, 5])
    mean, covariance, campaign = at.theta[:9], at.covariance[:9, :9], at.model.campaign
    locked = campaign.inertia.includes_wheel_spin
    drawn = draw_physical(
        lambda k: rng.multivariate_normal(mean, covariance, k, method="cholesky"),
        n - 1,
        wheel_spin=inertia_tensor.elements(spin_tensor(campaign.wheels)) if locked else None,
        where="the estimate",
        advice="hardly any tensor within its uncertainty is one of a body: fly more slews first",
    )
    return [
        Mission(spacecraft_at(campaign, theta), campaign.inertia)
        for theta in [at.theta[:9], *drawn]
    ]


def _tightest(found: Sequence[tuple[Margin, ...]]) -> tuple[Margin, ...]:
    """The smallest margin of each limit over several flights."""
    return tuple(min(same, key=lambda m: m.left) for same in zip(*found, strict=True))
