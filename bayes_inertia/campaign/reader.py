"""From a campaign folder to a `Campaign` in SI units, and the digest that identifies its data."""

from __future__ import annotations

import hashlib
import math
import reprlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.channels import stream_from_table
from bayes_inertia.campaign.commands import held_commands
from bayes_inertia.campaign.csv_table import read_table
from bayes_inertia.campaign.description import parse_description
from bayes_inertia.campaign.dirt import Dirt
from bayes_inertia.campaign.hardware import RateSensor, StarTracker, Wheel
from bayes_inertia.campaign.inertia_prior import InertiaPrior
from bayes_inertia.campaign.row_order import ordered_rows
from bayes_inertia.campaign.schema import CampaignPart, ColumnsPart, SlewPart
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.campaign.streams import Stream, streams_of, union
from bayes_inertia.campaign.table import Table
from bayes_inertia.errors import CampaignError, OutputError
from bayes_inertia.files import (
    description_path,
    make_folder,
    read_bytes,
    table_path,
    text_of,
    write_atomically,
)


def read_campaign(path: str | Path) -> Campaign:
    """The campaign in a folder, checked and in SI units and radians.

    Parameters
    ----------
    path : str or Path
        A folder that holds `campaign.toml`, or the path of a description; tables lie in its folder.

    Returns
    -------
    Campaign
        The campaign.

    Raises
    ------
    CampaignError
        If anything is missing, unknown or contradictory; the error names the file, line or key.

    Examples
    --------
    >>> read_campaign("no/such/folder")
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: no/such/folder: does not exist; ...
    """
    description = description_path(path)
    parsed = parse_description(text_of(read_bytes(description), str(description)), str(description))
    tables = _table_paths(parsed, description)
    try:
        hardware = _hardware(parsed)
    except CampaignError as error:
        raise error.inside(str(description)) from None
    read = [_channels(part, tables, parsed, hardware["wheels"]) for part in parsed.slews]
    dirt = tuple(record for _, records in read for record in records)
    try:
        slews = tuple(
            _slew(part, values) for part, (values, _) in zip(parsed.slews, read, strict=True)
        )
        return Campaign(name=parsed.name, slews=slews, dirt=dirt, **hardware)
    except CampaignError as error:
        raise error.inside(str(description)) from None


def campaign_sha256(path: str | Path) -> str:
    """The digest of a campaign's description and of every table it names, in its order.

    It changes with any byte of those files, and with nothing else: not with the folder's place,
    not with other files in it.

    Parameters
    ----------
    path : str or Path
        As for `read_campaign`.

    Returns
    -------
    str
        SHA-256 as 64 hexadecimal digits.

    Raises
    ------
    CampaignError
        If the description is invalid or a table is missing.
    """
    digest = hashlib.sha256()
    for name, data in _files(path):
        # Names and lengths delimit the parts, so that no two campaigns share one stream of bytes.
        digest.update(f"{name}\0{len(data)}\0".encode())
        digest.update(data)
    return digest.hexdigest()


def copy_campaign(path: str | Path, folder: str | Path) -> Path:
    """Copy a campaign's description and the tables it names, byte for byte.

    Parameters
    ----------
    path : str or Path
        As for `read_campaign`.
    folder : str or Path
        Where to; made if absent. Identical files may be there already.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    CampaignError
        If the description is invalid or a table is missing.
    OutputError
        If the folder cannot be written, or holds a file of another content.
    """
    folder = Path(folder)
    wanted = {folder / name: data for name, data in _files(path)}
    for target, data in wanted.items():
        if target.exists() and read_bytes(target) != data:
            raise OutputError(
                "would overwrite another file",
                where=str(target),
                advice="choose another folder; nothing was overwritten",
            )
    for target, data in wanted.items():
        make_folder(target.parent)
        write_atomically(target, data)
    return folder


def _files(path: str | Path) -> list[tuple[str, bytes]]:
    description = description_path(path)
    content = read_bytes(description)
    parsed = parse_description(text_of(content, str(description)), str(description))
    tables = _table_paths(parsed, description)
    files = [file for part in parsed.slews for file in part.tables()]
    return [("campaign.toml", content), *((file, read_bytes(tables[file])) for file in files)]


