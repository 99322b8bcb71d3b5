"""The rate sensor's readings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.schema import to_si
from bayes_inertia.campaign.sensors.sensor_stream import SensorStream, refuse_empty_columns
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.faults.limits import LIMITS
from bayes_inertia.faults.saturated import in_range
from bayes_inertia.tables.table import Table


@dataclass(frozen=True)
class RateStream(SensorStream):
    """Angular rate about the axes of a rate sensor."""

    sensor = title = "rate sensor"
    unit = "rad/s"
    keys = ("rate",)
    first = "rate_sensor"
    may_be_correlated = True
    written = ("rate", {"unit": "rad/s"}, ("wx_radps", "wy_radps", "wz_radps"))

    def read(self, table: Table, entry: Any, spin_inertias: np.ndarray) -> np.ndarray | None:
        """Each axis has its own column."""
        refuse_empty_columns(table, entry.names)
        return to_si(table.stack(entry.names), "rate", entry.unit)

    def valid(self, campaign: Campaign, slew: Slew) -> np.ndarray:
        """Those inside the sensor's range."""
        return in_range(self.values(slew), self.hardware(campaign).range)

    def unattainable(self, campaign: Campaign) -> float:
        """The last number below what no spacecraft turns at."""
        return float(np.nextafter(LIMITS.fastest_rate, 0.0))

    def components(self, campaign: Campaign) -> tuple[str, ...]:
        """The sensor's axes."""
        sensor = self.hardware(campaign)
        return tuple(f"axis {i + 1}" for i in range(len(sensor.axes) if sensor else 3))

    def sigma(self, campaign: Campaign) -> Sequence[float | None]:
        """White noise of each axis [rad/s]; none without rate sensor."""
        sensor = self.hardware(campaign)
        return sensor.sigma if sensor else ()


RATE = RateStream("rate", "rate")
