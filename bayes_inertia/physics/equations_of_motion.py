"""The equations of motion of one slew: its state, its constants, and the rate that follows.

The state is the attitude and the TOTAL momentum in inertial axes M_N, not the body rate: without
external torque M_N is constant to rounding, and the rate follows from
`J w = C(q) M_N - G H` (commanded drive, H' = u) or `J_locked w = C(q) M_N - G h` (measured drive,
h the tachometer momentum): the integral of Ferguson's eq 6. Vectors are tuples of components.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from bayes_inertia.maths import quaternion
from bayes_inertia.maths.inertia_tensor import with_wheel_spin
from bayes_inertia.physics.active_effects import ActiveEffects
from bayes_inertia.physics.components import Components, stacked
from bayes_inertia.physics.slew_context import SlewContext
from bayes_inertia.physics.slew_input import Drive, SlewInput, Start


class SlewState(NamedTuple):
    """The state that is integrated along a slew.

    Parameters
    ----------
    attitude : tuple of 4 Array
        Components of the quaternion, body from inertial, scalar last.
    momentum_N : tuple of 3 Array
        Total angular momentum in inertial axes [N m s].
    wheel : tuple of Array
        One absolute momentum H a wheel [N m s] in the commanded drive; unused in the measured one.
    effect_states : tuple of Array
        Each effect's own states (k,).
    """

    attitude: Components
    momentum_N: Components
    wheel: Components
    effect_states: Components


class MassProperties(NamedTuple):
    """Constants of one slew.

    Parameters
    ----------
    inverse : (3, 3) array
        Inverse of the tensor that turns momentum into rate [1/(kg m^2)]: of J in the commanded
        drive, of J_locked in the measured one.
    locked : (3, 3) array
        J_locked, the inertia of everything with the wheels locked [kg m^2].
    axes_B : (3, wheels) array
        Spin axes of the wheels as columns, body frame.
    spin_inertia : (wheels,) array
        Spin inertias of the wheels [kg m^2].
    """

    inverse: Array
    locked: Array
    axes_B: Array
    spin_inertia: Array


def prepare(
    slew: SlewInput,
    start: Start,
    inertia_B: Array,
    active: ActiveEffects,
    drive: Drive = "commanded",
) -> tuple[MassProperties, SlewState, Array]:
    """What the integration of one slew begins with.

    `inertia_B` (3, 3): J of everything except the wheels' spin [kg m^2]. Returns `mass`: the
    constants of this slew; `state`: the state at the first row; `torque` (n, wheels): the torque
    that the wheels deliver for the commanded one [N m].

    Examples
    --------
    >>> from bayes_inertia.physics.slew_input import idle_slew
    >>> q = jnp.array([0.0, 0.0, 0.0, 1.0])
    >>> start = Start(jnp.array([0.1, 0.0, 0.0]), q, jnp.zeros(0))
    >>> slew = idle_slew([0.0, 1.0])
    >>> prepare(slew, start, 2.0 * jnp.eye(3), ActiveEffects())[1].momentum_N[0].item()
    0.2
    """
    context = slew.context
    axes, torque = context.wheel_axes_B, context.torque
    for effect, p in active:
        inertia_B = effect.inertia(p, context, inertia_B)
        axes = effect.wheel_axes(p, context, axes)
        torque = effect.delivered_torque(p, context, torque)
    effect_states = tuple(effect.initial_state(p, context, start.rate_B) for effect, p in active)
    locked = with_wheel_spin(inertia_B, axes, context.spin_inertia)
    relative = start.wheel_momentum if drive == "commanded" else slew.momentum[0]
    inputs = None if slew.inputs is None else {k: x.first[0] for k, x in slew.inputs.items()}
    internal = internal_momentum(active, context, effect_states, context.time[0], inputs)
    momentum_B = locked @ start.rate_B + axes @ relative + internal
    wheel = relative + context.spin_inertia * (axes.T @ start.rate_B)
    inverse = jnp.linalg.inv(inertia_B if drive == "commanded" else locked)
    momentum_N = quaternion.to_inertial(start.attitude, momentum_B)
    state = SlewState(tuple(start.attitude), tuple(momentum_N), tuple(wheel), effect_states)
    return MassProperties(inverse, locked, axes, context.spin_inertia), state, torque


def with_delivered_inputs(slew: SlewInput, active: ActiveEffects) -> SlewInput:
    """The slew with what its devices do, where effects make that another than they were told."""
    inputs = slew.inputs
    for effect, p in active:
        if inputs is not None:
            inputs = effect.delivered_inputs(p, slew.context, inputs)
    return slew._replace(inputs=inputs)


def rate_and_wheel_momentum(
    state: SlewState, mass: MassProperties, context: SlewContext, active: ActiveEffects
) -> tuple[Array, Array]:
    """What turns at one instant of the commanded drive.

    Returns `rate_B` (3,) [rad/s]; `wheel_momentum` (wheels,): wheel momentum relative to the body
    [N m s].

    Examples
    --------
    >>> from bayes_inertia.physics.slew_input import idle_slew
    >>> q = jnp.array([0.0, 0.0, 0.0, 1.0])
    >>> start = Start(jnp.array([0.1, 0.0, 0.0]), q, jnp.zeros(0))
    >>> slew, nothing = idle_slew([0.0, 1.0]), ActiveEffects()
    >>> mass, state, _ = prepare(slew, start, 2.0 * jnp.eye(3), nothing)
    >>> rate_and_wheel_momentum(state, mass, slew.context, nothing)[0].tolist()
    [0.1, 0.0, 0.0]
    """
    wheel = stacked(state.wheel)
    momentum_B = jnp.stack(quaternion.to_body_components(state.attitude, state.momentum_N))
    rate = mass.inverse @ (
        momentum_B - mass.axes_B @ wheel - internal_momentum(active, context, state.effect_states)
    )
    return rate, wheel - mass.spin_inertia * (rate @ mass.axes_B)


def rate_components(
    mass: MassProperties,
    attitude: Components,
    momentum_N: Components,
    wheel: Components,
    internal: Array | None = None,
) -> Components:
    """Body rate from total momentum.

    `momentum_N` [N m s]. `attitude`: quaternion, body from inertial. Runge-Kutta's inner stages
    leave the unit sphere; with C(q) of the unit quaternion the error is a quarter as large and does
    not depend on the choice of inertial axes: give the unit quaternion. `wheel`: wheel momenta [N m
    s]: absolute with the inverse of J, relative with that of J_locked. `internal` (3,): momentum
    that the effects' own states carry, body frame [N m s]. Returns [rad/s].

    Examples
    --------
    >>> mass = MassProperties(0.5 * jnp.eye(3), 2.0 * jnp.eye(3), jnp.zeros((3, 0)), jnp.zeros(0))
    >>> rate_components(mass, (0.0, 0.0, 0.0, 1.0), (0.2, 0.0, 0.0), ())[0].item()
    0.1
    """
    momentum_B = quaternion.to_body_components(attitude, momentum_N)
    momentum_B = tuple(
        m - sum(mass.axes_B[i, k] * h for k, h in enumerate(wheel))
        for i, m in enumerate(momentum_B)
    )
    if internal is not None:
        momentum_B = tuple(m - internal[i] for i, m in enumerate(momentum_B))
    return rate_of_momentum(mass, momentum_B)


def rate_of_momentum(mass: MassProperties, momentum_B: Sequence[Any]) -> Components:
    """Body rate from the momentum of the body alone; likewise its change from a torque.

    `momentum_B`: momentum without that of wheels and of effects' own states, body frame [N m s].
    Returns [rad/s].

    Examples
    --------
    >>> mass = MassProperties(0.5 * jnp.eye(3), 2.0 * jnp.eye(3), jnp.zeros((3, 0)), jnp.zeros(0))
    >>> rate_of_momentum(mass, (0.2, 0.0, 0.0))[0].item()
    0.1
    """
    return tuple(sum(mass.inverse[i, j] * momentum_B[j] for j in range(3)) for i in range(3))


def internal_momentum(
    active: ActiveEffects,
    context: SlewContext,
    effect_states: Components,
    t: Array | None = None,
    inputs: Mapping[str, Array] | None = None,
) -> Array:
    """Momentum that the effects' own states carry, and devices by what they do.

    `effect_states`: each effect's own states (k,), or (n, k) for a whole slew. `inputs`: of devices
    (k,) or (n, k), at times `t` () or (n,). Returns (n, 3): angular momentum in the body frame
    [N m s].

    Examples
    --------
    >>> from bayes_inertia.physics.slew_input import idle_slew
    >>> internal_momentum(ActiveEffects(), idle_slew([0.0, 1.0]).context, ()).tolist()
    [0.0, 0.0, 0.0]
    """
    total = jnp.zeros(3)
    for (effect, p), states in zip(active, effect_states, strict=True):
        if effect.acts("internal_momentum"):
            hook = effect.internal_momentum
            total = total + (
                hook(p, context, states)
                if states.ndim == 1
                else jax.vmap(lambda x, h=hook, p=p: h(p, context, x))(states)
            )
        if effect.acts("carried_momentum") and inputs is not None and t is not None:
            carried = partial(effect.carried_momentum, p, context)
            whole = inputs[effect.inputs[0]].ndim == 2
            total = total + (jax.vmap(carried)(t, inputs) if whole else carried(t, inputs))
    return total
