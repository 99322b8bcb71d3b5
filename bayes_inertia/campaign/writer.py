"""From a `Campaign` to a campaign folder that reads back as the same numbers."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayes_inertia.campaign.actuators import DEVICE_INPUTS
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.description import keys_of
from bayes_inertia.campaign.hardware import DirectionSensor
from bayes_inertia.campaign.prior import COPY_FILE
from bayes_inertia.campaign.reader import unmasked_of
from bayes_inertia.campaign.schema import FORMAT, FORMAT_2
from bayes_inertia.campaign.sensors import FIRST, SensorStream, streams_of
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.campaign.slew_parts import MORE
from bayes_inertia.errors import CampaignError, OutputError, require, require_kind
from bayes_inertia.files import write_new_files
from bayes_inertia.tables.table import Table

_TIME: Mapping[str, Any] = {"names": ["t_s"], "unit": "s"}


def write_campaign(campaign: Campaign, folder: str | Path) -> Path:
    """Write a campaign as a folder that reads back as the same numbers.

    The folder gets `campaign.toml` and one `slew_NN.csv` a slew, also where the telemetry was read
    from several streams; what format 1 has no keys for is written in format 2, the input of each
    device in a table of its own. All digits are kept and NaN becomes an empty cell; angles of slews
    are kept to 15 digits. The description comes last: an interrupted write leaves no campaign, and
    writing again completes it.

    Parameters
    ----------
    campaign : Campaign
        The campaign.
    folder : str or Path
        Where to; made if absent. Identical files may be there already.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    OutputError
        If a file of another content is in the way, or the system refuses; if the campaign could
        not be read back, such as one with a wheel or rate axis that has no number in one slew.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> with TemporaryDirectory() as parent:
    ...     folder = write_campaign(small_campaign(), Path(parent) / "small")
    ...     sorted(path.name for path in folder.iterdir())[:2]
    ['campaign.toml', 'slew_01.csv']
    """
    require_kind(campaign, Campaign, "campaign", "give a Campaign: read_campaign reads one")
    prior = campaign.prior
    known = {} if prior is None else {COPY_FILE: json.dumps(prior.json()).encode()}
    description, tables = content_of(campaign)
    _require_readable(campaign, description, tables)
    return write_new_files(folder, known | files_of(description, tables), holds="campaign")


def _require_readable(campaign: Campaign, description: str, tables: Mapping[str, Table]) -> None:
    """Raise `OutputError` unless the content of a folder reads back, with what is unknown."""
    place = f"campaign {campaign.name}"
    try:
        again = unmasked_of(description, "campaign.toml", tables)
    except CampaignError as error:
        where, what = error.where or place, f"it could not be read back: {error.what}"
        raise OutputError(what, where=where, advice=error.advice) from None
    lost, found = (
        {slew.name for slew in c.slews if slew.lost_command is not None} for c in (campaign, again)
    )
    for name in sorted(lost - found):
        what = "commands that were lost would be taken as held: rows at no regular step hide them"
        advice = "copy the folder that the campaign was read from, or leave the slew out"
        raise OutputError(what, where=f"slew {name}", advice=advice)


def files_of(description: str, tables: Mapping[str, Table]) -> dict[str, bytes]:
    """The files of a campaign folder by name, the description last."""
    texts = {file: _csv(table) for file, table in tables.items()} | {"campaign.toml": description}
    return {name: text.encode("utf-8") for name, text in texts.items()}


def _csv(table: Table) -> str:
    """Text with all digits; NaN becomes an empty cell."""
    cells = table.stack(list(table.columns)).tolist()
    rows = [["" if math.isnan(cell) else repr(cell) for cell in row] for row in cells]
    return "".join(",".join(row) + "\n" for row in [list(table.columns), *rows])


def content_of(campaign: Campaign) -> tuple[str, dict[str, Table]]:
    """The text of a campaign's description, and its tables by file."""
    for name, sensor in campaign.sensors.items():
        white = getattr(sensor, "correlated_noise", None) is None
        what, advice = "a folder has no key for correlated noise", "leave it out"
        require(white, f"sensor {name}", what, advice, error=OutputError)
    channels = written_channels(campaign)
    if needs_format_2(campaign, channels):
        return _content_2(campaign, channels)
    files = numbered(len(campaign.slews), "slew_{}.csv")
    slews = list(zip(campaign.slews, files, strict=True))
    first = zip(FIRST.values(), campaign.names, strict=True)
    parts = {
        **_head(campaign, FORMAT),
        # A wheel that is not running is said in format 2.
        "wheels": [keys_of(wheel) | {"state": None} for wheel in campaign.wheels],
        **{table: _named(campaign, table, name) for table, name in first},
        "columns": {"time": _TIME}
        | {channel.key: {"names": channel.names, **channel.sense} for channel in channels},
        "slews": [_slew(slew, file, channels) for slew, file in slews],
    }
    return toml_text(parts), {file: _table_of(slew, channels) for slew, file in slews}


