"""The slew simulator: attitude, body rate and wheel momentum from torque commands or tachometers.

The state is the attitude and the TOTAL momentum in inertial axes M_N, not the body rate: without
external torque M_N is constant to rounding, and the rate follows from
`J w = C(q) M_N - G H` (commanded drive, H' = u) or `J_locked w = C(q) M_N - G h` (measured drive,
h the tachometer momentum). This is the integral of Ferguson's eq 6. Classical Runge-Kutta of
fourth order on the grid of telemetry times, refined where an effect asks for it.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from bayes_inertia.maths import quaternion
from bayes_inertia.physics.active_effects import ActiveEffects
from bayes_inertia.physics.components import (
    Components,
    between,
    columns,
    following,
    runge_kutta_4,
    stacked,
    unit,
)
from bayes_inertia.physics.equations_of_motion import (
    MassProperties,
    SlewState,
    advance,
    grid_rows,
    internal_momentum,
    prepare,
    rate_components,
)
from bayes_inertia.physics.slew_context import Trajectory
from bayes_inertia.physics.slew_input import Drive, SlewInput, Start

# Hooks that make more than the attitude change during a slew.
_MOVING_HOOKS = ("wheel_torque", "body_torque", "initial_state", "internal_momentum")


def simulate_slew(
    slew: SlewInput,
    start: Start,
    inertia_B: Array,
    active: ActiveEffects | None = None,
    drive: Drive = "commanded",
) -> tuple[Trajectory, Components]:
    """Simulate one slew; a pure function that JAX can batch and differentiate.

    Parameters
    ----------
    slew : SlewInput
        What was commanded or measured.
    start : Start
        The state at the first row.
    inertia_B : (3, 3) array
        J of everything except the wheels' spin [kg m^2].
    active : ActiveEffects, optional
        What else acts; nothing by default.
    drive : "commanded" or "measured", optional
        Commanded: torques are the input, wheel momentum is an output. Measured: wheel momentum
        is the input.

    Returns
    -------
    trajectory : Trajectory
        The slew on the grid; its `effect_states` is empty.
    effect_states : tuple of (n, k) arrays
        Each effect's own states.

    Examples
    --------
    >>> from bayes_inertia.physics.slew_input import idle_slew
    >>> slew, q = idle_slew([0.0, 1.0, 2.0]), jnp.array([0.0, 0.0, 0.0, 1.0])
    >>> start = Start(jnp.array([0.1, 0.0, 0.0]), q, jnp.zeros(0))
    >>> simulate_slew(slew, start, jnp.eye(3))[0].rate_B[:, 0].round(9).tolist()
    [0.1, 0.1, 0.1]
    """
    active = ActiveEffects() if active is None else active
    context = slew.context
    mass, state, torque = prepare(slew, start, inertia_B, active, drive)
    integrate = _full_path if active.act(*_MOVING_HOOKS) else _attitude_path
    path = integrate(slew, mass, state, torque, active, drive)
    wheel = stacked(path.wheel, len(context.time)) if drive == "commanded" else slew.momentum
    attitude, effect_states = jnp.stack(path.attitude, -1), path.effect_states
    internal = internal_momentum(active, context, effect_states)
    momentum_B = (
        quaternion.to_body(attitude, jnp.stack(path.momentum_N, -1))
        - wheel @ mass.axes_B.T
        - internal
    )
    rate = momentum_B @ mass.inverse.T
    momentum = wheel if drive == "measured" else wheel - mass.spin_inertia * (rate @ mass.axes_B)
    no_states = jnp.zeros((len(context.time), 0))
    return Trajectory(context.time, attitude, rate, momentum, no_states), effect_states


def _full_path(
    slew: SlewInput,
    mass: MassProperties,
    first: SlewState,
    torque: Array,
    active: ActiveEffects,
    drive: Drive,
) -> SlewState:
    """The state at every grid point where momentum, wheels or own states change on the way."""

    def step(state: SlewState, row: dict) -> tuple[SlewState, SlewState]:
        return advance(state, row, mass, slew.context, active, drive), state

    return jax.lax.scan(step, first, grid_rows(slew, torque))[1]


def _attitude_path(
    slew: SlewInput,
    mass: MassProperties,
    first: SlewState,
    torque: Array,
    active: ActiveEffects,
    drive: Drive,
) -> SlewState:
    """The same where M_N is constant and the wheels are known beforehand.

    Only the attitude is integrated, in 0.6 of the time of `_full_path`; no effect acts on it.
    """
    n = len(slew.context.time)
    if drive == "commanded":
        # Kept apart from the start value, so that draws of one slew share these rows.
        gained = jnp.cumsum(torque * slew.context.step[:, None], axis=0)
        wheel = jnp.concatenate([jnp.zeros((1, torque.shape[1])), gained[:-1]])
        offset = first.wheel
    else:
        wheel, offset = slew.momentum, tuple(jnp.zeros_like(h) for h in first.wheel)

    def step(attitude: Components, row: tuple) -> tuple[Components, Components]:
        step_ends, length = row

        def slope(fraction: float, q: Components) -> Components:
            wheel_now = tuple(
                h + gain for h, gain in zip(offset, between(fraction, step_ends), strict=True)
            )
            rate = rate_components(mass, unit(q), first.momentum_N, wheel_now)
            return quaternion.rate_of_components(q, rate)

        return unit(runge_kutta_4(slope, attitude, length)), attitude

    rows = ((columns(wheel), columns(following(wheel))), slew.context.step)
    _, attitude = jax.lax.scan(step, first.attitude, rows)
    effect_states = jax.tree.map(lambda x: jnp.broadcast_to(x, (n, *x.shape)), first.effect_states)
    momentum_N = tuple(jnp.broadcast_to(m, n) for m in first.momentum_N)
    absolute = tuple(h + column for h, column in zip(offset, columns(wheel), strict=True))
    return SlewState(attitude, momentum_N, absolute, effect_states)
