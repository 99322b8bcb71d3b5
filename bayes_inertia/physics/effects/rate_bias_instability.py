"""The bias instability of a gyro: a bias that wanders about its mean with a correlation time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_inertia.physics.effects.rate_random_walk import RateNoise
from bayes_inertia.physics.effects.scales import sd_and_time
from bayes_inertia.physics.processes import Process


@dataclass(frozen=True)
class RateBiasInstability(RateNoise):
    """The rate bias of each axis and slew has a part that is a first-order Gauss-Markov process.

    Its covariance is sd^2 exp(-|t - t'| / time). A fit takes two slews as independent; where the
    process is weighed against other effects it goes on between slews. Flicker noise (BI of an Allan
    curve) has no finite state; the Gauss-Markov process is the usual stand-in for it.

    Parameters
    ----------
    median_sd, median_time : float or None, optional
        Medians of the priors [rad/s, s]; None takes what the campaign states, or else the noise of
        one reading, and a fifth of a slew.
    factor_sd : float, optional
        Sd of the logarithm of the sd. The time is known to a factor of 2 (sd 0.7).
    knots : int, optional
        On each axis, evenly over the slew. What the process does between them is noise of the
        readings, of the size that belongs to it, and is filtered out.

    References
    ----------
    IEEE Std 952-1997, annex B and C (bias instability, exponentially correlated noise).

    Examples
    --------
    >>> RateBiasInstability(knots=9).coefficient_count(None)
    27
    """

    name = "rate_bias_instability"
    signal_title = "wandering rate bias"
    median_sd: float | None = None
    median_time: float | None = None
    factor_sd: float = 1.5

    def parameters(self, campaign):
        sensor = campaign.gyro
        sd = self.median_sd or sensor.bias_instability or float(np.max(sensor.sigma))
        time = self.median_time or sensor.bias_instability_time
        return sd_and_time(campaign, "rad/s", sd, time, self.factor_sd)

    def reading_noise(self, p):
        return Process("rate", p["sd"], p["time"], self.knots)


@dataclass(frozen=True)
class RateRemainder(RateBiasInstability):
    """A rate error without a name: `rate_bias_instability` whose size is known to a factor of 90.

    For fits that stay honest although the model is incomplete: what errors of the rate sensor
    nobody thought of did is taken from the information on J and K.

    Parameters
    ----------
    median_sd, median_time, factor_sd, knots
        As `RateBiasInstability`.

    Examples
    --------
    >>> RateRemainder().factor_sd
    2.3
    """

    name = "rate_remainder"
    signal_title = "rate error without a name"
    factor_sd: float = 2.3
