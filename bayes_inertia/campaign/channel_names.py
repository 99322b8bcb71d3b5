"""The channels of telemetry that are compared with the model, in the order of all tables."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

CHANNELS = ("rate", "attitude", "momentum")

FIELD_OF_CHANNEL: Mapping[str, str] = MappingProxyType(
    {"rate": "rate", "attitude": "attitude", "momentum": "wheel_momentum"}
)
"""The field of `Slew` that holds each channel."""
