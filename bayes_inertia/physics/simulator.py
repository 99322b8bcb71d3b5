"""The slew simulator: attitude, body rate and wheel momentum from torque commands or tachometers.

The state is the attitude and the TOTAL momentum in inertial axes M_N, not the body rate: without
external torque M_N is constant to rounding, and the rate follows from
`J w = C(q) M_N - G H` (commanded drive, H' = u) or `J_locked w = C(q) M_N - G h` (measured drive,
h the tachometer momentum). This is the integral of Ferguson's eq 6. Butcher's Runge-Kutta method of
sixth order takes steps of as many telemetry rows as the motion allows; what the wheels do within a
step is told by its moments (`step_drive`), and rows within a step come from dense output, all at
once.

One slew integrated: attitude, total momentum and own states, at every row of the grid.

States between the ends of integration steps, from values and slopes at both ends.

Attitude and body-frame momentum are polynomials of fifth degree (Hairer, Norsett and Wanner 1993,
section II.6), whose error is far below that of the step; what effects add is a cubic. Slopes are
counted per step, not per second, so that steps of zero length are no exception.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from bayes_inertia.maths import quaternion
from bayes_inertia.physics.effect import MOVING_HOOKS, ActiveEffects
from bayes_inertia.physics.equations_of_motion import (
    Body,
    Components,
    SlewState,
    StepInputs,
    computed_once,
    prepare,
    runge_kutta_6,
    stacked,
    state_slope,
    unit,
    wheel_momentum_at,
    with_delivered_inputs,
)
from bayes_inertia.physics.numerics import NUMERICS
from bayes_inertia.physics.slew_context import Environment, Trajectory
from bayes_inertia.physics.slew_input import Drive, SlewInput, Start
from bayes_inertia.physics.step_drive import (
    KnownMomentum,
    StepPoints,
    derivative,
    known_momentum,
    polynomials,
    step_ends,
    value,
)


def simulate_slew(
    slew: SlewInput,
    start: Start,
    inertia_B: Array,
    active: ActiveEffects | None = None,
    drive: Drive = "commanded",
    rows_per_step: int = 1,
) -> tuple[Trajectory, Components]:
    """Simulate one slew; a pure function that JAX can batch and differentiate.

    `inertia_B` (3, 3): J of everything except the wheels' spin [kg m^2]. `drive`: commanded:
    torques are the input, wheel momentum is an output. Measured: wheel momentum is the input.
    `rows_per_step`: grid points that one integration step spans; the grid's length is a multiple of
    it (`integration_plan` finds how many the motion allows). Returns `trajectory`: the slew on the
    grid, its attitude at `slew.fixes` where these are given; its `effect_states` is
    empty; `effect_states` (n, k).

    Examples
    --------
    >>> from bayes_inertia.physics.slew_input import idle_slew
    >>> slew, q = idle_slew([0.0, 1.0, 2.0]), jnp.array([0.0, 0.0, 0.0, 1.0])
    >>> start = Start(jnp.array([0.1, 0.0, 0.0]), q, jnp.zeros(0))
    >>> simulate_slew(slew, start, jnp.eye(3))[0].rate_B[:, 0].round(9).tolist()
    [0.1, 0.1, 0.1]
    """
    active = ActiveEffects() if active is None else active
    slew, context = with_delivered_inputs(slew, active), slew.context
    body, state, torque = prepare(slew, start, inertia_B, active, drive)
    known = known_momentum(slew, torque, drive, rows_per_step)
    if active.act(*MOVING_HOOKS):
        path = full_path(slew, body, state, known)
    else:
        known = known.with_points(slew.fixes)
        path = attitude_path(body, state, known)
    wheel = tuple(known.at_rows.T)
    if drive == "commanded":
        wheel = tuple(h + gained for h, gained in zip(path.wheel, wheel, strict=True))
    devices = None if slew.inputs is None else {k: x.first for k, x in slew.inputs.items()}
    internal = body.internal(path.effect_states, context.time, devices)
    # By components: products of matrices with three numbers cost several times as much.
    own = computed_once(body.own_momentum(path.momentum_B, wheel, internal))
    rate = computed_once(body.rate_of(own))
    momentum = stacked(body.relative(wheel, rate), len(context.time))
    no_states = jnp.zeros((len(context.time), 0))
    motion = path.attitude, jnp.stack(rate, -1), momentum
    trajectory = Trajectory(context.time, *motion, no_states, devices)
    return trajectory, path.effect_states


class MotionHistory(NamedTuple):
    """What was integrated, at the n rows of the grid, or where it is wanted.

    Parameters
    ----------
    attitude : (n, 4) array
        Quaternions, body from inertial, scalar last; (f, 4) where only fixes are wanted.
    momentum_B : tuple of 3 (n,) arrays
        Total momentum in the body frame [N m s].
    wheel : tuple of (n,) or () arrays
        Absolute momentum of each wheel beyond what commands gave it [N m s].
    effect_states : tuple of (n, k) arrays
        Each effect's own states.
    """

    attitude: Array
    momentum_B: Components
    wheel: Components
    effect_states: Components


def attitude_path(body: Body, first: SlewState, known: KnownMomentum) -> MotionHistory:
    """The slew where M_N is constant and the wheels are known beforehand.

    Only the attitude is integrated; no effect acts on it. Body-frame momentum between the ends of
    a step is a polynomial of its own, so that rates need no attitude.
    """
    n, momentum_N = len(known.at_rows), first.momentum_N
    wheels = _WheelsInBody.of(body, first, known)

    def step(attitude: Components, row: tuple) -> tuple[Components, Components]:
        cubic_B, duration = row

        def slope_of(fraction: float, q: Components) -> Components:
            momentum_B = quaternion.to_body_components(unit(q), momentum_N)
            rate = wheels.rate(momentum_B, value(tuple(cubic_B), fraction))
            return quaternion.rate_of_components(q, computed_once(rate))

        return unit(runge_kutta_6(slope_of, attitude, duration)), attitude

    last, begin = _over_steps(step, first.attitude, (wheels.cubic_B, known.steps.length))
    states = jax.tree.map(lambda x: jnp.broadcast_to(x, (n, *x.shape)), first.effect_states)
    if known.left_out is None:
        momentum_B = quaternion.to_body_components(begin, momentum_N)
        return MotionHistory(jnp.stack(begin, -1), momentum_B, first.wheel, states)
    length = known.steps.length
    q0, body0 = wheels.derivatives(begin, momentum_N, length, 0.0)
    q1, body1 = wheels.derivatives(_followed(begin, last), momentum_N, length, 1.0)
    angle = _within_step(body, known)
    q0, q1, body0, body1, angle = computed_once((q0, q1, body0, body1, angle))
    if known.fixes is None:
        attitude = turned(_at_rows(q0, q1, known), angle)
    else:
        attitude = turned(*_at_points(q0, q1, known.fixes, body))
    smooth_B = _at_rows(body0, body1, known)
    carried = quaternion.cross_components(smooth_B, angle)
    all_B = tuple((m + c).reshape(-1) for m, c in zip(smooth_B, carried, strict=True))
    return MotionHistory(_rows(attitude), all_B, first.wheel, states)


class _WheelsInBody(NamedTuple):
    """The wheels' momentum in body axes: a constant (3,) and a cubic a step (m, 4, 3) [N m s]."""

    body: Body
    offset: Array
    cubic_B: Array

    @classmethod
    def of(cls, body: Body, first: SlewState, known: KnownMomentum) -> _WheelsInBody:
        offset = jnp.zeros(3)
        if body.drive == "commanded" and first.wheel:
            offset = body.axes_B @ jnp.stack(first.wheel)
        return cls(body, offset, jnp.einsum("iw,mlw->mli", body.axes_B, known.cubic))

    def rate(self, momentum_B: Components, known_B: Any) -> Components:
        """Body rate from total momentum and from the wheels' known momentum."""
        free = [momentum_B[i] - known_B[i] - self.offset[i] for i in range(3)]
        return self.body.rate_of(free)

    def derivatives(
        self, attitude: Components, momentum_N: Components, length: Array, s: float
    ) -> tuple[list, list]:
        """Value, first and second derivative over the steps of attitude and body-frame momentum."""
        wheels = [tuple(self.cubic_B[:, k, i] for k in range(4)) for i in range(3)]
        momentum_B = quaternion.to_body_components(attitude, momentum_N)
        rate = self.rate(momentum_B, [value(p, s) for p in wheels])
        rate = computed_once(tuple(length * w for w in rate))
        turn = quaternion.cross_components(momentum_B, rate)
        change = [t - value(derivative(p), s) for t, p in zip(turn, wheels, strict=True)]
        rate_change = tuple(length * w for w in self.body.rate_of(change))
        turn, rate_change = computed_once((turn, rate_change))
        of_turn = quaternion.cross_components(turn, rate)
        of_change = quaternion.cross_components(momentum_B, rate_change)
        bend = [a + b for a, b in zip(of_turn, of_change, strict=True)]
        body = list(zip(momentum_B, turn, bend, strict=True))
        return attitude_derivatives(attitude, rate, rate_change), body


