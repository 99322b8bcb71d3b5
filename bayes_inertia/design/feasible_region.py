"""The slews that may be flown: which rates, angles and accelerations, and what they violate.

What no plan can keep is found before any search.

A slew is five design variables: its rotation vector [rad], and its rate and acceleration as
fractions of the largest that the region allows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.design.limits import HardwareLimits, Limits
from bayes_inertia.design.margins import Margin, broken_limits, demands, planned_margins
from bayes_inertia.design.numerics import NUMERICS
from bayes_inertia.errors import BayesInertiaError, DesignError, require
from bayes_inertia.flight.plan import Plan, PlannedSlew
from bayes_inertia.flight.planned_motion import (
    PlannedMotion,
    PlanTimes,
    RigidBody,
    SlewArrays,
    motion_of_plan,
    plan_times,
    slew_arrays,
)
from bayes_inertia.flight.spacecraft import Spacecraft
from bayes_inertia.flight.steering import Jets, share_of_reach
from bayes_inertia.maths.printed import counted
from bayes_inertia.maths.values import AnyArray


class FeasibleRegion(NamedTuple):
    """Region in which designs are searched; what is not limited is infinite."""

    rate: float  # largest rate that a plan may ask for [rad/s]
    acceleration: float  # largest angular acceleration that it may ask for [rad/s^2]
    angles: tuple[float, float]  # smallest and largest angle of a slew [rad]
    torque: np.ndarray  # (wheels,) what it may ask of each wheel [N m]
    momentum: np.ndarray  # (wheels,) what it may ask of each wheel [N m s]
    time: float  # longest campaign [s]
    # (cones, 3) unit vectors to what the star tracker must not see, inertial axes.
    cones_N: np.ndarray
    half_angles: np.ndarray  # (cones,) half of each cone's opening angle [rad]
    boresight_B: np.ndarray  # (3,) the star tracker's boresight
    reach: np.ndarray  # (m,) what it may ask of the device along `directions_B`; (0,) without one
    # How far a slew may miss its target before it is corrected, as a fraction of its angle.
    pointing_error: float


def region_within(
    limits: Limits,
    hardware: HardwareLimits,
    *,
    default_rate: float | None = None,
    scale_factor_sigma: float = 0.0,
) -> FeasibleRegion:
    """The region that limits leave, with their reserves.

    `default_rate`: largest rate [rad/s] where nothing limits it; None for 1 deg/s.
    `scale_factor_sigma`: largest sd of a scale factor that the controller does not know. A slew
    misses its target by that share of its angle.

    Examples
    --------
    >>> from bayes_inertia.design.limits import hardware_limits
    >>> from bayes_inertia.flight.spacecraft import most_like_spacecraft
    >>> round(region_within(Limits(rate=0.02), hardware_limits(most_like_spacecraft())).rate, 6)
    0.0184
    """
    rate = (1.0 - limits.rate_reserve) * min(limits.rate or math.inf, hardware.sensor_range)
    rate = rate if math.isfinite(rate) else default_rate or NUMERICS.default_rate
    acceleration = min(limits.acceleration or math.inf, rate / NUMERICS.shortest_ramp)
    largest, keep = min(limits.angle or math.pi, math.pi), 1.0 - limits.wheel_reserve
    return FeasibleRegion(
        rate=rate,
        acceleration=acceleration,
        angles=(min(NUMERICS.smallest_angle, 0.5 * largest), largest),
        torque=keep * hardware.wheel_torque,
        momentum=keep * hardware.wheel_momentum,
        time=limits.total_time or math.inf,
        cones_N=np.array([c.direction_N for c in limits.keep_out]).reshape(-1, 3),
        half_angles=np.array([c.half_angle for c in limits.keep_out]),
        boresight_B=hardware.boresight_B,
        reach=keep * hardware.reach,
        pointing_error=NUMERICS.scale_factor_sigmas * scale_factor_sigma,
    )


def slews_from_variables(x: AnyArray, region: FeasibleRegion) -> SlewArrays:
    """Slews from their design variables; JAX can differentiate it.

    `x` (n, 5): rotation vectors [rad], fractions of the largest rate, fractions of the largest
    acceleration.
    """
    zero = jnp.zeros(len(x))
    return SlewArrays(
        x[:, :3], x[:, 3] * region.rate, x[:, 4] * region.acceleration, zero > 1.0, zero
    )


def time_without_motion(times: PlanTimes, n: int) -> float:
    """Time of n slews without their motion.

    Each may last up to one telemetry period longer than its parts.

    `times` [s]. Returns [s].

    Examples
    --------
    >>> time_without_motion(PlanTimes(20.0, 33.0, 12.0, 300.0, 8.0, 1.0, 1.0), 2)
    432.0
    """
    of_one = times.rest_before + times.settle + times.rest_after + times.telemetry_period
    return n * of_one + (n - 1) * times.pause


def draw_variables(
    rng: np.random.Generator,
    n: int,
    slews: int,
    region: FeasibleRegion,
    times: PlanTimes,
    body: RigidBody,
) -> np.ndarray:
    """Random plans: directions of all kinds, angles that use the time there is, all kinds of ramps.

    Wheel torques are within their limits by construction, but for the gyroscopic part. Momentum and
    keep-out cones are not.

    `times` [s]. Returns (n, slews, 5).
    """
    axis = rng.normal(size=(n, slews, 3))
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    low, high = region.angles
    rate = rng.uniform(0.5, 1.0, (n, slews)) ** 0.25 * region.rate
    acceleration = strongest_ramps(axis, region, body) * rng.uniform(0.1, 1.0, (n, slews))
    # Some plans of slews that are alike, some of a few long ones and others as short as may be.
    angle = low + (high - low) * rng.uniform(0.0, 1.0, (n, slews)) ** rng.choice(
        [1.0, 3.0, 6.0], (n, 1)
    )
    spare = region.time - time_without_motion(times, slews)
    if math.isfinite(spare):
        # The time of a slew is its angle over its rate and a ramp: share what there is among them.
        coasting = np.maximum(spare - (rate / acceleration).sum(1), 0.02 * spare)
        share = coasting / np.sum(angle / rate, axis=1)
        angle = np.clip(angle * share[:, None], low, high)
    fractions = [(rate / region.rate)[..., None], (acceleration / region.acceleration)[..., None]]
    return np.concatenate([axis * angle[..., None], *fractions], -1)


def strongest_ramps(axis_B: np.ndarray, region: FeasibleRegion, body: RigidBody) -> np.ndarray:
    """Accelerations (...) about axes (..., 3) that torques allow [rad/s^2], but for w x (J w + h).

    Some of the torque is left for that.
    """
    turning_B = axis_B @ np.asarray(body.inertia_B)
    needed = np.abs(turning_B @ np.asarray(body.allocation).T)
    with np.errstate(divide="ignore"):
        most = np.min(region.torque / needed, axis=-1, initial=np.inf)
    if any(isinstance(device, Jets) for device in (body.devices or {}).values()):
        up, down = (np.asarray(share_of_reach(s * turning_B, region.reach)) for s in (1.0, -1.0))
        most = 1.0 / np.maximum(up, down)
    return np.minimum(0.9 * most, region.acceleration)


def is_driven(plan: Plan, region: FeasibleRegion, body: RigidBody) -> bool:
    """Whether wheels, or the device in their place, can give what a plan asks of them."""
    motion = motion_of_plan(plan, body)
    slacks = constraint_slacks(motion, slew_arrays(plan), region, plan_times(plan))
    driving = ("wheel torque", "wheel momentum", "reach")
    return all(bool(jnp.all(slacks[key] >= 0.0)) for key in driving if key in slacks)


def constraint_slacks(
    motion: PlannedMotion, slews: SlewArrays, region: FeasibleRegion, times: PlanTimes
) -> dict[str, Array]:
    """Slack of every limit, as a fraction of it; negative where violated.

    `times` [s]. Returns `wheel torque` and `wheel momentum` (n, wheels), `rate`, `angle` and `least
    angle` (n,), `total time` (), `keep-out` (n + 1, cones), `reach` of a device (n,). JAX can
    differentiate all.
    """
    used = demands(motion, slews, region.boresight_B, region.cones_N, region.reach)
    missed = jnp.concatenate([jnp.zeros(1), region.pointing_error * used["angle"]])[:, None]
    return {
        "wheel torque": 1.0 - used["torque"] / region.torque,
        "wheel momentum": 1.0 - used["momentum"] / region.momentum,
        "rate": 1.0 - used["rate"] / region.rate,
        "angle": 1.0 - used["angle"] / region.angles[1],
        "least angle": used["angle"] / region.angles[0] - 1.0,
        # Durations are rounded up to whole samples.
        "total time": 1.0 - used["time"] / (region.time - len(slews.rate) * times.telemetry_period),
        "keep-out": (used["distance"] - missed) / region.half_angles - 1.0,
        **({"reach": 1.0 - used["reach"]} if len(region.reach) else {}),
    }


def require_feasible(
    spacecraft: Spacecraft, base: Plan, region: FeasibleRegion, limits: Limits, n_slews: int
) -> None:
    """Raise for what no plan can keep."""
    require_three_axes(spacecraft, DesignError)
    smallest = PlannedSlew((1.0, 0.0, 0.0), region.angles[0], region.rate, region.acceleration)
    _require_time(replace(base, slews=(smallest,) * n_slews), limits)
    still = replace(smallest, angle=NUMERICS.negligible_angle)
    at_start = replace(base, slews=(still,))
    margins = planned_margins(at_start, spacecraft, limits)
    what, place = "broken before the first slew", "at the start"
    _require_rest(margins, ("keep-out",), what, "start", "start in another attitude", place)
    _require_rest(margins, ("momentum", "reach"), what, "start", "start with slower wheels")
    if limits.end_attitude is not None:
        at_end = replace(at_start, start_attitude=limits.end_attitude)
        what, advice = "the end attitude itself breaks a limit", "end in another attitude"
        margins = planned_margins(at_end, spacecraft, limits)
        _require_rest(margins, ("keep-out",), what, "limit end attitude", advice, "at the end")


def require_three_axes(spacecraft: Spacecraft, error: type[BayesInertiaError]) -> None:
    """Raise where nothing turns the spacecraft about all axes."""
    axes, device = spacecraft.axes_of_control, spacecraft.device
    name = device.record.name if device else "wheels"
    turns = f"{name} turns" if device else "the wheels turn"
    what = f"{turns} the spacecraft about {axes} of three axes"
    require(axes >= 3, name, what, "slews are designed for three", error=error)


def _require_time(shortest: Plan, limits: Limits) -> None:
    """An error where even the shortest plan lasts too long."""
    n, needed = len(shortest.slews), shortest.starts[-1] + shortest.durations[-1]
    allowed = limits.total_time
    if allowed is None or needed <= allowed + 1e-9:
        return
    short = math.ceil(needed - allowed)
    what = f"{counted(n, 'slew')} need at least {math.ceil(needed)} s"
    what += f", {allowed:.6g} s allowed ({short} s too few)"
    raise DesignError(what, where="limit total time", advice="allow more time, or fewer slews")


def _require_rest(
    margins: Sequence[Margin],
    kinds: tuple[str, ...],
    what: str,
    where: str,
    advice: str,
    place: str = "the campaign",
) -> None:
    """An error where a rest itself breaks a limit of one of these kinds; `place` of a margin."""
    for margin in broken_limits([m for m in margins if m.limit.startswith(kinds)]):
        says = replace(margin, where=place).says
        raise DesignError(f"{what}: {says}", where=where, advice=advice)
