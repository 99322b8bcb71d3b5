"""The motion that a plan asks for, as a smooth function of its slews: attitude, rate, wheel momentum and torque.

Flown as planned, a slew's wheels hold what is left of the conserved total momentum, G H = C(q) M_N - J w, and the motors
give its rate of change: the integral of J a + w x (J w + G H) = -G u (Ferguson's eq 6). Nothing is integrated numerically,
so that thousands of plans can be tried, and everything can be differentiated with respect to axes, angles and rates.

The time grid of a slew has a fixed number of rows in each of its phases (rest, ramp, coast, ramp, settling, rest) and
stretches with them: no row jumps from one phase into another as a slew changes.
"""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.flight.plan import Plan, PlannedSlew, angle_and_rate
from bayes_inertia.maths import quaternion

# Rows in the rest before, each ramp, the coast, the settling and the rest after.
_PHASES = (8, 14, 24, 14, 8, 8)
ROWS = sum(_PHASES) + 1
# Shortest coast in the grid [s]: a slew without a coast keeps increasing times.
_SHORTEST = 0.05


class Slews(NamedTuple):
    """Slews as arrays, leading axis slews: `turn_B` (n, 3) axis times angle [rad], `rate` (n,) [rad/s], `acceleration` (n,)
    [rad/s^2], `smooth` (n,) bool profile, `extra` (n,) rest beyond what the plan's times ask for [s]."""

    turn_B: Array
    rate: Array
    acceleration: Array
    smooth: Array
    extra: Array


class Times(NamedTuple):
    """A plan's times [s]: before, between and after the motions, and of the star tracker's fixes."""

    rest_before: float
    settle: float
    rest_after: float
    pause: float
    first_fix: float
    fix_spacing: float
    telemetry_period: float


class Body(NamedTuple):
    """What moves: `inertia_B` (3, 3) [kg m^2] without the wheels' spin, `wheel_axes_B` (3, wheels), `allocation` (wheels, 3) its
    pseudo-inverse, `spin_inertia` (wheels,) [kg m^2]."""

    inertia_B: Array
    wheel_axes_B: Array
    allocation: Array
    spin_inertia: Array


def body_with(inertia_B: Array, wheel_axes_B: np.ndarray, spin_inertia: np.ndarray) -> Body:
    """A body with these wheels.

    >>> body_with(np.eye(3), np.eye(3), np.full(3, 1e-3)).allocation.shape
    (3, 3)
    """
    return Body(inertia_B, wheel_axes_B, np.linalg.pinv(wheel_axes_B), spin_inertia)


class Origin(NamedTuple):
    """Where a plan begins: `attitude` (4,), `wheel_momentum` (wheels,) relative to the body [N m s]."""

    attitude: Array
    wheel_momentum: Array


class Motion(NamedTuple):
    """Planned slews (n of them, rows each): `time` (n, rows) [s] from each slew's first row, `start` (n,) [s] of that row in the
    campaign, `attitude` (n, rows, 4), `rate_B` (n, rows, 3) [rad/s], `wheel` (n, rows, wheels) momentum relative to the body
    [N m s], `torque` (n, rows, wheels) on the wheels, held from each row to the next [N m], `rests` (n + 1, 4) attitudes at rest,
    `total` time of the campaign [s]."""

    time: Array
    start: Array
    attitude: Array
    rate_B: Array
    wheel: Array
    torque: Array
    rests: Array
    total: Array


def times_of(plan: Plan) -> Times:
    """The times that all slews of a plan share."""
    return Times(*(getattr(plan, key) for key in Times._fields))


def slews_of(plan: Plan) -> Slews:
    """A plan's slews as arrays."""
    turn = np.array([slew.angle * np.array(slew.axis_B) for slew in plan.slews])
    needed = np.array(
        [plan.rest_before + slew.motion_time + plan.settle + plan.rest_after for slew in plan.slews]
    )
    rate, acceleration = (
        np.array([getattr(slew, key) for slew in plan.slews]) for key in ("rate", "acceleration")
    )
    smooth = np.array([slew.profile == "smooth" for slew in plan.slews])
    return Slews(
        turn, rate, acceleration, smooth, np.maximum(np.array(plan.durations) - needed, 0.0)
    )


def planned_slews(slews: Slews) -> tuple[PlannedSlew, ...]:
    """Arrays as slews that can be flown (durations no longer than needed)."""
    out = []
    for turn, rate, acceleration, smooth in zip(*(np.asarray(x) for x in slews[:4]), strict=True):
        angle = float(np.linalg.norm(turn))
        out.append(
            PlannedSlew(
                tuple((turn / angle).tolist()),
                angle,
                float(rate),
                float(acceleration),
                "smooth" if smooth else "trapezoid",
            )
        )
    return tuple(out)


def origin_of(plan: Plan, wheels: int) -> Origin:
    """Start attitude and wheel momentum of a plan (wheels at rest where it names none)."""
    return Origin(np.array(plan.start_attitude), np.array(plan.wheel_momentum or np.zeros(wheels)))


