"""Torques and rate errors in proportion to something known: how well each would explain a misfit.

Disturbances that no effect of the library describes still follow something as a rule, a driver: the
square of the body rate, the momentum of the wheels, the field, the time. Along any axes, they are
linear in a few numbers, whose evidence needs no simulation. They have no name; their use is to show
that a name would be an imitation.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from bayes_inertia.diagnosis.evidence import log_bayes_factor_of
from bayes_inertia.diagnosis.torque_response import TorqueResponse
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.maths import quaternion
from bayes_inertia.physics.effects.scales import torque_scale

CONSTANT = "constant in the body"
COMMAND = "commanded wheel torque"
CAMPAIGN_TIME = "time in the campaign"
# What effects of the library follow with the same freedom: constant_torque, wheel_torque_gain with
# wheel_misalignment, rate_bias and rate_bias_drift.
DRIVEN_BY_LIBRARY = (
    ("body torque", CONSTANT),
    ("body torque", COMMAND),
    ("rate sensor", CONSTANT),
    ("rate sensor", CAMPAIGN_TIME),
)
# Largest error of the rate sensor that is thought of, as a share of the typical rate.
_RATE_ERROR_SHARE = 0.1
_NEGLIGIBLE = 1e-9  # rms of a component, as a share of the largest


def drivers(response: TorqueResponse) -> dict[str, np.ndarray]:
    """List what a disturbance may be proportional to.

    Returns: {name: (slews, n, k) array} on the integration grid, in SI units.
    """
    campaign = response.estimate.model.campaign
    slews = response.estimate.model.data.arrays.slews
    rate_B, time = response.rate_B, response.time
    speed = np.linalg.norm(rate_B, axis=-1, keepdims=True)
    # From the middle: counted from an epoch it would not differ from a constant.
    since_middle = (
        time + np.array([s.start for s in campaign.slews])[:, None] - 0.5 * sum(campaign.span)
    )
    known = {
        CONSTANT: np.ones_like(speed),
        "body rate": rate_B,
        "square of the body rate": speed**2,
        "products of body rates": np.stack(
            [rate_B[..., i] * rate_B[..., j] for i in range(3) for j in range(i + 1)], -1
        ),
        "angular acceleration": _slope(rate_B, time),
        "time in the slew": time[..., None],
        CAMPAIGN_TIME: since_middle[..., None],
    }
    if campaign.wheels:
        known["wheel momentum"] = response.wheel_momentum
        known["square of the wheel momentum"] = response.wheel_momentum**2
        if campaign.has_commands:
            known[COMMAND] = np.asarray(slews.context.torque)
    if all(s.magnetic_field_N is not None for s in campaign.slews):
        known["magnetic field"] = np.asarray(
            quaternion.to_body(jnp.asarray(response.attitude), slews.environment.magnetic_field_N)
        )
    return known


def _slope(rate_B: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Angular acceleration (slews, n, 3); zero in padding."""
    step = np.diff(time, axis=1)[..., None]
    slope = np.divide(
        np.diff(rate_B, axis=1), step, out=np.zeros_like(rate_B[:, 1:]), where=step > 0.0
    )
    return np.concatenate([slope, slope[:, -1:]], axis=1)


def driven_evidence(response: TorqueResponse, fit: LinearisedFit) -> dict[tuple[str, str], float]:
    """Weigh each disturbance in proportion to a driver against nothing.

    Returns: {(source, driver): log evidence}. The source is "body torque" or "rate sensor". The
    disturbance has any axes.
    """
    campaign = response.estimate.model.campaign
    torque_size = torque_scale(campaign)
    rate_size = _RATE_ERROR_SHARE * campaign.scale_of_motion()[0]
    evidence = {}
    for name, values in drivers(response).items():
        rms = np.sqrt(np.mean(values**2, axis=(0, 1)))
        if not rms.max() > 0.0:
            continue
        # Component by component along each axis: unit values are one rms of the driver.
        moving = rms > _NEGLIGIBLE * rms.max()
        scaled = values[..., moving] / rms[moving]
        along = np.einsum("snk,ij->snikj", scaled, np.eye(3))
        along = along.reshape(*scaled.shape[:2], 3, -1)
        change = response.residual_change(torque_size * along)
        evidence["body torque", name] = _evidence(fit, change)
        error = response.reading_change("rate", rate_size * along)
        evidence["rate sensor", name] = _evidence(fit, error)
    return evidence


def _evidence(fit: LinearisedFit, columns: np.ndarray) -> float:
    """Log evidence for amplitudes of columns (slews, numbers, k) beyond all that is fitted."""
    imitated = fit.imitated(columns)
    matrix = np.einsum("snj,snk->jk", columns, columns, optimize=True) - imitated.T @ imitated
    powers, directions = np.linalg.eigh(matrix)
    return log_bayes_factor_of(fit.projected_gradient(columns, imitated) @ directions, powers)
