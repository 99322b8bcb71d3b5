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
from typing import NamedTuple

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
from bayes_inertia.design.plan_arrays import PlanTimes, SlewArrays
from bayes_inertia.design.planned_motion import motion_of_slews
from bayes_inertia.errors import EffectError
from bayes_inertia.maths import inertia_tensor, quaternion
from bayes_inertia.maths.values import AnyArray
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.parameters import N_BIAS
from bayes_inertia.physics.prediction import Structure
from bayes_inertia.physics.slew_context import Environment, SlewContext, State, Trajectory
from bayes_inertia.physics.stochastic_effect import StochasticEffect


class _Along(NamedTuple):
    """Inertia, wheels, torques and sensor signals that parameters give along the planned motion."""

    inertia_B: Array
    axes_B: Array
    delivered: Array
    wheel_torque: Array
    body_torque: Array
    rate_S: Array
    attitude: Array
    momentum: Array


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


def _along(
    structure: Structure,
    conditions: FlightConditions,
    context: SlewContext,
    path: Trajectory,
    environment: Environment,
    theta: Array,
) -> _Along:
    """What theta (d,) gives along the planned motion."""
    active, sensors = structure.active_effects(theta), conditions.sensors
    J, axes, torque = inertia_tensor.tensor(theta[:6]), context.wheel_axes_B, context.torque
    if structure.includes_wheel_spin:
        J = inertia_tensor.without_wheel_spin(J, axes, context.spin_inertia)
    for effect, p in active:
        J, axes, torque = (
            effect.inertia(p, context, J),
            effect.wheel_axes(p, context, axes),
            effect.delivered_torque(p, context, torque),
        )
    locked = inertia_tensor.with_wheel_spin(J, axes, context.spin_inertia)
    friction, external = jnp.zeros_like(path.wheel_momentum), jnp.zeros_like(path.rate_B)
    rate_S = path.rate_B @ sensors.axes.T + sensors.bias
    attitude, momentum = path.attitude, path.wheel_momentum
    for effect, p in active:
        on_wheels, on_body = _torques_along(effect, p, context, path, environment, locked)
        friction, external = friction + on_wheels, external + on_body
        rate_S = effect.rate_output(p, context, path, rate_S)
        attitude = effect.attitude_output(p, context, path, attitude)
        momentum = effect.momentum_output(p, context, path, momentum)
    return _Along(J, axes, torque, friction, external, rate_S, attitude, momentum)


def _torques_along(
    effect: Effect,
    p: Mapping[str, Array],
    context: SlewContext,
    path: Trajectory,
    environment: Environment,
    locked_B: Array,
) -> tuple[Array, Array]:
    """Torques of an effect on the wheels (n, wheels) and on the body (n, 3) along the motion."""

    def instant(
        t: Array, q: Array, w: Array, h: Array, environment: Environment
    ) -> tuple[Array, Array]:
        state = State(q, w, h, jnp.zeros(0), locked_B, *environment)
        wheel_torque = effect.wheel_torque(p, context, t, state)
        return wheel_torque, effect.body_torque(p, context, t, state)

    return jax.vmap(instant)(
        path.time, path.attitude, path.rate_B, path.wheel_momentum, environment
    )


class _Known(NamedTuple):
    """What unknowns decide without integrating a deviation of the state.

    The `turn` (3,) of the first attitude in body axes [rad], the `source` C M_N - G H - J w (n, 3)
    along the planned motion [N m s], and sensors there: `rate` of the readings (n, 3) [rad/s],
    `attitude` (n, 3) as a small rotation [rad], `momentum` (n, wheels) of the tachometers [N m s].
    """

    turn: Array
    source: Array
    rate: Array
    attitude: Array
    momentum: Array


