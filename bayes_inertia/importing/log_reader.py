"""From raw files and a mapping to streams on one clock."""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bayes_inertia.errors import CampaignError, require
from bayes_inertia.importing.common_clock import Logs, on_one_clock
from bayes_inertia.importing.limits import LIMITS
from bayes_inertia.importing.logged_stream import SHARED_ZERO, ZERO_OF_FILE, FileShare
from bayes_inertia.importing.mapping_schema import (
    AttitudeStream,
    MappedStream,
    MappingPart,
    TimeStampPart,
    WheelStream,
)
from bayes_inertia.importing.questions import require_answer
from bayes_inertia.importing.stream_readings import agreed, readings_of, standing_mark
from bayes_inertia.progress import Progress, silent
from bayes_inertia.tables.raw_files import file_format, read_raw
from bayes_inertia.tables.stamp_parts import SECOND, tai_to_utc
from bayes_inertia.tables.table import Column, Table
from bayes_inertia.tables.text_cells import TextOptions
from bayes_inertia.tables.time_stamps import FREE_CLOCKS, TimeStamps, times_to_seconds

# In these a table may hold arrays of different lengths.
_ARRAY_FORMATS = ("numpy", "hdf5", "netcdf", "mat", "ulog", "bag")


def _table(path: Path, stream: MappedStream, read: dict[tuple, Table]) -> Table:
    """The table of a stream, read once although several streams may name it."""
    options = TextOptions(**stream.text.model_dump())
    columns = _wanted(stream) if file_format(path) in _ARRAY_FORMATS else ()
    key = (path, stream.table, columns, options)
    if key not in read:
        read[key] = read_raw(path, table=stream.table, columns=columns, options=options)
    return read[key]


def _wanted(stream: MappedStream) -> tuple[str, ...]:
    """The columns that a stream names; none if it leaves some to the file."""
    flag = () if stream.valid is None else (stream.valid.name,)
    named = (stream.time.names or stream.time.rate_hz) and stream.names
    return (*stream.time.names, *stream.names, *flag) if named else ()


def require_files(paths: Sequence[Path]) -> None:
    """Raise unless all raw logs are files."""
    for path in paths:
        what = "is a folder" if path.is_dir() else "is no file" if path.exists() else "is not there"
        advice = "name the raw logs themselves"
        advice += ", such as the .db3 or .mcap in a ROS 2 bag" if path.is_dir() else ""
        require(path.is_file(), str(path), what, advice)


def read_logs(
    files: Sequence[str | Path], mapping: MappingPart, label: str, say: Progress = silent
) -> Logs:
    """All streams of a mapping, read from raw files."""
    paths = sorted({Path(file) for file in files}, key=_natural)
    require_files(paths)
    tables: dict[tuple, Table] = {}
    shares: list[FileShare] = []
    used: dict[Path, list[MappedStream]] = {}
    for stream in mapping.streams:
        matched = files_of(stream, paths, label)
        where = f"{label}, key streams.{stream.holds}"
        read = []
        for path in matched:
            _refuse_second_use(stream, used.setdefault(path, []), path, where)
            used[path].append(stream)
            say("reading the logs, files", len(used) - 1, len(paths))
            read.append(_read_part(stream, _table(path, stream, tables), where))
        _refuse_no_reading(stream, read, where)
        if stream.holds == "rate":
            _refuse_few_rates(stream, read, mapping)
        shares += [_of_all_wheels(share, mapping) for share in read]
    unused = tuple(path.name for path in paths if path not in used)
    return on_one_clock(shares, mapping, label, unused)


def _natural(path: Path) -> list:
    """Sorts gyro_2 before gyro_10."""
    words = re.split(r"(\d+)", path.name)
    return [(word.isdigit(), int(word) if word.isdigit() else 0, word) for word in words]