def full_path(slew: SlewInput, body: Body, first: SlewState, known: KnownMomentum) -> MotionHistory:
    """The slew where momentum, wheels or own states change on the way."""
    inputs = _inputs(slew, known)

    def step(state: SlewState, row: StepInputs) -> tuple[SlewState, SlewState]:
        later = runge_kutta_6(lambda s, x: state_slope(body, s, x, row), state, row.length)
        return later._replace(attitude=unit(later.attitude)), state

    last, begin = _over_steps(step, first, inputs)
    if known.left_out is None:
        momentum_B = quaternion.to_body_components(begin.attitude, begin.momentum_N)
        rows = jnp.stack(begin.attitude, -1), momentum_B
        return MotionHistory(*rows, begin.wheel, begin.effect_states)

    def end(state: SlewState, s: float) -> tuple[list, SlewState]:
        def one(x: SlewState, row: StepInputs) -> tuple[Any, SlewState]:
            change = jax.tree.map(lambda k: row.length * k, state_slope(body, s, x, row))
            return _spin(body, s, x, change, row), change

        (rate, rate_change), change = jax.vmap(one)(state, inputs)
        return attitude_derivatives(state.attitude, rate, rate_change), change

    final = _followed(begin, last)
    (q0, change0), (q1, change1) = computed_once((end(begin, 0.0), end(final, 1.0)))
    attitude = turned(_at_rows(q0, q1, known), _within_step(body, known))
    rest = _cubics_at_rows(begin, change0, final, change1, known.steps.fraction)
    momentum_B = quaternion.to_body_components([q.reshape(-1) for q in attitude], rest.momentum_N)
    return MotionHistory(_rows(attitude), momentum_B, rest.wheel, rest.effect_states)