def _whitened_columns(
    layout: ForecastLayout,
    conditions: FlightConditions,
    theta: Array,
    context: SlewContext,
    path: Trajectory,
) -> Array:
    """Whitened derivatives (numbers, p) of all that one slew measures, at rest in the beginning.

    The p unknowns are theta, the whitened bias and the whitened start state. A row counts as many
    times as it stands for samples or fixes.
    """
    _require_plain(layout.structure)
    environment = conditions.environment.at(context.start + context.time)
    along = partial(_along, layout.structure, conditions, context, path, environment)
    nominal, spin, d = along(theta), context.spin_inertia, len(theta)
    planned = path.wheel_momentum + spin * (path.rate_B @ nominal.axes_B)
    momentum_B = nominal.axes_B @ path.wheel_momentum[0]  # total, before the slew

    def known(unknown: Array) -> _Known:
        theta, bias, start = jnp.split(unknown, [d, d + N_BIAS])
        now, (rate, turn, added) = along(theta), jnp.split(conditions.scale.local * start, [3, 6])
        locked = inertia_tensor.with_wheel_spin(now.inertia_B, now.axes_B, spin)
        first_B = locked @ rate + now.axes_B @ (path.wheel_momentum[0] + added)
        first_N = quaternion.to_inertial(path.attitude[0], first_B + jnp.cross(turn, momentum_B))
        torque_N = quaternion.to_inertial(path.attitude, now.body_torque)
        total_N = first_N + _integral(path.time, _midpoints(torque_N))
        wheel = added + spin * (rate @ now.axes_B)
        wheel += _integral(path.time, now.delivered[:-1] + _midpoints(now.wheel_torque))
        source = quaternion.to_body(path.attitude, total_N) - wheel @ nominal.axes_B.T
        source -= planned @ now.axes_B.T + path.rate_B @ now.inertia_B.T
        # To first order, the vector part is half a small rotation.
        seen = quaternion.multiply(quaternion.conjugate(nominal.attitude), now.attitude)
        tachometers = now.momentum + wheel - spin * (path.rate_B @ now.axes_B)
        rate_S = (now.rate_S + conditions.scale.bias * bias) / theta[6:9]
        return _Known(turn, source, rate_S, 2.0 * seen[:, :3], tachometers)

    unknown = jnp.concatenate([theta, jnp.zeros(N_BIAS + layout.structure.n_local)])
    by = jax.jacfwd(known)(unknown)
    turned, d_rate = _integrated(path, momentum_B, _inverse(nominal.inertia_B), by)
    noise, axes_S = conditions.noise, conditions.sensors.axes / theta[6:9, None]
    samples, fixes = (jnp.sqrt(n)[:, None, None] for n in _counts(layout.times, path.time))
    whitened = (
        samples * noise.rate[:, None] * (by.rate + axes_S @ d_rate),
        fixes * (noise.attitude @ (by.attitude + turned)),
        samples * noise.momentum[:, None] * (by.momentum - (spin * nominal.axes_B).T @ d_rate),
    )
    return jnp.concatenate([x.reshape(-1, len(unknown)) for x in whitened])


def _integrated(
    path: Trajectory, momentum_B: Array, inverse: Array, by: _Known
) -> tuple[Array, Array]:
    """Deviations of attitude and rate (n, 3, p) in body axes, by the trapezoidal rule.

    `momentum_B` (3,): total momentum at the start [N m s]; `inverse` (3, 3) of J.
    """
    momentum_N = quaternion.to_inertial(path.attitude[0], momentum_B)
    momentum_B = quaternion.to_body(path.attitude, jnp.broadcast_to(momentum_N, path.rate_B.shape))
    to_body = jax.vmap(lambda q: quaternion.to_body(q, jnp.eye(3)).T)(path.attitude)  # C
    to_inertial = jnp.swapaxes(to_body, 1, 2)
    gain = inverse @ jnp.cross(jnp.eye(3), momentum_B[:, None])  # [m]x
    A, B = to_inertial @ gain @ to_body, to_inertial @ (inverse @ by.source)
    half = 0.5 * jnp.diff(path.time)[:, None, None]
    left = _inverse(jnp.eye(3) - half * A[1:])
    transition, driven = left @ (jnp.eye(3) + half * A[:-1]), left @ (half * (B[:-1] + B[1:]))

    def step(psi: Array, row: tuple[Array, Array]) -> tuple[Array, Array]:
        following = row[0] @ psi + row[1]
        return following, following

    start = to_inertial[0] @ by.turn
    _, psi = jax.lax.scan(step, start, (transition, driven))
    turned = to_body @ jnp.concatenate([start[None], psi])
    return turned, gain @ turned + inverse @ by.source


def _inverse(matrix: Array) -> Array:
    """Inverse of matrices (..., 3, 3) by cross products of their rows."""
    a, b, c = matrix[..., 0, :], matrix[..., 1, :], matrix[..., 2, :]
    adjugate = jnp.stack([jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)], -1)
    return adjugate / jnp.sum(a * adjugate[..., 0], -1)[..., None, None]


def _midpoints(rows: Array) -> Array:
    """Means of neighbouring rows."""
    return 0.5 * (rows[1:] + rows[:-1])


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
    """Covariance of the parameters from prior and information (n, d + 3, d + 3) of slews."""
    d = len(arrays.prior_sd)
    unit = jnp.concatenate([jnp.asarray(arrays.prior_sd), jnp.ones(N_BIAS)])
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
        )
        columns = _whitened_columns(layout, arrays.conditions, theta, context, path)
        return without_start_state(columns.T @ columns, len(theta) + N_BIAS)

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


def _counts(times: PlanTimes, time: Array) -> tuple[Array, Array]:
    """Numbers of samples and of fixes that each row stands for, (n,) both.

    A row has half of each step beside it; two rows share a fix between them.
    """
    half = 0.5 * jnp.diff(time)
    beside = jnp.append(half, 0.0) + jnp.concatenate([jnp.zeros(1), half])
    before = np.arange(times.first_fix, times.rest_before - 1e-9, times.fix_spacing)
    after = np.arange(0.0, times.rest_after + 1e-9, times.fix_spacing)
    moments = jnp.concatenate([jnp.asarray(before), time[-1] - jnp.asarray(after)])
    right = jnp.clip(jnp.searchsorted(time, moments), 1, len(time) - 1)
    share = jnp.clip((moments - time[right - 1]) / (time[right] - time[right - 1]), 0.0, 1.0)
    # A floor, because a root has no derivative at zero.
    fixes = jnp.full(len(time), 1e-12).at[right].add(share).at[right - 1].add(1.0 - share)
    return beside / times.telemetry_period, fixes
