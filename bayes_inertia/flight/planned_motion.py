"""The motion that a plan asks for, as a smooth function of its slews.

Flown as planned, a slew's wheels hold what is left of the conserved total momentum,
G H = C(q) M_N - J w. The motors give its rate of change: the integral of
J a + w x (J w + G H) = -G u (Ferguson's equation 6). Nothing is integrated numerically. So
thousands of plans can be tried, and everything can be differentiated with respect to axes, angles
and rates.

The time grid of a slew has a fixed number of rows in each of its phases (rest, ramp, coast, ramp,
settling, rest) and stretches with them. No row jumps from one phase into another as a slew changes.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.campaign.hardware import require_key
from bayes_inertia.flight.numerics import NUMERICS
from bayes_inertia.flight.plan import Plan, PlannedSlew, Profile, angle_and_rate, peak_and_ramp
from bayes_inertia.flight.spacecraft import Spacecraft, allocation
from bayes_inertia.flight.steering import Gimbals, Jets
from bayes_inertia.maths import quaternion
from bayes_inertia.maths.jax_settings import require_usable_jax
from bayes_inertia.maths.values import AnyArray
from bayes_inertia.physics.slew_context import Trajectory


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
    fixes_in_motion: bool = False  # whether fixes follow each other throughout


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
    motion = np.array([slew.motion_time for slew in plan.slews])
    needed = plan.rest_before + motion + plan.settle + plan.rest_after
    rate, acceleration = np.array([(slew.rate, slew.acceleration) for slew in plan.slews]).T
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
    """Start of a plan of a spacecraft with so many wheels."""
    momentum = np.array(plan.wheel_momentum or np.zeros(wheels))
    what, advice = f"{len(momentum)} momenta for {wheels} wheels", "give one a wheel"
    require_key(len(momentum) == wheels, "wheel_momentum_Nms", what, advice)
    return PlanStart(np.array(plan.start_attitude), momentum)


class RigidBody(NamedTuple):
    """Rigid body with wheels."""

    inertia_B: AnyArray  # (3, 3) J, without the wheels' spin inertia [kg m^2]
    wheel_axes_B: AnyArray  # (3, wheels) unit spin axes as columns
    # (wheels, 3) shares of a torque among the wheels that motors drive
    allocation: AnyArray
    spin_inertia: AnyArray  # (wheels,) spin inertia of each wheel [kg m^2]
    devices: Mapping[str, Jets | Gimbals] | None = None  # what flies in the wheels' place


class PlannedMotion(NamedTuple):
    """Planned slews: n of them, `NUMERICS.rows_of_slew` rows each."""

    path: Trajectory  # the motion of each slew, (n, rows, ...), without states of effects
    start: Array  # (n,) time of each slew's first row in the campaign [s]
    wheel_torque: Array  # (n, rows, wheels) on the wheels, held from each row to the next [N m]
    rest_attitudes: Array  # (n + 1, 4) attitudes before each slew and after the last
    total_time: Array  # () from the first row of the campaign to the last [s]
    wanted_B: Array  # (n, rows, 3) of the device: torque from row to row [N m], or momentum [N m s]


def rigid_body(spacecraft: Spacecraft) -> RigidBody:
    """A spacecraft's rigid body and wheels.

    Examples
    --------
    >>> from bayes_inertia.flight.spacecraft import most_like_spacecraft
    >>> rigid_body(most_like_spacecraft()).allocation.shape
    (3, 3)
    """
    wheels, device = spacecraft.wheels, spacecraft.device
    spin, shares = np.array([wheel.spin_inertia for wheel in wheels]), allocation(wheels)
    devices = None
    if device is not None:  # The wheels hold still.
        shares, devices = np.zeros_like(shares), {device.record.name: device.array}
    return RigidBody(spacecraft.inertia_B, spacecraft.wheel_axes_B, shares, spin, devices)


def motion_of_plan(plan: Plan, body: RigidBody) -> PlannedMotion:
    """The motion of a plan, compiled.

    Examples
    --------
    >>> import math
    >>> from bayes_inertia.flight.plan import PlannedSlew
    >>> one = Plan("one", (PlannedSlew((1.0, 0.0, 0.0), math.radians(30.0)),))
    >>> from bayes_inertia.flight.spacecraft import most_like_spacecraft
    >>> body = rigid_body(most_like_spacecraft())
    >>> round(float(motion_of_plan(one, body).total_time), 9)
    115.0
    """
    require_usable_jax()
    start = plan_start(plan, body.wheel_axes_B.shape[1])
    return jax.jit(motion_of_slews)(slew_arrays(plan), plan_times(plan), body, start)


def motion_of_slews(
    slews: SlewArrays, times: PlanTimes, body: RigidBody, origin: PlanStart
) -> PlannedMotion:
    """The motion of slews flown one after the other; a pure function that JAX can differentiate.

    `times` [s].

    Examples
    --------
    >>> slews = SlewArrays(jnp.array([[0.5, 0., 0.]]), *(jnp.array([x]) for x in (0.01, 1e-3)),
    ...                    jnp.array([False]), jnp.zeros(1))
    >>> times = PlanTimes(20., 33., 12., 300., 8., 1., .25)
    >>> body = RigidBody(2.0 * np.eye(3), np.eye(3), np.eye(3), np.full(3, 1e-3))
    >>> origin = PlanStart(jnp.array([0., 0., 0., 1.]), jnp.zeros(3))
    >>> round(float(motion_of_slews(slews, times, body, origin).wheel_torque.min()), 6)
    -0.002
    """
    angle = jnp.sqrt(jnp.sum(slews.rotation_B**2, -1))
    axis = slews.rotation_B / angle[:, None]
    rests = _rest_attitudes(slews.rotation_B, origin.attitude)
    time, begin = _time_grid(slews, angle, times)
    turn, fastest, quickest = (x[:, None] for x in (angle, slews.rate, slews.acceleration))
    turned, rate = angle_and_rate(turn, fastest, quickest, slews.smooth[:, None], time - begin)
    attitude = quaternion.turned(rests[:-1, None], turned[..., None] * axis[:, None])
    rate_B = rate[..., None] * axis[:, None]
    lasting = time[:, -1] + times.pause
    start: AnyArray = np.tri(len(lasting), k=-1) @ lasting
    total_time = start[-1] + time[-1, -1]
    drive = partial(driven_path, body, origin)
    path, torque, wanted_B = jax.vmap(drive)(time, attitude, rate_B)
    return PlannedMotion(path, start, torque, rests, total_time, wanted_B)


def driven_path(
    body: RigidBody, origin: PlanStart, time: Array, attitude: Array, rate_B: Array
) -> tuple[Trajectory, Array, Array]:
    """What turns the body along the motion of one slew.

    `time` (rows,) [s]; `attitude` (rows, 4); `rate_B` (rows, 3) [rad/s]. Returns the path with
    wheel momentum and inputs of devices; torque on the wheels (rows, wheels), held from each row to
    the next [N m]; what the device must give (rows, 3) in body axes, see `PlannedMotion`.
    """
    wheel = _wheel_momentum(body, origin, attitude, rate_B)
    total_wheel = wheel + body.spin_inertia * (rate_B @ body.wheel_axes_B)
    step = jnp.diff(time)[:, None]
    step = jnp.where(step > 0.0, step, 1.0)  # time stands still in padding
    torque = jnp.diff(total_wheel, axis=0) / step
    torque = jnp.concatenate([torque, jnp.zeros_like(torque[:1])])
    wanted_B, inputs = jnp.zeros_like(rate_B), {}
    momentum_B = rate_B @ body.inertia_B + total_wheel @ body.wheel_axes_B.T
    for name, device in (body.devices or {}).items():
        if isinstance(device, Gimbals):
            carried_B, _ = device.carried_B(device.start)  # before the first slew
            at_start = body.wheel_axes_B @ origin.wheel_momentum + carried_B
            total_N = quaternion.to_inertial(origin.attitude, at_start)
            wanted_B = quaternion.to_body(attitude, jnp.broadcast_to(total_N, rate_B.shape))
            wanted_B = wanted_B - momentum_B
        else:
            torque_N = jnp.diff(quaternion.to_inertial(attitude, momentum_B), axis=0) / step
            # Held in body axes, it turns with the body: its mean in inertial axes is what counts.
            to_inertial = jax.vmap(lambda q: quaternion.to_inertial(q, jnp.eye(3)).T)(attitude)
            mean = 0.5 * (to_inertial[1:] + to_inertial[:-1])
            held = jnp.linalg.solve(mean, torque_N[..., None])[..., 0]
            wanted_B = jnp.concatenate([held, jnp.zeros_like(held[:1])])
        inputs[name] = device.inputs(wanted_B)
    path = Trajectory(
        time, attitude, rate_B, wheel, jnp.zeros((len(time), 0)), inputs if inputs else None
    )
    return path, torque, wanted_B


def _rest_attitudes(rotation_B: Array, attitude: Array) -> Array:
    """Attitudes (n + 1, 4) before each slew and after the last."""
    out = [jnp.asarray(attitude)]
    for turn in quaternion.exp(rotation_B):
        out.append(quaternion.multiply(out[-1], turn))
    return jnp.stack(out)


def _time_grid(slews: SlewArrays, angle: Array, times: PlanTimes) -> tuple[Array, float]:
    """Times (n, rows) of all rows [s], and when the motion begins [s]."""
    peak, ramp = peak_and_ramp(angle, slews.rate, slews.acceleration, slews.smooth)
    coast = jnp.maximum(angle / peak - ramp, NUMERICS.shortest_coast)
    same = jnp.ones_like(ramp)
    lengths = (
        times.rest_before * same,
        ramp,
        coast,
        ramp,
        times.settle * same,
        times.rest_after + slews.extra_rest,
    )
    phases, n = zip(lengths, NUMERICS.rows_of_phases, strict=True), len(ramp)
    steps = [jnp.broadcast_to(length[:, None] / rows, (n, rows)) for length, rows in phases]
    # Sums as matrix products: they compile much faster than cumulative sums.
    rows = NUMERICS.rows_of_slew
    return jnp.concatenate(steps, 1) @ np.tri(rows, rows - 1, -1).T, times.rest_before


def _wheel_momentum(body: RigidBody, origin: PlanStart, attitude: Array, rate_B: Array) -> Array:
    """Wheel momentum relative to the body (n, rows, wheels), from the conserved total momentum."""
    G, spin = body.wheel_axes_B, body.spin_inertia
    total_N = quaternion.to_inertial(origin.attitude, G @ origin.wheel_momentum)
    allocate = partial(jnp.einsum, "wi,...i->...w", body.allocation)
    # What has no influence on the body (more than three wheels) stays as it began.
    left = (
        quaternion.to_body(attitude, jnp.broadcast_to(total_N, rate_B.shape))
        - rate_B @ body.inertia_B
        - G @ origin.wheel_momentum
    )
    return origin.wheel_momentum + allocate(left) - spin * (rate_B @ G)
