"""A rate sensor whose scale factor depends on the rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_inertia.campaign.sensors import stream_of_device
from bayes_inertia.physics.effect import RowByRow
from bayes_inertia.physics.effects.scales import gyro_of, rate_axes
from bayes_inertia.physics.parameters import Normal, vector


@dataclass(frozen=True)
class RateSensorNonlinearity(RowByRow):
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

    name = "rate_sensor_nonlinearity"
    kind = "nonlinearity"
    sigma: float = 0.003

    def parameters(self, campaign):
        stream = stream_of_device(self.device, campaign)
        full = max(
            float(np.max(np.abs(stream.values(s)), where=stream.valid(campaign, s), initial=0.0))
            for s in campaign.slews
            if stream.of(s) is not None
        )
        full = max(full, float(np.mean(gyro_of(campaign, self.device).sigma)))
        axes = rate_axes(campaign, self.device)
        second, third = self.sigma / full, self.sigma / full**2
        return (
            vector("quadratic", axes, unit="s/rad", prior=Normal(0.0, second)),
            vector("cubic", axes, unit="s^2/rad^2", prior=Normal(0.0, third)),
        )

    def rate_output(self, p, slew, trajectory, rate_S):
        return rate_S + p["quadratic"] * rate_S**2 + p["cubic"] * rate_S**3
