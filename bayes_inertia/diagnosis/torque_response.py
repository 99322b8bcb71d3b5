"""What small torques and sensor errors would do to the residuals, without simulating them.

A torque at time t' moves the state by J^-1 tau dt'; carried back to the start of the slew by the
transition matrix X of the perturbed motion it is a change of the start state, whose effect on all
later telemetry is known. With c(t) = integral of X(t')^-1 (0, J^-1 tau) dt' the attitude and rate
change by X(t) c(t). One set of six tangents a slew serves all torque histories, and the columns of
effects without a fixed shape: no model is compiled for them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.inference.compiled_programs import forget_surplus
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.likelihood import of_all_slews, of_slew
from bayes_inertia.inference.noise_filter import innovations
from bayes_inertia.maths import inertia_tensor, quaternion
from bayes_inertia.maths.device_arrays import repeated
from bayes_inertia.maths.kept_programs import KeptProgram
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.channels.channel import Channel, SensorAtFit
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.packing import Data
from bayes_inertia.physics.prediction import Structure, acting_in, inertia_in, start_of
from bayes_inertia.physics.simulator import simulate_slew
from bayes_inertia.physics.slew_context import SlewContext, State, Trajectory
from bayes_inertia.physics.slew_input import without_slow_error
from bayes_inertia.physics.stochastic_effect import StochasticEffect


@array_dataclass
class TorqueResponse:
    """Linear response of every slew to body torques, at an estimate.

    Parameters
    ----------
    estimate : Estimate
        The fit.
    time : (slews, n) array
        The integration grid from each slew's zero [s]; padding repeats the end.
    attitude : (slews, n, 4) array
        Of the fit, body from inertial.
    rate_B : (slews, n, 3) array
        Of the fit [rad/s].
    wheel_momentum : (slews, n, wheels) array
        Of the fit, relative to the body [N m s].
    transition : (slews, n, 6, 6) array
        Change of attitude [rad, body axes] and rate [rad/s] per change of the start state.
    inverse_inertia : (slews, 3, 3) array
        From body momentum to body rate [1/(kg m^2)], of each slew.
    """

    estimate: Estimate
    time: np.ndarray
    attitude: np.ndarray
    rate_B: np.ndarray
    wheel_momentum: np.ndarray
    transition: np.ndarray
    inverse_inertia: np.ndarray

    def residual_change(self, torque_B: np.ndarray) -> np.ndarray:
        """Compute the change of the whitened residuals by torques on the body.

        `torque_B` (slews, n, 3, k) [N m]. Returns (slews, numbers, k).
        """
        kick = np.zeros((*torque_B.shape[:2], 6, torque_B.shape[-1]))
        kick[:, :, 3:] = np.einsum("sij,snjk->snik", self.inverse_inertia, torque_B)
        rate_of_change = np.linalg.solve(self.transition, kick)
        step = np.diff(self.time, axis=1)[..., None, None]
        middle = 0.5 * (rate_of_change[:, 1:] + rate_of_change[:, :-1]) * step
        carried = np.concatenate([np.zeros_like(kick[:, :1]), np.cumsum(middle, axis=1)], axis=1)
        moved = self.transition @ carried
        turn, rate_B = moved[:, :, :3], moved[:, :, 3:]
        return -self._of_channels(
            lambda channel, fit, rows: channel.whitened_motion(fit, turn[rows], rate_B[rows])
        )

    def reading_change(self, channel: str, error: np.ndarray) -> np.ndarray:
        """Compute the size of the change of the whitened residuals by errors of one sensor.

        `error` (slews, n, components, k): k histories of the readings' error. Returns (slews,
        numbers, k).
        """

        def change(each: Channel, fit: SensorAtFit, rows: tuple[np.ndarray, ...]) -> np.ndarray:
            if each.name == channel:
                return each.whitened_columns(fit.factors, error[rows])
            return np.zeros((*fit.factors.shape[:3], error.shape[-1]))

        return self._of_channels(change)

    def _of_channels(
        self, change: Callable[[Channel, SensorAtFit, tuple[np.ndarray, ...]], np.ndarray]
    ) -> np.ndarray:
        """Changes (slews, n, components, k) of each channel's readings, one after the other."""
        model, theta, parts = self.estimate.model, self.estimate.theta, []
        telemetry, slews = model.data.arrays.telemetry, np.arange(len(self.time))[:, None]
        sample = np.asarray(telemetry.sample)
        for channel, readings, white in zip(
            model.channels, telemetry.readings, self.estimate.white, strict=True
        ):
            rows = slews, sample[slews, np.asarray(readings.row)]
            fit = SensorAtFit(model.campaign, theta, readings, np.asarray(white.factors))
            columns = change(channel, fit, rows)
            if white.memory is not None:
                columns = np.asarray(innovations(columns, white.memory))
            columns = columns[:, :, : None if channel.compared else 0]
            parts.append(columns.reshape(len(columns), -1, columns.shape[-1]))
        return np.concatenate(parts, 1)


def torque_response(estimate: Estimate) -> TorqueResponse:
    """Compute the linear response of all slews to body torques."""
    model = estimate.model
    time = np.asarray(model.data.arrays.slews.context.time)
    attitude, rate_B, momentum, turn, change = tangents(
        model.structure, estimate.theta, estimate.point.local, model.data
    )
    transition = np.concatenate([turn, change], axis=-2)
    inverse = _inverse_inertia(model, estimate.theta)
    return TorqueResponse(estimate, time, attitude, rate_B, momentum, transition, inverse)


