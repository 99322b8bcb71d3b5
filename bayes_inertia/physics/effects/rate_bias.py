"""A rate bias larger than the campaign file allows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_inertia.physics.effect import RowByRow
from bayes_inertia.physics.effects.scales import gyro_of, rate_axes
from bayes_inertia.physics.parameters import Normal, vector


@dataclass(frozen=True)
class RateBias(RowByRow):
    """A constant bias of the rate sensor beyond the prior that the campaign file states.

    The sensor reads C_rate w + b + bias before its scale factors.

    A small bias within that prior is always fitted as a nuisance; this one is for a sensor
    whose bias moved after calibration (turn-on to turn-on shifts of MEMS and fibre-optic gyros
    are several times the in-run figure).

    Parameters
    ----------
    sigma : float or None, optional
        Prior sd [rad/s]; None takes ten times the largest `bias_sigma` of the campaign.

    Examples
    --------
    >>> RateBias(sigma=1e-5).parameters(None)[0].names
    ('bias_x', 'bias_y', 'bias_z')
    """

    name = "rate_bias"
    kind = "bias"
    sigma: float | None = None

    def parameters(self, campaign):
        sigma = self.sigma
        if sigma is None:
            sigma = 10.0 * float(np.max(gyro_of(campaign, self.device).bias_sigma))
        axes = rate_axes(campaign, self.device)
        return (vector("bias", axes, unit="rad/s", prior=Normal(0.0, sigma)),)

    def rate_output(self, p, slew, trajectory, rate_S):
        return rate_S + p["bias"]
