"""What small torques and sensor errors would do to the residuals, without simulating them.

A torque at time t' moves the state by J^-1 tau dt'; carried back to the start of the slew by the
transition matrix X of the perturbed motion it is a change of the start state, whose effect on all
later telemetry is known. With c(t) = integral of X(t')^-1 (0, J^-1 tau) dt' the attitude and rate
change by X(t) c(t). One set of six tangents a slew serves all torque histories, and the columns of
effects without a fixed shape: no model is compiled for them.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.likelihood import of_all_slews, of_slew
from bayes_inertia.inference.noise_model import innovations
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
from bayes_inertia.physics.slew_input import without_tachometer_error
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

    def changes(self, signals: Mapping[str, np.ndarray]) -> np.ndarray:
        """Compute the changes of the whitened residuals by signals in hooks of effects.

        `signals` (slews, n, components, k): k histories on the grid of a torque on the body or the
        wheels [N m], or of errors of the sensors with such a hook. Returns (slews, numbers, k).
        """
        signals, model, parts = dict(signals), self.estimate.model, []
        count, slews = next(iter(signals.values())).shape[-1], np.arange(len(self.time))[:, None]
        if "delivered_torque" in signals:
            delivered = signals.pop("delivered_torque")
            taken, axes_B = _integral(delivered[:, :-1], self.time), model.campaign.wheel_axes_B
            signals["momentum_output"] = taken
            # The body feels the motor, and the gyroscopic torque of the momentum that wheels took.
            gyroscopic = np.cross(self.rate_B[..., None], _along(axes_B, taken), axis=2)
            signals["body_torque"] = -_along(axes_B, delivered) - gyroscopic
        torque_B = signals.pop("body_torque", None)
        starts = [] if torque_B is None else self._starts(torque_B)
        channels = zip(model.channels, self.estimate.white, self._sensor_tangents, strict=True)
        for channel, white, (fit, rows, by_start) in channels:
            columns = np.zeros((*np.shape(fit.readings.valid), count))
            for k, start in enumerate(starts):
                columns[k] = -by_start[k] @ start[rows[k]]
            if channel.hook in signals and channel.stream.field:
                error: Any = np.moveaxis(signals[channel.hook][slews, rows], -1, -2)
                own: Any = fit.theta[slice(*channel.parameters)]
                read = np.moveaxis(np.asarray(channel.read(own, error)), -1, -2)
                columns = columns - channel.whitened_columns(fit.factors, read)
            if white.memory is not None:
                columns = np.asarray(innovations(columns, white.memory))
            columns = columns[:, :, : None if channel.compared else 0]
            parts.append(columns.reshape(len(columns), -1, count))
        return np.concatenate(parts, 1)

    @cached_property
    def _sensor_tangents(self) -> list[tuple[SensorAtFit, np.ndarray, np.ndarray]]:
        """Each channel's readings, their rows of the grid (slews, rows), how they follow the start.

        The last (slews, rows, components, 6): in sigmas per change of the start state.
        """
        estimate, found = self.estimate, []
        model, slews = estimate.model, np.arange(len(self.time))[:, None]
        telemetry = model.data.arrays.telemetry
        channels = zip(model.channels, telemetry.readings, estimate.white, strict=True)
        for channel, readings, white in channels:
            rows = np.asarray(telemetry.sample)[slews, np.asarray(readings.row)]
            fit = SensorAtFit(model.campaign, estimate.theta, readings, np.asarray(white.factors))
            moved = self.transition[slews, rows]
            by_start = channel.whitened_motion(fit, moved[:, :, :3], moved[:, :, 3:])
            found.append((fit, rows, by_start))
        return found

    @cached_property
    def _to_start(self) -> np.ndarray:
        """Change of the start state per angular impulse on the body, (slews, n, 6, 3)."""
        back = np.linalg.inv(self.transition)[..., 3:]
        return back @ self.inverse_inertia[:, None]

    def _starts(self, torque_B: np.ndarray) -> list[np.ndarray]:
        """Changes (n, 6, k) of each slew's start state that torques so far amount to."""
        changes = map(np.matmul, self._to_start, torque_B)
        middles = (0.5 * (change[1:] + change[:-1]) for change in changes)
        return [_integral(x, time) for x, time in zip(middles, self.time, strict=True)]


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
            noise = (x[6:] * data.scale.local[6:]).reshape(structure.wheels, structure.shapes)
            slew = without_tachometer_error(slew, telemetry.tachometer_shapes, noise)
        begin = start_of(structure, data.scale, reference, x)

        def path(y):
            start = begin._replace(
                attitude=quaternion.turned(begin.attitude, y[:3]), rate_B=begin.rate_B + y[3:]
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


def coefficient_columns(response: TorqueResponse, effect: StochasticEffect) -> np.ndarray:
    """Take the derivatives of the whitened residuals towards an effect's coefficients.

    `response`: of the fit; the effect need not be part of its model. Returns (slews, numbers, k):
    all channels one after the other; zero where the campaign does not see the effect.
    """
    model, grid = response.estimate.model, response.time.shape
    contexts, count = model.data.contexts, effect.coefficient_count(model.campaign)
    # Where tachometers drive the model, what the wheels are given moves nothing.
    torques = ("body_torque", "delivered_torque")[: 1 + (model.structure.drive == "commanded")]
    acting = tuple(hook for hook in torques if effect.acts(hook))
    sensors = [
        (channel, constants)
        for channel, constants in zip(model.channels, model.data.sensors, strict=True)
        if channel.compared and channel.stream.field and effect.acts(channel.hook)
    ]
    channels, constants = tuple(c for c, _ in sensors), tuple(x for _, x in sensors)
    motion = (response.attitude, response.rate_B, response.wheel_momentum)
    # Of padding: the last instant again.
    path = (repeated(x, contexts.time.shape[1]) for x in motion)
    states = np.zeros((*contexts.time.shape, 0))
    inputs = contexts, Trajectory(contexts.time, *path, states)  # type: ignore[call-arg]
    parts = [
        _unit_signals(effect, channels, acting, count, constants, *of_slew(k, inputs))
        for k in range(model.n_slews)
    ]
    hooks = [*(channel.hook for channel in channels), *acting]
    signals = dict(zip(hooks, of_all_slews(parts, grid[1:] * len(hooks)), strict=True))
    return response.changes(signals or {"body_torque": np.zeros((*grid, 3, count))})


def _along(axes_B: np.ndarray, of_wheels: np.ndarray) -> np.ndarray:
    """What the wheels have together (slews, n, 3, k), body axes."""
    return np.einsum("iw,snwk->snik", axes_B, of_wheels)


def _integral(pieces: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Integrals (..., n, i, k) of what has one value (..., n - 1, i, k) between instants."""
    sums = np.zeros((*time.shape, *pieces.shape[-2:]))
    steps = np.diff(time)[..., None, None]
    np.cumsum(pieces * steps, axis=-3, out=sums[..., 1:, :, :])
    return sums


@partial(KeptProgram, static=4)
def _unit_signals(
    effect: StochasticEffect,
    channels: tuple[Channel, ...],
    torques: tuple[str, ...],
    count: int,
    constants: tuple[Any, ...],
    contexts: SlewContext,
    path: Trajectory,
) -> tuple[Array, ...]:
    """What unit coefficients add to each reading, then to each torque (slews, n, components, k)."""
    nothing, still = jnp.zeros(3), jnp.zeros(count)

    def one(slew: SlewContext, motion: Trajectory) -> tuple[Array, ...]:
        def values(c: Array) -> tuple[Array, ...]:
            p, found = {"coefficients": c}, list[Array]()

            def torque(t: Array, q: Array, rate_B: Array, momentum: Array, states: Array) -> Array:
                # Without inertia and field: a random torque does not follow them.
                state = State(q, rate_B, momentum, states, jnp.eye(3), nothing, nothing)
                return effect.body_torque(p, slew, t, state)

            for channel, known in zip(channels, constants, strict=True):
                perfect = channel.sensed(known, still[:0], slew, motion)  # type: ignore[arg-type]
                read = channel.with_effect(effect, p, known, slew, motion, perfect)
                found.append(channel.gap(read, perfect))
            if "body_torque" in torques:
                found.append(jax.vmap(torque)(*motion[:-1]))
            if "delivered_torque" in torques:
                found.append(effect.delivered_torque(p, slew, slew.torque))
            return tuple(found)

        along = jax.vmap(lambda unit: jax.jvp(values, (still,), (unit,))[1], out_axes=-1)
        return along(jnp.eye(count))

    return jax.vmap(one)(contexts, path)
