"""Information of slews that have not been flown, as a smooth function of the slews.

The information matrix of each slew's telemetry on the parameters and the bias, with the slew's own
start state integrated out, and the covariance that follows. The prior of everything is in it as in
`likelihood`.

It needs the sensitivity of the telemetry to each unknown, to first order. The planned motion is
known (`planned_motion`), so that only the linear equations of a small deviation are integrated.
With the deviation psi of the attitude as a rotation vector in inertial axes, m the total momentum
in body axes, and C, J, G, H as in `simulator`,

    psi' = C^T J^-1 ([m]x C psi + s),   s = C dM_N - G dH - dG H - dJ w,
    dw = J^-1 ([m]x C psi + s),

where dJ, dG, dM_N, dH are what an unknown does to inertia, wheel axes, total momentum and wheel
momentum. All of that is asked of the effects' own hooks along the planned motion, and JAX
differentiates it. How a deviation of the state would change an effect is left out: it vanishes at
the effect's null. Sensitivities out of the simulator give the same sds to 0.2 %, but the goal's
gradient for five slews then takes 30 s to compile and 18 times as long to run (237 ms against 13
ms).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.design.information_forecast import (
    FlightConditions,
    ForecastArrays,
    ForecastLayout,
    rigid_body_at,
)
from bayes_inertia.design.numerics import NUMERICS
from bayes_inertia.errors import EffectError
from bayes_inertia.flight.planned_motion import PlanTimes, SlewArrays, motion_of_slews
from bayes_inertia.inference.noise_model import filter_of, in_states, innovations
from bayes_inertia.maths import inertia_tensor, quaternion
from bayes_inertia.maths.values import AnyArray
from bayes_inertia.physics.channels import Channel
from bayes_inertia.physics.channels.attitude import AttitudeChannel
from bayes_inertia.physics.channels.direction import DirectionConstants
from bayes_inertia.physics.effect import ActiveEffects, Effect
from bayes_inertia.physics.prediction import Structure, acting_in, inertia_in
from bayes_inertia.physics.processes import RowTimes
from bayes_inertia.physics.slew_context import Environment, SlewContext, State, Trajectory
from bayes_inertia.physics.slew_input import SlewInput
from bayes_inertia.physics.stochastic_effect import StochasticEffect


class _Along(NamedTuple):
    """Inertia, wheels, torques and momentum that parameters give along the planned motion."""

    inertia_B: Array
    axes_B: Array
    delivered: Array  # (n, wheels) motor torque [N m]
    wheel_torque: Array  # (n - 1, wheels) what else acts on the wheels, from row to row [N m]
    torque_N: Array  # (n - 1, 3) on the body, from row to row, inertial axes [N m]
    carried_B: Array  # (n, 3) momentum that devices carry [N m s]


def _require_plain(structure: Structure) -> None:
    """Raise for effects that a plan cannot be designed for."""
    advice = "leave it out of the design"
    for effect in structure.effects:
        if effect.acts("state_rate"):
            what = "has states of its own, which plans are not designed for"
            raise EffectError(what, where=effect.name, advice=advice)
    if structure.hyperparameters:
        stochastic = [e.name for e in structure.effects if isinstance(e, StochasticEffect)]
        what = "is stochastic, which plans are not designed for"
        raise EffectError(what, where=stochastic[0], advice=advice)


class _Slew(NamedTuple):
    """One slew that is flown as planned."""

    structure: Structure
    conditions: FlightConditions
    context: SlewContext
    path: Trajectory
    environment: Environment

    def acting(self, theta: Array, local: Array) -> ActiveEffects:
        """What acts beside J and K; `theta` (d,), `local` (n_local,) whitened."""
        coefficients = self.structure.nuisances(local).coefficients
        active = acting_in(self.structure, theta, coefficients, self.context)
        told = set(self.path.inputs or {})  # other devices rest
        flying = tuple(effect for effect in active.effects if set(effect.inputs) <= told)
        return ActiveEffects(flying, active.values)

    def along(self, theta: Array, local: Array) -> _Along:
        """What parameters and the slew's own nuisances give along the planned motion."""
        active, context, path = self.acting(theta, local), self.context, self.path
        J = inertia_in(self.structure, theta, context)
        axes = context.wheel_axes_B
        torque = context.torque
        for effect, p in active:
            J, axes, torque = (
                effect.inertia(p, context, J),
                effect.wheel_axes(p, context, axes),
                effect.delivered_torque(p, context, torque),
            )
        locked = inertia_tensor.with_wheel_spin(J, axes, context.spin_inertia)
        friction = jnp.zeros_like(path.wheel_momentum[1:])
        torque_N = carried_B = jnp.zeros_like(path.rate_B)
        torque_N = torque_N[1:]
        for effect, p in active:
            on_wheels, on_body = self._torques(effect, p, locked)
            friction, torque_N = friction + on_wheels, torque_N + on_body
            if effect.acts("carried_momentum"):
                carried = partial(effect.carried_momentum, p, context)
                carried_B = carried_B + jax.vmap(carried)(path.time, path.inputs or {})
        return _Along(J, axes, torque, friction, torque_N, carried_B)

    def _torques(
        self, effect: Effect, p: Mapping[str, Array], locked_B: Array
    ) -> tuple[Array, Array]:
        """Mean torques of an effect on wheels and body (inertial axes) from row to row."""
        path, context = self.path, self.context

        def instant(row: tuple[Any, ...]) -> tuple[Array, Array]:
            t, q, w, h, environment, inputs = row
            state = State(q, w, h, jnp.zeros(0), locked_B, *environment)._replace(inputs=inputs)
            torque_B = effect.body_torque(p, context, t, state)
            return effect.wheel_torque(p, context, t, state), quaternion.to_inertial(q, torque_B)

        rows = (path.time, path.attitude, path.rate_B, path.wheel_momentum, self.environment)
        held = jax.tree.map(lambda x: x[:-1], path.inputs)
        begin, end = (
            jax.vmap(instant)((*jax.tree.map(lambda x, k=k: x[k], rows), held))
            for k in (_FIRST, _LAST)
        )
        return jax.tree.map(lambda a, b: 0.5 * (a + b), begin, end)

    def reported(self, k: int, theta: Array, bias: Array, local: Array, path: Trajectory) -> Array:
        """What the k-th sensor reports along a motion near the planned one, without noise."""
        conditions, channel = self.conditions, self.structure.channels[k]
        slew = SlewInput(self.context, path.wheel_momentum, self.environment)
        here = _here(channel, conditions.sensors[k], self.context, self.environment)
        values = channel.seen(theta, here, conditions.scale.bias * bias, slew, path)
        for effect, p in self.acting(theta, local):
            values = channel.with_effect(effect, p, here, self.context, path, values)
        return channel.read(theta[slice(*channel.parameters)], values)


