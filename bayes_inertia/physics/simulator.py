"""The slew simulator: attitude, body rate and wheel momentum from torque commands or tachometers.

The state is the attitude and the TOTAL momentum in inertial axes M_N, not the body rate: without
external torque M_N is constant to rounding, and the rate follows from
`J w = C(q) M_N - G H` (commanded drive, H' = u) or `J_locked w = C(q) M_N - G h` (measured drive,
h the tachometer momentum). This is the integral of Ferguson's eq 6. Classical Runge-Kutta of
fourth order on the grid of telemetry times, refined where an effect asks for it.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from bayes_inertia.maths import inertia_tensor, quaternion
from bayes_inertia.physics.active_effects import ActiveEffects
from bayes_inertia.physics.effect import SlewContext, State, Trajectory

Drive = Literal["commanded", "measured"]
# Hooks that make more than the attitude change during a slew.
_MOVING_HOOKS = ("wheel_torque", "body_torque", "initial_state", "internal_momentum")


class SlewInput(NamedTuple):
    """Everything the simulator needs of one slew, on its grid of n points (`context` and environment).

    `momentum` (n, wheels) [N m s] is the wheel momentum that drives the `measured` mode (unused by `commanded`);
    `magnetic_field_N` (n, 3) [T] and `position_N` (n, 3) [m] are zero where unknown.
    """

    context: SlewContext
    momentum: Array
    magnetic_field_N: Array
    position_N: Array


class Start(NamedTuple):
    """State at the slew's first row: `rate_B` (3,) [rad/s], `attitude` (4,), `wheel_momentum` (wheels,) relative to the body [N m s]."""

    rate_B: Array
    attitude: Array
    wheel_momentum: Array


class Motion(NamedTuple):
    """The integrated state, vectors as tuples of components (see `rotation`): `attitude` (4), `momentum_N` (3) the total
    momentum in inertial axes [N m s], `wheel` (wheels) and each effect's own states."""

    attitude: tuple[Array, ...]
    momentum_N: tuple[Array, ...]
    wheel: tuple[Array, ...]  # H in the commanded drive; unused in the measured one
    own: tuple[Array, ...]


class Body(NamedTuple):
    """Constants of one slew: inverse of the inertia that turns momentum into rate, J_locked, wheel axes, spin inertia."""

    inverse: Array
    locked: Array
    axes_B: Array
    spin_inertia: Array


def simulate(
    slew: SlewInput,
    start: Start,
    inertia_B: Array,
    active: ActiveEffects | None = None,
    drive: Drive = "commanded",
) -> tuple[Trajectory, tuple[Array, ...]]:
    """Simulate one slew.

    Parameters
    ----------
    slew, start : what was commanded or measured, and the initial state.
    inertia_B : (3, 3) [kg m^2], J of everything except the wheels' spin.
    active : what else acts; None for nothing.
    drive : "commanded" (torques are the input, wheel momentum an output) or "measured" (wheel momentum is the input).

    Returns
    -------
    The trajectory on the grid (its `own` is empty) and each effect's own states (n, k).

    >>> import numpy as np
    >>> from bayes_inertia.physics.simulator import idle_slew
    >>> slew = idle_slew(np.arange(3.0))
    >>> start = Start(jnp.array([0.1, 0.0, 0.0]), jnp.array([0., 0., 0., 1.]), jnp.zeros(0))
    >>> simulate(slew, start, jnp.eye(3))[0].rate_B[:, 0].round(9).tolist()
    [0.1, 0.1, 0.1]
    """
    active = ActiveEffects() if active is None else active
    context = slew.context
    body, motion, torque = prepare(slew, start, inertia_B, active, drive)
    coasting = not active.act(*_MOVING_HOOKS)
    path = (_attitude_path if coasting else _full_path)(slew, body, motion, torque, active, drive)
    wheel = _stack(path.wheel, len(context.time)) if drive == "commanded" else slew.momentum
    attitude, own = jnp.stack(path.attitude, -1), path.own
    internal = _internal_momentum(active, context, own)
    momentum_B = (
        quaternion.to_body(attitude, jnp.stack(path.momentum_N, -1))
        - wheel @ body.axes_B.T
        - internal
    )
    rate = momentum_B @ body.inverse.T
    momentum = wheel if drive == "measured" else wheel - body.spin_inertia * (rate @ body.axes_B)
    return Trajectory(
        context.time, attitude, rate, momentum, jnp.zeros((len(context.time), 0))
    ), own


