"""The star tracker's fixes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.sensors.sensor_stream import SensorStream


@dataclass(frozen=True)
class AttitudeStream(SensorStream):
    """Quaternions of a star tracker, in a few rows of a slew."""

    sensor = "star tracker"
    unit = ""
    is_series = False

    def sigma(self, campaign: Campaign) -> Sequence[float | None]:
        """Noise across the boresight, twice, and about it [rad]; none without star tracker."""
        tracker = campaign.star_tracker
        if tracker is None:
            return ()
        return tracker.sigma_cross, tracker.sigma_cross, tracker.sigma_roll

    def louder(self, campaign: Campaign, factor: float) -> Campaign:
        """The campaign with another noise of the star tracker."""
        tracker = campaign.star_tracker
        if tracker is None:
            return campaign
        cross, roll = factor * tracker.sigma_cross, factor * tracker.sigma_roll
        return replace(campaign, star_tracker=replace(tracker, sigma_cross=cross, sigma_roll=roll))


ATTITUDE = AttitudeStream("attitude", "attitude")
