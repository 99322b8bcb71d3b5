"""Devices of a campaign as format 2 writes them, and their streams."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from bayes_inertia.campaign.actuators import GimballedRotors, KnownTorque, Magnetorquer, Thruster
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.description import keys_of
from bayes_inertia.campaign.hardware import DirectionSensor
from bayes_inertia.campaign.sensors import SensorStream, streams_of
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.campaign.slew_parts import MORE
from bayes_inertia.errors import OutputError
from bayes_inertia.tables.table import Table

# The stream of all that every slew has on its own list of times.
TELEMETRY = "telemetry"


def needs_format_2(campaign: Campaign) -> bool:
    """Whether a campaign holds what format 1 has no keys for."""
    sensor = campaign.rate_sensor
    return bool(
        campaign.more_sensors
        or campaign.actuators
        or campaign.changes
        or campaign.reference
        or any(wheel.state != "running" for wheel in campaign.wheels)
        or sensor is None
        or len(sensor.axes) != 3
    )


def more_streams(campaign: Campaign) -> dict[str, SensorStream]:
    """Streams of further sensors, by their channel."""
    return {MORE + s.name: s for s in streams_of(campaign) if not s.field}


def values_of(slew: Slew, channel: str) -> np.ndarray | None:
    """Readings of a channel of a slew."""
    if channel.startswith(MORE):
        return (slew.more or {}).get(channel.removeprefix(MORE))
    return getattr(slew, channel)


def word(name: str) -> str:
    """A device's name as part of the names of files and columns.

    >>> word("star tracker 2")
    'star_tracker_2'
    """
    return re.sub(r"\W+", "_", name)


@dataclass(frozen=True)
class Streams:
    """Which stream each channel and each device's input is of."""

    # By channel: `TELEMETRY`, or a stream of its own where some slews lack it
    channels: Mapping[str, str]
    inputs: Mapping[str, str]  # By device

    def files(self, number: str, own: Sequence[str]) -> dict[str, Any]:
        """`file` or `files` of a slew: `own`, the channels that it has."""
        one = set(self.channels.values()) <= {TELEMETRY}
        if one and not self.inputs:
            return {"file": f"slew_{number}.csv"}
        if one:
            return {"files": f"slew_{number}_{{stream}}.csv"}
        streams = dict.fromkeys(self.channels[channel] for channel in own)
        table = dict.fromkeys(streams, self.telemetry_file(number))
        inputs = {stream: f"slew_{number}_{stream}.csv" for stream in self.inputs.values()}
        return {"files": table | inputs}

    def telemetry_file(self, number: str) -> str:
        """The table of all channels of a slew."""
        alone = set(self.channels.values()) <= {TELEMETRY} and not self.inputs
        return f"slew_{number}.csv" if alone else f"slew_{number}_{TELEMETRY}.csv"


def streams_for(
    campaign: Campaign, columns: Mapping[str, Sequence[str]], partial: set[str]
) -> Streams:
    """The streams of a campaign: `columns` by channel, and the channels that some slews lack."""
    channels = {c: word(c.removeprefix(MORE)) if c in partial else TELEMETRY for c in columns}
    taken = {TELEMETRY, *channels.values()}
    inputs: dict[str, str] = {}
    seen = {name for slew in campaign.slews for name in slew.inputs or ()}
    names = [device.name for device in campaign.actuators]
    names += [name for name, _ in campaign.more_sensors if name in seen]
    for k, name in enumerate(names):
        inputs[name] = f"{word(name)}_{k + 1}" if word(name) in taken else word(name)
        taken.add(inputs[name])
    return Streams(channels, inputs)


def input_tables(slew: Slew, streams: Streams, number: str) -> dict[str, Table]:
    """The tables of a slew's inputs, by file."""
    unknown = sorted(set(slew.inputs or ()) - set(streams.inputs))
    if unknown:
        what = f"the input {unknown[0]!r} belongs to no device"
        advice = "leave it out: a campaign folder holds inputs of [[actuators]] only"
        raise OutputError(what, where=f"slew {slew.name}", advice=advice)
    tables = {}
    for device, stream in streams.inputs.items():
        if device not in (slew.inputs or {}):
            what, advice = f"{device} has no input here", "give it in every slew"
            raise OutputError(what, where=f"slew {slew.name}", advice=advice)
        given = (slew.inputs or {})[device]
        columns = {f"{stream}_{k + 1}": column for k, column in enumerate(given.values.T)}
        columns = {"t_s": given.time, **columns}
        tables[f"slew_{number}_{stream}.csv"] = Table.of(slew.name, columns)
    return tables


