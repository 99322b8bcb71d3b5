"""Sensors whose readings are compared with the model, one file a kind, in the order of tables."""

from bayes_inertia.campaign.sensors.attitude import ATTITUDE
from bayes_inertia.campaign.sensors.momentum import MOMENTUM
from bayes_inertia.campaign.sensors.rate import RATE
from bayes_inertia.campaign.sensors.sensor_stream import SensorStream

STREAMS: tuple[SensorStream, ...] = (RATE, ATTITUDE, MOMENTUM)
# Names of the channels.
CHANNELS = tuple(stream.name for stream in STREAMS)


def stream_named(channel: str) -> SensorStream:
    """The stream of a channel."""
    return STREAMS[CHANNELS.index(channel)]