def _inverse_inertia(model: Model, theta: np.ndarray) -> np.ndarray:
    """J^-1 (slews, 3, 3) by which torques turn the body, after the changes of J that are fitted."""
    structure, contexts, tensors = model.structure, model.data.contexts, []
    # An appendage takes part in what is slow.
    changes = [
        (effect, p)
        for effect, p in structure.active_effects(jnp.asarray(theta))
        if effect.acts("inertia") and not effect.acts("initial_state")
    ]
    for k in range(model.n_slews):
        slew = jax.tree.map(lambda rows, k=k: rows[k], contexts)
        J = inertia_in(structure, jnp.asarray(theta), slew)
        for effect, p in changes:
            J = effect.inertia(p, slew, J)
        if structure.drive == "measured":
            J = inertia_tensor.with_wheel_spin(J, slew.wheel_axes_B, slew.spin_inertia)
        tensors.append(J)
    return np.linalg.inv(np.array(tensors))


def tangents(
    structure: Structure, theta: np.ndarray, local: np.ndarray, data: Data
) -> tuple[np.ndarray, ...]:
    """Simulate every slew, and how its attitude and rate follow the start state.

    `theta` (d,); `local` (slews, n_local). Returns `attitude` (slews, n, 4); `rate_B` (slews, n, 3)
    [rad/s]; `wheel_momentum` (slews, n, wheels) [N m s]; `turn, change` (slews, n, 3, 6): change of
    attitude [rad, body axes] and rate [rad/s] per change of the start state.
    """
    forget_surplus((_tangents,))
    grid = data.arrays.slews.context.time.shape[1]
    parts = [
        _tangents(structure, theta, of_slew(k, local), alone) for k, alone in enumerate(data.pieces)
    ]
    return of_all_slews(parts, (grid,) * len(parts[0]))


# Compiled without optimization: half the time to compile, a few calls of less than 0.1 s.
@partial(KeptProgram, compiler_options={"xla_backend_optimization_level": 0})
def _tangents(
    structure: Structure, theta: Array, local: Array, data: Data
) -> tuple[Array, Array, Array, Array, Array]:

    def one(x, slew, telemetry, reference):
        x, coefficients = structure.nuisances(x)
        active = acting_in(structure, theta, coefficients, slew.context)
        J = inertia_in(structure, theta, slew.context)
        if structure.drive == "measured" and structure.wheels:
            noise = (x[6:] * data.scale.local[6:]).reshape(structure.wheels, structure.modes)
            slew = without_slow_error(slew, telemetry.tachometer_modes, noise)
        begin = start_of(structure, data.scale, reference, x)

        def path(y):
            start = begin._replace(
                attitude=quaternion.turned(begin.attitude, y[:3]),
                rate_B=begin.rate_B + y[3:],
            )
            setting = structure.drive, structure.rows_per_step
            trajectory, _ = simulate_slew(slew, start, J, active, *setting)
            return trajectory.attitude, trajectory.rate_B, trajectory.wheel_momentum

        (q, w, h), (dq, dw, _) = jax.vmap(
            lambda v: jax.jvp(path, (jnp.zeros(6),), (v,)),
            out_axes=((None, None, None), (-1, -1, -1)),
        )(jnp.eye(6))
        turn = 2.0 * jax.vmap(
            lambda d: quaternion.multiply(quaternion.conjugate(q), d)[..., :3],
            in_axes=-1,
            out_axes=-1,
        )(dq)
        return q, w, h, turn, dw

    return jax.vmap(one)(local, data.arrays.slews, data.arrays.telemetry, data.arrays.reference)


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
    gyro = model.structure.place("rate")
    rate_S = response.rate_B @ np.asarray(model.data.sensors[gyro].axes).T
    # Of padding: the last instant again.
    *path, rate_S = (repeated(x, contexts.time.shape[1]) for x in (*motion, rate_S))
    states = np.zeros((*contexts.time.shape, 0))
    inputs = contexts, Trajectory(contexts.time, *path, states), rate_S  # type: ignore[call-arg]
    count = effect.coefficient_count(model.campaign)
    parts = [_unit_signals(effect, hooks, count, *of_slew(k, inputs)) for k in range(model.n_slews)]
    units = of_all_slews(parts, (grid,) * len(hooks))
    return changes_of(response, dict(zip(hooks, units, strict=True)), count)


def changes_of(response: TorqueResponse, units: Mapping[str, np.ndarray], count: int) -> np.ndarray:
    """Changes of the whitened residuals by signals (slews, n, components, k) in hooks."""
    estimate = response.estimate
    campaign = estimate.model.campaign
    torque_B, momentum = units.get("body_torque"), units.get("momentum_output")
    if "delivered_torque" in units:
        axes_B, delivered = campaign.wheel_axes_B, units["delivered_torque"]
        momentum = _integral(delivered, response.time)
        # The body feels the motor, and the gyroscopic torque of the momentum that the wheel took.
        taken = np.einsum("iw,snwk->snik", axes_B, momentum)
        gyroscopic = np.cross(response.rate_B[..., None], taken, axis=2)
        torque_B = -np.einsum("iw,snwk->snik", axes_B, delivered) - gyroscopic
    if torque_B is None and not units:
        torque_B = np.zeros((*response.time.shape, 3, count))
    parts = [response.residual_change(torque_B)] if torque_B is not None else []
    if "rate_output" in units:
        factors = estimate.theta[6 : estimate.model.n_base]
        error = units["rate_output"] / factors[:, None]
        parts.append(-response.reading_change("rate", error))
    if "attitude_output" in units:
        parts.append(-response.reading_change("attitude", units["attitude_output"]))
    if momentum is not None:
        parts.append(-response.reading_change("momentum", momentum))
    return sum(parts[1:], start=parts[0])


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

    return jax.vmap(torque)(*motion[:-1])


# What is compiled for each effect and size of slew.
PROGRAMS = (_unit_signals,)
