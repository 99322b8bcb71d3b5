"""A rate sensor whose scale factor depends on the rate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects.scales import rate_axes
from bayes_inertia.physics.parameters import Normal, vector


@dataclass(frozen=True)
class RateSensorNonlinearity(Effect):
    """Each sensor axis reads s + quadratic s^2 + cubic s^3 where it should read s.

    A quadratic term is a difference of scale factor between the two senses of rotation; a cubic
    one bends both ends.

    Parameters
    ----------
    sigma : float, optional
        Prior sd of each term's share of the reading at the campaign's largest rate; 0.003 is
        the linearity of a low-cost MEMS gyro over its range.

    Examples
    --------
    >>> RateSensorNonlinearity().sigma
    0.003
    """

    name: ClassVar[str] = "rate_sensor_nonlinearity"
    sigma: float = 0.003

    def parameters(self, campaign):
        full = max(
            float(np.max(np.abs(s.rate), where=campaign.valid_readings(s), initial=0.0))
            for s in campaign.slews
        )
        full = max(full, float(np.mean(campaign.gyro.sigma)))
        axes, second, third = rate_axes(campaign), self.sigma / full, self.sigma / full**2
        return (
            vector("quadratic", axes, unit="s/rad", prior=Normal(0.0, second)),
            vector("cubic", axes, unit="s^2/rad^2", prior=Normal(0.0, third)),
        )

    def looks_between_rows(self, campaign):
        return False

    def rate_output(self, p, slew, trajectory, rate_S):
        return rate_S + p["quadratic"] * rate_S**2 + p["cubic"] * rate_S**3
