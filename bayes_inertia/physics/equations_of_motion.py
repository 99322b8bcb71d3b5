"""The equations of motion of one slew: its state, how that changes, and steps of the integration.

The state is the attitude and the TOTAL momentum in inertial axes M_N, not the body rate: without
external torque M_N is constant to rounding, and the rate follows from
`J w = C(q) M_N - G H` (commanded drive, H' = u) or `J_locked w = C(q) M_N - G h` (measured drive,
h the tachometer momentum): the integral of Ferguson's eq 6. Vectors are tuples of components:
compiled code handles a few scalars faster than arrays of three numbers. Everything known beforehand
comes as polynomials over the step (`StepInputs`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.maths import quaternion
from bayes_inertia.maths.inertia_tensor import with_wheel_spin
from bayes_inertia.physics.effect import ActiveEffects, shaped
from bayes_inertia.physics.slew_context import Environment, SlewContext, State
from bayes_inertia.physics.slew_input import Drive, SlewInput, Start
from bayes_inertia.physics.step_drive import value

Components = tuple[Array, ...]


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


@dataclass(frozen=True, eq=False)
class Body:
    """What moves in one slew, and what acts on it.

    Parameters
    ----------
    inverse : (3, 3) array
        Inverse of the tensor that turns momentum into rate [1/(kg m^2)]: of J in the commanded
        drive, of J_locked in the measured one.
    locked : (3, 3) array
        J_locked, the inertia of everything with the wheels locked [kg m^2].
    axes_B : (3, wheels) array
        Spin axes of the wheels as columns, body frame.
    context : SlewContext
        The slew.
    active : ActiveEffects
        What acts.
    drive : {"commanded", "measured"}
        What is known of the wheels beforehand.
    """

    inverse: Array
    locked: Array
    axes_B: Array
    context: SlewContext
    active: ActiveEffects
    drive: Drive

    def relative(self, wheel: Sequence[Array], rate: Components) -> Components:
        """Momentum of each wheel relative to the body, from that of the drive [N m s]."""
        if self.drive == "measured":
            return tuple(wheel)
        along = [sum(rate[i] * self.axes_B[i, k] for i in range(3)) for k in range(len(wheel))]
        spin = self.context.spin_inertia
        return tuple(h - spin[k] * along[k] for k, h in enumerate(wheel))

    def own_momentum(
        self, momentum_B: Sequence[Array], wheel: Sequence[Array], internal: Array | None = None
    ) -> Components:
        """Momentum of the body alone: without wheels and effects' own states, [N m s].

        `internal` (3,), or (n, 3) where the others are (n,).
        """
        internal = jnp.zeros(3) if internal is None else internal
        wheels = [sum(self.axes_B[i, k] * h for k, h in enumerate(wheel)) for i in range(3)]
        return tuple(m - wheels[i] - internal[..., i] for i, m in enumerate(momentum_B))

    def rate_of(self, momentum_B: Sequence[Any]) -> Components:
        """Body rate [rad/s] from the momentum of the body alone; its change from a torque.

        `momentum_B`: without that of wheels and of effects' own states, body frame [N m s].
        """
        return tuple(sum(self.inverse[i, j] * momentum_B[j] for j in range(3)) for i in range(3))

    def rate(
        self,
        attitude: Components,
        momentum_N: Components,
        wheel: Components,
        internal: Array | None = None,
    ) -> Components:
        """Body rate [rad/s] from total momentum.

        `momentum_N` [N m s]. `attitude`: quaternion, body from inertial. Runge-Kutta's inner stages
        leave the unit sphere; with C(q) of the unit quaternion the error is a quarter as large and
        does not depend on the choice of inertial axes: give the unit quaternion. `wheel`: wheel
        momenta [N m s]: absolute with the inverse of J, relative with that of J_locked. `internal`
        (3,): momentum that the effects' own states carry, body frame [N m s].
        """
        momentum_B = quaternion.to_body_components(attitude, momentum_N)
        return self.rate_of(self.own_momentum(momentum_B, wheel, internal))

    def rate_and_wheel_momentum(self, state: SlewState) -> tuple[Array, Array]:
        """What turns at one instant of the commanded drive.

        Returns `rate_B` (3,) [rad/s]; `wheel_momentum` (wheels,): wheel momentum relative to the
        body [N m s].
        """
        internal = self.internal(state.effect_states)
        rate = self.rate(state.attitude, state.momentum_N, state.wheel, internal)
        return jnp.stack(rate), stacked(self.relative(state.wheel, rate))

    def internal(self, effect_states: Components, *moment: Any) -> Array:
        """Momentum that the effects' own states carry, and devices by what they do, [N m s]."""
        return internal_momentum(self.active, self.context, effect_states, *moment)


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


