"""How the state of a slew changes at one instant, and one step of a flight whose torques are held.

Everything known beforehand comes as polynomials over the step (`StepInputs`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

from bayes_inertia.maths import quaternion
from bayes_inertia.physics.active_effects import ActiveEffects
from bayes_inertia.physics.components import (
    Components,
    columns,
    computed_once,
    following,
    runge_kutta_4,
    stacked,
    unit,
)
from bayes_inertia.physics.equations_of_motion import (
    MassProperties,
    SlewState,
    internal_momentum,
    rate_components,
)
from bayes_inertia.physics.slew_context import Environment, SlewContext, State
from bayes_inertia.physics.slew_input import Drive, SlewInput
from bayes_inertia.physics.step_drive import value


class StepInputs(NamedTuple):
    """What is known beforehand of one step: polynomials in the part of it that has passed.

    Parameters
    ----------
    time : () array
        Its beginning [s].
    length : () array
        Its length [s].
    wheel : tuple of (wheels,) arrays
        Coefficients of the momentum that commands give the wheels (commanded drive), or of their
        momentum relative to the body (measured drive) [N m s].
    environment : Environment
        Of each of its vectors: a tuple of (3,) arrays.
    inputs : mapping of str to tuple of (k,) arrays, optional
        Likewise of what devices do.
    """

    time: Array
    length: Array
    wheel: tuple[Array, ...]
    environment: Environment
    inputs: Mapping[str, tuple[Array, ...]] | None = None

    def inputs_at(self, fraction: Any) -> dict[str, Array] | None:
        """What devices do within the step."""
        if self.inputs is None:
            return None
        return {name: value(line, fraction) for name, line in self.inputs.items()}


def wheel_momentum_at(
    fraction: Any, state: SlewState, inputs: StepInputs, drive: Drive
) -> Components:
    """Wheel momentum within a step: absolute (commanded drive) or relative (measured drive).

    Returns [N m s].
    """
    known = value(inputs.wheel, fraction)
    if drive == "measured":
        return tuple(known)
    return tuple(h + known[k] for k, h in enumerate(state.wheel))


def state_slope(
    fraction: Any,
    x: SlewState,
    inputs: StepInputs,
    mass: MassProperties,
    context: SlewContext,
    active: ActiveEffects,
    drive: Drive,
) -> SlewState:
    """Time derivative of the state within a step.

    `x`: the state there; its wheels lack what the commands give them within the step. Returns:
    change per second; of the wheels, beyond the commands.
    """
    wheel = wheel_momentum_at(fraction, x, inputs, drive)
    attitude, wheel = computed_once((unit(x.attitude), wheel))
    internal = None
    if active.act("internal_momentum", "carried_momentum"):
        known = inputs.inputs_at(fraction)
        t = inputs.time + fraction * inputs.length
        internal = internal_momentum(active, context, x.effect_states, t, known)
    rate = computed_once(rate_components(mass, attitude, x.momentum_N, wheel, internal))
    attitude_rate = quaternion.rate_of_components(x.attitude, rate)
    if not active:
        return SlewState(attitude_rate, _zeros(x.momentum_N), _zeros(x.wheel), ())
    external, wheel_torque, own_rates = _effect_slopes(
        fraction, x._replace(attitude=attitude), inputs, mass, context, active, drive, rate, wheel
    )
    momentum_rate = _zeros(x.momentum_N)
    if active.act("body_torque"):
        momentum_rate = quaternion.to_inertial_components(attitude, tuple(external))
    further = tuple(wheel_torque[k] for k in range(len(x.wheel)))
    return SlewState(attitude_rate, momentum_rate, further, own_rates)


def _effect_slopes(
    fraction: Any,
    x: SlewState,
    inputs: StepInputs,
    mass: MassProperties,
    context: SlewContext,
    active: ActiveEffects,
    drive: Drive,
    rate: Components,
    wheel: Components,
) -> tuple[Array, Array, Components]:
    """External torque (3,), further torque on the wheels (wheels,), rates of all own states."""
    rate_B, momentum = jnp.stack(rate), stacked(wheel)
    relative = (
        momentum - mass.spin_inertia * (rate_B @ mass.axes_B) if drive == "commanded" else momentum
    )
    environment = [value(coefficients, fraction) for coefficients in inputs.environment]
    devices = inputs.inputs_at(fraction)
    t = inputs.time + fraction * inputs.length
    external, wheel_torque, own_rates = jnp.zeros(3), jnp.zeros_like(relative), []
    for (effect, p), effect_states in zip(active, x.effect_states, strict=True):
        state = State(
            jnp.stack(x.attitude), rate_B, relative, effect_states, mass.locked, *environment
        )._replace(inputs=devices)
        if effect.acts("body_torque"):
            external = external + effect.body_torque(p, context, t, state)
        if effect.acts("wheel_torque"):
            wheel_torque = wheel_torque + effect.wheel_torque(p, context, t, state)
        own_rates.append(effect.state_rate(p, context, t, state))
    return external, wheel_torque, tuple(own_rates)


def _zeros(components: Components) -> Components:
    return tuple(jnp.zeros_like(c) for c in components)


def grid_rows(slew: SlewInput, torque: Array) -> dict:
    """What `advance` reads at each grid point.

    `torque` (n, wheels): torque delivered to the wheels and held over each step [N m]. Returns
    `time` and `step` (n,) [s]; `torque`, `wheel` and `environment` as components at the two ends of
    each step.

    Examples
    --------
    >>> from bayes_inertia.physics.slew_input import idle_slew
    >>> sorted(grid_rows(idle_slew([0.0, 1.0]), jnp.zeros((2, 0))))
    ['environment', 'step', 'time', 'torque', 'wheel']
    """

    def ends(x: Array) -> tuple[Components, Components]:
        return columns(x), columns(following(x))

    return {
        "torque": ends(torque),
        "wheel": ends(slew.momentum),
        "environment": Environment(*map(ends, slew.environment)),
        "time": slew.context.time,
        "step": slew.context.step,
    }


def advance(
    state: SlewState,
    row: dict,
    mass: MassProperties,
    context: SlewContext,
    active: ActiveEffects,
    drive: Drive = "commanded",
) -> SlewState:
    """Integrate over one grid step. A step of zero length changes nothing.

    Returns: the state at the step's end, its quaternion of unit length.

    Examples
    --------
    >>> import jax
    >>> from bayes_inertia.physics.equations_of_motion import prepare
    >>> from bayes_inertia.physics.slew_input import Start, idle_slew
    >>> q = jnp.array([0.0, 0.0, 0.0, 1.0])
    >>> start = Start(jnp.array([0.1, 0.0, 0.0]), q, jnp.zeros(0))
    >>> slew, nothing = idle_slew([0.0, 1.0]), ActiveEffects()
    >>> mass, state, torque = prepare(slew, start, jnp.eye(3), nothing)
    >>> row = jax.tree.map(lambda rows: rows[0], grid_rows(slew, torque))
    >>> advance(state, row, mass, slew.context, nothing).attitude[0].round(4).item()
    0.05
    """

    torque = stacked(row["torque"][0])
    given = jnp.zeros_like(torque), torque * row["step"]
    inputs = StepInputs(
        row["time"],
        row["step"],
        given if drive == "commanded" else _line(row["wheel"]),
        Environment(*map(_line, row["environment"])),
    )

    def slope(fraction: float, x: SlewState) -> SlewState:
        return state_slope(fraction, x, inputs, mass, context, active, drive)

    later = runge_kutta_4(slope, state, row["step"])
    wheel = tuple(h + given[1][k] for k, h in enumerate(later.wheel))
    return later._replace(attitude=unit(later.attitude), wheel=wheel)


def _line(ends: tuple[Components, Components]) -> tuple[Array, Array]:
    """The straight line from one end of a step to the other."""
    first, last = (stacked(components) for components in ends)
    return first, last - first
