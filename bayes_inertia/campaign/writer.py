"""From a `Campaign` to a campaign folder that reads back as the same numbers."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.description import keys_of
from bayes_inertia.campaign.prior import COPY_FILE
from bayes_inertia.campaign.schema import FORMAT, FORMAT_2
from bayes_inertia.campaign.sensors import STREAMS, SensorStream
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.campaign.slew_parts import MORE
from bayes_inertia.campaign.written_devices import (
    devices,
    input_tables,
    more_streams,
    needs_format_2,
    streams_for,
    values_of,
    word,
)
from bayes_inertia.errors import OutputError
from bayes_inertia.files import write_new_files
from bayes_inertia.tables.table import Table

# Slew field -> key of [columns], its unit and sense, and its columns (a text: one a wheel).
_CHANNELS: dict[str, tuple[str, Mapping[str, str], str | Sequence[str]]] = {
    "wheel_torque": ("wheel_torque", {"unit": "N m", "acts_on": "wheel"}, "u{}_Nm"),
    # What wheels have first.
    **{sensor.field: sensor.written for sensor in sorted(STREAMS, key=lambda s: not s.per_wheel)},
    "magnetic_field_N": (
        "magnetic_field",
        {"unit": "T", "frame": "inertial"},
        ["Bx_N_T", "By_N_T", "Bz_N_T"],
    ),
    "position_N": ("position", {"unit": "m", "frame": "inertial"}, ["rx_N_m", "ry_N_m", "rz_N_m"]),
}


_SENSORS = {sensor.field: sensor for sensor in STREAMS}
_TIME: Mapping[str, Any] = MappingProxyType({"names": ["t_s"], "unit": "s"})


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
        If a file of another content is in the way, or the system refuses; if a rate axis or a
        wheel has no number in a slew, or a vector of the environment lacks one (which cannot be
        read back).

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
    known = {} if campaign.prior is None else {COPY_FILE: json.dumps(campaign.prior.json())}
    files = {name: text.encode() for name, text in known.items()}
    return write_new_files(folder, files | files_of(*content_of(campaign)), holds="campaign")


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
    columns = _columns(campaign)
    if needs_format_2(campaign):
        return _content_2(campaign, columns)
    files = numbered(len(campaign.slews), "slew_{}.csv")
    tables = {f: _table_of(slew, columns) for f, slew in zip(files, campaign.slews, strict=True)}
    return _toml(campaign, columns, files), tables


def _content_2(campaign: Campaign, columns: dict[str, list[str]]) -> tuple[str, dict[str, Table]]:
    """The same in format 2."""
    partial = {c for c in columns if any(c not in _columns_of(s, columns) for s in campaign.slews)}
    streams = streams_for(campaign, columns, partial)
    more = {c: (s.written[0], s.written[1]) for c, s in more_streams(campaign).items()}
    senses = {channel: said[:2] for channel, said in _CHANNELS.items()} | more
    slews, tables = [], {}
    for slew, number in zip(campaign.slews, numbered(len(campaign.slews), "{}"), strict=True):
        own = _columns_of(slew, columns)
        slews.append({**_slew_part(slew), **streams.files(number, list(own))})
        tables[streams.telemetry_file(number)] = _table_of(slew, columns)
        tables |= input_tables(slew, streams, number)
    parts = {
        **_head(campaign, FORMAT_2),
        "time": _TIME,
        **devices(campaign, columns, senses, streams),
        "slews": slews,
    }
    return toml_text(parts), tables


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


def _columns(campaign: Campaign) -> dict[str, list[str]]:
    """The channels that the campaign has, with the names of their columns."""
    more = more_streams(campaign)
    columns: dict[str, list[str]] = {}
    for channel in (*_CHANNELS, *more):
        sensor = more.get(channel) or _SENSORS.get(channel)
        names = [] if channel in more else _CHANNELS[channel][2]
        having = [slew for slew in campaign.slews if _has(slew, channel, sensor)]
        per_wheel = isinstance(names, str)
        if (
            not having
            or (per_wheel and not campaign.wheels)
            or (sensor is not None and not sensor.sigma(campaign))
        ):
            continue
        for slew in having:
            _refuse_what_reading_refuses(slew, channel, sensor)
        width = np.asarray(values_of(having[0], channel)).shape[1]
        if isinstance(names, str):
            columns[channel] = [names.format(i + 1) for i in range(len(campaign.wheels))]
        elif len(names) == width:
            columns[channel] = list(names)
        else:
            begin = word(channel.removeprefix(MORE))
            columns[channel] = [f"{begin}_{i + 1}" for i in range(width)]
    return columns


def _has(slew: Slew, channel: str, sensor: SensorStream | None) -> bool:
    """Whether a slew has a channel; fixes and environment without a number count as absent."""
    values = values_of(slew, channel)
    may_be_empty = channel.endswith("_N") or not (sensor is None or sensor.is_series)
    return values is not None and not (may_be_empty and np.isnan(values).all())


def _refuse_what_reading_refuses(slew: Slew, channel: str, sensor: SensorStream | None) -> None:
    """Raise `OutputError` for gaps in a channel that cannot be read back."""
    empty = np.isnan(np.asarray(values_of(slew, channel)))
    if sensor is not None and sensor.is_series and empty.all(axis=0).any():
        raise OutputError(
            f"{channel} has no number in column {int(np.argmax(empty.all(axis=0))) + 1}",
            where=f"slew {slew.name}",
            advice="leave the channel or the slew out",
        )
    if channel.endswith("_N") and (empty.any(axis=1) != empty.all(axis=1)).any():
        row = int(np.argmax(empty.any(axis=1) != empty.all(axis=1)))
        raise OutputError(
            f"{channel} has a gap in row {row + 1}",
            where=f"slew {slew.name}",
            advice="fill it, or leave the row of the channel empty",
        )


def _columns_of(slew: Slew, columns: dict[str, list[str]]) -> dict[str, list[str]]:
    """The columns of a slew's table; of wheels and further sensors only where the slew has it."""
    return {
        channel: names
        for channel, names in columns.items()
        if not channel.startswith(("wheel", MORE)) or _has(slew, channel, _SENSORS.get(channel))
    }