def _content_2(campaign: Campaign, channels: Sequence[Written]) -> tuple[str, dict[str, Table]]:
    """The same in format 2."""
    streams = streams_for(campaign, channels)
    slews, tables = [], {}
    for slew, number in zip(campaign.slews, numbered(len(campaign.slews), "{}"), strict=True):
        own = [channel for channel in channels if channel.in_table(slew)]
        slews.append({**_slew_part(slew), **streams.files(number, own)})
        tables[streams.telemetry_file(number)] = _table_of(slew, channels)
        tables |= input_tables(slew, streams, number)
    told = devices(campaign, channels, streams)
    parts = {**_head(campaign, FORMAT_2), "time": _TIME, **told, "slews": slews}
    return toml_text(parts), tables


def _named(campaign: Campaign, table: str, name: str) -> dict[str, Any]:
    """The table of the first sensor of a kind in format 1, with its name where that is its own."""
    stated = keys_of(getattr(campaign, table))
    usual = name == table.replace("_", " ")
    return stated if usual or not stated else {"name": name, **stated}


def _head(campaign: Campaign, form: str) -> dict[str, Any]:
    """What both formats begin with."""
    return {
        "format": form,
        "name": campaign.name,
        "mission": dict(campaign.mission),
        "inertia": vars(campaign.inertia),
        "prior": {} if campaign.prior is None else {"from": COPY_FILE},
    }


def numbered(count: int, name: str) -> list[str]:
    """Names of files with numbers of one width, from 1."""
    digits = max(2, len(str(count)))
    return [name.format(f"{i:0{digits}d}") for i in range(1, count + 1)]


def _table_of(slew: Slew, channels: Sequence[Written]) -> Table:
    made = {"t_s": slew.time}
    for channel in (channel for channel in channels if channel.in_table(slew)):
        values = channel.values(slew)
        if values is None:
            values = np.full((len(slew.time), len(channel.names)), np.nan)
        if channel.channel == "wheel_torque" and slew.lost_command is not None:
            values = np.where((slew.lost_command > 0)[:, None], np.nan, values)
        columns = zip(channel.names, values.T, strict=True)
        made |= {name: column for name, column in columns if name}
    return Table.of(f"slew {slew.name}", made)


def _slew(slew: Slew, file: str, channels: Sequence[Written]) -> dict[str, Any]:
    own = [channel for channel in channels if channel.in_table(slew)]
    whole = len(own) == len(channels)
    return {
        "name": slew.name,
        "file": file if whole else None,
        **_slew_part(slew),
        "files": None if whole else {channel.key: file for channel in own},
    }


def _slew_part(slew: Slew) -> dict[str, Any]:
    """What a description says of a slew beside its tables."""
    return {
        "name": slew.name,
        "start": slew.start,
        "axis": slew.axis_B,
        # 15 digits return the degrees that were read, so that copying a campaign changes nothing.
        "angle_deg": None if slew.angle is None else float(f"{math.degrees(slew.angle):.15g}"),
    }


def toml_text(
    parts: Mapping[str, Any], comment: str = "", remarks: Mapping[str, str] | None = None
) -> str:
    """The text of a description, without what is None or empty; `remarks` stand behind keys."""
    import tomlkit

    document = tomlkit.document()
    if comment:
        document.add(tomlkit.comment(comment))
    for key, value in parts.items():
        if isinstance(value, str):
            document[key] = value
        elif isinstance(value, Mapping) and value:
            document[key] = _table(value, key, remarks or {})
        elif value:
            listed = tomlkit.aot()
            for part in value:
                listed.append(_table(part, f"{key}.{part['name']}", remarks or {}))
            document[key] = listed
    return tomlkit.dumps(document)


