"""From a `Campaign` to a campaign folder that reads back as the same numbers."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.description import keys_of
from bayes_inertia.campaign.prior import COPY_FILE
from bayes_inertia.campaign.schema import FORMAT, FORMAT_2
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.campaign.written_devices import (
    Written,
    devices,
    input_tables,
    needs_format_2,
    streams_for,
    written_channels,
)
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
    channels = written_channels(campaign)
    if needs_format_2(campaign):
        return _content_2(campaign, channels)
    files = numbered(len(campaign.slews), "slew_{}.csv")
    slews = list(zip(campaign.slews, files, strict=True))
    parts = {
        **_head(campaign, FORMAT),
        # A wheel that is not running is said in format 2.
        "wheels": [keys_of(wheel) | {"state": None} for wheel in campaign.wheels],
        "rate_sensor": keys_of(campaign.rate_sensor),
        "star_tracker": keys_of(campaign.star_tracker),
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
    parts = {
        **_head(campaign, FORMAT_2),
        "time": _TIME,
        **devices(campaign, channels, streams),
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


def _table_of(slew: Slew, channels: Sequence[Written]) -> Table:
    made = {"t_s": slew.time}
    for channel in (channel for channel in channels if channel.in_table(slew)):
        values = channel.values(slew)
        if (
            channel.channel == "wheel_torque"
            and values is not None
            and slew.lost_command is not None
        ):
            values = np.where((slew.lost_command > 0)[:, None], np.nan, values)
        if values is None:
            values = np.full((len(slew.time), len(channel.names)), np.nan)
        made |= dict(zip(channel.names, values.T, strict=True))
    return Table.of(slew.name, made)


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
