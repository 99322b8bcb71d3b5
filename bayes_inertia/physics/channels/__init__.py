"""The channels of a model: one small file for each kind of sensor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.sensors import streams_of
from bayes_inertia.campaign.sensors.attitude import AttitudeStream
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
KINDS: Mapping[type[SensorStream], type[Channel]] = MappingProxyType(
    {
        RateStream: RateChannel,
        AttitudeStream: AttitudeChannel,
        MomentumStream: MomentumChannel,
        DirectionStream: DirectionChannel,
    }
)


def _mounted(channel: Channel, campaign: Campaign) -> Channel:
    """The channel of a further sensor, whose mounting is estimated if a sd of it is stated."""
    if channel.stream.field:
        return channel
    sigma = getattr(channel.stream.hardware(campaign), "mounting_sigma", None)
    return channel if sigma is None else replace(channel, mounting=True)


def channels_of(campaign: Campaign, drive: Drive) -> tuple[Channel, ...]:
    """The channels of a model, in the order of all tables; tachometers may drive it."""
    axes = len(campaign.rate_sensor.axes) if campaign.rate_sensor else 0
    channels, begin = [], 6 + axes
    for stream in streams_of(campaign):
        channel = (KINDS.get(type(stream)) or stream.channel)(stream).of_campaign(campaign)
        if stream == RATE:
            channel = replace(channel, parameters=(6, 6 + axes))
        elif isinstance(stream, MomentumStream):
            channel = replace(channel, compared=drive == "commanded")
        elif own := (channel := _mounted(channel, campaign)).every_parameter(campaign):
            end = begin + sum(len(parameter.names) for parameter in own)
            channel, begin = replace(channel, parameters=(begin, end)), end
        channels.append(channel)
    return tuple(channels)
