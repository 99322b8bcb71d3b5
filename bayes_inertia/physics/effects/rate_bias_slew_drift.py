"""A rate bias that drifts at another constant rate in each slew."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_inertia.physics.effect import RowByRow
from bayes_inertia.physics.effects.scales import rate_axes
from bayes_inertia.physics.parameters import LogNormal, scalar
from bayes_inertia.physics.random_basis import independent
from bayes_inertia.physics.stochastic_effect import StochasticEffect


@dataclass(frozen=True)
class RateBiasSlewDrift(RowByRow, StochasticEffect):
    """The rate bias begins each slew at its mean and drifts from there, in each slew otherwise.

    A gyro that warms up while it turns; Ferguson names it as the worry of the method. The drift of
    each axis and slew is normal with sd rate_bias_slew_drift.sd.

    Parameters
    ----------
    median : float or None, optional
        Median of the prior of the sd [rad/s^2]; None takes the drift that reaches the noise of one
        reading within a slew.
    factor_sd : float, optional
        Sd of the logarithm of the sd.

    Examples
    --------
    >>> RateBiasSlewDrift().coefficient_count(None)
    3
    """

    name = "rate_bias_slew_drift"
    median: float | None = None
    factor_sd: float = 1.5

    def parameters(self, campaign):
        sigma, duration = np.max(campaign.gyro.sigma), campaign.scale_of_motion()[1]
        median = self.median or float(sigma) / duration
        return (scalar("sd", unit="rad/s^2", prior=LogNormal(median, self.factor_sd)),)

    def coefficient_count(self, campaign):
        return len(rate_axes(campaign))

    def coefficient_root(self, p, slew, count):
        return independent(p["sd"], count)

    def rate_output(self, p, slew, trajectory, rate_S):
        return rate_S + (slew.time - slew.time[0])[:, None] * p["coefficients"]