def _table_of(slew: Slew, columns: dict[str, list[str]]) -> Table:
    made = {"t_s": slew.time}
    for channel, names in _columns_of(slew, columns).items():
        values = values_of(slew, channel)
        if channel == "wheel_torque" and values is not None and slew.lost_command is not None:
            values = np.where((slew.lost_command > 0)[:, None], np.nan, values)
        if values is None:
            values = np.full((len(slew.time), len(names)), np.nan)
        made |= dict(zip(names, values.T, strict=True))
    return Table.of(slew.name, made)


def _toml(campaign: Campaign, columns: dict[str, list[str]], files: list[str]) -> str:
    """The text of campaign.toml."""
    entries = {"time": _TIME}
    for channel, names in columns.items():
        key, sense, _ = _CHANNELS[channel]
        entries[key] = {"names": names, **sense}
    return toml_text(
        {
            **_head(campaign, FORMAT),
            # A wheel that is not running is said in format 2.
            "wheels": [keys_of(wheel) | {"state": None} for wheel in campaign.wheels],
            "rate_sensor": keys_of(campaign.rate_sensor),
            "star_tracker": keys_of(campaign.star_tracker),
            "columns": entries,
            "slews": [_slew(s, f, columns) for s, f in zip(campaign.slews, files, strict=True)],
        }
    )


def _slew(slew: Slew, file: str, columns: dict[str, list[str]]) -> dict[str, Any]:
    own = _columns_of(slew, columns)
    whole = len(own) == len(columns)
    return {
        "name": slew.name,
        "file": file if whole else None,
        **_slew_part(slew),
        "files": None if whole else {_CHANNELS[channel][0]: file for channel in own},
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