def _over_steps(step: Callable[[Any, Any], tuple[Any, Any]], first: Any, inputs: Any) -> Any:
    """As `jax.lax.scan`, but blocks of padding, whose steps have no length, cost nothing."""
    length = inputs.length if isinstance(inputs, StepInputs) else inputs[1]
    size = math.gcd(len(length), NUMERICS.steps_of_block)
    number = len(length) // size
    blocks = jax.tree.map(lambda x: x.reshape(number, size, *x.shape[1:]), (inputs, length))

    def block(state: Any, rows: tuple[Any, Array]) -> tuple[Any, Any]:
        def stay(x: Any) -> Any:
            return x, jax.tree.map(lambda y: jnp.broadcast_to(y, (size, *y.shape)), x)

        return jax.lax.cond(rows[1].any(), lambda x: jax.lax.scan(step, x, rows[0]), stay, state)

    last, begin = jax.lax.scan(block, first, blocks)
    return last, jax.tree.map(lambda x: x.reshape(len(length), *x.shape[2:]), begin)


def _cubics_at_rows(begin: Any, change0: Any, final: Any, change1: Any, s: Array) -> Any:
    """States at all rows, from values and slopes at both ends of each step."""

    def at_rows(x: Array, dx: Array, y: Array, dy: Array) -> Array:
        fraction = s.reshape(*s.shape, *[1] * (x.ndim - 1))
        pieces = value(tuple(c[:, None] for c in cubic((x, dx), (y, dy))), fraction)
        return pieces.reshape(s.size, *x.shape[1:])

    return jax.tree.map(at_rows, begin, change0, final, change1)


def _inputs(slew: SlewInput, known: KnownMomentum) -> StepInputs:
    """Wheels and environment over each step; leading axis: steps."""
    steps, rows = known.steps, known.steps.fraction.shape[1]

    def of_step(values: Array) -> tuple[Array, ...]:
        coefficients = polynomials(steps, step_ends(values, values[-1], rows))
        return tuple(coefficients[:, k] for k in range(coefficients.shape[1]))

    wheel = tuple(known.cubic[:, k] for k in range(known.cubic.shape[1]))
    environment = Environment(*map(of_step, slew.environment))
    if slew.inputs is None:
        return StepInputs(steps.time, steps.length, wheel, environment)
    assert rows == 1, "inputs are lines over steps of one row"
    devices = {name: (x.first, x.last - x.first) for name, x in slew.inputs.items()}
    return StepInputs(steps.time, steps.length, wheel, environment, devices)


def _spin(
    body: Body, s: float, x: SlewState, change: SlewState, row: StepInputs
) -> tuple[Components, Components]:
    """Body rate times a step's length, and its derivative over the step."""
    wheel = wheel_momentum_at(body, s, x, row)
    gained = value(derivative(row.wheel), s)
    if body.drive == "commanded":
        gained = gained + jnp.stack(change.wheel) if change.wheel else gained

    internal, bend = None, jnp.zeros(3)
    if body.active.act("internal_momentum"):
        internal, bend = jax.jvp(body.internal, (x.effect_states,), (change.effect_states,))
    rate = body.rate(x.attitude, x.momentum_N, wheel, internal)
    rate = tuple(row.length * w for w in rate)
    momentum_B = quaternion.to_body_components(x.attitude, x.momentum_N)
    turn = quaternion.cross_components(momentum_B, rate)
    torque = quaternion.to_body_components(x.attitude, change.momentum_N)
    moved = body.axes_B @ gained + bend
    free = [turn[i] + torque[i] - moved[i] for i in range(3)]
    return rate, tuple(row.length * w for w in body.rate_of(free))


