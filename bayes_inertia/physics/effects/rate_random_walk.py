"""The rate random walk of a gyro: its bias wanders, in every slew anew."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_inertia.physics.effects.scales import rate_axes
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
