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
momentum. All of that is asked of the effects' own hooks by differentiating them along the planned
motion. How a deviation of the state would change an effect is left out: it vanishes at the effect's
null. Sensitivities out of the simulator give the same sds to 0.2 %, but the goal's gradient for
five slews then takes 30 s to compile and 18 times as long to run (237 ms against 13 ms).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.design.flight_conditions import InverseNoise, environment_at
from bayes_inertia.design.information_forecast import (
    ForecastArrays,
    ForecastLayout,
    rigid_body_at,
)
from bayes_inertia.design.plan_arrays import PlanTimes, SlewArrays
from bayes_inertia.design.planned_motion import motion_of_slews
from bayes_inertia.errors import EffectError
from bayes_inertia.maths import inertia_tensor, quaternion
from bayes_inertia.maths.values import AnyArray
from bayes_inertia.physics.channels.rate import RateConstants
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.nuisances import NuisanceScale
from bayes_inertia.physics.parameters import N_BIAS
from bayes_inertia.physics.prediction import Structure
from bayes_inertia.physics.slew_context import Environment, SlewContext, State, Trajectory
from bayes_inertia.physics.stochastic_effect import StochasticEffect


class PlannedTrajectory(NamedTuple):
    """The planned motion of one slew and its environment.

    Parameters
    ----------
    path : Trajectory
        The motion on n rows, without states of effects.
    environment : Environment
        Its columns (n, 3).
    """

    path: Trajectory
    environment: Environment


class TelemetrySensitivity(NamedTuple):
    """Derivatives of one slew's telemetry with respect to p unknowns.

    The unknowns are theta, the whitened bias, and the whitened start state.

    Parameters
    ----------
    rate : (n, 3, p) array
        Of the rate sensor's readings [rad/s].
    attitude : (n, 3, p) array
        Of the attitude, as a rotation vector in body axes [rad].
    momentum : (n, wheels, p) array
        Of the tachometers' readings [N m s].
    """

    rate: Array
    attitude: Array
    momentum: Array


class _Quantities(NamedTuple):
    """Quantities along the planned motion that the parameters decide."""

    inertia_B: Array
    axes_B: Array
    delivered: Array
    wheel_torque: Array
    body_torque: Array
    rate_S: Array
    attitude: Array
    momentum: Array
    scale_factor: Array


class _StateDeviation(NamedTuple):
    """Derivatives of the state along the planned motion with respect to p unknowns.

    `attitude` (n, 3, p) as a rotation vector in body axes, `rate_B` (n, 3, p), and `wheel`
    (n, wheels, p) of the wheels' total momentum.
    """

    attitude: Array
    rate_B: Array
    wheel: Array


def telemetry_sensitivity(
    structure: Structure,
    theta: Array,
    context: SlewContext,
    planned: PlannedTrajectory,
    sensors: RateConstants,
    scale: NuisanceScale,
) -> TelemetrySensitivity:
    """First-order sensitivity of one slew's telemetry; the slew begins at rest.

    `theta` (d,). `structure`: of the model that will be fitted, with n_local nuisances a slew.
    """
    for effect in structure.effects:
        if effect.acts("state_rate"):
            raise EffectError(
                "has states of its own, which plans are not designed for",
                where=effect.name,
                advice="leave it out of the design",
            )
    stochastic = [e.name for e in structure.effects if isinstance(e, StochasticEffect)]
    if structure.hyperparameters:
        raise EffectError(
            "is stochastic, which plans are not designed for",
            where=stochastic[0],
            advice="leave it out of the design",
        )
    quantities = partial(_quantities, structure, context=context, planned=planned, sensors=sensors)
    nominal, by_theta = quantities(theta), jax.jacfwd(quantities)(theta)
    d, p = len(theta), len(theta) + N_BIAS + structure.n_local
    derivatives = jax.tree.map(
        lambda x: jnp.concatenate([x, jnp.zeros((*x.shape[:-1], p - d))], -1), by_theta
    )
    deviation = _state_deviation(nominal, derivatives, planned.path, context, scale, d)
    return _of_sensors(nominal, derivatives, deviation, planned.path, context, sensors, scale, d)


