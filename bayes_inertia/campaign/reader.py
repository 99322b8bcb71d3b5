"""From a campaign folder to a `Campaign` in SI units, and the digest that identifies its data."""

from __future__ import annotations

import json
import math
import reprlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.commands import with_known_torques, without_impossible_torques
from bayes_inertia.campaign.hardware import InertiaPrior, RateSensor, StarTracker, Wheel
from bayes_inertia.campaign.inspection import with_dirt_masked
from bayes_inertia.campaign.limits import LIMITS
from bayes_inertia.campaign.prior import COPY_FILE, GaussianPrior, prior_in
from bayes_inertia.campaign.schema import CampaignPart, ColumnsPart, SlewPart, parse_description
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.campaign.slew_parts import located, parts_of, with_known_momentum
from bayes_inertia.campaign.streams import (
    Stream,
    StreamRows,
    counted_once,
    on_their_clocks,
    stream_from_table,
    streams_of,
    union,
)
from bayes_inertia.errors import CampaignError, OutputError
from bayes_inertia.faults.fault import Dirt
from bayes_inertia.faults.row_order import ordered_rows
from bayes_inertia.files import (
    description_path,
    make_folder,
    read_bytes,
    table_path,
    text_of,
    write_atomically,
)
from bayes_inertia.sealing import sha256_of
from bayes_inertia.tables.number_table import Table, read_table

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
    return with_known_momentum(with_dirt_masked(read_unmasked(path)))


def read_unmasked(path: str | Path, *, keep_commands: bool = False) -> Campaign:
    """The campaign in a folder with every reading as it was written, believable or not.

    `keep_commands`: whether commands with gaps are kept although tachometers make them unnecessary.
    Returns: the campaign before impossible and stuck readings are masked.
    """
    description = description_path(path)
    label = str(description)
    parsed = parse_description(text_of(read_bytes(description), label), label)
    paths = _table_paths(parsed, description)

    def table(file: str, names: Sequence[str], slew: str) -> Table:
        return read_table(paths[file], names, group=slew)

    campaign = _assembled(parsed, label, table, keep_commands)
    return replace(campaign, prior=_prior(parsed, description))


def _prior(parsed: CampaignPart, description: Path) -> GaussianPrior | None:
    """The prior that a description names: a copy beside it, or what lies where it points."""
    if parsed.prior is None:
        return None
    copied = description.parent / COPY_FILE
    if copied.is_file():
        return prior_in(copied)
    try:
        prior = prior_in(description.parent / parsed.prior.from_)
    except CampaignError as error:
        raise error.inside(f"{description}, key prior.from") from None
    return prior if parsed.prior.inflate is None else prior.inflated(parsed.prior.inflate.relative)


def campaign_of(description: str, label: str, tables: Mapping[str, Table]) -> Campaign:
    """The campaign that a folder with this description and these tables is; nothing is written."""
    parsed = parse_description(description, label)
    unmasked = _assembled(parsed, label, lambda file, names, _: tables[file].only(names))
    return with_known_momentum(with_dirt_masked(unmasked))


def _assembled(
    parsed: CampaignPart, label: str, table: _TableReader, keep_commands: bool = False
) -> Campaign:
    """The campaign of a description, whose tables are asked for by file, columns and slew."""
    try:
        hardware = _hardware(parsed)
    except CampaignError as error:
        raise error.inside(label) from None
    slews, dirt = [], []
    unplaced = [_streams(part, table, parsed) for part in parsed.slews]
    streams = on_their_clocks(counted_once(unplaced, parsed.columns), parsed.columns)
    for part, of_slew in zip(parsed.slews, streams, strict=True):
        channels, records = _channels(part, of_slew, parsed, hardware["wheels"])
        try:
            parts, unknown = _slews(part, channels, hardware, keep_commands)
        except CampaignError as error:
            raise error.inside(label) from None
        slews += parts
        dirt += located(records + unknown, parts)
    stated = {} if parsed.mission is None else parsed.mission.model_dump(exclude_none=True)
    hardware |= {"slews": tuple(slews), "dirt": tuple(dirt), "mission": tuple(stated.items())}
    try:
        return Campaign(name=parsed.name, **hardware)
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
    read = [("campaign.toml", content), *((file, read_bytes(tables[file])) for file in files)]
    prior = _prior(parsed, description)
    # Where the run lies, or whether it changes, does not matter to a copy.
    return read if prior is None else [*read, (COPY_FILE, json.dumps(prior.json()).encode())]