def _followed(begin: Any, last: Any) -> Any:
    """The states at the steps' ends, from those at their beginnings and the last one."""
    return jax.tree.map(lambda rows, end: jnp.concatenate([rows[1:], end[None]]), begin, last)


def _within_step(body: Body, known: KnownMomentum) -> Components:
    """How far the body turns within each step by what the cubics leave out, (m, r) each [rad]."""
    assert known.left_out is not None
    angle = -jnp.einsum("iw,mrw->imr", body.inverse @ body.axes_B, known.left_out)
    return tuple(angle)


def _at_rows(first: list, last: list, known: KnownMomentum) -> Components:
    """Quintics through both ends of each step, at its rows: (m, r) each."""
    pieces = computed_once([quintic(a, b) for a, b in zip(first, last, strict=True)])
    at_rows = [value(tuple(c[:, None] for c in p), known.steps.fraction) for p in pieces]
    return computed_once(tuple(at_rows))


def _at_points(
    first: list, last: list, points: StepPoints, body: Body
) -> tuple[Components, Components]:
    """Quintics at some points, and how far the body turns there by what the cubics leave out."""

    def of_step(end: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        x, v, a = end
        return x[points.step], v[points.step], a[points.step]

    pieces = [quintic(of_step(a), of_step(b)) for a, b in zip(first, last, strict=True)]
    angle = -(body.inverse @ body.axes_B) @ points.left_out.T
    return computed_once((tuple(value(p, points.fraction) for p in pieces), tuple(angle)))


def _rows(components: Components) -> Array:
    return jnp.stack([c.reshape(-1) for c in components], -1)


Polynomial = tuple[Array, ...]


def quintic(first: tuple[Any, Any, Any], last: tuple[Any, Any, Any]) -> Polynomial:
    """The quintic with given value, slope and curvature at both ends.

    `first`: value, first and second derivative at s = 0.

    Examples
    --------
    >>> quintic((0.0, 0.0, 0.0), (1.0, 5.0, 20.0))
    (0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    """
    (x, v, a), (end, end_v, end_a) = first, last
    gap, turn, bend = end - x - v - 0.5 * a, end_v - v - a, end_a - a
    return (
        x,
        v,
        0.5 * a,
        10.0 * gap - 4.0 * turn + 0.5 * bend,
        -15.0 * gap + 7.0 * turn - bend,
        6.0 * gap - 3.0 * turn + 0.5 * bend,
    )


def cubic(first: tuple[Any, Any], last: tuple[Any, Any]) -> Polynomial:
    """The cubic with given value and slope at both ends.

    Examples
    --------
    >>> cubic((0.0, 0.0), (1.0, 3.0))
    (0.0, 0.0, 0.0, 1.0)
    """
    (x, v), (end, end_v) = first, last
    gap, turn = end - x - v, end_v - v
    return x, v, 3.0 * gap - turn, turn - 2.0 * gap


def attitude_derivatives(
    attitude: Components, rate: Components, rate_change: Components
) -> list[tuple[Array, Array, Array]]:
    """Value, first and second derivative of a quaternion's components over a step.

    `rate` [rad]; `rate_change` [rad].

    Examples
    --------
    >>> attitude_derivatives((0.0, 0.0, 0.0, 1.0), (2.0, 0.0, 0.0), (0.0, 0.0, 0.0))[0]
    (0.0, 1.0, 0.0)
    """
    turn = quaternion.rate_of_components(attitude, rate)
    of_turn = quaternion.rate_of_components(turn, rate)
    of_change = quaternion.rate_of_components(attitude, rate_change)
    return [(q, v, a + b) for q, v, a, b in zip(attitude, turn, of_turn, of_change, strict=True)]


def turned(attitude: Components, angle: Components) -> Components:
    """A quaternion near the unit sphere, turned by a small angle and put on the sphere.

    `angle`: rotation of the body in its own axes [rad]; its cube is neglected.

    Examples
    --------
    >>> [round(float(c), 4) for c in turned((0.0, 0.0, 0.0, 1.0), (0.02, 0.0, 0.0))]
    [0.01, 0.0, 0.0, 1.0]
    """
    change = quaternion.rate_of_components(attitude, angle)
    return unit(tuple(q + d for q, d in zip(attitude, change, strict=True)))
