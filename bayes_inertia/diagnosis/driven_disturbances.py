"""Torques and rate errors in proportion to something known: how well each would explain what a fit leaves.

Disturbances that no effect of the library describes still follow something as a rule: the square of the body rate, the
momentum of the wheels, the field, the time. Along any axes, they are linear in a few numbers, whose evidence
needs no simulation. They have no name; their use is to show that a name would be an imitation.
"""

from __future__ import annotations

import numpy as np

from bayes_inertia.diagnosis.evidence import log_bayes_factor_of
from bayes_inertia.diagnosis.torque_response import TorqueResponse
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.maths import quaternion
from bayes_inertia.physics.effects.scales import torque_scale

CONSTANT = "constant in the body"
COMMAND = "commanded wheel torque"
# What effects of the library follow with the same freedom: constant_torque, wheel_torque_gain with wheel_misalignment.
NAMED = (("body torque", CONSTANT), ("body torque", COMMAND))
# Largest error of the rate sensor that is thought of, as a share of the typical rate.
_SHARE = 0.1


def drivers(response: TorqueResponse) -> dict[str, np.ndarray]:
    """What a disturbance may be proportional to: {name: (slews, n, k)} on the integration grid, in SI units."""
    at, rate, time = response.at, response.rate_B, response.time
    campaign, slews = at.model.campaign, at.model.data.arrays.slews
    speed = np.linalg.norm(rate, axis=-1, keepdims=True)
    step = np.diff(time, axis=1)[..., None]
    slope = np.divide(np.diff(rate, axis=1), step, out=np.zeros_like(rate[:, 1:]), where=step > 0.0)
    known = {
        CONSTANT: np.ones_like(speed),
        "body rate": rate,
        "square of the body rate": speed**2,
        "products of body rates": np.stack(
            [rate[..., i] * rate[..., j] for i in range(3) for j in range(i + 1)], -1
        ),
        "angular acceleration": np.concatenate([slope, slope[:, -1:]], axis=1),
        "time in the slew": time[..., None],
        # From the middle: on the clock of an epoch it would not differ from a constant.
        "time in the campaign": (
            time + np.array([s.start for s in campaign.slews])[:, None] - 0.5 * sum(campaign.span)
        )[..., None],
    }
    if campaign.wheels:
        known["wheel momentum"] = response.wheel_momentum
        known["square of the wheel momentum"] = response.wheel_momentum**2
        if campaign.has_commands:
            known[COMMAND] = np.asarray(slews.context.torque)
    if all(s.magnetic_field_N is not None for s in campaign.slews):
        known["magnetic field"] = np.asarray(
            quaternion.to_body(response.attitude, slews.magnetic_field_N)
        )
    return known


def log_evidence(
    at: Estimate, response: TorqueResponse, fit: LinearisedFit
) -> dict[tuple[str, str], float]:
    """Log evidence for each disturbance in proportion to a driver, against nothing, at an estimate: {(source, driver): it}.

    The source is "body torque" or "rate sensor"; the disturbance has any axes.

    Parameters
    ----------
    response, fit : `torque_response(at)` and `at.linearised()`.
    """
    torque, rate = torque_scale(at.model.campaign), _SHARE * at.model.campaign.scale_of_motion()[0]
    found = {}
    for name, values in drivers(response).items():
        size = np.sqrt(np.mean(values**2, axis=(0, 1)))
        if not size.max() > 0.0:
            continue
        # Component by component along each axis: unit values are one rms of the driver.
        seen = values[..., size > 1e-9 * size.max()] / size[size > 1e-9 * size.max()]
        along = np.einsum("snk,ij->snikj", seen, np.eye(3)).reshape(*seen.shape[:2], 3, -1)
        change = response.residual_change(torque * along)
        found["body torque", name] = _evidence(
            fit, np.concatenate([np.asarray(c) for c in change], axis=1)
        )
        found["rate sensor", name] = _evidence(fit, response.reading_change(rate * along))
    return found


def _evidence(fit: LinearisedFit, columns: np.ndarray) -> float:
    """Log evidence for amplitudes of columns (slews, numbers, k) beyond all that is fitted."""
    taken = fit.imitated(columns)
    powers, directions = np.linalg.eigh(
        np.einsum("snj,snk->jk", columns, columns, optimize=True) - taken.T @ taken
    )
    return log_bayes_factor_of(fit.pull(columns, taken) @ directions, powers)
