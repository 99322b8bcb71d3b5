"""The closed loop of one slew as compiled code: plant, sensors and controller.

One step is one control period.

The controller follows the planned rotation about a body-fixed axis. It feeds forward the torque
that its own inertia tensor asks for, and feeds back the attitude and rate that it believes. It
knows attitude and rate from RATE SENSORS ALONE during the motion. It propagates the attitude with
scaled readings, beginning with the star tracker's mean attitude in the rest before the slew. What
it gets wrong in the scale factors therefore stays in the final attitude, as in Ferguson's paper.

The plant is `bayes_inertia.physics.equations_of_motion`. Effects that act at an instant act inside
the loop. Effects whose hook needs the whole history (a lag, a sensor's delay) are found by waveform
relaxation: fly, ask the hooks what they make of that history, fly again with the difference as a
given input, until nothing changes.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from bayes_inertia.flight.numerics import NUMERICS
from bayes_inertia.flight.plan import angle_and_rate
from bayes_inertia.maths import quaternion
from bayes_inertia.maths.kept_programs import KeptProgram
from bayes_inertia.physics.effect import ActiveEffects, Effect
from bayes_inertia.physics.equations_of_motion import Body, SlewState, advance, grid_steps, prepare
from bayes_inertia.physics.slew_context import Trajectory
from bayes_inertia.physics.slew_input import SlewInput, Start


class SlewSchedule(NamedTuple):
    """One slew as the controller is told to fly it, padded to n rows.

    Parameters
    ----------
    start_attitude : (4,) array
        Planned attitude before the slew, body from inertial, scalar last.
    axis_B : (3,) array
        Unit axis of the slew in the body frame.
    angle : float
        Angle of the slew [rad].
    rate : float
        Largest rate [rad/s].
    acceleration : float
        Limit of the angular acceleration [rad/s^2].
    smooth : bool
        Whether the ramps are versines.
    motion_start : float
        When the motion begins [s], from the first row.
    n_rows : int
        How many rows are no padding.
    time : (n,) array
        Times of the rows [s].
    fix_gain : (n,) array
        Share of each star-tracker fix before the motion in the mean attitude so far; 0 where there
        is none.
    final_fix_weight : (n,) array
        Weight of each fix after the motion in the mean final attitude.
    """

    start_attitude: Array
    axis_B: Array
    angle: Array
    rate: Array
    acceleration: Array
    smooth: Array
    motion_start: Array
    n_rows: Array
    time: Array
    fix_gain: Array
    final_fix_weight: Array


class ControlLaw(NamedTuple):
    """Beliefs and gains of the controller, as arrays.

    Parameters
    ----------
    inertia_B : (3, 3) array
        Inertia tensor that it believes, without the wheels' spin [kg m^2].
    scale_factor : (3,) array
        K by which it multiplies the readings of the rate sensor.
    rate_axes_inverse : (3, 3) array
        Inverse of C_rate: from sensor axes to body axes.
    wheel_axes_B : (3, wheels) array
        Unit spin axes as columns.
    allocation : (wheels, 3) array
        Shares of a torque among the wheels that motors drive.
    spin_inertia : (wheels,) array
        Spin inertia of each wheel [kg m^2].
    max_torque : (wheels,) array
        Torque limit of each wheel [N m].
    max_momentum : (wheels,) array
        Momentum limit of each wheel [N m s].
    period : float
        How long a command is held [s].
    stiffness : float
        Gain on the attitude error [1/s^2].
    damping : float
        Gain on the rate error [1/s].
    rate_range : float
        Largest rate that the sensor reads [rad/s].
    """

    inertia_B: Array
    scale_factor: Array
    rate_axes_inverse: Array
    wheel_axes_B: Array
    allocation: Array
    spin_inertia: Array
    max_torque: Array
    max_momentum: Array
    period: Array
    stiffness: Array
    damping: Array
    rate_range: Array


class ReferenceMotion(NamedTuple):
    """The planned motion at a row, and over the control period that begins there.

    Parameters
    ----------
    attitude : (4,) array
        Planned attitude.
    rate_B : (3,) array
        Planned rate [rad/s].
    middle_rate_B : (3,) array
        Planned rate in the middle of the period [rad/s].
    acceleration_B : (3,) array
        Mean planned acceleration over the period [rad/s^2].
    fix_gain : float
        Share of this row's star-tracker fix in the mean attitude so far.
    elapsed : float
        Time since the row before [s].
    """

    attitude: Array
    rate_B: Array
    middle_rate_B: Array
    acceleration_B: Array
    fix_gain: Array
    elapsed: Array


def target_attitude(schedule: SlewSchedule) -> Array:
    """Attitude that the slew is to end in.

    Returns (4,).

    Examples
    --------
    >>> start, axis, row = jnp.array([0., 0., 0., 1.]), jnp.array([0., 0., 1.]), jnp.zeros(2)
    >>> schedule = SlewSchedule(start, axis, jnp.pi, 1., 1., False, 0., 2, row, row, row)
    >>> (target_attitude(schedule).round(6) + 0.0).tolist()
    [0.0, 0.0, 1.0, 0.0]
    """
    return quaternion.turned(schedule.start_attitude, schedule.axis_B * schedule.angle)


def reference_motion(schedule: SlewSchedule) -> ReferenceMotion:
    """The planned motion at all rows of a slew.

    Returns: every field with a leading axis of n rows.
    """
    t = schedule.time - schedule.motion_start
    step = jnp.append(jnp.diff(schedule.time), 0.0)
    motion = partial(
        angle_and_rate, schedule.angle, schedule.rate, schedule.acceleration, schedule.smooth
    )
    angle, rate = motion(t)
    _, middle_rate = motion(t + 0.5 * step)
    next_rate = jnp.append(rate[1:], rate[-1:])
    acceleration = jnp.where(step > 0.0, (next_rate - rate) / jnp.where(step > 0.0, step, 1.0), 0.0)
    attitude = quaternion.turned(schedule.start_attitude, angle[:, None] * schedule.axis_B)
    return ReferenceMotion(
        attitude=attitude,
        rate_B=rate[:, None] * schedule.axis_B,
        middle_rate_B=middle_rate[:, None] * schedule.axis_B,
        acceleration_B=acceleration[:, None] * schedule.axis_B,
        fix_gain=schedule.fix_gain,
        elapsed=jnp.concatenate([jnp.zeros(1), step[:-1]]),
    )


def wheel_command(
    law: ControlLaw, reference: ReferenceMotion, attitude: Array, rate_B: Array, momentum: Array
) -> Array:
    """Motor torques that the controller commands.

    Inverse dynamics of the planned motion (paper eq 6), and feedback of what differs from it.
    Saturation scales all wheels together, which keeps the torque's direction. A wheel at its
    momentum limit takes up no more, whatever the others do.

    `attitude` (4,); `rate_B` (3,) [rad/s]. `momentum` (wheels,): wheel momentum relative to the
    body, as the tachometers show it [N m s]. Returns (wheels,) [N m].
    """
    error = quaternion.error(reference.attitude, attitude)
    # The planned rate in the axes of the believed attitude.
    rate_error = rate_B - reference.rate_B + jnp.cross(error, reference.rate_B)
    wheel = momentum + law.spin_inertia * (reference.middle_rate_B @ law.wheel_axes_B)
    total = law.inertia_B @ reference.middle_rate_B + law.wheel_axes_B @ wheel
    acceleration = reference.acceleration_B - law.stiffness * error - law.damping * rate_error
    torque = -law.allocation @ (
        law.inertia_B @ acceleration + jnp.cross(reference.middle_rate_B, total)
    )
    torque = torque * jnp.min(
        law.max_torque / jnp.maximum(jnp.abs(torque), law.max_torque), initial=1.0
    )
    lowest = jnp.minimum(-law.max_momentum, momentum)
    highest = jnp.maximum(law.max_momentum, momentum)
    return jnp.clip(torque, (lowest - momentum) / law.period, (highest - momentum) / law.period)


class Plant(NamedTuple):
    """The spacecraft as it is, as arrays.

    Parameters
    ----------
    inertia_B : (3, 3) array
        Inertia tensor without the wheels' spin [kg m^2].
    scale_factor : (3,) array
        True K of the rate sensor.
    bias : (3,) array
        True bias of the rate sensor, in its own axes [rad/s].
    rate_axes : (3, 3) array
        C_rate, from body axes to sensor axes.
    start : Start
        State at the first row.
    """

    inertia_B: Array
    scale_factor: Array
    bias: Array
    rate_axes: Array
    start: Start


class SensorNoise(NamedTuple):
    """Noise of one slew of n rows.

    Parameters
    ----------
    rate : (n, 3) array
        Of the rate readings [rad/s].
    momentum : (n, wheels) array
        Of the tachometers [N m s].
    attitude : (n, 3) array
        Small rotation of each star-tracker fix, in body axes [rad].
    bias_snapshot : (3,) array
        Of the mean reading at rest that gives the controller its bias [rad/s].
    """

    rate: Array
    momentum: Array
    attitude: Array
    bias_snapshot: Array


class FlownSlew(NamedTuple):
    """One slew as flown, n rows: first what telemetry shows, then the truth.

    Parameters
    ----------
    command : (n, wheels) array
        Commanded torque on each wheel [N m].
    rate : (n, 3) array
        Readings of the rate sensor [rad/s].
    momentum : (n, wheels) array
        Wheel momentum as the tachometers show it [N m s].
    fixes : (n, 4) array
        What the star tracker would show in every row.
    attitude : (n, 4) array
        True attitude.
    rate_B : (n, 3) array
        True rate [rad/s].
    wheel_momentum : (n, wheels) array
        True wheel momentum relative to the body [N m s].
    final_error_B : (3,) array
        Rotation vector from the target to the true final attitude [rad].
    measured_error_B : (3,) array
        The same as the star tracker measures it [rad].
    relaxation_change : float
        Largest change of a command in the last round, as a fraction of the largest command.
    """

    command: Array
    rate: Array
    momentum: Array
    fixes: Array
    attitude: Array
    rate_B: Array
    wheel_momentum: Array
    final_error_B: Array
    measured_error_B: Array
    relaxation_change: Array


class _HookTerms(NamedTuple):
    """Terms of whole-history hooks, and the `commands` (grid, wheels) [N m] that they saw.

    They add to the sensor-axis rates `rate_S` (n, 3) [rad/s], the star tracker's `attitude` (n, 3)
    [rad] and the tachometers' `momentum` (n, wheels) [N m s].
    """

    rate_S: Array
    attitude: Array
    momentum: Array
    commands: Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """All that one slew in closed loop depends on; a pytree, with slews as leading axis for many.

    Parameters
    ----------
    slew : SlewInput
        Integration grid of n rows with `substeps` points each, and the environment on it. Its
        torques and momenta are not used.
    schedule : SlewSchedule
        What the controller is to fly.
    plant : Plant
        The spacecraft as it is; of many slews only `start` has the leading axis.
    law : ControlLaw
        What the controller believes, and its gains; all slews share it.
    noise : SensorNoise
        Noise of all sensors.
    active : ActiveEffects
        What else acts, in all slews.
    substeps : int
        Integration steps a row.
    """

    slew: SlewInput
    schedule: SlewSchedule
    plant: Plant
    law: ControlLaw
    noise: SensorNoise
    active: ActiveEffects
    substeps: int = field(default=1, metadata={"static": True})


def fly_slews(loop: ClosedLoop) -> FlownSlew:
    """`fly_slew` for all slews of a campaign; compiled once for each shape and set of effects."""
    return _flown(loop.active.effects, loop)


@KeptProgram
def _flown(effects: tuple[Effect, ...], loop: ClosedLoop) -> FlownSlew:
    """All slews at once; effects, those of the loop, say whose code is compiled."""

    def one(slew, schedule, start, noise):
        plant = loop.plant._replace(start=start)
        return fly_slew(replace(loop, slew=slew, schedule=schedule, plant=plant, noise=noise))

    return jax.vmap(one)(loop.slew, loop.schedule, loop.plant.start, loop.noise)


def fly_slew(loop: ClosedLoop) -> FlownSlew:
    """One slew in closed loop; a pure function that JAX can differentiate.

    Where effects act, only in forward mode.
    """
    n_rows, wheels = len(loop.schedule.time), loop.law.allocation.shape[0]
    no_torque = jnp.zeros((n_rows * loop.substeps, wheels))
    no_rotation = jnp.zeros((n_rows, 3))
    no_terms = _HookTerms(no_rotation, no_rotation, jnp.zeros((n_rows, wheels)), no_torque)
    one_round = partial(_round, loop)
    if not loop.active:
        return one_round(no_terms)[0]

    def not_converged(carry) -> Array:
        rounds, flown, _ = carry
        return (flown.relaxation_change > NUMERICS.relaxation_tolerance) & (
            rounds < NUMERICS.most_relaxations
        )

    def fly_again(carry):
        rounds, _, terms = carry
        return (rounds + 1, *one_round(terms))

    # An empty flight that has not converged, so that the round is compiled once and not twice.
    shapes = jax.eval_shape(one_round, no_terms)[0]
    empty = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    empty = empty._replace(relaxation_change=jnp.asarray(jnp.inf))
    return jax.lax.while_loop(not_converged, fly_again, (jnp.asarray(0), empty, no_terms))[1]


def _round(loop: ClosedLoop, terms: _HookTerms) -> tuple[FlownSlew, _HookTerms]:
    """Fly once with what the whole-history hooks made of the round before, and ask them again."""
    n_rows, substeps = len(loop.schedule.time), loop.substeps
    slew = loop.slew._replace(context=loop.slew.context._replace(torque=terms.commands))
    body, motion, delivered = prepare(slew, loop.plant.start, loop.plant.inertia_B, loop.active)
    exogenous = delivered - terms.commands if loop.active else jnp.zeros_like(terms.commands)
    period = partial(_control_period, loop, body, _bias_snapshot(loop, terms))
    first = (motion, loop.schedule.start_attitude, jnp.zeros(3))
    rows = _rows(loop, (grid_steps(slew), exogenous), terms)
    _, (path, command, reading, momentum, fixes) = jax.lax.scan(period, first, rows)
    path = jax.tree.map(lambda x: x.reshape(n_rows * substeps, *x.shape[2:]), path)
    trajectory, next_terms = _ask_hooks(loop, body, path, command)
    change = jnp.max(jnp.abs(next_terms.commands - terms.commands)) / jnp.maximum(
        jnp.max(jnp.abs(command)), 1e-30
    )
    attitude = trajectory.attitude[::substeps]
    final_error_B, measured_error_B = _final_errors(loop.schedule, attitude, fixes)
    flown = FlownSlew(
        command=command,
        rate=reading,
        momentum=momentum,
        fixes=fixes,
        attitude=attitude,
        rate_B=trajectory.rate_B[::substeps],
        wheel_momentum=trajectory.wheel_momentum[::substeps],
        final_error_B=final_error_B,
        measured_error_B=measured_error_B,
        relaxation_change=change,
    )
    return flown, next_terms


def _bias_snapshot(loop: ClosedLoop, terms: _HookTerms) -> Array:
    """The bias (3,) [rad/s] that the controller takes from readings at rest, times its K."""
    schedule, plant = loop.schedule, loop.plant
    resting = schedule.time < schedule.motion_start
    added_at_rest = jnp.mean(jnp.where(resting[:, None], terms.rate_S, 0.0), axis=0) * (
        len(schedule.time) / jnp.maximum(jnp.sum(resting), 1)
    )
    reading = (plant.bias + added_at_rest) / plant.scale_factor + loop.noise.bias_snapshot
    return loop.law.scale_factor * reading


def _rows(loop: ClosedLoop, grid: Any, terms: _HookTerms) -> dict[str, Any]:
    """Inputs of a scan over control periods: everything that differs from row to row."""
    n_rows = len(loop.schedule.time)
    unused = jnp.zeros(n_rows)
    return {
        "grid": jax.tree.map(lambda x: x.reshape(n_rows, loop.substeps, *x.shape[1:]), grid),
        "reference": reference_motion(loop.schedule),
        "noise": loop.noise._replace(bias_snapshot=unused),
        "terms": terms._replace(commands=unused),
    }


def _control_period(loop: ClosedLoop, body: Body, bias_snapshot: Array, carry, row):
    """One control period: measure, propagate the attitude, command, let the plant move."""
    motion, believed, last_rate = carry
    reading, momentum, fix = _measure(loop, body, motion, row)
    law, reference = loop.law, row["reference"]
    rate = law.rate_axes_inverse @ (law.scale_factor * reading - bias_snapshot)
    believed = _propagated(reference, believed, last_rate, rate, fix)
    command = wheel_command(law, reference, believed, rate, momentum)

    def substep(motion: SlewState, point) -> tuple[SlewState, SlewState]:
        step, exogenous = point
        return advance(body, motion, step, exogenous + command), motion

    motion, path = jax.lax.scan(substep, motion, row["grid"], unroll=loop.substeps <= 4)
    return (motion, believed, rate), (path, command, reading, momentum, fix)


def _measure(loop: ClosedLoop, body: Body, motion: SlewState, row) -> tuple[Array, Array, Array]:
    """Rate reading (3,), tachometer momentum (wheels,) and star-tracker fix (4,) at a row."""
    plant, terms, noise = loop.plant, row["terms"], row["noise"]
    rate_B, momentum = body.rate_and_wheel_momentum(motion)
    rate_S = plant.rate_axes @ rate_B + plant.bias + terms.rate_S
    reading = jnp.clip(
        rate_S / plant.scale_factor + noise.rate, -loop.law.rate_range, loop.law.rate_range
    )
    fix = quaternion.turned(jnp.stack(motion.attitude), terms.attitude)
    fix = quaternion.turned(fix, noise.attitude)
    return reading, momentum + terms.momentum + noise.momentum, fix


def _propagated(
    reference: ReferenceMotion, attitude: Array, last_rate_B: Array, rate_B: Array, fix: Array
) -> Array:
    """The believed attitude (4,): propagated, and moved to the mean of the fixes."""
    attitude = quaternion.turned(attitude, 0.5 * reference.elapsed * (last_rate_B + rate_B))
    return quaternion.turned(attitude, reference.fix_gain * quaternion.error(attitude, fix))


def _ask_hooks(
    loop: ClosedLoop, body: Body, path: SlewState, command: Array
) -> tuple[Trajectory, _HookTerms]:
    """The trajectory on the grid, and what the whole-history hooks make of it."""
    rate_B, momentum = jax.vmap(body.rate_and_wheel_momentum)(path)
    attitude = jnp.stack(path.attitude, -1)
    no_states = jnp.zeros((len(body.context.time), 0))
    trajectory = Trajectory(body.context.time, attitude, rate_B, momentum, no_states)
    last = jnp.minimum(jnp.arange(len(command)), loop.schedule.n_rows - 1)
    commands = jnp.repeat(command[last], loop.substeps, axis=0)
    context = body.context._replace(torque=commands)
    plain = rate_B @ loop.plant.rate_axes.T + loop.plant.bias
    rate_S, fix, tachometer = plain, attitude, momentum
    for (effect, p), effect_states in zip(loop.active, path.effect_states, strict=True):
        with_states = trajectory._replace(effect_states=effect_states)
        rate_S = effect.rate_output(p, context, with_states, rate_S)
        fix = effect.attitude_output(p, context, with_states, fix)
        tachometer = effect.momentum_output(p, context, with_states, tachometer)
    terms = _HookTerms(
        rate_S=(rate_S - plain)[:: loop.substeps],
        attitude=quaternion.error(attitude, fix)[:: loop.substeps],
        momentum=(tachometer - momentum)[:: loop.substeps],
        commands=commands,
    )
    return trajectory, terms


def _final_errors(schedule: SlewSchedule, attitude: Array, fixes: Array) -> tuple[Array, Array]:
    """Rotation vectors (3,) [rad] from target to final attitude: the true one, the tracker's."""
    target = target_attitude(schedule)
    true = quaternion.error(target, attitude[schedule.n_rows - 1])
    return true, schedule.final_fix_weight @ quaternion.error(target, fixes)
