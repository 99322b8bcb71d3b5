"""The star tracker's fixes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.sensors.sensor_stream import SensorStream, all_empty
from bayes_inertia.campaign.slew import bad_quaternion
from bayes_inertia.errors import require
from bayes_inertia.tables.table import Table


@dataclass(frozen=True)
class AttitudeStream(SensorStream):
    """Quaternions of a star tracker, in a few rows of a slew."""

    sensor = title = "star tracker"
    unit = ""
    keys = ("attitude",)
    first = "star_tracker"
    noise = ("sigma_cross", "sigma_roll")
    written = ("attitude", {"scalar": "last", "maps": "inertial_to_body"}, ("q1", "q2", "q3", "q4"))
    is_series = False

    def read(self, table: Table, entry: Any, spin_inertias: np.ndarray) -> np.ndarray | None:
        """Scalar last, body from inertial; a star tracker whose columns are empty is left out."""
        if all_empty(table, entry.names):
            return None
        quaternion = table.stack(entry.names)
        problem = bad_quaternion(quaternion)
        row, what = problem or (0, "")
        where = f"{table.place(row)}, columns {', '.join(entry.names)}"
        advice = "repair the row, or leave all four cells empty (no fix)"
        require(problem is None, where, f"{what}: {quaternion[row].tolist()}", advice)
        if entry.scalar == "first":
            quaternion = quaternion[:, [1, 2, 3, 0]]
        # The inverse rotation is the conjugate; the scalar's sign is kept.
        return quaternion * ([-1.0, -1.0, -1.0, 1.0] if entry.maps == "body_to_inertial" else 1.0)

    def exchangeable(self, entry: Any) -> Sequence[int]:
        """The quaternion's vector."""
        return range(1, 4) if entry.scalar == "first" else range(3)

    def components(self, campaign: Campaign) -> tuple[str, ...]:
        """Body axes of the small rotation."""
        return ("about x", "about y", "about z")

    def sigma(self, campaign: Campaign) -> Sequence[float | None]:
        """Noise across the boresight, twice, and about it [rad]; none without star tracker."""
        tracker = self.hardware(campaign)
        if tracker is None:
            return ()
        return tracker.sigma_cross, tracker.sigma_cross, tracker.sigma_roll


ATTITUDE = AttitudeStream("attitude", "attitude")