def prepare(
    slew: SlewInput,
    start: Start,
    inertia_B: Array,
    active: ActiveEffects,
    drive: Drive = "commanded",
) -> tuple[Body, SlewState, Array]:
    """What the integration of one slew begins with.

    `inertia_B` (3, 3): J of everything except the wheels' spin [kg m^2]. Returns `body`: what
    moves; `state`: the state at the first row; `torque` (n, wheels): the torque
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
    return Body(inverse, locked, axes, context, active, drive), state, torque


def with_delivered_inputs(slew: SlewInput, active: ActiveEffects) -> SlewInput:
    """The slew with what its devices do, where effects make that another than they were told."""
    inputs = slew.inputs
    for effect, p in active:
        if inputs is not None:
            inputs = effect.delivered_inputs(p, slew.context, inputs)
    return slew._replace(inputs=inputs)


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
            own = partial(effect.internal_momentum, p, context)
            total = total + (own(states) if states.ndim == 1 else jax.vmap(own)(states))
        if effect.acts("carried_momentum") and inputs is not None and t is not None:
            carried = partial(effect.carried_momentum, p, context)
            whole = inputs[effect.inputs[0]].ndim == 2
            total = total + (jax.vmap(carried)(t, inputs) if whole else carried(t, inputs))
    return total


def wheel_momentum_at(
    body: Body, fraction: Any, state: SlewState, inputs: StepInputs
) -> Components:
    """Wheel momentum within a step: absolute (commanded drive) or relative (measured drive).

    Returns [N m s].
    """
    known = value(inputs.wheel, fraction)
    if body.drive == "measured":
        return tuple(known)
    return tuple(h + known[k] for k, h in enumerate(state.wheel))


def state_slope(body: Body, fraction: Any, x: SlewState, inputs: StepInputs) -> SlewState:
    """Time derivative of the state within a step.

    `x`: the state there; its wheels lack what the commands give them within the step. Returns:
    change per second; of the wheels, beyond the commands.
    """
    wheel, active = wheel_momentum_at(body, fraction, x, inputs), body.active
    attitude, wheel = computed_once((unit(x.attitude), wheel))
    internal, t = None, inputs.time + fraction * inputs.length
    devices = inputs.inputs_at(fraction)
    if active.act("internal_momentum", "carried_momentum"):
        internal = body.internal(x.effect_states, t, devices)
    rate = computed_once(body.rate(attitude, x.momentum_N, wheel, internal))
    attitude_rate = quaternion.rate_of_components(x.attitude, rate)
    if not active:
        return SlewState(attitude_rate, _zeros(x.momentum_N), _zeros(x.wheel), ())
    rate_B = jnp.stack(rate)
    environment = Environment(*(value(line, fraction) for line in inputs.environment))
    motion = jnp.stack(attitude), rate_B, stacked(body.relative(wheel, rate))
    state = State(*motion, jnp.zeros(0), body.locked, *environment, devices)
    slopes = _effect_slopes(body, t, state, x.effect_states)
    external, wheel_torque, own_rates = computed_once(slopes)
    momentum_rate = _zeros(x.momentum_N)
    if active.act("body_torque"):
        momentum_rate = quaternion.to_inertial_components(attitude, tuple(external))
    further = tuple(wheel_torque[k] for k in range(len(x.wheel)))
    return SlewState(attitude_rate, momentum_rate, further, own_rates)


def _effect_slopes(
    body: Body, t: Array, state: State, effect_states: Components
) -> tuple[Array, Array, Components]:
    """External torque (3,), further torque on the wheels (wheels,), rates of all own states."""
    external, wheel_torque = jnp.zeros(3), jnp.zeros_like(state.wheel_momentum)
    own_rates, context = [], body.context
    for (effect, p), own in zip(body.active, effect_states, strict=True):
        seen = state._replace(effect_states=own)
        if effect.acts("body_torque"):
            torque = effect.body_torque(p, context, t, seen)
            external = external + shaped(effect, "body_torque", torque, external)
        if effect.acts("wheel_torque"):
            torque = effect.wheel_torque(p, context, t, seen)
            wheel_torque = wheel_torque + shaped(effect, "wheel_torque", torque, wheel_torque)
        own_rates.append(effect.state_rate(p, context, t, seen))
    return external, wheel_torque, tuple(own_rates)


def _zeros(components: Components) -> Components:
    return tuple(jnp.zeros_like(c) for c in components)


def grid_steps(slew: SlewInput) -> StepInputs:
    """What `advance` knows of each grid step (leading axis), but for the wheels.

    Examples
    --------
    >>> from bayes_inertia.physics.slew_input import idle_slew
    >>> grid_steps(idle_slew([0.0, 1.0])).length.tolist()
    [1.0, 0.0]
    """

    def lines(x: Array) -> tuple[Array, Array]:
        return x, jnp.concatenate([x[1:], x[-1:]]) - x

    environment = Environment(*map(lines, slew.environment))
    return StepInputs(slew.context.time, slew.context.step, (), environment)


def advance(body: Body, state: SlewState, step: StepInputs, torque: Array) -> SlewState:
    """Integrate over one grid step of the commanded drive. One of zero length changes nothing.

    `torque` (wheels,): delivered to the wheels and held over the step [N m]. Returns: the state at
    the step's end, its quaternion of unit length.

    Examples
    --------
    >>> from bayes_inertia.physics.slew_input import idle_slew
    >>> q = jnp.array([0.0, 0.0, 0.0, 1.0])
    >>> start = Start(jnp.array([0.1, 0.0, 0.0]), q, jnp.zeros(0))
    >>> slew = idle_slew([0.0, 1.0])
    >>> body, state, torque = prepare(slew, start, jnp.eye(3), ActiveEffects())
    >>> first = jax.tree.map(lambda rows: rows[0], grid_steps(slew))
    >>> advance(body, state, first, torque[0]).attitude[0].round(4).item()
    0.05
    """
    given = torque * step.length
    step = step._replace(wheel=(jnp.zeros_like(given), given))
    later = runge_kutta_4(lambda s, x: state_slope(body, s, x, step), state, step.length)
    wheel = tuple(h + given[k] for k, h in enumerate(later.wheel))
    return later._replace(attitude=unit(later.attitude), wheel=wheel)


def stacked(components: Components, *shape: int) -> Array:
    """Components as one array, also where there are none.

    Returns (..., k).

    Examples
    --------
    >>> stacked((), 3).shape
    (3, 0)
    """
    return jnp.stack(components, -1) if len(components) else jnp.zeros((*shape, 0))


def unit(components: Components) -> Components:
    """A vector or quaternion scaled to unit length.

    Examples
    --------
    >>> [round(float(c), 6) for c in unit((3.0, 4.0))]
    [0.6, 0.8]
    """
    shrink = 1.0 / jnp.sqrt(sum(c * c for c in components))
    return tuple(c * shrink for c in components)


def computed_once(values: Any) -> Any:
    """Values that compiled code computes once and keeps.

    Otherwise it computes them anew for each of the numbers that depend on them: a simulation with
    many effects takes three times as long, and compiling it longer too.

    Examples
    --------
    >>> computed_once((jnp.array(1.0), jnp.array(2.0)))[1].item()
    2.0
    """
    return jax.lax.optimization_barrier(values)


def runge_kutta_4(slope: Callable[[Any, Any], Any], x: Any, step: Array) -> Any:
    """One step of the classical Runge-Kutta method of fourth order.

    `step` [s]. `slope`: takes the fraction of the step that has passed and the state; returns its
    time derivative.

    Examples
    --------
    >>> runge_kutta_4(lambda fraction, x: -x, jnp.array(1.0), 0.1).round(4).item()
    0.9048
    """

    # The stages are a loop, not written out: with many effects compiling takes minutes otherwise.
    def stage(carry, row):
        fraction, share = row
        k, total = carry
        k = slope(fraction, jax.tree.map(lambda a, b: a + fraction * step * b, x, k))
        return (k, jax.tree.map(lambda t, b: t + share * step * b, total, k)), None

    still = jax.tree.map(jnp.zeros_like, x)
    stages = (jnp.array([0.0, 0.5, 0.5, 1.0]), jnp.array([1.0, 2.0, 2.0, 1.0]) / 6.0)
    return jax.lax.scan(stage, (still, x), stages)[0][1]


def _butcher_6() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sixth order in seven stages (J. C. Butcher, J. Austral. Math. Soc. 4, 1964): his tableau.

    Returns: fractions (7,) of the step that have passed; what each stage takes (7, 7) of the slopes
    of those before it; weights (7,) of the slopes in the step.
    """
    third, half = 1.0 / 3.0, 0.5
    stages = np.zeros((7, 7))
    stages[1, :1] = third
    stages[2, :2] = 0.0, 2.0 / 3.0
    stages[3, :3] = 1.0 / 12.0, third, -1.0 / 12.0
    stages[4, :4] = -1.0 / 16.0, 9.0 / 8.0, -3.0 / 16.0, -3.0 / 8.0
    stages[5, :5] = 0.0, 9.0 / 8.0, -3.0 / 8.0, -3.0 / 4.0, half
    stages[6, :6] = 9.0 / 44.0, -9.0 / 11.0, 63.0 / 44.0, 18.0 / 11.0, 0.0, -16.0 / 11.0
    weights = np.array([11.0, 0.0, 81.0, 81.0, -32.0, -32.0, 11.0]) / 120.0
    return np.array([0.0, third, 2.0 / 3.0, third, half, half, 1.0]), stages, weights


