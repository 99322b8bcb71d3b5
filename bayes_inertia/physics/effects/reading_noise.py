"""Readings whose error wanders: of a gyro, of tachometers, and of a star tracker."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from bayes_inertia.campaign.slew import fix_groups
from bayes_inertia.maths import quaternion
from bayes_inertia.physics.effects.scales import rate_axes, sd_and_time
from bayes_inertia.physics.parameters import LogNormal, scalar
from bayes_inertia.physics.random_basis import independent
from bayes_inertia.physics.stochastic_effect import Process, ReadingNoise, StochasticEffect


@dataclass(frozen=True)
class RateRandomWalk(ReadingNoise):
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

    name: ClassVar[str] = "rate_random_walk"
    signal_title: ClassVar[str] = "random walk of the rate bias"
    signal_quantity: ClassVar[str] = "rate error"
    signal_unit: ClassVar[str] = "rad/s"
    signal_components: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    median: float | None = None
    factor_sd: float = 1.5

    def parameters(self, campaign):
        median = self.median or campaign.gyro.rate_random_walk
        if median is None:
            sigma = float(np.max(campaign.gyro.sigma))
            median = sigma / np.sqrt(campaign.scale_of_motion()[1])
        return (scalar("density", unit="rad/s^1.5", prior=LogNormal(median, self.factor_sd)),)

    def components(self, campaign):
        return len(rate_axes(campaign))

    def reading_noise(self, p):
        return Process("rate", p["density"], knots=self.knots)

    def rate_output(self, p, slew, trajectory, rate_S):
        return rate_S + self.signal(p, slew, slew.time)


@dataclass(frozen=True)
class RateBiasInstability(ReadingNoise):
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

    name: ClassVar[str] = "rate_bias_instability"
    signal_title: ClassVar[str] = "wandering rate bias"
    signal_quantity: ClassVar[str] = "rate error"
    signal_unit: ClassVar[str] = "rad/s"
    signal_components: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    median_sd: float | None = None
    median_time: float | None = None
    factor_sd: float = 1.5

    def parameters(self, campaign):
        sensor = campaign.gyro
        sd = self.median_sd or sensor.bias_instability or float(np.max(sensor.sigma))
        time = self.median_time or sensor.bias_instability_time
        return sd_and_time(campaign, "rad/s", sd, time, self.factor_sd)

    def components(self, campaign):
        return len(rate_axes(campaign))

    def reading_noise(self, p):
        return Process("rate", p["sd"], p["time"], self.knots)

    def rate_output(self, p, slew, trajectory, rate_S):
        return rate_S + self.signal(p, slew, slew.time)


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

    name: ClassVar[str] = "rate_remainder"
    signal_title: ClassVar[str] = "rate error without a name"
    factor_sd: float = 2.3


@dataclass(frozen=True)
class RateBiasSlewDrift(StochasticEffect):
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

    name: ClassVar[str] = "rate_bias_slew_drift"
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

    def looks_between_rows(self, campaign):
        return False

    def rate_output(self, p, slew, trajectory, rate_S):
        return rate_S + (slew.time - slew.time[0])[:, None] * p["coefficients"]


@dataclass(frozen=True)
class TachometerNoiseWalk(ReadingNoise):
    """The error of each tachometer is a Wiener process, which goes on between slews.

    Over a time T the error changes by tachometer_noise_walk.density sqrt(T) (one sd). In each slew
    it has an offset, as large as the walk from the middle of the campaign to the slew makes it, and
    walks on from there. In the measured drive tachometers are the input and this effect does
    nothing.

    Parameters
    ----------
    median : float or None, optional
        Median of the density's prior [N m s^0.5]; None takes the walk that reaches the noise of one
        reading within a slew.
    factor_sd : float, optional
        Sd of the logarithm of the density.
    knots : int, optional
        On each wheel, evenly over the slew, with straight lines between.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> TachometerNoiseWalk().coefficient_count(small_campaign())
    51
    """

    name: ClassVar[str] = "tachometer_noise_walk"
    median: float | None = None
    factor_sd: float = 1.5

    def parameters(self, campaign):
        sigma = [wheel.momentum_sigma for wheel in campaign.wheels if wheel.momentum_sigma]
        if not sigma:
            return ()
        median = self.median or float(np.max(sigma)) / np.sqrt(campaign.scale_of_motion()[1])
        return (scalar("density", unit="N m s^0.5", prior=LogNormal(median, self.factor_sd)),)

    def components(self, campaign):
        return len(campaign.wheels) if self.parameters(campaign) else 0

    def reading_noise(self, p):
        return Process("momentum", p["density"], knots=self.knots)

    def momentum_output(self, p, slew, trajectory, momentum):
        return momentum + self.signal(p, slew, slew.time) if p["coefficients"].size else momentum


@dataclass(frozen=True)
class StarTrackerLowFrequency(StochasticEffect):
    """All fixes of a group are turned by one small rotation, each group by another.

    A group is a run of fixes without a gap: usually one before and one after each slew. The stars
    in view, their places in the catalogue, and the warmth of the baffle change from one attitude to
    the next and not within seconds. Each component of the rotation (body axes) is normal with sd
    star_tracker_low_frequency.sd.

    Parameters
    ----------
    median : float or None, optional
        Median of the prior of the sd [rad]; None takes what the campaign states, or else the
        tracker's sigma_cross.
    factor_sd : float, optional
        Sd of the logarithm of the sd.
    known : bool, optional
        Whether the sd is what the campaign states, and nothing is estimated.

    References
    ----------
    ECSS-E-ST-60-20C, section 3 (low frequency error of star sensors).

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> StarTrackerLowFrequency().coefficient_count(small_campaign())
    3
    """

    name: ClassVar[str] = "star_tracker_low_frequency"
    median: float | None = None
    factor_sd: float = 1.5
    known: bool = False

    def parameters(self, campaign):
        if self.known:
            return ()
        tracker = campaign.star_tracker
        sigma = (tracker.low_frequency_sigma or tracker.sigma_cross) if tracker else 2.5e-5
        prior = LogNormal(self.median or sigma, self.factor_sd)
        return (scalar("sd", unit="rad", prior=prior),)

    def coefficient_count(self, campaign):
        return 3 * max(int(fix_groups(slew).max(initial=0)) + 1 for slew in campaign.slews)

    def coefficient_root(self, p, slew, count):
        return independent(jnp.asarray(self.median) if self.known else p["sd"], count)

    def looks_between_rows(self, campaign):
        return False

    def attitude_output(self, p, slew, trajectory, attitude):
        if slew.fix_group is None:
            return attitude
        offsets = p["coefficients"].reshape(-1, 3)
        return quaternion.turned(attitude, offsets[slew.fix_group])