def _table_paths(parsed: CampaignPart, description: Path) -> dict[str, Path]:
    """Path of each table, by its name in the description."""
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
    tracker = None
    if parsed.star_tracker is not None:
        given = _given(parsed.star_tracker)
        tracker = StarTracker(tuple(given.pop("boresight")), **given)
    return {
        "inertia": InertiaPrior(
            **{**_given(parsed.inertia), "tensor": np.array(parsed.inertia.tensor)}
        ),
        "wheels": tuple(wheels),
        "rate_sensor": RateSensor(**_given(parsed.rate_sensor)),
        "star_tracker": tracker,
    }


def _tables(part: SlewPart, table: _TableReader, parsed: CampaignPart) -> dict[str, Table]:
    """The tables of a slew by their names in the description, with the columns that count."""
    names: dict[str, dict[str, None]] = {}
    for stream in streams_of(part, parsed.columns):
        columns = names.setdefault(stream.file, {})
        columns |= dict.fromkeys(_columns(stream, parsed.columns))
    tables = {file: table(file, list(columns), part.name) for file, columns in names.items()}
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


def _streams(part: SlewPart, table: _TableReader, parsed: CampaignPart) -> list[StreamRows]:
    """The streams of a slew, their rows in the order of time."""
    tables = _tables(part, table, parsed)
    streams = []
    for stream in streams_of(part, parsed.columns):
        time, *names = _columns(stream, parsed.columns)
        rows, dirt = ordered_rows(tables[stream.file], time, names)
        streams.append(StreamRows(stream, rows, tuple(dirt)))
    return streams


def _channels(
    part: SlewPart,
    streams: Sequence[StreamRows],
    parsed: CampaignPart,
    wheels: tuple[Wheel, ...],
) -> tuple[dict[str, np.ndarray], list[_TimedDirt]]:
    """The channels of a slew on one list of times, and faults of its rows with their times."""
    spin_inertias = np.array([wheel.spin_inertia for wheel in wheels])
    readings, disorder = [], []
    for rows in streams:
        readings.append(stream_from_table(rows.table, parsed.columns, rows.stream, spin_inertias))
        disorder += [(record, readings[-1]["time"][list(record.rows)]) for record in rows.dirt]
    return union(readings, f"slews.{part.name}"), disorder


def _slews(
    part: SlewPart,
    channels: dict[str, np.ndarray],
    hardware: dict[str, Any],
    keep_commands: bool,
) -> tuple[list[Slew], list[_TimedDirt]]:
    """The slew, or its parts where it must be cut."""
    momentum = channels.get("wheel_momentum")
    is_read = momentum is not None and bool(np.isfinite(momentum).any(axis=0).all())
    is_read = is_read and all(w.momentum_sigma is not None for w in hardware["wheels"])
    channels, dirt = without_impossible_torques(channels, hardware["wheels"])
    limit = _negligible_impulse(channels["time"], hardware)
    pieces, unknown = with_known_torques(channels, is_read and not keep_commands, limit)
    angle = None if part.angle_deg is None else math.radians(part.angle_deg)
    axis: Any = None if part.axis is None else tuple(part.axis)
    whole = Slew(part.name, part.start, channels["time"], axis_B=axis, angle=angle)
    return parts_of(whole, pieces), dirt + unknown


def _negligible_impulse(time: np.ndarray, hardware: dict[str, Any]) -> float:
    """An error of the wheels' momentum that rates and attitude cannot tell [N m s]."""
    inertia = float(np.linalg.eigvalsh(hardware["inertia"].tensor)[0])
    rate = LIMITS.negligible_of_rate_noise * min(hardware["rate_sensor"].sigma)
    tracker = hardware["star_tracker"]
    if tracker is not None:
        duration = max(float(time[-1] - time[0]), LIMITS.shortest_slew)
        rate = min(rate, LIMITS.negligible_of_attitude_noise * tracker.sigma_cross / duration)
    return inertia * rate
