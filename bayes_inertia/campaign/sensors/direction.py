"""Vectors seen in body axes: of a Sun sensor, magnetometer or horizon sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import DirectionSensor
from bayes_inertia.campaign.sensors.sensor_stream import SensorStream

__all__ = ["DirectionSensor", "DirectionStream"]


@dataclass(frozen=True)
class DirectionStream(SensorStream):
    """Three components in body axes; a direction needs no length."""

    sensor = title = "direction sensor"
    unit = ""
    written = ("direction", {}, ("x", "y", "z"))

    def components(self, campaign: Campaign) -> tuple[str, ...]:
        """Body axes of a field; of a direction, two axes across it."""
        is_field = self.hardware(campaign).is_field
        return ("x", "y", "z") if is_field else ("across 1", "across 2")

    def sigma(self, campaign: Campaign) -> Sequence[float | None]:
        """Noise of each column [T], or of a unit vector [rad]."""
        return self.hardware(campaign).sigma

    def louder(self, campaign: Campaign, factor: float) -> Campaign:
        """The campaign with another noise of this sensor."""
        sensor = self.hardware(campaign)
        sigma = tuple(factor * sigma for sigma in sensor.sigma)
        return self.with_hardware(campaign, replace(sensor, sigma=sigma))
