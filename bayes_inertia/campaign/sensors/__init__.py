"""Sensors whose readings are compared with the model, one file a kind, in the order of tables."""

from collections.abc import Mapping

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import DirectionSensor, RateSensor, StarTracker, require_key
from bayes_inertia.campaign.sensors.attitude import ATTITUDE, AttitudeStream
from bayes_inertia.campaign.sensors.direction import DirectionStream
from bayes_inertia.campaign.sensors.momentum import MOMENTUM, MomentumStream
from bayes_inertia.campaign.sensors.rate import RATE, RateStream
from bayes_inertia.campaign.sensors.sensor_stream import SensorStream

STREAMS: tuple[SensorStream, ...] = (RATE, ATTITUDE, MOMENTUM)
# The stream of each entry of [columns] that holds readings.
BY_KEY: Mapping[str, SensorStream] = {key: stream for stream in STREAMS for key in stream.keys}
# Names of the channels that every campaign has.
CHANNELS = tuple(stream.name for stream in STREAMS)
# Which class reads the sensors of `Campaign.more_sensors`; others name theirs as `stream`.
KINDS: Mapping[type, type[SensorStream]] = {
    RateSensor: RateStream,
    StarTracker: AttitudeStream,
    DirectionSensor: DirectionStream,
}
# The field of `Campaign` that holds the first sensor of a kind, in the order of `Campaign.names`.
FIRST: Mapping[str, str] = {kind.written[0]: kind.first for kind in KINDS.values() if kind.first}
# The class of a further sensor by what its columns hold.
KINDS_BY_KEY: Mapping[str, type[SensorStream]] = {kind.written[0]: kind for kind in KINDS.values()}


def streams_of(campaign: Campaign) -> tuple[SensorStream, ...]:
    """The streams of a campaign, one a sensor."""
    for name in set(dict(campaign.more_sensors)) & {*CHANNELS, "noise"}:
        what, advice = f"results know something else as {name!r}", "give the sensor another name"
        require_key(False, f"sensors.{name}.name", what, advice)
    more = ((KINDS.get(type(x)) or x.stream)(name) for name, x in campaign.more_sensors)
    return (*STREAMS, *more)


def series_of(campaign: Campaign) -> tuple[SensorStream, ...]:
    """Those in which every row may hold a reading."""
    return tuple(stream for stream in streams_of(campaign) if stream.is_series)


def reading_step(campaign: Campaign) -> float:
    """Time from one reading to the next [s] of the sensor that shows the motion best.

    Of the fastest rate sensor, or of the fastest of the others where none reads rates. Rows of a
    slew tell it only where all its columns have one clock.
    """
    motion = [stream for stream in streams_of(campaign) if not isinstance(stream, MomentumStream)]
    gyros = [stream for stream in motion if isinstance(stream, RateStream)]
    for streams in (gyros, motion):
        steps = (stream.spacings(campaign.slews) for stream in streams)
        if medians := [float(np.median(x)) for x in steps if len(x)]:
            return min(medians)
    return float(np.median(np.concatenate([np.diff(slew.time) for slew in campaign.slews])))


def stream_of_device(device: str, campaign: Campaign) -> SensorStream:
    """The stream of a sensor by its name; of the first rate sensor where there is none."""
    first = dict(zip(campaign.names, (RATE, ATTITUDE), strict=True)) | {"": RATE}
    return first.get(device) or stream_named(device, campaign)


def stream_named(channel: str, campaign: Campaign) -> SensorStream:
    """The stream of a channel."""
    return next(stream for stream in streams_of(campaign) if stream.name == channel)