def devices(
    campaign: Campaign,
    columns: Mapping[str, Sequence[str]],
    senses: Mapping[str, tuple[str, Mapping[str, str]]],
    streams: Streams,
) -> dict[str, Any]:
    """Devices, sensors, environment and changes of format 2; `senses`: key, unit and sense."""

    def entry(channel: str, **more: Any) -> tuple[str, dict[str, Any]]:
        key, sense = senses[channel]
        said = {"stream": streams.channels[channel], "names": list(columns[channel])}
        return key, {**said, **sense, **more}

    return {
        "actuators": [
            *_wheels(campaign, columns, entry),
            *(_actuator(campaign, device, streams) for device in campaign.actuators),
        ],
        "sensors": _sensors(campaign, columns, entry, streams),
        "environment": [
            {"name": key.replace("_", " "), "type": key, "vector": said}
            for key, said in (entry(c) for c in columns if c.endswith("_N"))
        ],
        "changes": [dict(vars(change)) for change in campaign.changes],
    }


def _wheels(campaign: Campaign, columns: Mapping[str, Sequence[str]], entry: Any) -> list[dict]:
    parts = []
    for k, wheel in enumerate(campaign.wheels):
        part = {"name": wheel.name, "type": "wheel", **keys_of(wheel)}
        part["state"] = None if wheel.state == "running" else wheel.state
        for channel, key in (("wheel_torque", "torque"), ("wheel_momentum", "momentum")):
            if channel in columns:
                part[key] = entry(channel)[1] | {"names": [columns[channel][k]]}
        if "momentum" in part and wheel.momentum_sigma is not None:
            part["momentum"]["sigma"] = part.pop("momentum_sigma")
        parts.append(part)
    return parts


def _sensors(
    campaign: Campaign, columns: Mapping[str, Sequence[str]], entry: Any, streams: Streams
) -> list[dict]:
    first = [
        ("rate", campaign.names[0], campaign.rate_sensor),
        ("attitude", campaign.names[1], campaign.star_tracker),
    ]
    further = [(MORE + name, name, hardware) for name, hardware in campaign.more_sensors]
    parts = []
    for channel, name, hardware in (*first, *further):
        if channel in columns:
            key, said = entry(channel)
            stated = keys_of(hardware)
            if isinstance(hardware, DirectionSensor):
                unit = {"unit": "T"} if stated.pop("unit") else {}
                said |= {"frame": "body", **unit}
                if name in streams.inputs:
                    stream = streams.inputs[name]
                    names = [f"{stream}_{k + 1}" for k in range(3)]
                    seen = {"stream": stream, "names": names, "frame": "inertial", **unit}
                    stated["reference"] = seen
            stated |= {"reference": True} if name == campaign.reference else {}
            parts.append({"name": name, "type": key, **stated, key: said})
    return parts


def _actuator(campaign: Campaign, device: Any, streams: Streams) -> dict[str, Any]:
    kinds = {(slew.inputs or {})[device.name].between for slew in campaign.slews}
    if len(kinds) > 1:
        what = f"the input of {device.name!r} is {' in one slew, '.join(sorted(kinds))} in another"
        advice = "give it one form in all slews: a campaign folder says it once"
        raise OutputError(what, where=f"campaign {campaign.name}", advice=advice)
    between, stream, stated = kinds.pop(), streams.inputs[device.name], keys_of(device)
    kind, key, unit = _INPUTS[type(device)]
    names = [f"{stream}_{k + 1}" for k in range(device.columns)]
    frame = {"frame": stated.pop("frame")} if "frame" in stated else {}
    sigma = {"sigma": stated.pop("angle_sigma")} if "angle_sigma" in stated else {}
    said = {"stream": stream, "names": names, "unit": unit, **frame, "between": between, **sigma}
    if between == "on_time":
        key, said = between, {"stream": stream, "names": names, "unit": "s"}
    return {"name": stated.pop("name"), "type": kind, **stated, key: said}


# Of each device: its type, and the key and unit of its input.
_INPUTS: Mapping[type, tuple[str, str, str]] = MappingProxyType(
    {
        KnownTorque: ("torque", "torque", "N m"),
        Magnetorquer: ("magnetorquer", "dipole", "A m^2"),
        Thruster: ("thruster", "level", "1"),
        GimballedRotors: ("gimballed_rotors", "gimbal_angle", "rad"),
    }
)
