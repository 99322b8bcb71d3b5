"""What any small body torque would do to the residuals, to first order, without simulating it.

A torque at time t' moves the state by J^-1 tau dt'; carried back to the start of the slew by the
transition matrix X of the perturbed motion it is a change of the start state, whose effect on all
later telemetry is known. With c(t) = integral of X(t')^-1 (0, J^-1 tau) dt' the attitude and rate
change by X(t) c(t). One set of six tangents a slew serves all torque histories.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.inference.compiled_programs import forget_surplus
from bayes_inertia.inference.each_slew import of_all_slews, of_slew
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.noise_filter import innovations
from bayes_inertia.maths import inertia_tensor, quaternion
from bayes_inertia.maths.kept_programs import KeptProgram
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.channels.channel import Channel, SensorAtFit
from bayes_inertia.physics.model_data import Data
from bayes_inertia.physics.prediction import Structure, acting_in, inertia_in, start_of
from bayes_inertia.physics.simulator import simulate_slew
from bayes_inertia.physics.slew_input import without_slow_error


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
    inverse_inertia : (3, 3) array
        From body momentum to body rate [1/(kg m^2)].
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
        kick[:, :, 3:] = np.einsum("ij,snjk->snik", self.inverse_inertia, torque_B)
        rate_of_change = np.linalg.solve(self.transition, kick)
        step = np.diff(self.time, axis=1)[..., None, None]
        middle = 0.5 * (rate_of_change[:, 1:] + rate_of_change[:, :-1]) * step
        carried = np.concatenate([np.zeros_like(kick[:, :1]), np.cumsum(middle, axis=1)], axis=1)
        moved = self.transition @ carried
        return self._whitened(moved[:, :, :3], moved[:, :, 3:])

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

    def _whitened(self, turn: np.ndarray, rate_B: np.ndarray) -> np.ndarray:
        """Changes of attitude and rate (slews, n, 3, k) as changes of the whitened residuals."""
        return -self._of_channels(
            lambda channel, fit, rows: channel.whitened_motion(fit, turn[rows], rate_B[rows])
        )

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
    J = inertia_tensor.tensor(jnp.asarray(estimate.theta[:6]))
    axes = jnp.asarray(model.campaign.wheel_axes_B)
    spin = jnp.asarray(model.campaign.spin_inertias)
    if model.structure.includes_wheel_spin:
        J = inertia_tensor.without_wheel_spin(J, axes, spin)
    if model.structure.drive == "measured":
        J = inertia_tensor.with_wheel_spin(J, axes, spin)
    inverse = np.linalg.inv(np.array(J))
    return TorqueResponse(estimate, time, attitude, rate_B, momentum, transition, inverse)


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
                attitude=quaternion.multiply(begin.attitude, quaternion.exp(y[:3])),
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
