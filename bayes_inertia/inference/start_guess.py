"""Where the optimizer begins: a wheel momentum that nothing measures, from the motion.

Without external torque the total momentum L = J w + A (h + U), with U the integral of the wheel
torques, is constant in inertial space. Seen from the body, J (w(t) - w(0)) + A U(t) + integral of
w x (J w + A U) = -(integral of w) x A h: linear in the momentum h at the beginning. From there
the simulation is near the data; from zero momentum most descents lose their way.
"""

from __future__ import annotations

import numpy as np
from scipy import integrate

from bayes_inertia.campaign.hardware import body_rates
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.physics.forward_model import Model


def guess_nuisances(model: Model, theta: np.ndarray) -> np.ndarray:
    """Nuisances to begin from.

    `theta` (d,). Returns (slews, n_local): in prior sd: zero, but for wheel momenta that are not
    measured.
    """
    local = np.zeros((model.n_slews, model.structure.n_local))
    campaign = model.campaign
    unmeasured = campaign.wheels and not campaign.has_tachometers
    if model.structure.drive == "commanded" and unmeasured:
        prior_sd = np.asarray(model.data.scale.local[6:])
        J = inertia_tensor.tensor(theta[:6])
        for s in range(model.n_slews):
            local[s, 6 : 6 + len(prior_sd)] = _start_momentum(model, J, theta[6:9], s, prior_sd)
    return local


def _start_momentum(
    model: Model, J: np.ndarray, scale_factor: np.ndarray, s: int, prior_sd: np.ndarray
) -> np.ndarray:
    """Wheel momentum (wheels,) at the start of slew s beyond the reference, in prior sd."""
    campaign, slew = model.campaign, model.campaign.slews[s]
    sensor, axes = campaign.rate_sensor, campaign.wheel_axes_B
    rows, readings = slew.complete_rates(campaign.valid_readings(slew))
    if len(rows) < 2:
        return np.zeros(len(prior_sd))

    def integrated(values: np.ndarray, time: np.ndarray) -> np.ndarray:
        return integrate.cumulative_trapezoid(values, time, axis=0, initial=0.0)

    time = slew.time[rows]
    rate = body_rates(sensor, readings, scale_factor)
    taken_up = integrated(np.asarray(slew.wheel_torque), slew.time)[rows]
    reference = np.asarray(model.data.arrays.reference.wheel_momentum)[s]
    known = rate @ J + (taken_up + reference) @ axes.T
    unexplained = known - known[0] + integrated(np.cross(rate, known), time)
    turned = integrated(rate, time)
    columns = np.cross(turned[:, :, None], (axes * prior_sd)[None], axis=1)
    # What no momentum explains comes from errors of J and K, alike over the slew: all its rows
    # count as one. Momentum along the axis of the slew, which leaves hardly a trace, is then left
    # to the prior.
    columns, unexplained = columns.reshape(-1, len(prior_sd)), unexplained.ravel()
    scatter = unexplained - columns @ np.linalg.lstsq(columns, unexplained, rcond=1e-6)[0]
    weight = float(np.sum(scatter**2)) + 1e-300
    normal = columns.T @ columns + weight * np.eye(len(prior_sd))
    return -np.linalg.solve(normal, columns.T @ unexplained)