def _table(entries: Mapping[str, Any], path: str, remarks: Mapping[str, str]) -> Any:
    import tomlkit

    table = tomlkit.table()
    for key, value in entries.items():
        if value is not None:
            table[key] = _plain(value)
            if f"{path}.{key}" in remarks:
                table[key].comment(remarks[f"{path}.{key}"])
    return table


def _plain(value: Any) -> Any:
    """Numbers, lists and inline tables, which is what TOML writers know."""
    import tomlkit

    if isinstance(value, bool | str):
        return value
    if isinstance(value, Mapping):
        table = tomlkit.inline_table()
        table.update({key: _plain(inner) for key, inner in value.items()})
        return table
    if isinstance(value, list):
        return [_plain(inner) for inner in value]
    return np.asarray(value, dtype=float).tolist()


# The stream of all that every slew has on its own list of times.
TELEMETRY = "telemetry"


def needs_format_2(campaign: Campaign, channels: Sequence[Written]) -> bool:
    """Whether a campaign holds what format 1 has no keys for."""
    sensor = campaign.rate_sensor
    return bool(
        campaign.more_sensors
        or campaign.actuators
        or campaign.changes
        or campaign.reference
        or any("" in channel.names for channel in channels)
        or any(wheel.state != "running" for wheel in campaign.wheels)
        or any(slew.inputs for slew in campaign.slews)
        or sensor is None
        or len(sensor.axes) != 3
    )


def word(name: str) -> str:
    """A device's name as part of the names of files and columns."""
    return re.sub(r"\W+", "_", name)


@dataclass(frozen=True)
class Written:
    """A channel, as tables and descriptions hold it."""

    channel: str  # Field of `Slew`; "more.NAME" of a further sensor
    key: str  # Entry of `[columns]`, and what a device of format 2 calls it
    sense: Mapping[str, str]  # Its unit and sense
    # Its columns; a text: one a wheel. An empty name: of a wheel without readings
    names: str | Sequence[str]
    sensor: SensorStream | None = None

    @property
    def is_series(self) -> bool:
        """Whether every row should hold a number, not fixes or the environment alone."""
        return self.sensor.is_series if self.sensor else self.key == "wheel_torque"

    def values(self, slew: Slew) -> np.ndarray | None:
        """Numbers (n, columns) of a slew; fixes and environment without any count as absent."""
        values = self.sensor.of(slew) if self.sensor else getattr(slew, self.channel)
        absent = values is None or (not self.is_series and np.isnan(values).all())
        return None if absent else np.asarray(values)

    def in_table(self, slew: Slew) -> bool:
        """Whether the slew's table has the columns; of wheels and further sensors it may lack."""
        may_lack = self.key.startswith("wheel") or bool(self.sensor and not self.sensor.field)
        return not may_lack or self.values(slew) is not None


_TORQUE = Written("wheel_torque", "wheel_torque", {"unit": "N m", "acts_on": "wheel"}, "u{}_Nm")
_FIELD_NAMES, _POSITION_NAMES = ("Bx_N_T", "By_N_T", "Bz_N_T"), ("rx_N_m", "ry_N_m", "rz_N_m")
_ENVIRONMENT = (
    Written("magnetic_field_N", "magnetic_field", {"unit": "T", "frame": "inertial"}, _FIELD_NAMES),
    Written("position_N", "position", {"unit": "m", "frame": "inertial"}, _POSITION_NAMES),
)


