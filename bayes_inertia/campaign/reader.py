"""From a campaign folder to a `Campaign` in SI units, and the digest that identifies its data."""

from __future__ import annotations

import json
import math
import reprlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bayes_inertia import errors
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.commands import with_known_torques, without_impossible_torques
from bayes_inertia.campaign.description import AS_CAMPAIGN, Description
from bayes_inertia.campaign.environment import slews_with_orbit
from bayes_inertia.campaign.format_2 import SlewPart
from bayes_inertia.campaign.hardware import attitude_noise, rate_noise, require_key
from bayes_inertia.campaign.inputs import InputStream
from bayes_inertia.campaign.inspection import with_dirt_masked
from bayes_inertia.campaign.limits import LIMITS
from bayes_inertia.campaign.parsed_description import parse_description
from bayes_inertia.campaign.prior import COPY_FILE, GaussianPrior, prior_from_json, prior_in
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.campaign.slew_parts import MORE, located, parts_of, with_known_momentum
from bayes_inertia.campaign.streams import (
    StreamRows,
    counted_once,
    inputs_of,
    on_their_clocks,
    require_beside_rates,
    stream_from_table,
    streams_of,
    union,
)
from bayes_inertia.errors import CampaignError
from bayes_inertia.faults.fault import Dirt
from bayes_inertia.faults.row_order import ordered_rows
from bayes_inertia.files import description_path, read_bytes, table_path, text_of, write_new_files
from bayes_inertia.sealing import sha256_of
from bayes_inertia.tables.number_table import read_table
from bayes_inertia.tables.table import Table

# Channels of a wheel that are zero where nothing is recorded.
_ZERO_OF_STATE = {"free": ("wheel_torque",), "locked": ("wheel_torque", "wheel_momentum")}
# A record without rows, and the times [s] that it concerns.
_TimedDirt = tuple[Dirt, np.ndarray]
# The wanted columns of the table of a file and a slew.
_TableReader = Callable[[str, Sequence[str], str], Table]


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
    return with_fewest_cuts(lambda keep: read_unmasked(path, keep_commands=keep))


def with_fewest_cuts(written: Callable[[bool], Campaign]) -> Campaign:
    """The campaign that tachometers drive where commands are lost, unless that cuts more slews.

    `written`: it with every reading, by whether commands with gaps are kept. A message that holds
    torques and speeds takes both along where it is lost.
    """
    measured = written(False)
    whole, masked = len(measured.slews), with_known_momentum(with_dirt_masked(measured))
    if len(masked.slews) <= whole:
        return masked
    commanded = with_dirt_masked(written(True))
    better = commanded.has_commands and len(commanded.slews) <= whole
    return commanded if better and _rows(commanded) >= _rows(masked) else masked


def _rows(campaign: Campaign) -> int:
    return sum(len(slew.time) for slew in campaign.slews)


def read_unmasked(path: str | Path, *, keep_commands: bool = False) -> Campaign:
    """The campaign in a folder with every reading as it was written, believable or not.

    `keep_commands`: whether commands with gaps are kept where tachometers make them unnecessary.
    """
    description = description_path(path)
    label = str(description)
    parsed = parse_description(text_of(read_bytes(description), label), label)
    paths = _table_paths(parsed, description)

    def table(file: str, names: Sequence[str], slew: str) -> Table:
        return read_table(paths[file], names, group=slew)

    campaign = _assembled(parsed, label, table, keep_commands, _orbit_path(parsed, description))
    return replace(campaign, prior=_prior(parsed, description))


def _prior(parsed: Description, description: Path) -> GaussianPrior | None:
    """The prior that a description states, or that lies beside it or where it points."""
    part = parsed.prior
    if part is None:
        return None
    stated, label = part.stated(), f"{description}, key prior"
    once = (part.from_ is None) == bool(stated)
    advice = "give from, or principal_moments, or names with mean and covariance"
    errors.require(once, label, "it says nothing, or two things", advice)
    copied = description.parent / COPY_FILE
    if part.from_ is not None and copied.is_file():
        return prior_in(copied)
    try:
        prior = (
            prior_from_json(stated, label)
            if part.from_ is None
            else prior_in(description.parent / part.from_)
        )
    except CampaignError as error:
        raise (error.inside(f"{label}.from") if part.from_ else error) from None
    return prior if part.inflate is None else prior.inflated(part.inflate.relative)