def motion_of(plan: Plan, body: Body) -> Motion:
    """The motion of a plan.

    >>> one = Plan("one", (PlannedSlew((1., 0., 0.), math.radians(30.0)),))
    >>> body = body_with(np.eye(3), np.eye(3), np.full(3, 1e-3))
    >>> round(float(motion_of(one, body).total), 9)
    115.0
    """
    return jax.jit(motion)(
        slews_of(plan), times_of(plan), body, origin_of(plan, body.wheel_axes_B.shape[1])
    )


def motion(slews: Slews, times: Times, body: Body, origin: Origin) -> Motion:
    """The motion of slews (n,) flown one after the other; a pure function that JAX can differentiate.

    >>> slews = Slews(jnp.array([[0.5, 0., 0.]]), jnp.array([0.01]), jnp.array([1e-3]), jnp.array([False]), jnp.zeros(1))
    >>> times, body = Times(20., 33., 12., 300., 8., 1., .25), body_with(2.0 * jnp.eye(3), np.eye(3), np.full(3, 1e-3))
    >>> round(float(motion(slews, times, body, Origin(jnp.array([0., 0., 0., 1.]), jnp.zeros(3))).torque.min()), 6)
    -0.002
    """
    angle = jnp.sqrt(jnp.sum(slews.turn_B**2, -1))
    axis = slews.turn_B / angle[:, None]
    rests = _rests(slews.turn_B, origin.attitude)
    time, begin = _grid(slews, angle, times)
    turned, rate = angle_and_rate(
        angle[:, None],
        slews.rate[:, None],
        slews.acceleration[:, None],
        slews.smooth[:, None],
        time - begin,
    )
    attitude = quaternion.multiply(
        rests[:-1, None], quaternion.exp(turned[..., None] * axis[:, None])
    )
    rate_B = rate[..., None] * axis[:, None]
    wheel = _wheels(body, origin, attitude, rate_B)
    total_wheel = wheel + body.spin_inertia * (rate_B @ body.wheel_axes_B)
    step = jnp.diff(time, axis=1)[..., None]
    torque = jnp.diff(total_wheel, axis=1) / step
    torque = jnp.concatenate([torque, jnp.zeros_like(torque[:, :1])], 1)
    lasting = time[:, -1] + times.pause
    start = np.tri(len(lasting), k=-1) @ lasting
    return Motion(time, start, attitude, rate_B, wheel, torque, rests, start[-1] + time[-1, -1])


def motion_time(angle: Array, rate: Array, acceleration: Array, smooth: Array) -> Array:
    """Time of ramps and coast [s]; arguments broadcast. As `PlannedSlew.motion_time`, for JAX.

    >>> float(motion_time(2.0, 2.0**-5, 2.0**-10, False))
    96.0
    """
    peak, ramp = _peak_and_ramp(angle, rate, acceleration, smooth)
    return angle / peak + ramp


def _peak_and_ramp(
    angle: Array, rate: Array, acceleration: Array, smooth: Array
) -> tuple[Array, Array]:
    factor = jnp.where(smooth, math.pi / 2.0, 1.0)
    peak = jnp.minimum(rate, jnp.sqrt(acceleration * angle / factor))
    return peak, factor * peak / acceleration


def _rests(turn_B: Array, attitude: Array) -> Array:
    """Attitudes (n + 1, 4) before each slew and after the last."""
    out = [jnp.asarray(attitude)]
    for turn in quaternion.exp(turn_B):
        out.append(quaternion.multiply(out[-1], turn))
    return jnp.stack(out)


def _grid(slews: Slews, angle: Array, times: Times) -> tuple[Array, Array]:
    """Times (n, ROWS) of all rows, and when the motion begins."""
    peak, ramp = _peak_and_ramp(angle, slews.rate, slews.acceleration, slews.smooth)
    coast = jnp.maximum(angle / peak - ramp, _SHORTEST)
    same = jnp.ones_like(ramp)
    lengths = (
        times.rest_before * same,
        ramp,
        coast,
        ramp,
        times.settle * same,
        times.rest_after + slews.extra,
    )
    steps = [
        jnp.broadcast_to(length[:, None] / rows, (len(ramp), rows))
        for length, rows in zip(lengths, _PHASES, strict=True)
    ]
    # Sums as matrix products: they compile much faster than cumulative sums.
    return jnp.concatenate(steps, 1) @ np.tri(ROWS, ROWS - 1, -1).T, times.rest_before


def _wheels(body: Body, origin: Origin, attitude: Array, rate_B: Array) -> Array:
    """Wheel momentum relative to the body (n, rows, wheels) that the conserved total momentum leaves."""
    G, spin = body.wheel_axes_B, body.spin_inertia
    total_N = quaternion.to_inertial(origin.attitude, G @ origin.wheel_momentum)
    spread = partial(jnp.einsum, "wi,...i->...w", body.allocation)
    # What has no influence on the body (more than three wheels) stays as it began.
    left = (
        quaternion.to_body(attitude, jnp.broadcast_to(total_N, rate_B.shape))
        - rate_B @ body.inertia_B
        - G @ origin.wheel_momentum
    )
    return origin.wheel_momentum + spread(left) - spin * (rate_B @ G)