def idle_slew(
    time, wheels: int = 0, wheel_axes_B=None, spin_inertia=None, torque=None
) -> SlewInput:
    """A slew input on the given grid (n,) with wheels that rest unless `torque` (n, wheels) [N m] is given.

    >>> idle_slew([0.0, 1.0]).context.step.tolist()
    [1.0, 0.0]
    """
    time = jnp.asarray(time, dtype=float)
    n = len(time)
    axes = (
        jnp.zeros((3, wheels)) if wheel_axes_B is None else jnp.asarray(wheel_axes_B, dtype=float)
    )
    wheels = axes.shape[1]
    spin = jnp.zeros(wheels) if spin_inertia is None else jnp.asarray(spin_inertia, dtype=float)
    torque = jnp.zeros((n, wheels)) if torque is None else jnp.asarray(torque, dtype=float)
    step = jnp.append(jnp.diff(time), 0.0)
    context = SlewContext(
        index=jnp.asarray(0),
        slews=jnp.asarray(1),
        start=jnp.asarray(0.0),
        middle=0.5 * (time[0] + time[-1]),
        time=time,
        step=step,
        torque=torque,
        wheel_axes_B=axes,
        spin_inertia=spin,
        boresight_B=jnp.array([0.0, 0.0, 1.0]),
        rate_axes=jnp.eye(3),
    )
    return SlewInput(context, jnp.zeros((n, wheels)), jnp.zeros((n, 3)), jnp.zeros((n, 3)))


def total_momentum_N(
    trajectory: Trajectory, inertia_B: Array, wheel_axes_B: Array, spin_inertia: Array
) -> Array:
    """J w + G H (n, 3) [N m s] in inertial axes, from a trajectory without own states: constant where no external torque acts.

    >>> slew = idle_slew([0.0, 1.0]); start = Start(jnp.array([0.1, 0., 0.]), jnp.array([0., 0., 0., 1.]), jnp.zeros(0))
    >>> total_momentum_N(simulate(slew, start, jnp.eye(3))[0], jnp.eye(3), jnp.zeros((3, 0)), jnp.zeros(0))[1, 0].round(9).item()
    0.1
    """
    locked = inertia_B + inertia_tensor.wheel_spin_tensor(wheel_axes_B, spin_inertia)
    momentum_B = trajectory.rate_B @ locked + trajectory.wheel_momentum @ wheel_axes_B.T
    return quaternion.to_inertial(trajectory.attitude, momentum_B)


def prepare(
    slew: SlewInput,
    start: Start,
    inertia_B: Array,
    active: ActiveEffects,
    drive: Drive = "commanded",
) -> tuple[Body, Motion, Array]:
    """Constants and initial motion of one slew, and the torque (n, wheels) [N m] that the wheels deliver for the commanded one.

    >>> slew = idle_slew([0.0, 1.0]); start = Start(jnp.array([0.1, 0., 0.]), jnp.array([0., 0., 0., 1.]), jnp.zeros(0))
    >>> prepare(slew, start, 2.0 * jnp.eye(3), ActiveEffects())[1].momentum_N[0].item()
    0.2
    """
    context = slew.context
    axes, torque = context.wheel_axes_B, context.torque
    for effect, p in active:
        inertia_B = effect.inertia(p, context, inertia_B)
        axes = effect.wheel_axes(p, context, axes)
        torque = effect.delivered_torque(p, context, torque)
    own = tuple(effect.initial_state(p, context, start.rate_B) for effect, p in active)
    locked = inertia_B + inertia_tensor.wheel_spin_tensor(axes, context.spin_inertia)
    relative = start.wheel_momentum if drive == "commanded" else slew.momentum[0]
    internal = _internal_momentum(active, context, own)
    momentum_B = locked @ start.rate_B + axes @ relative + internal
    wheel = relative + context.spin_inertia * (axes.T @ start.rate_B)
    inverse = jnp.linalg.inv(inertia_B if drive == "commanded" else locked)
    momentum_N = quaternion.to_inertial(start.attitude, momentum_B)
    motion = Motion(tuple(start.attitude), tuple(momentum_N), tuple(wheel), own)
    return Body(inverse, locked, axes, context.spin_inertia), motion, torque


def grid_rows(slew: SlewInput, torque: Array) -> dict:
    """What `advance` reads at each grid point: time, step, and each input's values at the step's two ends, by components.

    `torque` (n, wheels) [N m] is delivered to the wheels and held over the step.

    >>> sorted(grid_rows(idle_slew([0.0, 1.0]), jnp.zeros((2, 0))))
    ['field', 'position', 'step', 'time', 'torque', 'wheel']
    """
    rows = {
        "torque": torque,
        "wheel": slew.momentum,
        "field": slew.magnetic_field_N,
        "position": slew.position_N,
    }
    ahead: dict = {key: (_columns(value), _columns(_next(value))) for key, value in rows.items()}
    return ahead | {"time": slew.context.time, "step": slew.context.step}