def campaign_of(description: str, label: str, tables: Mapping[str, Table]) -> Campaign:
    """The campaign that a folder with this description and these tables is; nothing is written."""
    return with_fewest_cuts(partial(unmasked_of, description, label, tables))


def unmasked_of(
    description: str, label: str, tables: Mapping[str, Table], keep_commands: bool = False
) -> Campaign:
    """The same with every reading, believable or not."""
    parsed = parse_description(description, label)

    def table(file: str, names: Sequence[str], _: str) -> Table:
        return tables[file].only(names)

    return _assembled(parsed, label, table, keep_commands)


def _assembled(
    parsed: Description,
    label: str,
    table: _TableReader,
    keep_commands: bool = False,
    orbit: Path | None = None,
) -> Campaign:
    """The campaign of a description, whose tables are asked for by file, columns and slew."""
    slews, dirt = [], []
    unplaced = [rows for k in range(len(parsed.slews)) for rows in _streams(k, table, parsed)]
    require_beside_rates(unplaced)
    streams = on_their_clocks(counted_once(unplaced))
    for k, part in enumerate(parsed.slews):
        of_slew = [rows for rows in streams if rows.slew == k]
        channels, records = _channels(part, of_slew, parsed)
        try:
            parts, unknown = _slews(part, channels, inputs_of(of_slew), parsed, keep_commands)
        except CampaignError as error:
            raise error.inside(label) from None
        slews += parts
        dirt += located(records + unknown, parts)
    if parsed.orbit is not None and orbit is not None:
        where = f"{label}, key environment.orbit.epoch"
        slews = list(slews_with_orbit(slews, orbit, parsed.orbit[1], where))
    try:
        said = {key: getattr(parsed, key) for key in AS_CAMPAIGN}
        return Campaign(slews=tuple(slews), dirt=tuple(dirt), **said)
    except CampaignError as error:
        raise error.inside(label) from None


def campaign_sha256(path: str | Path) -> str:
    """The digest of a campaign's description and of every table it names, in its order.

    It changes with any byte of those files, and with nothing else: not with the folder's place,
    not with other files in it.
    """
    # Names and lengths delimit the parts, so that no two campaigns share one stream of bytes.
    parts = ((f"{name}\0{len(data)}\0", data) for name, data in _files(path))
    return sha256_of(*(piece for part in parts for piece in part))


def copy_campaign(path: str | Path, folder: str | Path) -> Path:
    """Copy a campaign's description and the tables it names, byte for byte.

    `folder`: where to; made if absent. Identical files may be there already.
    """
    return write_new_files(folder, dict(_files(path)), holds="file")


def _files(path: str | Path) -> list[tuple[str, bytes]]:
    description = description_path(path)
    content = read_bytes(description)
    parsed = parse_description(text_of(content, str(description)), str(description))
    tables = _table_paths(parsed, description)
    files = [file for part in parsed.slews for file in parsed.tables(part)]
    read = [("campaign.toml", content), *((file, read_bytes(tables[file])) for file in files)]
    if parsed.orbit is not None and (orbit := _orbit_path(parsed, description)) is not None:
        read.append((parsed.orbit[0], read_bytes(orbit)))
    if parsed.prior is None or parsed.prior.from_ is None:
        return read
    prior = _prior(parsed, description)
    assert prior is not None
    # Where the run lies, or whether it changes, does not matter to a copy.
    return [*read, (COPY_FILE, json.dumps(prior.json()).encode())]


def _orbit_path(parsed: Description, description: Path) -> Path | None:
    """The file of two-line elements, if there is one."""
    if parsed.orbit is None:
        return None
    return table_path(description.parent, parsed.orbit[0], f"{description}, key environment.tle")


def _table_paths(parsed: Description, description: Path) -> dict[str, Path]:
    """Path of each table, by its name in the description."""
    paths: dict[str, Path] = {}
    owners: dict[Path, str] = {}
    for part in parsed.slews:
        for file in parsed.tables(part):
            key = "file" if part.files is None else "files"
            where = f"{description}, key slews.{part.name}.{key}"
            paths[file] = path = table_path(description.parent, file, where)
            # Only formats with groups can hold several slews in one file.
            single = path.suffix.lower() in (".csv", ".parquet")
            alone = not single or owners.setdefault(path, part.name) == part.name
            what = f"{reprlib.repr(file)} is the table of two slews"
            errors.require(alone, where, what, "give each slew its own table")
    return paths