def _state_deviation(
    nominal: _Quantities,
    derivatives: _Quantities,
    path: Trajectory,
    context: SlewContext,
    scale: NuisanceScale,
    d: int,
) -> _StateDeviation:
    """Sensitivity of the state to the unknowns, of which the first d are parameters."""
    spin, G = context.spin_inertia, nominal.axes_B
    total, d_total, d_wheel = _start_deviation(nominal, derivatives, path, context, scale, d)
    wheel = path.wheel_momentum + spin * (path.rate_B @ G)
    step = jnp.diff(path.time)[:, None, None]
    d_wheel = (
        d_wheel
        + _integral(step, derivatives.delivered[:-1])
        + _integral(step, _midpoints(derivatives.wheel_torque))
    )
    d_total = d_total + _integral(
        step, _midpoints(_to_inertial(path.attitude, derivatives.body_torque))
    )
    momentum_B = quaternion.to_body(path.attitude, jnp.broadcast_to(total, path.rate_B.shape))
    source = _to_body(path.attitude, d_total) - jnp.einsum("iw,nwp->nip", G, d_wheel)
    source = (
        source
        - jnp.einsum("iwp,nw->nip", derivatives.axes_B, wheel)
        - jnp.einsum("ijp,nj->nip", derivatives.inertia_B, path.rate_B)
    )
    inverse = _inverse(nominal.inertia_B)
    attitude, d_rate = _integrated(path, momentum_B, inverse, source, d + N_BIAS, scale)
    return _StateDeviation(attitude, d_rate, d_wheel)


def _of_sensors(
    nominal: _Quantities,
    derivatives: _Quantities,
    deviation: _StateDeviation,
    path: Trajectory,
    context: SlewContext,
    sensors: RateConstants,
    scale: NuisanceScale,
    d: int,
) -> TelemetrySensitivity:
    """Sensitivity of the sensors, by the state's deviation and by their own parameters."""
    p, spin, G = deviation.rate_B.shape[-1], context.spin_inertia, nominal.axes_B
    rate_S = jnp.einsum("ij,njp->nip", sensors.axes, deviation.rate_B) + derivatives.rate_S
    rate_S = rate_S + jnp.zeros((3, p)).at[jnp.arange(3), d + jnp.arange(N_BIAS)].set(scale.bias)
    rate = (
        rate_S - (nominal.rate_S / nominal.scale_factor)[..., None] * derivatives.scale_factor
    ) / nominal.scale_factor[:, None]
    by_tracker = (
        2.0
        * quaternion.multiply(
            quaternion.conjugate(nominal.attitude)[:, None],
            jnp.swapaxes(derivatives.attitude, 1, 2),
        )[..., :3]
    )
    h = deviation.wheel - spin[:, None] * (
        jnp.einsum("iwp,ni->nwp", derivatives.axes_B, path.rate_B)
        + jnp.einsum("iw,nip->nwp", G, deviation.rate_B)
    )
    attitude = deviation.attitude + jnp.swapaxes(by_tracker, 1, 2)
    return TelemetrySensitivity(rate, attitude, h + derivatives.momentum)


def _quantities(
    structure: Structure,
    theta: Array,
    context: SlewContext,
    planned: PlannedTrajectory,
    sensors: RateConstants,
) -> _Quantities:
    """Inertia, wheels, torques and sensor signals that theta (d,) gives along the motion."""
    active, path = structure.active_effects(theta), planned.path
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
        on_wheels, on_body = _torques_along(effect, p, context, planned, locked)
        friction, external = friction + on_wheels, external + on_body
        rate_S = effect.rate_output(p, context, path, rate_S)
        attitude = effect.attitude_output(p, context, path, attitude)
        momentum = effect.momentum_output(p, context, path, momentum)
    return _Quantities(J, axes, torque, friction, external, rate_S, attitude, momentum, theta[6:9])


def _torques_along(
    effect: Effect,
    p: Mapping[str, Array],
    context: SlewContext,
    planned: PlannedTrajectory,
    locked_B: Array,
) -> tuple[Array, Array]:
    """Torques of an effect on the wheels (n, wheels) and on the body (n, 3) along the motion."""

    def instant(
        t: Array, q: Array, w: Array, h: Array, environment: Environment
    ) -> tuple[Array, Array]:
        state = State(q, w, h, jnp.zeros(0), locked_B, *environment)
        wheel_torque = effect.wheel_torque(p, context, t, state)
        return wheel_torque, effect.body_torque(p, context, t, state)

    path = planned.path
    rows = (
        path.time,
        path.attitude,
        path.rate_B,
        path.wheel_momentum,
        planned.environment,
    )
    return jax.vmap(instant)(*rows)