def advance(
    motion: Motion,
    row: dict,
    body: Body,
    context: SlewContext,
    active: ActiveEffects,
    drive: Drive = "commanded",
) -> Motion:
    """The motion one grid step later; `row` is one point of `grid_rows`. A step of zero length changes nothing.

    >>> slew = idle_slew([0.0, 1.0]); start = Start(jnp.array([0.1, 0., 0.]), jnp.array([0., 0., 0., 1.]), jnp.zeros(0))
    >>> body, motion, torque = prepare(slew, start, jnp.eye(3), ActiveEffects())
    >>> row = jax.tree.map(lambda rows: rows[0], grid_rows(slew, torque))
    >>> advance(motion, row, body, slew.context, ActiveEffects()).attitude[0].round(4).item()
    0.05
    """

    def slope(at: float, x: Motion) -> Motion:
        return _slope(at, x, row, body, context, active, drive)

    following = _runge_kutta_4(slope, motion, row["step"])
    return following._replace(attitude=_unit(following.attitude))


def rate_and_wheel_momentum(
    motion: Motion, body: Body, context: SlewContext, active: ActiveEffects
) -> tuple[Array, Array]:
    """Body rate (3,) [rad/s] and wheel momentum relative to the body (wheels,) [N m s] at one instant of the commanded drive.

    >>> slew = idle_slew([0.0, 1.0]); start = Start(jnp.array([0.1, 0., 0.]), jnp.array([0., 0., 0., 1.]), jnp.zeros(0))
    >>> body, motion, _ = prepare(slew, start, 2.0 * jnp.eye(3), ActiveEffects())
    >>> rate_and_wheel_momentum(motion, body, slew.context, ActiveEffects())[0].tolist()
    [0.1, 0.0, 0.0]
    """
    wheel = _stack(motion.wheel)
    momentum_B = jnp.stack(quaternion.to_body_components(motion.attitude, motion.momentum_N))
    rate = body.inverse @ (
        momentum_B - body.axes_B @ wheel - _internal_momentum(active, context, motion.own)
    )
    return rate, wheel - body.spin_inertia * (rate @ body.axes_B)


def _full_path(
    slew: SlewInput, body: Body, motion: Motion, torque: Array, active: ActiveEffects, drive: Drive
) -> Motion:
    """The motion at every grid point where momentum, wheels or own states change along the way."""

    def step(motion: Motion, row: dict) -> tuple[Motion, Motion]:
        return advance(motion, row, body, slew.context, active, drive), motion

    return jax.lax.scan(step, motion, grid_rows(slew, torque))[1]


def _attitude_path(
    slew: SlewInput, body: Body, motion: Motion, torque: Array, active: ActiveEffects, drive: Drive
) -> Motion:
    """The same where only the attitude needs integration: M_N is constant and the wheels are known beforehand.

    Without the constants in its loop this takes 0.6 of the time of `_full_path`.
    """
    n = len(slew.context.time)
    if drive == "commanded":
        # Kept apart from the start value, so that draws of one slew share these rows.
        gained = jnp.cumsum(torque * slew.context.step[:, None], axis=0)
        wheel, offset = (
            jnp.concatenate([jnp.zeros((1, torque.shape[1])), gained[:-1]]),
            motion.wheel,
        )
    else:
        wheel, offset = slew.momentum, tuple(jnp.zeros_like(h) for h in motion.wheel)

    def step(attitude, row):
        ends, h = row

        def slope(at: float, q):
            now = [h + gain for h, gain in zip(offset, _between(at, ends), strict=True)]
            return quaternion.rate_of_components(
                q, _rate_components(body, q, motion.momentum_N, now)
            )

        return _unit(_runge_kutta_4(slope, attitude, h)), attitude

    _, attitude = jax.lax.scan(
        step, motion.attitude, ((_columns(wheel), _columns(_next(wheel))), slew.context.step)
    )
    own = jax.tree.map(lambda x: jnp.broadcast_to(x, (n, *x.shape)), motion.own)
    momentum_N = tuple(jnp.broadcast_to(m, n) for m in motion.momentum_N)
    wheel = tuple(h + column for h, column in zip(offset, _columns(wheel), strict=True))
    return motion._replace(attitude=attitude, momentum_N=momentum_N, wheel=wheel, own=own)


def _rate_components(body, attitude, momentum_N, wheel) -> list[Array]:
    # Runge-Kutta's inner stages leave the unit sphere: with C(q) of the unit quaternion its error is a
    # quarter as large and does not depend on the choice of inertial axes.
    momentum_B = quaternion.to_body_components(_unit(attitude), momentum_N)
    momentum_B = [
        m - sum(body.axes_B[i, k] * h for k, h in enumerate(wheel))
        for i, m in enumerate(momentum_B)
    ]
    return [sum(body.inverse[i, j] * momentum_B[j] for j in range(3)) for i in range(3)]


