"""The channels of a model: one small file for each kind of sensor."""

from __future__ import annotations

from bayes_inertia.campaign.sensors import ATTITUDE, MOMENTUM, RATE
from bayes_inertia.physics.channels.attitude import AttitudeChannel
from bayes_inertia.physics.channels.channel import Channel, Readings
from bayes_inertia.physics.channels.momentum import MomentumChannel
from bayes_inertia.physics.channels.rate import RateChannel
from bayes_inertia.physics.slew_input import Drive

__all__ = ["Channel", "Readings", "channels_of"]


def channels_of(drive: Drive) -> tuple[Channel, ...]:
    """The channels of a model, in the order of all tables."""
    return (
        RateChannel(RATE, parameters=(6, 9)),
        AttitudeChannel(ATTITUDE),
        MomentumChannel(MOMENTUM, compared=drive == "commanded"),
    )
