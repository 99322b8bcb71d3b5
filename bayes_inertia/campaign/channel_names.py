"""The channels of telemetry that are compared with the model, in the order of all tables."""

from __future__ import annotations

CHANNELS = ("rate", "attitude", "momentum")
