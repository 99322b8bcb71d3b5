"""The wheels' tachometers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.sensors.sensor_stream import SensorStream


@dataclass(frozen=True)
class MomentumStream(SensorStream):
    """Momentum of each wheel relative to the body, by its tachometer."""

    sensor = "tachometers"
    unit = "N m s"

    def sigma(self, campaign: Campaign) -> Sequence[float | None]:
        """Noise of each wheel's reading [N m s], None without tachometer."""
        return [wheel.momentum_sigma for wheel in campaign.wheels]

    def louder(self, campaign: Campaign, factor: float) -> Campaign:
        """The campaign with another noise of its tachometers."""
        wheels = tuple(
            replace(w, momentum_sigma=w.momentum_sigma and factor * w.momentum_sigma)
            for w in campaign.wheels
        )
        return replace(campaign, wheels=wheels)


MOMENTUM = MomentumStream("momentum", "wheel_momentum")