_FIRST, _LAST = slice(None, -1), slice(1, None)


def _here(channel: Channel, constants: Any, context: SlewContext, environment: Environment) -> Any:
    """Constants of a sensor, with the field along this slew where it looks at the field."""
    if isinstance(channel, AttitudeChannel):
        return ()  # All trackers fix at the same times.
    if not isinstance(constants, DirectionConstants) or constants.time.shape[1] < 2:
        return constants
    reference_N = environment.magnetic_field_N
    if not getattr(channel, "is_field", False):
        reference_N = reference_N / jnp.linalg.norm(reference_N, axis=1, keepdims=True)
    # Whatever the slew's number, the only row is taken.
    return DirectionConstants(context.time[None], reference_N[None])


class _Known(NamedTuple):
    """What unknowns decide without integrating a deviation of the state.

    The `turn` (3,) of the first attitude in body axes [rad], the `source` C M_N - G H - J w (n, 3)
    along the planned motion [N m s], and the `momentum` (n, wheels) of the wheels [N m s].
    """

    turn: Array
    source: Array
    momentum: Array


def _whitened_columns(layout: ForecastLayout, slew: _Slew, theta: Array) -> Array:
    """Whitened derivatives (numbers, p) of all that one slew measures, at rest in the beginning.

    The p unknowns are theta, the whitened bias and the slew's whitened nuisances. A row counts as
    many times as it stands for samples or fixes.
    """
    _require_plain(layout.structure)
    structure, conditions, path = layout.structure, slew.conditions, slew.path
    scale, spin, d = conditions.scale, slew.context.spin_inertia, len(theta)
    n_bias, nothing = len(scale.bias), jnp.zeros(structure.n_local)
    ends = (d, d + n_bias)
    nominal = slew.along(theta, nothing)
    planned = path.wheel_momentum + spin * (path.rate_B @ nominal.axes_B)
    total_B = path.rate_B @ nominal.inertia_B + planned @ nominal.axes_B.T + nominal.carried_B

    def known(unknown: Array) -> _Known:
        theta, _, local = jnp.split(unknown, ends)
        now, start = slew.along(theta, local), scale.local * local[: structure.n_start]
        rate, turn, added = jnp.split(start, [3, 6])
        locked = inertia_tensor.with_wheel_spin(now.inertia_B, now.axes_B, spin)
        first_B = locked @ rate + now.axes_B @ (path.wheel_momentum[0] + added) + now.carried_B[0]
        first_N = quaternion.to_inertial(path.attitude[0], first_B + jnp.cross(turn, total_B[0]))
        total_N = first_N + _integral(path.time, now.torque_N)
        wheel = added + spin * (rate @ now.axes_B)
        wheel += _integral(path.time, now.delivered[:-1] + now.wheel_torque)
        source = quaternion.to_body(path.attitude, total_N) - wheel @ nominal.axes_B.T
        source -= planned @ now.axes_B.T + path.rate_B @ now.inertia_B.T + now.carried_B
        return _Known(turn, source, wheel - spin * (path.rate_B @ now.axes_B))

    unknown = jnp.concatenate([theta, jnp.zeros(n_bias), nothing])
    by = jax.jacfwd(known)(unknown)
    pushed = nominal.torque_N if path.inputs is not None else None
    turned, d_rate = _integrated(path, total_B, pushed, _inverse(nominal.inertia_B), by)
    d_wheel = by.momentum - (spin * nominal.axes_B).T @ d_rate

    moved = turned, d_rate, d_wheel
    whitened = []
    for k, weight in enumerate(_counts(layout, path.time)):
        columns = _channel_columns(slew, k, unknown, ends, moved)
        whitened.append(_counted(layout, slew, k, weight, columns).reshape(-1, len(unknown)))
    return jnp.concatenate(whitened)


