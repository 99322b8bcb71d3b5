"""From raw files and a mapping to streams on one clock."""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from bayes_inertia.errors import CampaignError
from bayes_inertia.importing.attitude_forms import (
    bad_attitude,
    from_tracker_axes,
    to_quaternions,
)
from bayes_inertia.importing.common_clock import Logs, on_one_clock
from bayes_inertia.importing.file_share import SHARED_ZERO, ZERO_OF_FILE, FileShare
from bayes_inertia.importing.leap_seconds import SECOND, tai_to_utc
from bayes_inertia.importing.mapping_schema import (
    AttitudeStream,
    MappedStream,
    MappingPart,
    ReadingsStream,
    TimeStampPart,
    TorqueStream,
    ValidRows,
    WheelStream,
)
from bayes_inertia.importing.questions import question_at
from bayes_inertia.importing.raw_files import file_format, read_raw
from bayes_inertia.importing.raw_table import RawColumn, RawTable, number_of
from bayes_inertia.importing.stated_facts import agreed, agreed_attitude, agreed_unit
from bayes_inertia.importing.text_options import TextOptions
from bayes_inertia.importing.time_stamps import FREE_CLOCKS, TimeStamps, times_to_seconds
from bayes_inertia.importing.unit_factors import to_si_with

# In these a table may hold arrays of different lengths.
_ARRAY_FORMATS = ("numpy", "hdf5", "netcdf", "mat")


@dataclass(frozen=True)
class _Tables:
    """Reads each table once, although several streams may name it."""

    read: dict[tuple, RawTable] = field(default_factory=dict)

    def table(self, path: Path, stream: MappedStream) -> RawTable:
        options = TextOptions(**stream.text.model_dump())
        columns = _wanted(stream) if file_format(path) in _ARRAY_FORMATS else ()
        key = (path, stream.table, columns, options)
        if key not in self.read:
            self.read[key] = read_raw(path, table=stream.table, columns=columns, options=options)
        return self.read[key]


def _wanted(stream: MappedStream) -> tuple[str, ...]:
    """The columns that a stream names; none if it leaves some to the file."""
    flag = () if stream.valid is None else (stream.valid.name,)
    named = (stream.time.names or stream.time.rate_hz) and stream.names
    return (*stream.time.names, *stream.names, *flag) if named else ()


def read_logs(files: Sequence[str | Path], mapping: MappingPart, label: str) -> Logs:
    """All streams of a mapping, read from raw files.

    Parameters
    ----------
    files : sequence of str or Path
        The raw files, in any order.
    mapping : MappingPart
        What they hold.
    label : str
        The mapping, as messages name it.

    Returns
    -------
    Logs
        The streams.

    Raises
    ------
    CampaignError
        If no file fits a stream, a file cannot be read, a column is missing or means something
        else than the mapping says, or clocks cannot be brought together.
    """
    paths = sorted({Path(file) for file in files}, key=_natural)
    for path in paths:
        if not path.is_file():
            what = "is no file" if path.exists() else "does not exist"
            raise CampaignError(what, where=str(path), advice="name the raw logs themselves")
    tables = _Tables()
    shares: list[FileShare] = []
    used: set[Path] = set()
    for stream in mapping.streams:
        matched = files_of(stream, paths, label)
        used |= set(matched)
        where = f"{label}, key streams.{stream.holds}"
        for path in matched:
            shares.append(_read_part(stream, tables.table(path, stream), mapping, where))
    unused = tuple(path.name for path in paths if path not in used)
    return on_one_clock(shares, mapping, label, unused)


def _natural(path: Path) -> list:
    """Sorts gyro_2 before gyro_10."""
    words = re.split(r"(\d+)", path.name)
    return [(word.isdigit(), int(word) if word.isdigit() else 0, word) for word in words]