def _streams(slew: int, table: _TableReader, parsed: Description) -> list[StreamRows]:
    """The streams of a slew, their rows in the order of time."""
    part = parsed.slews[slew]
    given = streams_of(part, parsed)
    names: dict[str, dict[str, None]] = {}
    for stream in given:
        names.setdefault(stream.file, {}).update(dict.fromkeys(stream.columns))
    tables = {file: table(file, list(columns), part.name) for file, columns in names.items()}
    first = min(given, key=lambda stream: all(entry.field != "rate" for entry in stream.entries))
    rated = tables[first.file]
    what, advice = f"{rated.rows} row(s) of telemetry", "a slew needs at least two"
    errors.require(rated.rows >= 2, rated.label, what, advice)
    streams = []
    for stream in given:
        time, *columns = stream.columns
        rows, dirt = ordered_rows(tables[stream.file], time, columns)
        streams.append(StreamRows(slew, stream, rows, tuple(dirt)))
    return streams


def _channels(
    part: SlewPart, streams: Sequence[StreamRows], parsed: Description
) -> tuple[dict[str, np.ndarray], list[_TimedDirt]]:
    """The channels of a slew on one list of times, and faults of its rows with their times."""
    spin_inertias = np.array([wheel.spin_inertia for wheel in parsed.wheels])
    readings, disorder = [], []
    for rows in streams:
        of_stream = stream_from_table(rows.table, rows.stream, spin_inertias)
        disorder += [(record, of_stream["time"][list(record.rows)]) for record in rows.dirt]
        # What only tells what devices did has times of its own.
        readings += [] if rows.stream.is_input else [of_stream]
    channels = union(readings, f"slews.{part.name}")
    for k, wheel in enumerate(parsed.wheels):
        # No motor drives these, and what is locked has no momentum of its own.
        for name in _ZERO_OF_STATE.get(wheel.state, ()):
            if name in channels and np.isnan(channels[name][:, k]).all():
                told = np.isfinite(channels[name]).any(axis=1)
                channels[name][told, k] = 0.0
        torque = channels.get("wheel_torque")
        driven = torque is not None and bool(np.nan_to_num(torque[:, k]).any())
        what, key = f"{wheel.name} spins freely, and is commanded", f"slews.{part.name}"
        advice = 'leave its commands out, or say state = "running"'
        require_key(wheel.state != "free" or not driven, key, what, advice)
    return channels, disorder


def _slews(
    part: SlewPart,
    channels: dict[str, np.ndarray],
    inputs: dict[str, InputStream],
    parsed: Description,
    keep_commands: bool,
) -> tuple[list[Slew], list[_TimedDirt]]:
    """The slew, or its parts where it must be cut."""
    momentum = channels.get("wheel_momentum")
    running = [k for k, wheel in enumerate(parsed.wheels) if wheel.state != "locked"]
    is_read = momentum is not None and bool(np.isfinite(momentum[:, running]).any(axis=0).all())
    is_read = is_read and all(parsed.wheels[k].momentum_sigma is not None for k in running)
    channels, dirt = without_impossible_torques(channels, parsed.wheels)
    limit = _negligible_impulse(channels, parsed)
    pieces, unknown = with_known_torques(channels, is_read and not keep_commands, limit)
    angle = None if part.angle_deg is None else math.radians(part.angle_deg)
    axis: Any = None if part.axis is None else tuple(part.axis)
    whole = Slew(
        part.name, part.start, channels["time"], axis_B=axis, angle=angle, inputs=inputs or None
    )
    return parts_of(whole, pieces), dirt + unknown


def _negligible_impulse(channels: Mapping[str, np.ndarray], parsed: Description) -> float:
    """An error of what the wheels store that no reading of the motion can tell [N m s]."""
    inertia = float(np.linalg.eigvalsh(parsed.inertia.tensor)[0])
    seen: list[tuple[Any, list]] = [(parsed.rate_sensor, []), (parsed.star_tracker, [])]
    for name, sensor in parsed.more_sensors:
        seen.append((sensor, [channels[MORE + name]] if MORE + name in channels else []))
    time = channels["time"]
    duration = max(float(time[-1] - time[0]), LIMITS.shortest_slew)
    return inertia * min(
        LIMITS.negligible_of_rate_noise * rate_noise(sensor for sensor, _ in seen),
        LIMITS.negligible_of_attitude_noise * attitude_noise(seen) / duration,
    )