def _counted(layout: ForecastLayout, slew: _Slew, k: int, weight: Array, columns: Array) -> Array:
    """Columns (n, components, p) of the k-th channel, each row of so many readings (n,).

    Without what a bias that wanders as stated lets expect.
    """
    name, factors = layout.structure.channels[k].name, slew.conditions.factors[k]
    wandering = [process for process in layout.wandering if process.channel == name]
    if not wandering:
        return jnp.sqrt(weight)[:, None, None] * columns
    context = slew.context
    rows = RowTimes(context.time[None], jnp.abs(context.start - context.middle)[None])
    variance = 1.0 / jnp.sum(factors**2, 0)
    states = in_states([process.in_rows(rows, variance, jnp) for process in wandering], jnp)
    read = jnp.ones((1, *columns.shape[:2]), bool)
    white = 1.0 / jnp.maximum(weight, NUMERICS.least_readings)[:, None]
    return innovations(columns[None], filter_of(states, white, read))[0]


def _channel_columns(
    slew: _Slew,
    k: int,
    unknown: Array,
    ends: tuple[int, int],
    moved: tuple[Array, Array, Array],
) -> Array:
    """Whitened derivatives (n, components, p) of the k-th channel by p unknowns.

    `ends` of theta and of the bias among the unknowns; `moved`: deviations of attitude, rate and
    wheel momentum (n, 3 or wheels, p).
    """
    channel, factors, path = slew.structure.channels[k], slew.conditions.factors[k], slew.path
    follows = {"rate_output": 1, "momentum_output": 2}.get(channel.hook, 0)

    def reported(unknown: Array, change: Array) -> Array:
        if follows == 0:
            near = path._replace(attitude=quaternion.turned(path.attitude, change))
        elif follows == 1:
            near = path._replace(rate_B=path.rate_B + change)
        else:
            near = path._replace(wheel_momentum=path.wheel_momentum + change)
        theta, bias, local = jnp.split(unknown, ends)
        return slew.reported(k, theta, bias, local, near)

    nothing = jnp.zeros(moved[follows].shape[:2])
    measured = reported(unknown, nothing)

    def gap(unknown: Array, change: Array) -> Array:
        return channel.whitened(factors, channel.gap(measured, reported(unknown, change)))

    def slope(unit: Array) -> Array:
        along = jnp.broadcast_to(unit, nothing.shape)
        return jax.jvp(partial(gap, unknown), (nothing,), (along,))[1]

    by_unknown = jax.jacfwd(lambda x: gap(x, nothing))(unknown)
    by_change = jax.vmap(slope, out_axes=-1)(jnp.eye(nothing.shape[1]))
    return by_unknown + by_change @ moved[follows]