def _start_deviation(
    nominal: _Quantities,
    derivatives: _Quantities,
    path: Trajectory,
    context: SlewContext,
    scale: NuisanceScale,
    d: int,
) -> tuple[Array, Array, Array]:
    """Total momentum (3,) in inertial axes at the start, and how it and the wheels' momentum move.

    Their derivatives are (3, p) and (wheels, p). The start state's columns are those of the forward
    model: rate, attitude, wheel momentum; the planned rate is zero.
    """
    p = derivatives.scale_factor.shape[-1]
    first, G, wheels = d + N_BIAS, nominal.axes_B, nominal.axes_B.shape[1]
    locked = inertia_tensor.with_wheel_spin(nominal.inertia_B, G, context.spin_inertia)
    h, q = path.wheel_momentum[0], path.attitude[0]
    momentum_B = G @ h
    d_momentum = jnp.einsum("iwp,w->ip", derivatives.axes_B, h)
    d_momentum = d_momentum.at[:, first : first + 3].add(locked * scale.local[:3])
    d_momentum = d_momentum.at[:, first + 3 : first + 6].add(-_cross(momentum_B) * scale.local[3:6])
    d_momentum = d_momentum.at[:, first + 6 : first + 6 + wheels].add(G * scale.local[6:])
    d_wheel = (
        jnp.zeros((wheels, p))
        .at[:, first : first + 3]
        .set((context.spin_inertia * G).T * scale.local[:3])
    )
    d_wheel = d_wheel.at[:, first + 6 : first + 6 + wheels].set(jnp.diag(scale.local[6:]))
    return quaternion.to_inertial(q, momentum_B), _to_inertial(q, d_momentum), d_wheel


def _integrated(
    path: Trajectory,
    momentum_B: Array,
    inverse: Array,
    source: Array,
    first: int,
    scale: NuisanceScale,
) -> tuple[Array, Array]:
    """Deviations of attitude and rate (n, 3, p) in body axes, by the trapezoidal rule."""
    to_body = jax.vmap(lambda q: quaternion.to_body(q, jnp.eye(3)).T)(path.attitude)  # C
    gain = inverse @ jax.vmap(_cross)(momentum_B)
    A = jnp.swapaxes(to_body, 1, 2) @ gain @ to_body
    B = jnp.swapaxes(to_body, 1, 2) @ (inverse @ source)
    half = 0.5 * jnp.diff(path.time)[:, None, None]
    left = _inverse(jnp.eye(3) - half * A[1:])
    transition, driven = left @ (jnp.eye(3) + half * A[:-1]), left @ (half * (B[:-1] + B[1:]))
    start = (
        jnp.zeros(source.shape[1:])
        .at[:, first + 3 : first + 6]
        .set(to_body[0].T * scale.local[3:6])
    )

    def step(psi: Array, row: tuple[Array, Array]) -> tuple[Array, Array]:
        following = row[0] @ psi + row[1]
        return following, following

    _, psi = jax.lax.scan(step, start, (transition, driven))
    turned = to_body @ jnp.concatenate([start[None], psi])
    return turned, gain @ turned + inverse @ source


def _inverse(matrix: Array) -> Array:
    """Inverse of matrices (..., 3, 3) by cross products of their rows."""
    a, b, c = matrix[..., 0, :], matrix[..., 1, :], matrix[..., 2, :]
    adjugate = jnp.stack([jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)], -1)
    return adjugate / jnp.sum(a * adjugate[..., 0], -1)[..., None, None]


def _cross(v: Array) -> Array:
    """[v]x (3, 3), so that [v]x u is the cross product of v and u."""
    zero = jnp.zeros(())
    return jnp.stack(
        [
            jnp.stack([zero, -v[2], v[1]]),
            jnp.stack([v[2], zero, -v[0]]),
            jnp.stack([-v[1], v[0], zero]),
        ]
    )


def _to_inertial(q: Array, columns_B: Array) -> Array:
    """Columns (..., 3, p) of body vectors in inertial axes."""
    return jnp.swapaxes(
        quaternion.to_inertial(q[..., None, :], jnp.swapaxes(columns_B, -1, -2)), -1, -2
    )


def _to_body(q: Array, columns_N: Array) -> Array:
    """Columns (..., 3, p) of inertial vectors in body axes."""
    return jnp.swapaxes(
        quaternion.to_body(q[..., None, :], jnp.swapaxes(columns_N, -1, -2)), -1, -2
    )


def _midpoints(rows: Array) -> Array:
    """Means of neighbouring rows."""
    return 0.5 * (rows[1:] + rows[:-1])


def _integral(step: Array, slope: Array) -> Array:
    """Integral (n, k, p) of what is given for each step (n - 1, k, p), zero at the first row."""
    # As a matrix product, which compiles ten times as fast as a cumulative sum.
    n = len(slope)
    return jnp.einsum("ij,jkp->ikp", jnp.tril(jnp.ones((n + 1, n)), -1), step * slope)


