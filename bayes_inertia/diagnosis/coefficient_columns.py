"""What effects without a fixed shape do to the residuals, to first order around an estimate.

No model is compiled for it: errors of sensors act on readings at once, torques through the response
that serves all torques (`torque_response`).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.diagnosis.torque_response import TorqueResponse
from bayes_inertia.inference.channel_rows import channel_rows
from bayes_inertia.inference.each_slew import of_all_slews, of_slew
from bayes_inertia.maths import quaternion
from bayes_inertia.maths.device_arrays import repeated
from bayes_inertia.physics.slew_context import SlewContext, State, Trajectory
from bayes_inertia.physics.stochastic_effect import StochasticEffect

_READINGS = ("rate_output", "attitude_output", "momentum_output")
# Of the wheels: in the measured drive neither is compared with data.
_OF_WHEELS = ("momentum_output", "delivered_torque")


def coefficient_columns(response: TorqueResponse, effect: StochasticEffect) -> np.ndarray:
    """Take the derivatives of the whitened residuals towards an effect's coefficients.

    `response`: of the fit; the effect need not be part of its model. Returns (slews, numbers, k):
    all channels one after the other; zero where the campaign does not see the effect.
    """
    model = response.estimate.model
    hooks = tuple(
        hook
        for hook in (*_READINGS, "body_torque", "delivered_torque")
        if effect.acts(hook) and not (model.structure.drive == "measured" and hook in _OF_WHEELS)
    )
    grid, contexts = response.time.shape[1], model.data.contexts
    motion = (response.attitude, response.rate_B, response.wheel_momentum)
    rate_S = response.rate_B @ model.campaign.rate_sensor.axes.T
    # Of padding: the last instant again.
    *path, rate_S = (repeated(x, contexts.time.shape[1]) for x in (*motion, rate_S))
    states = np.zeros((*contexts.time.shape, 0))
    inputs = contexts, Trajectory(contexts.time, *path, states), rate_S  # type: ignore[call-arg]
    count = effect.coefficient_count(model.campaign)
    parts = [_unit_signals(effect, hooks, count, *of_slew(k, inputs)) for k in range(model.n_slews)]
    units = of_all_slews(parts, (grid,) * len(hooks))
    return _changes(response, dict(zip(hooks, units, strict=True)), count)


def _changes(response: TorqueResponse, units: Mapping[str, np.ndarray], count: int) -> np.ndarray:
    """Changes of the whitened residuals by signals (slews, n, components, k) in hooks."""
    estimate = response.estimate
    campaign, channels = estimate.model.campaign, channel_rows(estimate.model)
    telemetry = estimate.model.data.arrays.telemetry
    sample, slews = np.asarray(telemetry.sample), np.arange(len(response.time))[:, None]
    torque_B, momentum = units.get("body_torque"), units.get("momentum_output")
    if "delivered_torque" in units:
        axes_B, delivered = campaign.wheel_axes_B, units["delivered_torque"]
        momentum = _integral(delivered, response.time)
        # The body feels the motor, and the gyroscopic torque of the momentum that the wheel took.
        taken = np.einsum("iw,snwk->snik", axes_B, momentum)
        gyroscopic = np.cross(response.rate_B[..., None], taken, axis=2)
        torque_B = -np.einsum("iw,snwk->snik", axes_B, delivered) - gyroscopic
    if torque_B is None:
        torque_B = np.zeros((*response.time.shape, 3, count))
    columns = np.concatenate([np.asarray(c) for c in response.residual_change(torque_B)], axis=1)
    if "rate_output" in units:
        factors = estimate.theta[6:9][:, None]
        columns -= response.reading_change(units["rate_output"] / factors)
    if "attitude_output" in units:
        fixes = units["attitude_output"][slews, sample[slews, np.asarray(telemetry.fix_row)]]
        turn = np.einsum("sfij,sfjk->sfik", np.asarray(estimate.white.attitude), fixes)
        columns[:, channels["attitude"].part] -= turn.reshape(len(slews), -1, count)
    if momentum is not None:
        read = np.asarray(estimate.white.momentum)[..., None] * momentum[slews, sample]
        columns[:, channels["momentum"].part] -= read.reshape(len(slews), -1, count)
    return columns


def _integral(held: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Integrals (slews, n, ...) of what is held over each interval of the grid."""
    pieces = held[:, :-1] * np.diff(time, axis=1)[..., None, None]
    return np.concatenate([np.zeros_like(held[:, :1]), np.cumsum(pieces, axis=1)], axis=1)


@partial(jax.jit, static_argnums=(0, 1, 2))
def _unit_signals(
    effect: StochasticEffect,
    hooks: tuple[str, ...],
    count: int,
    contexts: SlewContext,
    path: Trajectory,
    rate_S: Array,
) -> tuple[Array, ...]:
    """What unit coefficients add in each hook (slews, n, components, k)."""

    def one(slew: SlewContext, motion: Trajectory, reading: Array) -> tuple[Array, ...]:
        def values(c: Array) -> tuple[Array, ...]:
            return tuple(_value(effect, hook, c, slew, motion, reading) for hook in hooks)

        still = jnp.zeros(count)
        return jax.vmap(lambda unit: jax.jvp(values, (still,), (unit,))[1], out_axes=-1)(
            jnp.eye(count)
        )

    return jax.vmap(one)(contexts, path, rate_S)


def _value(
    effect: StochasticEffect,
    hook: str,
    coefficients: Array,
    slew: SlewContext,
    motion: Trajectory,
    rate_S: Array,
) -> Array:
    """What a hook gives along a slew (n, components); of attitudes the small rotation."""
    p, attitude = {"coefficients": coefficients}, motion.attitude
    if hook == "rate_output":
        return effect.rate_output(p, slew, motion, rate_S)
    if hook == "momentum_output":
        return effect.momentum_output(p, slew, motion, motion.wheel_momentum)
    if hook == "attitude_output":
        turned = effect.attitude_output(p, slew, motion, attitude)
        return 2.0 * quaternion.multiply(quaternion.conjugate(attitude), turned)[..., :3]
    if hook == "delivered_torque":
        return effect.delivered_torque(p, slew, slew.torque)

    nothing = jnp.zeros(3)

    def torque(t: Array, q: Array, rate_B: Array, momentum: Array, states: Array) -> Array:
        # Without inertia and field: a random torque does not follow them.
        state = State(q, rate_B, momentum, states, jnp.eye(3), nothing, nothing)
        return effect.body_torque(p, slew, t, state)

    return jax.vmap(torque)(*motion)


# What is compiled for each effect and size of slew.
PROGRAMS = (_unit_signals,)
