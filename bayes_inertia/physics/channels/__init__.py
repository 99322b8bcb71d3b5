"""The channels of a model: one small file for each kind of sensor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.sensors import streams_of
from bayes_inertia.campaign.sensors.attitude import ATTITUDE, AttitudeStream
from bayes_inertia.campaign.sensors.direction import DirectionStream
from bayes_inertia.campaign.sensors.momentum import MomentumStream
from bayes_inertia.campaign.sensors.rate import RATE, RateStream
from bayes_inertia.campaign.sensors.sensor_stream import SensorStream
from bayes_inertia.physics.channels.attitude import AttitudeChannel
from bayes_inertia.physics.channels.channel import Channel, Readings
from bayes_inertia.physics.channels.direction import DirectionChannel
from bayes_inertia.physics.channels.momentum import MomentumChannel
from bayes_inertia.physics.channels.rate import RateChannel
from bayes_inertia.physics.slew_input import Drive

__all__ = ["KINDS", "Channel", "Readings", "channels_of"]

# Which class models a stream.
KINDS: Mapping[type[SensorStream], type[Channel]] = {
    RateStream: RateChannel,
    AttitudeStream: AttitudeChannel,
    MomentumStream: MomentumChannel,
    DirectionStream: DirectionChannel,
}


def _named(channel: Channel, campaign: Campaign) -> Channel:
    """The channel with the sensor's name; of a further one, whether its mounting is estimated."""
    if not channel.stream.field:
        sigma = getattr(channel.stream.hardware(campaign), "mounting_sigma", None)
        return replace(channel, device=channel.name, mounting=sigma is not None)
    first = dict(zip((RATE.name, ATTITUDE.name), campaign.names, strict=True))
    return replace(channel, device=first.get(channel.name, ""))


def channels_of(campaign: Campaign, drive: Drive) -> tuple[Channel, ...]:
    """The channels of a model, in the order of all tables; tachometers may drive it."""
    axes = len(campaign.rate_sensor.axes) if campaign.rate_sensor else 0
    channels, begin = [], 6 + axes
    for stream in streams_of(campaign):
        channel = (KINDS.get(type(stream)) or stream.channel)(stream).of_campaign(campaign)
        channel = _named(channel, campaign)
        if stream == RATE:
            channel = replace(channel, parameters=(6, 6 + axes))
        elif isinstance(stream, MomentumStream):
            channel = replace(channel, compared=drive == "commanded")
        elif own := channel.every_parameter(campaign):
            end = begin + sum(len(parameter.names) for parameter in own)
            channel, begin = replace(channel, parameters=(begin, end)), end
        channels.append(channel)
    return tuple(channels)