def _unit(attitude):
    shrink = 1.0 / jnp.sqrt(sum(c * c for c in attitude))
    return tuple(c * shrink for c in attitude)


def _internal_momentum(active: ActiveEffects, context: SlewContext, own) -> Array:
    total = jnp.zeros(3)
    for (effect, p), states in zip(active, own, strict=True):
        if effect.acts("internal_momentum"):
            hook = effect.internal_momentum
            total = total + (
                hook(p, context, states)
                if states.ndim == 1
                else jax.vmap(lambda x, h=hook, p=p: h(p, context, x))(states)
            )
    return total


def _slope(
    at: float, x: Motion, row: dict, body: Body, context, active: ActiveEffects, drive: Drive
) -> Motion:
    """Time derivative of the motion, `at` a fraction of the step after its beginning."""
    wheel = x.wheel if drive == "commanded" else _between(at, row["wheel"])
    unit = _unit(x.attitude)  # as in `_rate_components`
    momentum_B = quaternion.to_body_components(unit, x.momentum_N)
    momentum_B = [
        m - sum(body.axes_B[i, k] * h for k, h in enumerate(wheel))
        for i, m in enumerate(momentum_B)
    ]
    if active.act("internal_momentum"):
        internal = _internal_momentum(active, context, x.own)
        momentum_B = [m - internal[i] for i, m in enumerate(momentum_B)]
    rate = [sum(body.inverse[i, j] * momentum_B[j] for j in range(3)) for i in range(3)]
    attitude_rate = quaternion.rate_of_components(x.attitude, rate)
    if not active:
        return Motion(attitude_rate, _zeros(x.momentum_N), row["torque"][0], ())
    external, wheel_torque, own_rates = _effect_slopes(
        at, x._replace(attitude=unit), row, body, context, active, drive, rate, wheel
    )
    momentum_rate = _zeros(x.momentum_N)
    if active.act("body_torque"):
        momentum_rate = quaternion.to_inertial_components(unit, tuple(external))
    total = tuple(u + wheel_torque[k] for k, u in enumerate(row["torque"][0]))
    return Motion(attitude_rate, momentum_rate, total, own_rates)


def _effect_slopes(
    at, x: Motion, row, body: Body, context, active: ActiveEffects, drive, rate, wheel
):
    """External torque (3,), further torque on the wheels (wheels,), and the rates of all own states."""
    rate_B, wheel = jnp.stack(rate), _stack(wheel)
    relative = wheel - body.spin_inertia * (rate_B @ body.axes_B) if drive == "commanded" else wheel
    field, position = (
        jnp.stack(_between(at, row["field"])),
        jnp.stack(_between(at, row["position"])),
    )
    t = row["time"] + at * row["step"]
    external, wheel_torque, own_rates = jnp.zeros(3), jnp.zeros_like(relative), []
    for (effect, p), own in zip(active, x.own, strict=True):
        state = State(jnp.stack(x.attitude), rate_B, relative, own, body.locked, field, position)
        if effect.acts("body_torque"):
            external = external + effect.body_torque(p, context, t, state)
        if effect.acts("wheel_torque"):
            wheel_torque = wheel_torque + effect.wheel_torque(p, context, t, state)
        own_rates.append(effect.state_rate(p, context, t, state))
    return external, wheel_torque, tuple(own_rates)


def _between(at: float, ends: tuple[tuple[Array, ...], tuple[Array, ...]]) -> tuple[Array, ...]:
    return tuple(a + at * (b - a) for a, b in zip(*ends, strict=True))


def _zeros(components: tuple[Array, ...]) -> tuple[Array, ...]:
    return tuple(jnp.zeros_like(c) for c in components)


def _columns(rows: Array) -> tuple[Array, ...]:
    return tuple(rows[:, i] for i in range(rows.shape[1]))


def _stack(components: tuple[Array, ...], *shape: int) -> Array:
    return jnp.stack(components, -1) if len(components) else jnp.zeros((*shape, 0))


def _runge_kutta_4(slope, x: Motion, step: Array) -> Motion:
    """One classical step. The stages are a loop, not written out: with many effects the compiler takes minutes otherwise."""

    def stage(carry, row):
        at, share = row
        k, total = carry
        k = slope(at, jax.tree.map(lambda a, b: a + at * step * b, x, k))
        return (k, jax.tree.map(lambda t, b: t + share * step * b, total, k)), None

    still = jax.tree.map(jnp.zeros_like, x)
    stages = (jnp.array([0.0, 0.5, 0.5, 1.0]), jnp.array([1.0, 2.0, 2.0, 1.0]) / 6.0)
    return jax.lax.scan(stage, (still, x), stages)[0][1]


def _next(rows: Array) -> Array:
    return jnp.concatenate([rows[1:], rows[-1:]])
