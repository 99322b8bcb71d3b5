"""A gyro bias that wanders: a random walk, or about its mean with a correlation time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_inertia.physics.effects.scales import rate_axes, sd_and_time
from bayes_inertia.physics.parameters import LogNormal, scalar
from bayes_inertia.physics.processes import Process
from bayes_inertia.physics.stochastic_effect import ReadingNoise


@dataclass(frozen=True)
class RateNoise(ReadingNoise):
    """Base of processes that each axis of the first rate sensor has."""

    signal_quantity = "rate error"
    signal_unit = "rad/s"
    signal_components = ("x", "y", "z")

    def components(self, campaign):
        return len(rate_axes(campaign))

    def rate_output(self, p, slew, trajectory, rate_S):
        return rate_S + self.signal(p, slew, slew.time)


@dataclass(frozen=True)
class RateRandomWalk(RateNoise):
    """The rate bias is a Wiener process: white noise of its derivative (Farrenkopf 1978, RRW).

    Over a time T the bias of each axis changes by rate_random_walk.density sqrt(T) (one sd). In
    each slew it has an offset, as large as the walk from the middle of the campaign to the slew
    makes it, and walks on from there. A fit takes the offsets of two slews as independent; where
    the walk is weighed against other effects it goes on between slews. Angle random walk (ARW) is
    the white noise that the campaign states: sigma = ARW / sqrt(step).

    Parameters
    ----------
    median : float or None, optional
        Median of the density's prior [rad/s^1.5]; None takes what the campaign states, or else the
        walk that reaches the noise of one reading within a slew.
    factor_sd : float, optional
        Sd of the logarithm of the density: 1.5 allows a factor of 20 either way.
    knots : int, optional
        On each axis, evenly over the slew. What the walk does between them is noise of the
        readings, of the size that belongs to it, and is filtered out.
    prior_scale : float, optional
        Of every effect; nothing here, because the prior is log-normal.
    device : str, optional
        As of `Effect`; nothing here.

    References
    ----------
    R. L. Farrenkopf, "Analytic Steady-State Accuracy Solutions for Two Common Spacecraft Attitude
    Estimators", J. Guidance and Control 1(4), 1978; IEEE Std 952-1997, annex C.

    Examples
    --------
    >>> RateRandomWalk().coefficient_count(None)
    51
    """

    name = "rate_random_walk"
    signal_title = "random walk of the rate bias"
    median: float | None = None
    factor_sd: float = 1.5

    def parameters(self, campaign):
        median = self.median or campaign.gyro.rate_random_walk
        if median is None:
            sigma = float(np.max(campaign.gyro.sigma))
            median = sigma / np.sqrt(campaign.scale_of_motion()[1])
        return (scalar("density", unit="rad/s^1.5", prior=LogNormal(median, self.factor_sd)),)

    def reading_noise(self, p):
        return Process("rate", p["density"], knots=self.knots)


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