def _integrated(
    path: Trajectory, total_B: Array, pushed_N: Array | None, inverse: Array, by: _Known
) -> tuple[Array, Array]:
    """Deviations of attitude and rate (n, 3, p) in body axes, by the trapezoidal rule.

    `total_B` (n, 3): total momentum [N m s]; `pushed_N` (n - 1, 3): torque of devices that turns
    with the body [N m], None without any; `inverse` (3, 3) of J.
    """
    to_body = jax.vmap(lambda q: quaternion.to_body(q, jnp.eye(3)).T)(path.attitude)  # C
    to_inertial = jnp.swapaxes(to_body, 1, 2)
    gain = inverse @ jnp.cross(jnp.eye(3), total_B[:, None])  # [m]x
    A, B = to_inertial @ gain @ to_body, to_inertial @ (inverse @ by.source)
    half = 0.5 * jnp.diff(path.time)[:, None, None]
    start = to_inertial[0] @ by.turn
    if pushed_N is None:
        left = _inverse(jnp.eye(3) - half * A[1:])
        transition, driven = left @ (jnp.eye(3) + half * A[:-1]), left @ (half * (B[:-1] + B[1:]))

        def step(psi: Array, row: tuple[Array, Array]) -> tuple[Array, Array]:
            following = row[0] @ psi + row[1]
            return following, following

        _, psi = jax.lax.scan(step, start, (transition, driven))
        turned = to_body @ jnp.concatenate([start[None], psi])
        return turned, gain @ turned + inverse @ by.source
    # The total momentum deviates too: mu' = psi x torque.
    P, X = to_inertial @ inverse @ to_body, -jnp.cross(jnp.eye(3), pushed_N[:, None])
    left = _inverse(jnp.eye(3) - half * A[1:] - half**2 * P[1:] @ X)
    transition = left @ (jnp.eye(3) + half * A[:-1] + half**2 * P[1:] @ X)
    driven, by_mu = left @ (half * (B[:-1] + B[1:])), left @ (half * (P[:-1] + P[1:]))

    def pushed_step(state: tuple[Array, Array], row: tuple[Array, ...]) -> tuple[Any, Any]:
        psi, mu = state
        following = row[0] @ psi + row[1] + row[2] @ mu
        mu = mu + row[3] @ (psi + following)
        return (following, mu), (following, mu)

    none = jnp.zeros_like(start)
    rows = (transition, driven, by_mu, half * X)
    _, (psi, mu) = jax.lax.scan(pushed_step, (start, none), rows)
    turned = to_body @ jnp.concatenate([start[None], psi])
    source = by.source + to_body @ jnp.concatenate([none[None], mu])
    return turned, gain @ turned + inverse @ source


def _inverse(matrix: Array) -> Array:
    """Inverse of matrices (..., 3, 3) by cross products of their rows."""
    a, b, c = matrix[..., 0, :], matrix[..., 1, :], matrix[..., 2, :]
    adjugate = jnp.stack([jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)], -1)
    return adjugate / jnp.sum(a * adjugate[..., 0], -1)[..., None, None]


def _integral(time: Array, slope: Array) -> Array:
    """Integral (n, k) of what each step (n - 1, k) of times (n,) is given, zero at the first."""
    # As a matrix product, which compiles ten times as fast as a cumulative sum.
    return jnp.tril(jnp.ones((len(time), len(slope))), -1) @ (jnp.diff(time)[:, None] * slope)


def expected_covariance(
    layout: ForecastLayout, arrays: ForecastArrays, theta: AnyArray, slews: SlewArrays
) -> Array:
    """Expected covariance of the parameters (d,) after slews; JAX can differentiate it."""
    return covariance_after(arrays, information_matrices(layout, arrays, theta, slews))


