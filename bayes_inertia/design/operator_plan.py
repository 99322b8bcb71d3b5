"""The best of the plans found, in digits that an operator can read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayes_inertia.design.limits import Limits
from bayes_inertia.design.margins import broken_limits, planned_margins
from bayes_inertia.design.plan_arrays import planned_slews, slew_arrays
from bayes_inertia.design.plan_problem import PlanProblem
from bayes_inertia.errors import DesignError
from bayes_inertia.flight.plan import Plan, PlannedSlew, paper_like_plan
from bayes_inertia.flight.spacecraft import Spacecraft

# How far rounding to an operator's digits may reach into a reserve [fraction of the limit].
_ROUNDING_SLACK = 2e-3


def best_plan(
    problem: PlanProblem,
    candidates: Sequence[np.ndarray],
    base: Plan,
    spacecraft: Spacecraft,
    limits: Limits,
) -> Plan:
    """The first of several plans that keeps all limits, in an operator's digits.

    Parameters
    ----------
    problem : PlanProblem
        What was searched for.
    candidates : sequence of (slews, 5) arrays
        Design variables of the plans found, best first.
    base : Plan
        Name, start, telemetry and rests; its slews are not used.
    spacecraft : Spacecraft
        J, wheels and sensors.
    limits : Limits
        What the plan must respect.

    Returns
    -------
    Plan
        With rounded slews if these keep the limits, else with exact ones.

    Raises
    ------
    DesignError
        If none keeps the limits; it names the one that binds.
    """
    nearest = (-math.inf, "", base)
    for x in candidates:
        exact = planned_slews(problem.slews(x))
        for slews in (rounded_slews(exact, problem), exact):
            plan = replace(base, slews=slews)
            slacks = problem.least_slacks(problem.variables(slew_arrays(plan)))
            binding = min(slacks, key=slacks.__getitem__)
            enough = slacks[binding] >= -_ROUNDING_SLACK
            if enough and not broken_limits(planned_margins(plan, spacecraft, limits)):
                return plan
            nearest = max(nearest, (slacks[binding], binding, plan), key=lambda n: n[0])
    slack, binding, plan = nearest
    margins = planned_margins(plan, spacecraft, limits)
    said = [margin.says for margin in margins if _kind_of(margin.limit) == binding]
    what = "no plan was found that keeps it; the nearest misses it, with its reserve, by"
    raise DesignError(
        f"{what} {-100 * slack:.2g} %" + (f" ({said[0]})" if said else ""),
        where=f"limit {binding}",
        advice="loosen it, or ask for fewer slews or more time",
    )


def rounded_slews(slews: Sequence[PlannedSlew], problem: PlanProblem) -> tuple[PlannedSlew, ...]:
    """Slews with axes to 3 digits, angles to 0.1 deg, rates and accelerations rounded down.

    Parameters
    ----------
    slews : sequence of PlannedSlew
        Exact slews.
    problem : PlanProblem
        Where it gives the end attitude, the last slew stays exact.

    Returns
    -------
    tuple of PlannedSlew
        Slews that an operator can read.
    """
    out = [
        PlannedSlew(
            (round(x, 3), round(y, 3), round(z, 3)),
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


def _kind_of(limit: str) -> str:
    """A margin's name as `constraint_slacks` calls its kind.

    >>> _kind_of("torque of wheel_x"), _kind_of("keep-out Sun"), _kind_of("rate")
    ('wheel torque', 'keep-out', 'rate')
    """
    first = limit.partition(" of ")[0].partition(" ")[0]
    kinds = {"torque": "wheel torque", "momentum": "wheel momentum", "keep-out": "keep-out"}
    return kinds.get(first, limit)
