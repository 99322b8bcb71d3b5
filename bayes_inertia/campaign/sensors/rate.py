"""The rate sensor's readings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import CorrelatedNoise
from bayes_inertia.campaign.sensors.sensor_stream import SensorStream


@dataclass(frozen=True)
class RateStream(SensorStream):
    """Angular rate about the three axes of a rate sensor."""

    sensor = "rate sensor"
    unit = "rad/s"

    def sigma(self, campaign: Campaign) -> Sequence[float | None]:
        """White noise of each axis [rad/s]."""
        return campaign.rate_sensor.sigma

    def correlated(self, campaign: Campaign) -> CorrelatedNoise | None:
        """As a diagnosis measured it."""
        return campaign.rate_sensor.correlated_noise

    def louder(self, campaign: Campaign, factor: float) -> Campaign:
        """The campaign with another noise of the rate sensor."""
        x, y, z = (factor * sigma for sigma in campaign.rate_sensor.sigma)
        return replace(campaign, rate_sensor=replace(campaign.rate_sensor, sigma=(x, y, z)))


RATE = RateStream("rate", "rate")
