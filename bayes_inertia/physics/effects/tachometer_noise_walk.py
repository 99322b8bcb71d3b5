"""A random walk of the tachometers' error: wheel momentum that is read wrong, slowly otherwise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.physics.effects.scales import sd_and_time
from bayes_inertia.physics.parameters import LogNormal, Parameter, scalar
from bayes_inertia.physics.processes import Process
from bayes_inertia.physics.stochastic_effect import ReadingNoise


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

    name = "tachometer_noise_walk"
    median: float | None = None
    factor_sd: float = 1.5

    def parameters(self, campaign):
        sigma = [wheel.momentum_sigma for wheel in campaign.wheels if wheel.momentum_sigma]
        return self._beside(float(np.max(sigma)), campaign) if sigma else ()

    def _beside(self, sigma: float, campaign: Campaign) -> tuple[Parameter, ...]:
        """The parameters beside the largest noise of one reading [N m s]."""
        median = self.median or sigma / np.sqrt(campaign.scale_of_motion()[1])
        return (scalar("density", unit="N m s^0.5", prior=LogNormal(median, self.factor_sd)),)

    def components(self, campaign):
        return len(campaign.wheels) if self.parameters(campaign) else 0

    def reading_noise(self, p):
        return Process("momentum", p["density"], knots=self.knots)

    def momentum_output(self, p, slew, trajectory, momentum):
        return momentum + self.signal(p, slew, slew.time) if p["coefficients"].size else momentum


@dataclass(frozen=True)
class TachometerRemainder(TachometerNoiseWalk):
    """An error of the tachometers without a name, with covariance sd^2 exp(-|t - t'| / time).

    A diagnosis fits it along where a shape without a name explains the data best there: no torque
    and no error of the rates can make the readings of the wheels wrong. Its size is known to a
    factor of 90, its time to a factor of 2 about a fifth of a slew.

    Parameters
    ----------
    median : float or None, optional
        Median of the sd's prior [N m s]; None takes the noise of one reading.
    factor_sd, knots
        As `TachometerNoiseWalk`.

    Examples
    --------
    >>> TachometerRemainder().factor_sd
    2.3
    """

    name = "tachometer_remainder"
    signal_title = "tachometer error without a name"
    factor_sd: float = 2.3

    def _beside(self, sigma: float, campaign: Campaign) -> tuple[Parameter, ...]:
        return sd_and_time(campaign, "N m s", self.median or sigma, None, self.factor_sd)

    def reading_noise(self, p):
        return Process("momentum", p["sd"], p["time"], self.knots)
