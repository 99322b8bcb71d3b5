"""A random walk of the tachometers' error: wheel momentum that is read wrong, slowly otherwise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bayes_inertia.physics.parameters import LogNormal, scalar
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
