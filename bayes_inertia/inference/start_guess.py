"""Where the optimizer begins: a wheel momentum that nothing measures, from the motion.

Without external torque the total momentum L = J w + A (h + U), with U the integral of the wheel torques, is constant in inertial space. Seen
from the body, J (w(t) - w(0)) + A U(t) + integral of w x (J w + A U) = -(integral of w) x A h: linear in the momentum h at the
beginning. From there the simulation is near the data; from zero momentum most descents lose their way.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from scipy import integrate

from bayes_inertia.maths import inertia_tensor
from bayes_inertia.physics.forward_model import Model


def begin(model: Model, theta: np.ndarray) -> np.ndarray:
    """Whitened nuisances (slews, n_local) to begin from at `theta` (d,): zero, but for wheel momenta that are not measured."""
    local = np.zeros((model.n_slews, model.structure.n_local))
    if (
        model.structure.drive == "commanded"
        and model.campaign.wheels
        and not model.campaign.has_tachometers
    ):
        scale, J = (
            np.asarray(model.data.scale.local[6:]),
            np.array(inertia_tensor.tensor(jnp.asarray(theta[:6]))),
        )
        for s in range(model.n_slews):
            local[s, 6:] = _momentum(model, J, theta[6:9], s, scale)
    return local


def _momentum(
    model: Model, J: np.ndarray, scale_factor: np.ndarray, s: int, scale: np.ndarray
) -> np.ndarray:
    """Momentum of the wheels (wheels,) at the beginning of slew s beyond the reference, in prior sd: least squares with that prior."""
    campaign, slew = model.campaign, model.campaign.slews[s]
    sensor, axes = campaign.rate_sensor, campaign.wheel_axes_B
    rows, readings = slew.complete_rates(campaign.valid_readings(slew))
    if len(rows) < 2:
        return np.zeros(len(scale))
    time = slew.time[rows]
    rate = np.linalg.solve(sensor.axes, (scale_factor * readings - np.asarray(sensor.bias)).T).T
    taken_up = integrate.cumulative_trapezoid(slew.wheel_torque, slew.time, axis=0, initial=0.0)[
        rows
    ]
    known = (
        rate @ J + (taken_up + np.asarray(model.data.arrays.reference.wheel_momentum)[s]) @ axes.T
    )
    left = (
        known
        - known[0]
        + integrate.cumulative_trapezoid(np.cross(rate, known), time, axis=0, initial=0.0)
    )
    turned = integrate.cumulative_trapezoid(rate, time, axis=0, initial=0.0)
    columns = np.cross(turned[:, :, None], (axes * scale)[None], axis=1)
    # What no momentum explains comes from errors of J and K, alike over the slew: all its rows count as one. Momentum along the axis of
    # the slew, which leaves hardly a trace, is then left to the prior.
    columns, left = columns.reshape(-1, len(scale)), left.ravel()
    scatter = left - columns @ np.linalg.lstsq(columns, left, rcond=1e-6)[0]
    weight = float(np.sum(scatter**2)) + 1e-300
    return -np.linalg.solve(columns.T @ columns + weight * np.eye(len(scale)), columns.T @ left)