def runge_kutta_6(slope: Callable[[Any, Any], Any], x: Any, step: Array) -> Any:
    """One step of Butcher's Runge-Kutta method of sixth order (1964, seven stages).

    `step` [s]. `slope`: takes the fraction of the step that has passed and the state; returns its
    time derivative.

    Examples
    --------
    >>> print(f"{runge_kutta_6(lambda fraction, x: -x, jnp.array(1.0), 0.1):.9f}")
    0.904837418
    """

    def stage(slopes, row):
        index, fraction, taken = row
        k = slope(fraction, _moved(x, slopes, step * taken))
        return jax.tree.map(
            lambda rows, now: jax.lax.dynamic_update_index_in_dim(rows, now, index, 0), slopes, k
        ), None

    fractions, stages, weights = _butcher_6()
    none = jax.tree.map(lambda a: jnp.zeros((len(weights), *jnp.shape(a))), x)
    rows = (jnp.arange(len(weights)), jnp.asarray(fractions), jnp.asarray(stages))
    return _moved(x, jax.lax.scan(stage, none, rows)[0], step * weights)


def _moved(x: Any, slopes: Any, shares: Array) -> Any:
    """The state, moved along the slopes of all stages (7, ...) by so much of each."""
    # Products and a sum become part of what comes next; `tensordot` is a call of its own.
    of_all = jax.vmap(jnp.multiply)
    return jax.tree.map(lambda a, k: a + jnp.sum(of_all(shares, k), 0), x, slopes)