def files_of(stream: MappedStream, paths: Sequence[Path], label: str) -> list[Path]:
    """The files that a stream names."""
    wanted = [Path(pattern).name for pattern in stream.files]
    matched = [p for p in paths if any(fnmatch.fnmatchcase(p.name, name) for name in wanted)]
    advice = f"given: {', '.join(path.name for path in paths[:20])}"
    what = f"no file is called {' or '.join(stream.files)}"
    require(bool(matched), f"{label}, key streams.{stream.holds}.files", what, advice)
    return matched


def _refuse_second_use(
    stream: MappedStream, others: Sequence[MappedStream], path: Path, where: str
) -> None:
    """Refuse a column that another stream reads from the same rows of the same table."""
    # Streams that flag other rows as theirs may share a column.
    rows = {"table", "valid", "text"}
    for other in others:
        shared = next((name for name in stream.names if name in other.names), None)
        same_rows = stream.model_dump(include=rows) == other.model_dump(include=rows)
        what = f"the column {shared!r} of {path.name} is that of {other.holds} already"
        advice = "name for each quantity the column that holds it"
        require(shared is None or not same_rows, f"{where}.names", what, advice)


def _read_part(part: MappedStream, table: Table, where: str) -> FileShare:
    """One file's readings of a stream; NaN where a row holds none."""
    stamps = _stamps(table, part.time, where)
    values, rounding, said = readings_of(part, table, where)
    notes = [*table.notes, *(f"{table.label}: {note}" for note in said)]
    if isinstance(part, AttitudeStream):
        marks = standing_mark(values, stamps.seconds_since(stamps.first_ns))
        values = np.where(marks[:, None], np.nan, values)
        if marks.any():
            note = f"{marks.sum()} rows, as row {np.argmax(marks) + 1}, hold one attitude to which "
            notes.append(f"{table.label}: {note}others jump and back: no fix")
    place = f"{table.label}, column {', '.join(part.time.names or table.time_names)}"
    advice = "export the times with the readings, or name the column that holds them"
    given = not stamps.missing.all() or not len(stamps.missing)
    require(given, place, "every cell is empty", advice)
    return FileShare(part, table.label, stamps, values, rounding, tuple(notes), table.lines)


def _refuse_no_reading(part: MappedStream, shares: Sequence[FileShare], where: str) -> None:
    """Refuse a stream of which a column, or a whole file, holds no reading at all."""
    given = [np.isfinite(share.values[~share.stamps.missing]) for share in shares]
    empty = [share for share, rows in zip(shares, given, strict=True) if not rows.any()]
    columns = list(part.names) or ["of the attitude"]
    of_fixes = isinstance(part, AttitudeStream)
    # A tracker may see no star for a whole file; of other files more is wanted than nothing.
    if not empty or (of_fixes and len(empty) < len(shares)):
        full = np.any([rows.any(axis=0) for rows in given], axis=0)
        columns = [] if of_fixes else [n for n, f in zip(columns, full, strict=True) if not f]
        empty = list(shares)
    what = "there is no reading at all: every cell is empty, flagged or marked"
    advice = part.advice_if_empty.format(where=where, holds=part.holds)
    require(not columns, _columns_in(empty, columns), what, advice)


def _columns_in(shares: Sequence[FileShare], names: Sequence[str]) -> str:
    """Files and some of their columns, for a message."""
    files = ", ".join(share.file for share in shares)
    return f"{files}, column{'s' * (len(names) > 1)} {', '.join(names)}"


def _refuse_few_rates(
    part: MappedStream, shares: Sequence[FileShare], mapping: MappingPart
) -> None:
    """Refuse rates that are too few for a slew."""
    a_slew_each = len(shares) > 1 and mapping.cut.by not in ("rest", "gaps") and not mapping.slews
    for together in [[share] for share in shares] if a_slew_each else [shares]:
        counts = np.sum([np.isfinite(share.values).sum(axis=0) for share in together], axis=0)
        few = [n for n, c in zip(part.names, counts, strict=True) if c < LIMITS.fewest_rates]
        what = f"{counts.min()} reading{'' if counts.min() == 1 else 's'} only"
        advice = "give the rates of whole slews: was the sensor off, or the export cut?"
        require(not few, _columns_in(together, few), what, advice)