def files_of(stream: MappedStream, paths: Sequence[Path], label: str) -> list[Path]:
    """The files that a stream names.

    Parameters
    ----------
    stream : MappedStream
        The stream.
    paths : sequence of Path
        All raw files.
    label : str
        The mapping, as messages name it.

    Returns
    -------
    list of Path
        At least one.

    Raises
    ------
    CampaignError
        If there is none.
    """
    matched = [
        path
        for path in paths
        if any(fnmatch.fnmatchcase(path.name, Path(pattern).name) for pattern in stream.files)
    ]
    if not matched:
        given = ", ".join(path.name for path in paths[:20])
        raise CampaignError(
            f"no file is called {' or '.join(stream.files)}",
            where=f"{label}, key streams.{stream.holds}.files",
            advice=f"given: {given}",
        )
    return matched


def _read_part(part: MappedStream, table: RawTable, mapping: MappingPart, where: str) -> FileShare:
    """One file's readings of a stream, without rows that hold none."""
    stamps = _stamps(table, part.time, where)
    notes = list(table.notes)
    if isinstance(part, AttitudeStream):
        values = _attitudes(part, table, where)
    else:
        values = _readings(part, table, where)
    if part.valid is not None:
        invalid = ~_valid_rows(part.valid, table, where)
        values = np.where(invalid[:, None], np.nan, values)
        notes.append(f"{table.label}: {int(invalid.sum())} rows are flagged as not valid")
    if values.size == 0 or not np.isfinite(values[~stamps.missing]).any():
        raise CampaignError(
            "there is no reading at all",
            where=f"{where}, file {table.label}",
            advice="check the columns and the flag that the mapping names, or leave the file out",
        )
    if isinstance(part, WheelStream):
        values = _of_all_wheels(values, part, mapping)
    return FileShare(part, table.label, stamps, values, tuple(notes), table.lines)


def _stamps(table: RawTable, time: TimeStampPart, where: str) -> TimeStamps:
    where = f"{where}.time"
    if time.rate_hz is not None:
        return _with_epoch(_of_row_numbers(table, time, where), time, where)
    names = time.names or list(table.time_names)
    # What the file says of its time is not said of another column.
    stated = table.time_kind if names == list(table.time_names) else ""
    kind = agreed(stated, time.kind, f"{where}.kind", table.label)
    for key, value in (("names", names), ("kind", kind)):
        if not value:
            question = question_at(("streams", "time", key))
            raise CampaignError("missing key", where=f"{where}.{key}", advice=f"add it: {question}")
    stamps = _stamped(table, names, kind, time, where)
    if kind in FREE_CLOCKS:
        return _with_epoch(stamps, time, where)
    if time.epoch and kind != "cds":
        raise CampaignError(
            f"the clock {kind!r} has a zero of its own that everybody knows",
            where=f"{where}.epoch",
            advice="leave the key out",
        )
    return stamps


def _of_row_numbers(table: RawTable, time: TimeStampPart, where: str) -> TimeStamps:
    """Stamps of a log without any: its rows follow each other at the stated rate."""
    if time.names or time.kind:
        raise CampaignError(
            "a rate and columns of the time are both given",
            where=f"{where}.rate_hz",
            advice="leave names and kind out if the rows have no stamps, else rate_hz",
        )
    assert time.rate_hz is not None
    ns = np.rint(np.arange(table.rows) * (1e9 / time.rate_hz)).astype(np.int64)
    return TimeStamps(ns, np.zeros(table.rows, dtype=bool), absolute=False, resolution_s=1e-9)


def _with_epoch(stamps: TimeStamps, time: TimeStampPart, where: str) -> TimeStamps:
    """Stamps that count from a zero of their own, with the date of it where one is stated."""
    if not time.epoch:
        question = question_at(("streams", "time", "epoch"))
        raise CampaignError("missing key", where=f"{where}.epoch", advice=f"add it: {question}")
    if time.epoch in (SHARED_ZERO, ZERO_OF_FILE):
        return stamps
    zero = utc_ns(time.epoch, f"{where}.epoch")
    return replace(stamps, ns=stamps.ns + zero, absolute=True, zero_ns=zero)


def _stamped(
    table: RawTable, names: list[str], kind: str, time: TimeStampPart, where: str
) -> TimeStamps:
    try:
        return times_to_seconds(
            table,
            names,
            kind,
            units=time.units,
            form=time.format,
            gps_rollovers=time.gps_rollovers,
            first_day=_first_day(time.epoch, f"{where}.epoch") if kind == "cds" else 0,
        )
    except CampaignError as error:
        raise error.inside(where) from None


