"""A campaign whose stated noise is replaced by what a diagnosis measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.physics.slew_input import Drive


def with_measured_noise(
    campaign: Campaign, factors: Mapping[str, float], drive: Drive = "commanded"
) -> Campaign:
    """The campaign with each sensor's sigma multiplied by what a diagnosis measured of it.

    In the measured drive tachometers have no channel of their own: their noise is in that of the
    rate sensor, and grows with it.

    Parameters
    ----------
    campaign : Campaign
        With the noise as stated.
    factors : dict
        {"rate", "attitude", "momentum": factor on the channel's sigma}.
    drive : {"commanded", "measured"}
        What drove the model when the factors were measured.

    Returns
    -------
    Campaign
        The same telemetry with the sigmas of its sensors multiplied.
    """
    factors = factors if drive == "commanded" else {**factors, "momentum": factors["rate"]}
    sensor, tracker = campaign.rate_sensor, campaign.star_tracker
    x, y, z = (factors["rate"] * sigma for sigma in sensor.sigma)
    louder_sensor = replace(sensor, sigma=(x, y, z))
    louder_wheels = tuple(
        replace(w, momentum_sigma=w.momentum_sigma and factors["momentum"] * w.momentum_sigma)
        for w in campaign.wheels
    )
    if tracker is not None:
        tracker = replace(
            tracker,
            sigma_cross=factors["attitude"] * tracker.sigma_cross,
            sigma_roll=factors["attitude"] * tracker.sigma_roll,
        )
    return replace(campaign, rate_sensor=louder_sensor, wheels=louder_wheels, star_tracker=tracker)
