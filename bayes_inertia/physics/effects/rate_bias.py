"""Biases of a rate sensor: larger than stated, drifting in the campaign, or in each slew."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_inertia.physics.effect import RowByRow
from bayes_inertia.physics.effects.scales import gyro_of, rate_axes
from bayes_inertia.physics.parameters import LogNormal, Normal, scalar, vector
from bayes_inertia.physics.random_basis import independent
from bayes_inertia.physics.stochastic_effect import StochasticEffect


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
