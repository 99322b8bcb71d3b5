"""The wheels' tachometers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.format_2 import WheelSpeed
from bayes_inertia.campaign.hardware import unattainable
from bayes_inertia.campaign.schema import to_si
from bayes_inertia.campaign.sensors.sensor_stream import SensorStream, refuse_empty_columns
from bayes_inertia.tables.table import Table


@dataclass(frozen=True)
class MomentumStream(SensorStream):
    """Momentum of each wheel relative to the body, by its tachometer."""

    sensor = "tachometers"
    title = "wheel momentum"
    unit = "N m s"
    keys = ("wheel_momentum", "wheel_speed")
    written = ("wheel_momentum", {"unit": "N m s", "relative_to": "body"}, "h{}_Nms")

    def read(self, table: Table, entry: Any, spin_inertias: np.ndarray) -> np.ndarray | None:
        """Speeds become momentum by the spin inertias."""
        refuse_empty_columns(table, entry.names)
        values = table.stack(entry.names)
        if isinstance(entry, WheelSpeed):
            return to_si(values, "wheel_speed", entry.unit) * spin_inertias
        return to_si(values, "wheel_momentum", entry.unit)

    def unattainable(self, campaign: Campaign) -> np.ndarray:
        """Far beyond each wheel's limit, or what no wheel can hold."""
        return np.array([unattainable(wheel, "momentum") for wheel in campaign.wheels])

    def hardware(self, campaign: Campaign) -> None:
        """None: tachometers are described by their wheels."""

    def components(self, campaign: Campaign) -> tuple[str, ...]:
        """The wheels."""
        return tuple(wheel.name for wheel in campaign.wheels)

    def sigma(self, campaign: Campaign) -> Sequence[float | None]:
        """Noise of each wheel's reading [N m s], None without tachometer."""
        return [wheel.momentum_sigma for wheel in campaign.wheels]

    def louder(self, campaign: Campaign, factor: float) -> Campaign:
        """The campaign with another noise of its tachometers."""
        stated = [(wheel, wheel.momentum_sigma) for wheel in campaign.wheels]
        wheels = tuple(replace(w, momentum_sigma=s and factor * s) for w, s in stated)
        return replace(campaign, wheels=wheels)


MOMENTUM = MomentumStream("momentum", "wheel_momentum")