def expected_covariance(
    layout: ForecastLayout, arrays: ForecastArrays, theta: AnyArray, slews: SlewArrays
) -> Array:
    """Expected covariance of the parameters after slews; JAX can differentiate it.

    `theta` (d,).
    """
    return covariance_after(arrays, information_matrices(layout, arrays, theta, slews))


def covariance_after(arrays: ForecastArrays, information: Array) -> Array:
    """Covariance of the parameters from the prior and the information of slews.

    `information` (n, d + 3, d + 3).
    """
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
    """Information of each slew on the parameters and the whitened bias.

    `theta` (d,).
    """
    body = rigid_body_at(layout.structure, theta, arrays.conditions)
    motion = motion_of_slews(slews, layout.times, body, arrays.start)
    index = jnp.arange(len(slews.rate))
    one = partial(_information_of_slew, layout, arrays, theta)
    return jax.vmap(one)(
        index,
        *(
            getattr(motion, key)
            for key in ("time", "start", "attitude", "rate_B", "wheel_momentum", "wheel_torque")
        ),
    )


def _information_of_slew(
    layout: ForecastLayout,
    arrays: ForecastArrays,
    theta: Array,
    index: Array,
    time: Array,
    start: Array,
    attitude: Array,
    rate_B: Array,
    wheel_momentum: Array,
    wheel_torque: Array,
) -> Array:
    """Information (d + 3, d + 3) of one slew; its arrays as in `PlannedMotion`, without slews."""
    conditions, times = arrays.conditions, layout.times
    start_time = conditions.start_time + start
    context = SlewContext(
        index=conditions.first + index,
        slews=conditions.slew_count,
        start=start_time,
        middle=conditions.middle,
        time=time,
        step=jnp.append(jnp.diff(time), 0.0),
        torque=wheel_torque,
        wheel_axes_B=conditions.wheel_axes_B,
        spin_inertia=conditions.spin_inertia,
        boresight_B=conditions.boresight_B,
        rate_axes=conditions.sensors.axes,
    )
    environment = environment_at(conditions.environment, start_time + time)
    path = Trajectory(time, attitude, rate_B, wheel_momentum, jnp.zeros((len(time), 0)))
    planned = PlannedTrajectory(path, environment)
    sensitivity = telemetry_sensitivity(
        layout.structure, theta, context, planned, conditions.sensors, conditions.scale
    )
    samples = _time_by_row(time) / times.telemetry_period
    fixes = _fixes_by_row(times, time)
    columns = _whitened_columns(conditions.noise, sensitivity, samples, fixes)
    return without_start_state(columns.T @ columns, len(theta) + N_BIAS)


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


def _whitened_columns(
    noise: InverseNoise, sensitivity: TelemetrySensitivity, samples: Array, fixes: Array
) -> Array:
    """Whitened derivatives (numbers, p) of everything measured.

    A row counts as many times as it stands for samples or fixes (n,).
    """
    rate = sensitivity.rate * (noise.rate[:, None] * jnp.sqrt(samples)[:, None, None])
    momentum = sensitivity.momentum * (noise.momentum[:, None] * jnp.sqrt(samples)[:, None, None])
    attitude = (
        jnp.einsum("ij,njp->nip", noise.attitude, sensitivity.attitude)
        * jnp.sqrt(fixes)[:, None, None]
    )
    return jnp.concatenate([x.reshape(-1, x.shape[-1]) for x in (rate, attitude, momentum)])


def _time_by_row(time: Array) -> Array:
    """Time (n,) that each row stands for [s]: half of each step beside it."""
    half = 0.5 * jnp.diff(time)
    return jnp.append(half, 0.0) + jnp.concatenate([jnp.zeros(1), half])


def _fixes_by_row(times: PlanTimes, time: Array) -> Array:
    """Number of fixes that each row stands for (n,): two rows share a fix between them."""
    before = np.arange(times.first_fix, times.rest_before - 1e-9, times.fix_spacing)
    after = np.arange(0.0, times.rest_after + 1e-9, times.fix_spacing)
    moments = jnp.concatenate([jnp.asarray(before), time[-1] - jnp.asarray(after)])
    right = jnp.clip(jnp.searchsorted(time, moments), 1, len(time) - 1)
    share = jnp.clip((moments - time[right - 1]) / (time[right] - time[right - 1]), 0.0, 1.0)
    # A floor, because a root has no derivative at zero.
    return jnp.full(len(time), 1e-12).at[right].add(share).at[right - 1].add(1.0 - share)