def _stamps(table: Table, time: TimeStampPart, where: str) -> TimeStamps:
    where = f"{where}.time"
    if time.rate_hz is not None:
        return _with_epoch(_of_row_numbers(table, time, where), time, where)
    names = time.names or list(table.time_names)
    # What the file says of its time is not said of another column.
    stated = table.time_kind if names == list(table.time_names) else ""
    kind = agreed(stated, time.kind, f"{where}.kind", table.label)
    for key, value in (("names", names), ("kind", kind)):
        require_answer(value, ("streams", "time", key), where)
    first_day = _first_day(time.epoch, f"{where}.epoch") if kind == "cds" else 0
    try:
        stamps = times_to_seconds(
            table,
            names,
            kind,
            units=time.units,
            form=time.format,
            gps_rollovers=time.gps_rollovers,
            first_day=first_day,
        )
    except CampaignError as error:
        raise error.inside(where) from None
    if kind in FREE_CLOCKS:
        return _with_epoch(stamps, time, where)
    what = f"the clock {kind!r} has a zero of its own that everybody knows"
    require(not time.epoch or kind == "cds", f"{where}.epoch", what, "leave the key out")
    return stamps


def _of_row_numbers(table: Table, time: TimeStampPart, where: str) -> TimeStamps:
    """Stamps of a log without any: its rows follow each other at the stated rate."""
    what = "a rate and columns of the time are both given"
    advice = "leave names and kind out if the rows have no stamps, else rate_hz"
    require(not (time.names or time.kind), f"{where}.rate_hz", what, advice)
    assert time.rate_hz is not None
    ns = np.rint(np.arange(table.rows) * (1e9 / time.rate_hz)).astype(np.int64)
    return TimeStamps(ns, np.zeros(table.rows, dtype=bool), absolute=False, resolution_s=1e-9)


def _with_epoch(stamps: TimeStamps, time: TimeStampPart, where: str) -> TimeStamps:
    """Stamps that count from a zero of their own, with the date of it where one is stated."""
    require_answer(time.epoch, ("streams", "time", "epoch"), where)
    if time.epoch in (SHARED_ZERO, ZERO_OF_FILE):
        return stamps
    zero = utc_ns(time.epoch, f"{where}.epoch")
    return replace(stamps, ns=stamps.ns + zero, absolute=True, zero_ns=zero)


def _first_day(epoch: str, where: str) -> int:
    """Days from 1958-01-01 to the epoch of an agency."""
    if not epoch:
        return 0
    days, rest = divmod(tai_to_utc(utc_ns(epoch, where)), 86400 * SECOND)
    require(rest == 0, where, f"{epoch!r} is no midnight", 'write such as "2000-01-01T00:00:00Z"')
    return days


def utc_ns(text: str, where: str) -> int:
    """A date in UTC on the common scale."""
    table = Table(where, {"date": Column(np.array([text]))})
    stamps = times_to_seconds(table, ["date"], "utc")
    advice = 'write such as "2026-03-01T12:00:00Z"'
    require(not stamps.missing.any(), where, f"{text!r} is no date", advice)
    return int(stamps.ns[0])


def _of_all_wheels(share: FileShare, mapping: MappingPart) -> FileShare:
    """Columns of some wheels in the order of all; NaN for the others."""
    if not isinstance(share.stream, WheelStream):
        return share
    names = mapping.wheels_of()
    columns = [names.index(name) for name in mapping.wheels_of(share.stream)]
    values, rounding = np.full((len(share.values), len(names)), np.nan), np.zeros(len(names))
    values[:, columns], rounding[columns] = share.values, share.rounding
    return replace(share, values=values, rounding=tuple(rounding.tolist()))
