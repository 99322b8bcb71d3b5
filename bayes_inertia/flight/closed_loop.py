"""The closed loop of one slew as compiled code: truth, sensors and controller together, one step per control period.

The controller follows the planned rotation about a body-fixed axis. It feeds forward the torque that its own
inertia tensor asks for and feeds back attitude and rate, both from RATE SENSORS ALONE during the motion: the
attitude is propagated from scaled readings, beginning with the star tracker's mean attitude in the rest before
the slew. What it gets wrong in the scale factors therefore stays in the final attitude, as in Ferguson's paper.

The truth is `bayes_inertia.physics.simulator`. Effects that act at an instant act inside the loop. Effects whose hook
needs the whole history (a lag, a sensor's delay) are found by waveform relaxation: fly, ask the hooks what they
make of that history, fly again with the difference as a given input, until nothing changes.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from bayes_inertia.flight.plan import angle_and_rate
from bayes_inertia.maths import quaternion
from bayes_inertia.physics.active_effects import ActiveEffects
from bayes_inertia.physics.effect import Trajectory
from bayes_inertia.physics.simulator import (
    Motion,
    SlewInput,
    Start,
    advance,
    grid_rows,
    prepare,
    rate_and_wheel_momentum,
)

# Relaxation ends when no command changes by more than this fraction of the largest.
TOLERANCE = 1e-9
MOST_ROUNDS = 60


class Truth(NamedTuple):
    """The spacecraft as it is: `inertia_B` (3, 3) [kg m^2] without the wheels' spin, `scale_factor` (3,), `bias` (3,)
    [rad/s], `rate_axes` C_rate (3, 3), `start`."""

    inertia_B: Array
    scale_factor: Array
    bias: Array
    rate_axes: Array
    start: Start


class Control(NamedTuple):
    """What the controller believes and how it acts: `inertia_B` (3, 3), `scale_factor` (3,), `rate_axes_inverse` (3, 3),
    `wheel_axes_B` (3, wheels), `allocation` (wheels, 3) its pseudo-inverse, `spin_inertia` (wheels,), `max_torque` (wheels,)
    [N m], `stiffness` [1/s^2] and `damping` [1/s] of the closed loop, `rate_range` of the sensor [rad/s]."""

    inertia_B: Array
    scale_factor: Array
    rate_axes_inverse: Array
    wheel_axes_B: Array
    allocation: Array
    spin_inertia: Array
    max_torque: Array
    stiffness: Array
    damping: Array
    rate_range: Array


class Script(NamedTuple):
    """One slew as planned: `attitude` (4,) before it, `axis_B` (3,), `angle`, `rate`, `acceleration`, `smooth` (bool), `begin` of
    the motion [s], `rows` how many rows are no padding, `time` (n,) of the rows [s], `fix_gain` (n,) the share of each fix
    before the motion in the mean attitude so far (0: no fix), `fix_after` (n,) the weights of those after it."""

    attitude: Array
    axis_B: Array
    angle: Array
    rate: Array
    acceleration: Array
    smooth: Array
    begin: Array
    rows: Array
    time: Array
    fix_gain: Array
    fix_after: Array


class Noise(NamedTuple):
    """Noise of one slew: `rate` (n, 3) [rad/s] of the readings, `momentum` (n, wheels) [N m s], `attitude` (n, 3) [rad],
    `snapshot` (3,) [rad/s] of the mean reading at rest that gives the controller its bias."""

    rate: Array
    momentum: Array
    attitude: Array
    snapshot: Array


class Flown(NamedTuple):
    """One slew as flown (n rows): what telemetry shows (`command` (n, wheels) [N m], `rate` (n, 3), `momentum` (n, wheels),
    `fixes` (n, 4)), the truth (`attitude` (n, 4), `rate_B` (n, 3), `wheel_momentum` (n, wheels)), the errors of the final
    attitude (`final_error_B`, and `seen_error_B` as the star tracker sees it; (3,) [rad]), and the last relative
    `change` of the relaxation."""

    command: Array
    rate: Array
    momentum: Array
    fixes: Array
    attitude: Array
    rate_B: Array
    wheel_momentum: Array
    final_error_B: Array
    seen_error_B: Array
    change: Array


class _Given(NamedTuple):
    """What whole-history hooks add: to the delivered torque (grid, wheels), the sensor-axis rates (n, 3), the star
    tracker (n, 3) [rad], the tachometers (n, wheels); and the `commands` (grid, wheels) that they saw."""

    torque: Array
    rate_S: Array
    attitude: Array
    momentum: Array
    commands: Array


class _Reference(NamedTuple):
    """The planned motion at a row, and over the period that begins there."""

    attitude: Array
    rate_B: Array
    middle_rate_B: Array
    acceleration_B: Array
    fix_gain: Array
    elapsed: Array


def target(script: Script) -> Array:
    """Attitude (4,) that the slew is to end in.

    >>> values = (jnp.array([0., 0., 0., 1.]), jnp.array([0., 0., 1.]), jnp.pi, 1., 1., False, 0., 2, jnp.arange(2.), jnp.zeros(2), jnp.zeros(2))
    >>> (target(Script(*values)).round(6) + 0.0).tolist()
    [0.0, 0.0, 1.0, 0.0]
    """
    return quaternion.multiply(script.attitude, quaternion.exp(script.axis_B * script.angle))


@partial(jax.jit, static_argnames="substeps")
def fly_slews(
    slews: SlewInput,
    scripts: Script,
    truth: Truth,
    control: Control,
    noise: Noise,
    active: ActiveEffects,
    substeps: int,
) -> Flown:
    """`fly_slew` for all slews of a campaign: `slews`, `scripts`, `noise` and `truth.start` with a leading axis, `truth`'s constants,
    `control` and `active` shared. Compiled once for each shape and set of effects."""
    axes = (0, 0, Truth(None, None, None, None, 0), None, 0, None)
    return jax.vmap(partial(fly_slew, substeps=substeps), in_axes=axes)(
        slews, scripts, truth, control, noise, active
    )


def fly_slew(
    slew: SlewInput,
    script: Script,
    truth: Truth,
    control: Control,
    noise: Noise,
    active: ActiveEffects,
    *,
    substeps: int = 1,
) -> Flown:
    """One slew in closed loop; a pure function that JAX can differentiate (forward mode where there are effects).

    Parameters
    ----------
    slew : the integration grid, `substeps` points a row, and the environment on it (its torques and momenta are not used).
    script, truth, control, noise : see there. active : what else acts.
    """
    rows, wheels = len(script.time), control.allocation.shape[0]
    nothing = jnp.zeros((rows * substeps, wheels))
    given = _Given(
        nothing, jnp.zeros((rows, 3)), jnp.zeros((rows, 3)), jnp.zeros((rows, wheels)), nothing
    )
    one_round = partial(_round, slew, script, truth, control, noise, active, substeps)
    if not active:
        return one_round(given)[0]

    def going(carry) -> Array:
        rounds, flown, _ = carry
        return (flown.change > TOLERANCE) & (rounds < MOST_ROUNDS)

    def again(carry):
        rounds, _, given = carry
        return (rounds + 1, *one_round(given))

    # An empty flight that has not converged, so that the round is compiled once and not twice.
    empty = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(one_round, given)[0])
    return jax.lax.while_loop(
        going, again, (jnp.asarray(0), empty._replace(change=jnp.asarray(jnp.inf)), given)
    )[1]


def _round(
    slew: SlewInput,
    script,
    truth: Truth,
    control: Control,
    noise: Noise,
    active: ActiveEffects,
    substeps: int,
    given: _Given,
) -> tuple[Flown, _Given]:
    """Fly once with what the whole-history hooks made of the round before, and ask them again."""
    rows, context = len(script.time), slew.context._replace(torque=given.commands)
    slew = slew._replace(context=context)
    body, motion, delivered = prepare(slew, truth.start, truth.inertia_B, active)
    exogenous = delivered - given.commands if active else given.torque
    reference = _references(script, control)
    still = jnp.mean(
        jnp.where((script.time < script.begin)[:, None], given.rate_S, 0.0), axis=0
    ) * (len(script.time) / jnp.maximum(jnp.sum(script.time < script.begin), 1))
    snapshot = control.scale_factor * ((truth.bias + still) / truth.scale_factor + noise.snapshot)

    def measure(motion: Motion, row) -> tuple[Array, Array, Array]:
        rate_B, momentum = rate_and_wheel_momentum(motion, body, context, active)
        rate_S = truth.rate_axes @ rate_B + truth.bias + row["given"].rate_S
        reading = jnp.clip(
            rate_S / truth.scale_factor + row["noise"].rate, -control.rate_range, control.rate_range
        )
        fix = quaternion.multiply(jnp.stack(motion.attitude), quaternion.exp(row["given"].attitude))
        fix = quaternion.multiply(fix, quaternion.exp(row["noise"].attitude))
        return reading, momentum + row["given"].momentum + row["noise"].momentum, fix

    def period(carry, row):
        motion, believed, last_rate = carry
        reading, momentum, fix = measure(motion, row)
        plan: _Reference = row["plan"]
        rate = control.rate_axes_inverse @ (control.scale_factor * reading - snapshot)
        believed = quaternion.multiply(
            believed, quaternion.exp(0.5 * plan.elapsed * (last_rate + rate))
        )
        believed = quaternion.multiply(
            believed, quaternion.exp(plan.fix_gain * quaternion.error(believed, fix))
        )
        command = _command(control, plan, believed, rate, momentum)

        def substep(motion: Motion, inner) -> tuple[Motion, Motion]:
            torque = tuple(u + command[k] for k, u in enumerate(inner["torque"][0]))
            return advance(
                motion, inner | {"torque": (torque, torque)}, body, context, active
            ), motion

        motion, path = jax.lax.scan(substep, motion, row["grid"], unroll=substeps <= 4)
        return (motion, believed, rate), (path, command, reading, momentum, fix)

    by_row = jax.tree.map(
        lambda x: x.reshape(rows, substeps, *x.shape[1:]), grid_rows(slew, exogenous)
    )
    per_row = Noise(noise.rate, noise.momentum, noise.attitude, jnp.zeros(len(script.time)))
    shares = _Given(
        jnp.zeros(len(script.time)),
        given.rate_S,
        given.attitude,
        given.momentum,
        jnp.zeros(len(script.time)),
    )
    inputs = {"grid": by_row, "plan": reference, "noise": per_row, "given": shares}
    first = (motion, script.attitude, jnp.zeros(3))
    _, (path, command, reading, momentum, fixes) = jax.lax.scan(period, first, inputs)
    path = jax.tree.map(lambda x: x.reshape(rows * substeps, *x.shape[2:]), path)
    seen, following = _hooks(path, command, script, truth, context, body, active, substeps)
    change = jnp.max(jnp.abs(following.commands - given.commands)) / jnp.maximum(
        jnp.max(jnp.abs(command)), 1e-30
    )
    return _flown(script, command, reading, momentum, fixes, seen, substeps, change), following


def _references(script: Script, control: Control) -> _Reference:
    """The planned motion at all rows."""
    t = script.time - script.begin
    step = jnp.append(jnp.diff(script.time), 0.0)
    motion = partial(angle_and_rate, script.angle, script.rate, script.acceleration, script.smooth)
    angle, rate = motion(t)
    _, middle = motion(t + 0.5 * step)
    following = jnp.append(rate[1:], rate[-1:])
    acceleration = jnp.where(step > 0.0, (following - rate) / jnp.where(step > 0.0, step, 1.0), 0.0)
    attitude = quaternion.multiply(script.attitude, quaternion.exp(angle[:, None] * script.axis_B))
    along = [x[:, None] * script.axis_B for x in (rate, middle, acceleration)]
    elapsed = jnp.concatenate([jnp.zeros(1), step[:-1]])
    return _Reference(attitude, *along, script.fix_gain, elapsed)


def _command(
    control: Control, plan: _Reference, believed: Array, rate: Array, momentum: Array
) -> Array:
    """Motor torques on the wheels (wheels,): inverse dynamics of the planned motion (paper eq 6) and feedback of what differs from it.

    Saturation scales all wheels together, which keeps the torque's direction.
    """
    error = quaternion.error(plan.attitude, believed)
    excess = (
        rate - plan.rate_B + jnp.cross(error, plan.rate_B)
    )  # the planned rate in the axes of the believed attitude
    wheel = momentum + control.spin_inertia * (plan.middle_rate_B @ control.wheel_axes_B)
    total = control.inertia_B @ plan.middle_rate_B + control.wheel_axes_B @ wheel
    wanted = plan.acceleration_B - control.stiffness * error - control.damping * excess
    torque = -control.allocation @ (
        control.inertia_B @ wanted + jnp.cross(plan.middle_rate_B, total)
    )
    return torque * jnp.min(
        control.max_torque / jnp.maximum(jnp.abs(torque), control.max_torque), initial=1.0
    )


def _hooks(
    path: Motion,
    command: Array,
    script: Script,
    truth: Truth,
    context,
    body,
    active: ActiveEffects,
    substeps: int,
) -> tuple[Trajectory, _Given]:
    """The trajectory on the grid, and what the whole-history hooks make of it."""
    rate_B, momentum = jax.vmap(
        lambda motion: rate_and_wheel_momentum(motion, body, context, active)
    )(path)
    attitude = jnp.stack(path.attitude, -1)
    trajectory = Trajectory(
        context.time, attitude, rate_B, momentum, jnp.zeros((len(context.time), 0))
    )
    last = jnp.minimum(jnp.arange(len(command)), script.rows - 1)
    commands = jnp.repeat(command[last], substeps, axis=0)
    context = context._replace(torque=commands)
    plain = rate_B @ truth.rate_axes.T + truth.bias
    rate_S, fix, tachometer = plain, attitude, momentum
    for (effect, p), own in zip(active, path.own, strict=True):
        seen = trajectory._replace(own=own)
        rate_S = effect.rate_output(p, context, seen, rate_S)
        fix = effect.attitude_output(p, context, seen, fix)
        tachometer = effect.momentum_output(p, context, seen, tachometer)
    added = (rate_S - plain, quaternion.error(attitude, fix), tachometer - momentum)
    return trajectory, _Given(jnp.zeros_like(commands), *(x[::substeps] for x in added), commands)


def _flown(
    script: Script, command, reading, momentum, fixes, seen: Trajectory, substeps: int, change
) -> Flown:
    attitude, rate_B, wheel = (
        x[::substeps] for x in (seen.attitude, seen.rate_B, seen.wheel_momentum)
    )
    goal = target(script)
    final = quaternion.error(goal, attitude[script.rows - 1])
    visible = script.fix_after @ quaternion.error(goal, fixes)
    return Flown(command, reading, momentum, fixes, attitude, rate_B, wheel, final, visible, change)
