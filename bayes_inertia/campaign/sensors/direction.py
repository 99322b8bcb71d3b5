"""Vectors seen in body axes: of a Sun sensor, magnetometer or horizon sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.schema import to_si
from bayes_inertia.campaign.sensors.sensor_stream import SensorStream, refuse_empty_columns
from bayes_inertia.tables.table import Table


@dataclass(frozen=True)
class DirectionStream(SensorStream):
    """Three components in body axes; a direction needs no length."""

    sensor = title = "direction sensor"
    unit = ""
    written = ("direction", {}, ("x", "y", "z"))

    def read(self, table: Table, entry: Any, spin_inertias: np.ndarray) -> np.ndarray | None:
        """Fields in tesla, directions as they are; a row lacks all three where it lacks one."""
        refuse_empty_columns(table, entry.names)
        values = table.stack(entry.names)
        values = np.where(np.isnan(values).any(axis=1, keepdims=True), np.nan, values)
        return to_si(values, "magnetic_field", entry.unit) if entry.unit else values

    def components(self, campaign: Campaign) -> tuple[str, ...]:
        """Body axes of a field; of a direction, two axes across it."""
        is_field = self.hardware(campaign).is_field
        return ("x", "y", "z") if is_field else ("across 1", "across 2")

    def sigma(self, campaign: Campaign) -> Sequence[float | None]:
        """Noise of each column [T], or of a unit vector [rad]."""
        return self.hardware(campaign).sigma