def covariance_after(arrays: ForecastArrays, information: Array) -> Array:
    """Covariance of the parameters from prior and information (n, d + b, d + b) of slews."""
    d = len(arrays.prior_sd)
    unit = jnp.concatenate([jnp.asarray(arrays.prior_sd), jnp.ones(len(arrays.prior) - d)])
    precision = (arrays.prior + information.sum(0)) * unit * unit[:, None]
    # Unit diagonal first: what is sharply known and what is not stand side by side.
    scale = 1.0 / jnp.sqrt(jnp.diag(precision))
    inverse = jnp.linalg.inv(precision * scale * scale[:, None]) * scale * scale[:, None]
    return (inverse * unit * unit[:, None])[:d, :d]


def information_matrices(
    layout: ForecastLayout, arrays: ForecastArrays, theta: AnyArray, slews: SlewArrays
) -> Array:
    """Information of each slew on the parameters (d,) and the whitened bias."""
    first = arrays.conditions.context
    body = rigid_body_at(layout.structure, theta, arrays.conditions)
    motion = motion_of_slews(slews, layout.times, body, arrays.start)

    def of_slew(index: Array, start: Array, path: Trajectory, torque: Array) -> Array:
        context = first._replace(
            index=first.index + index,
            start=first.start + start,
            time=path.time,
            step=jnp.append(jnp.diff(path.time), 0.0),
            torque=torque,
            fix_group=_fix_groups(layout.times, path.time),
        )
        environment = arrays.conditions.environment.at(context.start + context.time)
        slew = _Slew(layout.structure, arrays.conditions, context, path, environment)
        columns = _whitened_columns(layout, slew, theta)
        return without_start_state(columns.T @ columns, len(arrays.prior))

    index = jnp.arange(len(slews.rate))
    return jax.vmap(of_slew)(index, motion.start, motion.path, motion.wheel_torque)


def without_start_state(matrix: Array, shared: int) -> Array:
    """Information of a slew on shared unknowns when its start state is not known.

    `matrix` (k, k): information on the shared unknowns and the whitened start state, which follows
    them and has a unit prior.

    Examples
    --------
    >>> without_start_state(jnp.array([[2.0, 1.0], [1.0, 1.0]]), 1).tolist()
    [[1.5]]
    """
    local = matrix[shared:, shared:] + jnp.eye(len(matrix) - shared)
    scale = 1.0 / jnp.sqrt(jnp.diag(local))
    factor = jnp.linalg.cholesky(local * scale * scale[:, None])
    across = jax.scipy.linalg.solve_triangular(
        factor, scale[:, None] * matrix[shared:, :shared], lower=True
    )
    return matrix[:shared, :shared] - across.T @ across


def _fix_groups(times: PlanTimes, time: Array) -> Array:
    """Of each row (n,): 0 before a slew and 1 after it; one group where fixes never cease."""
    middle = 0.5 * (times.rest_before + time[-1] - times.rest_after)
    return jnp.where(time > middle, 0 if times.fixes_in_motion else 1, 0)


def _counts(layout: ForecastLayout, time: Array) -> tuple[Array, ...]:
    """Of each channel: numbers of readings that each row stands for, (n,).

    A row has half of each step beside it; two rows share a fix between them.
    """
    times, half = layout.times, 0.5 * jnp.diff(time)
    beside = jnp.append(half, 0.0) + jnp.concatenate([jnp.zeros(1), half])
    if times.fixes_in_motion:
        fixes = beside / times.fix_spacing
    else:
        before = np.arange(times.first_fix, times.rest_before - 1e-9, times.fix_spacing)
        after = np.arange(0.0, times.rest_after + 1e-9, times.fix_spacing)
        moments = jnp.concatenate([jnp.asarray(before), time[-1] - jnp.asarray(after)])
        right = jnp.clip(jnp.searchsorted(time, moments), 1, len(time) - 1)
        share = (moments - time[right - 1]) / (time[right] - time[right - 1])
        share = jnp.clip(share, 0.0, 1.0)
        # A floor, because a root has no derivative at zero.
        fixes = jnp.full(len(time), NUMERICS.least_readings)
        fixes = fixes.at[right].add(share).at[right - 1].add(1.0 - share)
    return tuple(beside / period if period else fixes for period in layout.periods)