def _table_paths(parsed: CampaignPart, description: Path) -> dict[str, Path]:
    """Where each table lies, by its name in the description."""
    paths: dict[str, Path] = {}
    owners: dict[Path, str] = {}
    for part in parsed.slews:
        for file in part.tables():
            key = "file" if part.files is None else "files"
            where = f"{description}, key slews.{part.name}.{key}"
            paths[file] = path = table_path(description.parent, file, where)
            # Only formats with groups can hold several slews in one file.
            single = path.suffix.lower() in (".csv", ".parquet")
            if single and owners.setdefault(path, part.name) != part.name:
                raise CampaignError(
                    f"{reprlib.repr(file)} is the table of two slews",
                    where=where,
                    advice="give each slew its own table",
                )
    return paths


def _given(part: Any) -> dict[str, Any]:
    return {
        key: value for key in type(part).model_fields if (value := getattr(part, key)) is not None
    }


def _hardware(parsed: CampaignPart) -> dict[str, Any]:
    wheels = []
    for part in parsed.wheels:
        given = _given(part)
        wheels.append(Wheel(axis_B=tuple(given.pop("axis")), **given))
    given_tracker, tracker = parsed.star_tracker, None
    if given_tracker is not None:
        x, y, z = given_tracker.boresight
        sigma_cross, sigma_roll = given_tracker.sigma_cross, given_tracker.sigma_roll
        tracker = StarTracker((x, y, z), sigma_cross, sigma_roll)
    return {
        "inertia": InertiaPrior(
            **{**_given(parsed.inertia), "tensor": np.array(parsed.inertia.tensor)}
        ),
        "wheels": tuple(wheels),
        "rate_sensor": RateSensor(**_given(parsed.rate_sensor)),
        "star_tracker": tracker,
    }


def _tables(part: SlewPart, paths: dict[str, Path], parsed: CampaignPart) -> dict[str, Table]:
    """The tables of a slew by their names in the description, with the columns that count."""
    names: dict[str, dict[str, None]] = {}
    for stream in streams_of(part, parsed.columns):
        columns = names.setdefault(stream.file, {})
        columns |= dict.fromkeys(_columns(stream, parsed.columns))
    tables = {
        file: read_table(paths[file], list(columns), group=part.name)
        for file, columns in names.items()
    }
    rows = len(tables[part.file_of("rate") or ""].columns[parsed.columns.rate.names[0]])
    if rows < 2:
        raise CampaignError(
            f"{rows} row(s) of telemetry",
            where=tables[part.file_of("rate") or ""].label,
            advice="a slew needs at least two",
        )
    return tables


def _columns(stream: Stream, columns: ColumnsPart) -> list[str]:
    """The columns of a stream, its time first."""
    names = [name for key in stream.keys for name in getattr(columns, key).names]
    return [stream.time.names[0], *names]


def _channels(
    part: SlewPart, paths: dict[str, Path], parsed: CampaignPart, wheels: tuple[Wheel, ...]
) -> tuple[dict[str, Any], list[Dirt]]:
    """Start and channels of a slew on one list of times, with a torque in every row."""
    tables = _tables(part, paths, parsed)
    spin_inertias = np.array([wheel.spin_inertia for wheel in wheels])
    readings, disorder = [], []
    for stream in streams_of(part, parsed.columns):
        time, *names = _columns(stream, parsed.columns)
        table, dirt = ordered_rows(tables[stream.file], time, names)
        readings.append(stream_from_table(table, parsed.columns, stream, spin_inertias))
        disorder += [(record, readings[-1]["time"][list(record.rows)]) for record in dirt]
    joined = union(readings, f"slews.{part.name}")
    held = held_commands(joined)
    start = part.start + float(held["time"][0] - joined["time"][0])
    records = [
        replace(record, slew=part.name, rows=_nearest_rows(held["time"], times))
        for record, times in disorder
    ]
    return {**held, "start": start}, records


def _nearest_rows(time: np.ndarray, wanted: np.ndarray) -> tuple[int, ...]:
    """The rows of increasing times (n,) that are next to other times."""
    rows = np.searchsorted(0.5 * (time[1:] + time[:-1]), wanted)
    return tuple(np.unique(rows).tolist())


def _slew(part: SlewPart, channels: dict[str, Any]) -> Slew:
    angle = None if part.angle_deg is None else math.radians(part.angle_deg)
    axis: Any = None if part.axis is None else tuple(part.axis)
    return Slew(name=part.name, axis_B=axis, angle=angle, **channels)
