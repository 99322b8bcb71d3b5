"""A plan as arrays that JAX can differentiate, and arrays as slews that can be flown."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bayes_inertia.flight.plan import Plan, PlannedSlew, Profile
from bayes_inertia.maths.values import AnyArray


class SlewArrays(NamedTuple):
    """Slews as arrays, leading axis slews."""

    rotation_B: AnyArray  # (n, 3) rotation vectors: axis times angle [rad]
    rate: AnyArray  # (n,) largest rates [rad/s]
    acceleration: AnyArray  # (n,) angular accelerations of the ramps [rad/s^2]
    smooth: AnyArray  # (n,) whether the ramps are versines
    extra_rest: AnyArray  # (n,) rest after the slew beyond what the plan's times ask for [s]


class PlanTimes(NamedTuple):
    """The times that all slews of a plan share; fields as in `Plan`."""

    rest_before: float  # rest before the motion [s]
    settle: float  # time between the motion and the fixes after it [s]
    rest_after: float  # rest with fixes after settling [s]
    pause: float  # time between two slews [s]
    first_fix: float  # time of the first fix from the slew's first row [s]
    fix_spacing: float  # time between two fixes [s]
    telemetry_period: float  # time between two rows of telemetry [s]


class PlanStart(NamedTuple):
    """Start of a plan, at rest."""

    attitude: AnyArray  # (4,) body from inertial, scalar last
    wheel_momentum: AnyArray  # (wheels,) relative to the body [N m s]


def plan_times(plan: Plan) -> PlanTimes:
    """The times that all slews of a plan share [s]."""
    return PlanTimes(*(getattr(plan, key) for key in PlanTimes._fields))


def slew_arrays(plan: Plan) -> SlewArrays:
    """A plan's slews as arrays."""
    rotation = np.array([slew.angle * np.array(slew.axis_B) for slew in plan.slews])
    needed = np.array(
        [plan.rest_before + slew.motion_time + plan.settle + plan.rest_after for slew in plan.slews]
    )
    rate, acceleration = (
        np.array([getattr(slew, key) for slew in plan.slews]) for key in ("rate", "acceleration")
    )
    smooth = np.array([slew.profile == "smooth" for slew in plan.slews])
    extra_rest = np.maximum(np.array(plan.durations) - needed, 0.0)
    return SlewArrays(rotation, rate, acceleration, smooth, extra_rest)


def planned_slews(slews: SlewArrays) -> tuple[PlannedSlew, ...]:
    """Arrays as slews that can be flown, with durations no longer than needed.

    Examples
    --------
    >>> from bayes_inertia.flight.plan import paper_like_plan
    >>> planned_slews(slew_arrays(paper_like_plan()))[0].axis_B
    (1.0, 0.0, 0.0)
    """
    out = []
    rows = zip(*(np.asarray(column) for column in slews[:4]), strict=True)
    for rotation, rate, acceleration, smooth in rows:
        angle = float(np.linalg.norm(rotation))
        axis = tuple((rotation / angle).tolist())
        profile: Profile = "smooth" if smooth else "trapezoid"
        out.append(PlannedSlew(axis, angle, float(rate), float(acceleration), profile))
    return tuple(out)


def plan_start(plan: Plan, wheels: int) -> PlanStart:
    """Start of a plan."""
    momentum = np.array(plan.wheel_momentum or np.zeros(wheels))
    return PlanStart(np.array(plan.start_attitude), momentum)