def written_channels(campaign: Campaign) -> list[Written]:
    """The channels that a campaign has, in the order of their columns."""
    first: list[Written] = []
    more: list[Written] = []
    for sensor in streams_of(campaign):
        if sensor.sigma(campaign):
            channel = Written(sensor.field or MORE + sensor.name, *sensor.written, sensor)
            (first if sensor.field else more).append(channel)
    # What wheels have first.
    first.sort(key=lambda channel: not isinstance(channel.names, str))
    found = []
    for channel in (_TORQUE, *first, *_ENVIRONMENT, *more):
        given = [x for slew in campaign.slews if (x := channel.values(slew)) is not None]
        # A sensor may have no reading anywhere.
        hardware = channel.sensor.hardware(campaign) if channel.sensor else None
        values = np.concatenate(given or [np.zeros((0, getattr(hardware, "columns", 0)))])
        width, names = values.shape[1], channel.names
        if not width:
            continue
        if isinstance(names, str):
            read = np.isfinite(values).any(axis=0).tolist()
            names = [names.format(i + 1) if is_read else "" for i, is_read in enumerate(read)]
        elif len(names) != width or channel in more:
            names = [f"{word(channel.channel.removeprefix(MORE))}_{i + 1}" for i in range(width)]
        found.append(replace(channel, names=list(names)))
    return found


@dataclass(frozen=True)
class Streams:
    """Which stream each channel and each device's input is of."""

    # By channel: `TELEMETRY`, or a stream of its own where some slews lack it
    channels: Mapping[str, str]
    inputs: Mapping[str, str]  # By device

    @property
    def one_table(self) -> bool:
        """Whether every slew has all channels, in one table."""
        return set(self.channels.values()) <= {TELEMETRY}

    def files(self, number: str, own: Sequence[Written]) -> dict[str, Any]:
        """`file` or `files` of a slew: `own`, the channels that it has."""
        if self.one_table and not self.inputs:
            return {"file": f"slew_{number}.csv"}
        if self.one_table:
            return {"files": f"slew_{number}_{{stream}}.csv"}
        streams = dict.fromkeys(self.channels[channel.channel] for channel in own)
        table = dict.fromkeys(streams, self.telemetry_file(number))
        inputs = {stream: f"slew_{number}_{stream}.csv" for stream in self.inputs.values()}
        return {"files": table | inputs}

    def telemetry_file(self, number: str) -> str:
        """The table of all channels of a slew."""
        alone = self.one_table and not self.inputs
        return f"slew_{number}.csv" if alone else f"slew_{number}_{TELEMETRY}.csv"


def streams_for(campaign: Campaign, channels: Sequence[Written]) -> Streams:
    """The streams of a campaign: those of all channels, and one for what some slews lack."""
    whole = [c for c in channels if all(c.in_table(slew) for slew in campaign.slews)]
    streams = {
        c.channel: TELEMETRY if c in whole else word(c.channel.removeprefix(MORE)) for c in channels
    }
    taken = {TELEMETRY, *streams.values()}
    inputs: dict[str, str] = {}
    seen = {name for slew in campaign.slews for name in slew.inputs or ()}
    names = [device.name for device in campaign.actuators]
    names += [name for name, _ in campaign.more_sensors if name in seen]
    names += sorted(campaign.further_inputs)
    for k, name in enumerate(names):
        inputs[name] = f"{word(name)}_{k + 1}" if word(name) in taken else word(name)
        taken.add(inputs[name])
    return Streams(streams, inputs)


def input_tables(slew: Slew, streams: Streams, number: str) -> dict[str, Table]:
    """The tables of a slew's inputs, by file."""
    tables, inputs, place = {}, slew.inputs or {}, f"slew {slew.name}"
    for name in sorted(set(inputs) - set(streams.inputs)):
        what, advice = f"the input {name!r} has the name of a sensor", "give it a name of its own"
        raise OutputError(what, where=place, advice=advice)
    for device, stream in streams.inputs.items():
        what, advice = f"{device} has no input here", "give it in every slew"
        require(device in inputs, place, what, advice, error=OutputError)
        columns = {f"{stream}_{k + 1}": column for k, column in enumerate(inputs[device].values.T)}
        columns = {"t_s": inputs[device].time, **columns}
        tables[f"slew_{number}_{stream}.csv"] = Table.of(slew.name, columns)
    return tables


