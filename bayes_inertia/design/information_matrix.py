"""Information of slews that have not been flown, as a smooth function of the slews.

The information matrix of each slew's telemetry on the parameters and the bias, with the slew's own
start state integrated out, and the covariance that follows. The prior of everything is in it as in
`likelihood`.
"""

from __future__ import annotations

from functools import partial

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
from bayes_inertia.design.sensitivity import (
    PlannedTrajectory,
    TelemetrySensitivity,
    telemetry_sensitivity,
)
from bayes_inertia.inference.point import N_BIAS
from bayes_inertia.maths.values import AnyArray
from bayes_inertia.physics.slew_context import SlewContext, Trajectory


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