def _first_day(epoch: str, where: str) -> int:
    """Days from 1958-01-01 to the epoch of an agency."""
    if not epoch:
        return 0
    days, rest = divmod(tai_to_utc(utc_ns(epoch, where)), 86400 * SECOND)
    if rest:
        raise CampaignError(
            f"{epoch!r} is no midnight", where=where, advice='write such as "2000-01-01T00:00:00Z"'
        )
    return days


def utc_ns(text: str, where: str) -> int:
    """A date in UTC on the common scale.

    Parameters
    ----------
    text : str
        Such as "2026-03-01T12:00:00Z".
    where : str
        The key that holds it, for messages.

    Returns
    -------
    int
        Nanoseconds of TAI since 1958.

    Raises
    ------
    CampaignError
        If it is no date.

    Examples
    --------
    >>> utc_ns("1972-01-01T00:00:01Z", "epoch") - utc_ns("1972-01-01T00:00:00Z", "epoch")
    1000000000
    """
    table = RawTable(where, {"date": RawColumn(np.array([text]))})
    stamps = times_to_seconds(table, ["date"], "utc")
    if stamps.missing.any():
        raise CampaignError(
            f"{text!r} is no date", where=where, advice='write such as "2026-03-01T12:00:00Z"'
        )
    return int(stamps.ns[0])


def _readings(part: ReadingsStream, table: RawTable, where: str) -> np.ndarray:
    """Columns in SI units, torques on the wheel."""
    columns = []
    for k, name in enumerate(part.names):
        unit = agreed_unit(table, name, part.holds, part.unit, where)
        scale, offset = (v[k] if isinstance(v, list) else v for v in (part.scale, part.offset))
        numbers = table.numbers(name)
        columns.append(to_si_with(numbers, unit, part.holds, scale=scale, offset=offset))
    values = np.stack(columns, axis=1)
    # 0 - values, because -values would make zeros negative.
    return 0.0 - values if isinstance(part, TorqueStream) and part.acts_on == "body" else values


def _attitudes(part: AttitudeStream, table: RawTable, where: str) -> np.ndarray:
    """Quaternions, body from inertial, scalar last."""
    names, convention, of_tracker = agreed_attitude(table, part, where)
    values = table.stack(names)
    problem = bad_attitude(values, convention)
    if problem is not None:
        row, what = problem
        raise CampaignError(
            f"{what}: {values[row].tolist()}",
            where=f"{table.place(row, names[0])} to {names[-1]}",
            advice="repair the row, leave all its cells empty (no fix), or name other columns "
            "in the mapping",
        )
    quaternions = to_quaternions(values, convention)
    if of_tracker:
        quaternions = from_tracker_axes(quaternions, np.array(part.body_from_tracker))
    return quaternions


def _valid_rows(valid: ValidRows, table: RawTable, where: str) -> np.ndarray:
    column = table.column(valid.name)
    accepted = valid.equals if isinstance(valid.equals, list) else [valid.equals]
    if column.is_text:
        cells = np.array([str(cell).strip() for cell in column.values.tolist()])
        rows = np.isin(cells, [str(value) for value in accepted])
    else:
        numbers = [number_of(v) if isinstance(v, str) else float(v) for v in accepted]
        rows = np.isin(column.values.astype(float), numbers)
    if not rows.any():
        present = ", ".join(repr(v) for v in np.unique(column.values)[:8].tolist())
        raise CampaignError(
            f"no row has {valid.name} = {valid.equals!r}",
            where=f"{where}.valid.equals",
            advice=f"the column has {present}",
        )
    return rows


def _of_all_wheels(values: np.ndarray, part: WheelStream, mapping: MappingPart) -> np.ndarray:
    """Columns of some wheels in the order of all; NaN for the others."""
    names = [wheel.name for wheel in mapping.wheels]
    full = np.full((len(values), len(names)), np.nan)
    full[:, [names.index(name) for name in part.wheels or names]] = values
    return full