def devices(
    campaign: Campaign, channels: Sequence[Written], streams: Streams
) -> dict[str, list[dict[str, Any]]]:
    """Devices, sensors, environment and changes of format 2."""
    entries = {
        c.channel: {"stream": streams.channels[c.channel], "names": list(c.names), **c.sense}
        for c in channels
    }
    return {
        "actuators": [
            *(_wheel(campaign, k, entries) for k in range(len(campaign.wheels))),
            *(_actuator(campaign, device, streams) for device in campaign.actuators),
        ],
        "sensors": [
            _sensor(campaign, c.sensor, entries[c.channel], streams)
            for c in channels
            if c.sensor and c.sensor.hardware(campaign)
        ],
        "environment": [
            *(
                {"name": c.key.replace("_", " "), "type": c.key, "vector": entries[c.channel]}
                for c in channels
                if not c.sensor and not c.is_series
            ),
            *_inputs(campaign, streams),
        ],
        "changes": [dict(vars(change)) for change in campaign.changes],
    }


def _wheel(campaign: Campaign, k: int, entries: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    wheel = campaign.wheels[k]
    part = {"name": wheel.name, "type": "wheel", **keys_of(wheel)}
    part["state"] = None if wheel.state == "running" else wheel.state
    for channel, key in (("wheel_torque", "torque"), ("wheel_momentum", "momentum")):
        if channel in entries and entries[channel]["names"][k]:
            part[key] = {**entries[channel], "names": [entries[channel]["names"][k]]}
    if "momentum" in part and wheel.momentum_sigma is not None:
        part["momentum"]["sigma"] = part.pop("momentum_sigma")
    return part


def _sensor(
    campaign: Campaign, sensor: SensorStream, entry: Mapping[str, Any], streams: Streams
) -> dict[str, Any]:
    hardware, key = sensor.hardware(campaign), sensor.written[0]
    first = dict(zip(FIRST, campaign.names, strict=True))
    name = first[key] if sensor.field else sensor.name
    stated, said = keys_of(hardware), dict(entry)
    if isinstance(hardware, DirectionSensor):
        unit = {"unit": "T"} if stated.pop("unit") else {}
        said |= {"frame": "body", **unit}
        if name in streams.inputs:
            stream = streams.inputs[name]
            names = [f"{stream}_{k + 1}" for k in range(3)]
            seen = {"stream": stream, "names": names, "frame": "inertial", **unit}
            stated["reference"] = seen
    stated |= {"reference": True} if name == campaign.reference else {}
    return {"name": name, "type": key, **stated, key: said}


def _inputs(campaign: Campaign, streams: Streams) -> list[dict[str, Any]]:
    """Inputs of no device: what else a disturbance may follow."""
    told = []
    for name, width in sorted(campaign.further_inputs.items()):
        stream, between = streams.inputs[name], _between(campaign, name)
        names = [f"{stream}_{k + 1}" for k in range(width)]
        values = {"stream": stream, "names": names, "between": between}
        told.append({"name": name, "type": "input", "values": values})
    return told


def _between(campaign: Campaign, name: str) -> str:
    """What an input does between its readings, alike in all slews."""
    place, given = f"campaign {campaign.name}", [(s.inputs or {})[name] for s in campaign.slews]
    kinds: list[str] = sorted({stream.between for stream in given})
    what = f"the input of {name!r} is {' in one slew, '.join(kinds)} in another"
    advice = "give it one form in all slews: a campaign folder says it once"
    require(len(kinds) == 1, place, what, advice, error=OutputError)
    widths = sorted({stream.width for stream in given})
    what = f"the input of {name!r} has {' or '.join(map(str, widths))} numbers"
    advice = "give it as many numbers in every slew"
    require(len(widths) == 1, place, what, advice, error=OutputError)
    return kinds[0]


def _actuator(campaign: Campaign, device: Any, streams: Streams) -> dict[str, Any]:
    between = _between(campaign, device.name)
    stream, stated = streams.inputs[device.name], keys_of(device)
    kind, key, _, unit = DEVICE_INPUTS[type(device)]
    names = [f"{stream}_{k + 1}" for k in range(device.columns)]
    frame = {"frame": stated.pop("frame")} if "frame" in stated else {}
    sigma = {"sigma": stated.pop("angle_sigma")} if "angle_sigma" in stated else {}
    said = {"stream": stream, "names": names, "unit": unit, **frame, "between": between, **sigma}
    if between == "on_time":
        key, said = between, {"stream": stream, "names": names, "unit": "s"}
    return {"name": stated.pop("name"), "type": kind, **stated, key: said}
