"""A rate bias that drifts during the campaign."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_inertia.physics.effect import RowByRow
from bayes_inertia.physics.effects.scales import gyro_of, rate_axes
from bayes_inertia.physics.parameters import Normal, vector


@dataclass(frozen=True)
class RateBiasDrift(RowByRow):
    """The rate bias changes linearly in CAMPAIGN time (warming up, ageing).

    It passes through zero at the campaign's middle.

    Counting from the middle keeps the drift apart from the mean bias, which is a nuisance of
    its own.

    Parameters
    ----------
    sigma : float or None, optional
        Prior sd [rad/s^2]; None lets the bias move ten times the largest `bias_sigma` of the
        campaign between its middle and its end.

    Examples
    --------
    >>> RateBiasDrift(sigma=1e-8).parameters(None)[0].unit
    'rad/s^2'
    """

    name = "rate_bias_drift"
    kind = "bias_drift"
    sigma: float | None = None

    def parameters(self, campaign):
        sigma = self.sigma
        if sigma is None:
            first, last = campaign.span
            bias_sigma = gyro_of(campaign, self.device).bias_sigma
            sigma = 20.0 * float(np.max(bias_sigma)) / (last - first)
        axes = rate_axes(campaign, self.device)
        return (vector("drift", axes, unit="rad/s^2", prior=Normal(0.0, sigma)),)

    def rate_output(self, p, slew, trajectory, rate_S):
        return rate_S + (slew.start + slew.time - slew.middle)[:, None] * p["drift"]
