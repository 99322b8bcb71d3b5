"""One quantity of a raw log: its share in a file, and on the common clock in SI units."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bayes_inertia.errors import CampaignError
from bayes_inertia.faults.gaps import is_regular
from bayes_inertia.faults.row_order import joined_rows, late_rows, mended_stamps, set_back_row
from bayes_inertia.importing.limits import LIMITS
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.tables.table import row_name
from bayes_inertia.tables.time_stamps import TimeStamps

SHARED_ZERO = "campaign"
"""The `epoch` of clocks that share one unknown zero."""
ZERO_OF_FILE = "file"
"""The `epoch` of clocks that start anew in each file."""


@array_dataclass
class FileShare:
    """One file's share of a stream, its stamps not yet on the common clock."""

    stream: Any  # The `[[streams]]` of the mapping
    file: str  # The file, as messages name it
    stamps: TimeStamps  # The stamp of each row
    # (rows, width): readings in SI units and the package's senses; NaN where there is none
    values: np.ndarray
    # Standard deviation of the rounding in the file, as of `LoggedStream`
    rounding: tuple[float, ...]
    notes: tuple[str, ...] = ()  # What a user should know of the file
    # (rows,) of int: lines as a text editor shows them; None for files without lines
    lines: np.ndarray | None = None

    @property
    def counts(self) -> np.ndarray:
        """Stamps of the rows that have one, from the clock's own zero [ns]."""
        return self.stamps.ns[~self.stamps.missing] - self.stamps.zero_ns

    def place(self, row: int) -> str:
        """Place of a row, for a message."""
        return f"{self.file}, {row_name(self.lines, row)}"


@array_dataclass
class LoggedStream:
    """Readings of one quantity at their own times, from all the files that hold it."""

    # "rate", "wheel_torque", "wheel_momentum", "wheel_speed", "attitude", "magnetic_field" or
    # "position"
    holds: str
    # (n,): time of each reading on the clock of the import [s], strictly increasing within a file
    time: np.ndarray
    # (n, width): in SI units and radians: torques on the wheels; quaternions body from inertial,
    # scalar last; rates along the axes of the sensor. NaN where an element has no reading.
    values: np.ndarray
    file: np.ndarray  # (n,) of int: from which of `files` each row is
    files: tuple[str, ...]  # The files, as messages name them
    notes: tuple[str, ...] = ()  # What was sorted, dropped or taken from the files, for people
    # Standard deviation of the rounding of each element in the files; one number of attitudes,
    # about any axis [rad]
    rounding: tuple[float, ...] = (0.0,)
    overlap: bool = False  # Whether files repeat rows of each other, as downloads of one log do

    @property
    def step(self) -> float:
        """Median time between readings [s]; 0 for fewer than two."""
        return float(np.median(np.diff(self.time))) if len(self.time) > 1 else 0.0

    def rows(self, keep: np.ndarray, *notes: str) -> LoggedStream:
        """The same stream with some of its rows (n,) only."""
        kept = {key: getattr(self, key)[keep] for key in ("time", "values", "file")}
        return replace(self, notes=(*self.notes, *notes), **kept)

    def between(self, start: float, end: float) -> LoggedStream:
        """The readings from one time to another [s], both included."""
        return self.rows((self.time >= start) & (self.time <= end))


def left_out(count: int, rows: int, why: str, *, where: str, advice: str) -> str:
    """The note that rows are left out, or an error if they are more than damage would explain."""
    what = f"{count} of {rows} rows {why}"
    if count > max(1.0, LIMITS.most_left_out * rows):
        what = f"{what}; more than {LIMITS.most_left_out:.0%} are not left out"
        raise CampaignError(what, where=where, advice=advice)
    return f"{what} and are left out"


def in_order(stream: LoggedStream, place: Callable[[int], str] | None = None) -> LoggedStream:
    """A stream whose times increase strictly, with notes of what was sorted or dropped.

    Of rows with one time the first stays, filled up with the readings that only the others have, as
    of wheels that come in files of their own. `place`: of a row of a file, in words; None for
    several streams, each of which is in order.
    """
    kept, late = np.arange(len(stream.time)), 0
    if place is not None:
        _refuse_set_back(stream, place)
        stream, kept = _with_mended_stamps(stream)
        late = len(late_rows(stream.time))
    order = np.argsort(stream.time, kind="stable")
    stream = stream.rows(order, *_noted(late, "out of order", "sorted"))
    repeated = np.concatenate([[False], np.diff(stream.time) == 0.0])
    # The last row of a slew's file may be the first of the next.
    again = int((repeated[1:] & (np.diff(stream.file) != 0)).sum())
    stream = replace(stream, overlap=again >= max(len(stream.files), 2))
    if not repeated.any():
        return stream
    values, again, lost = joined_rows(stream.values, repeated)
    note = _noted(again, "repeated a time and", "left out")
    if lost.any():
        row = int(kept[order[np.argmax(lost)]])
        why, count = "repeat the time of another with other readings", int(lost.sum())
        where = ", ".join(stream.files) if place is None else place(row)
        advice = "stamps may be coarser than the rows: name the column of the fraction too in "
        advice += 'names = ["sec", "nanosec"]; or mend or remove the rows'
        note.append(left_out(count, len(order), why, where=where, advice=advice))
    return replace(stream, values=values).rows(~repeated, *note)


def _refuse_set_back(stream: LoggedStream, place: Callable[[int], str]) -> None:
    """Refuse a clock that goes back and runs on from there: two sessions are not one."""
    row = set_back_row(stream.time, stream.values)
    if row is None:
        return
    size = float(stream.time[row - 1] - stream.time[row])
    what = f"the clock goes back by {size:.6g} s and runs on from there"
    # A reading came between the two stamps.
    more = size + stream.step
    advice = 'if another session begins here, give it a file of its own and write epoch = "file"; '
    advice += f"if the clock was set back, add {more:.6g} s from this row on; if only the rows are "
    advice += "in another order, sort the file by time"
    raise CampaignError(what, where=place(row), advice=advice)


def _with_mended_stamps(stream: LoggedStream) -> tuple[LoggedStream, np.ndarray]:
    """The rows of a regular stream whose stamps fit or can be mended, and which (n,) they are."""
    rows = np.arange(len(stream.time))
    if not is_regular(np.unique(stream.time)):
        return stream, rows
    stamps, kept, wrong, single = mended_stamps(stream.time)
    if not len(wrong) or not single:
        return stream, rows
    lost, what = len(rows) - len(kept), "with a wrong stamp"
    notes = _noted(len(wrong) - lost, what, "given that between its neighbours")
    notes += _noted(lost, what, "left out")
    return replace(stream, time=stamps).rows(kept, *notes), kept


def _noted(count: int, what: str, done: str) -> list[str]:
    """A note such as "2 rows out of order were sorted"; none of no row."""
    rows, were = ("row", "was") if count == 1 else ("rows", "were")
    return [f"{count} {rows} {what} {were} {done}"] if count else []


def joined(streams: Sequence[LoggedStream]) -> LoggedStream:
    """Streams that hold one quantity, such as wheels in files of their own, as one."""
    if len(streams) == 1:
        return streams[0]
    files = tuple(dict.fromkeys(file for stream in streams for file in stream.files))
    numbered = [(np.array([files.index(f) for f in s.files], dtype=int), s) for s in streams]
    return LoggedStream(
        streams[0].holds,
        np.concatenate([stream.time for stream in streams]),
        np.concatenate([stream.values for stream in streams]),
        np.concatenate([of_files[stream.file] for of_files, stream in numbered]),
        files,
        tuple(note for stream in streams for note in stream.notes),
        tuple(np.max([stream.rounding for stream in streams], axis=0).tolist()),
    )


def held(stream: LoggedStream) -> LoggedStream:
    """Commands in force at each time, from where every element has its first command."""
    rows = np.arange(len(stream.time))[:, None]
    last = np.maximum.accumulate(np.where(np.isnan(stream.values), -1, rows), axis=0)
    values = np.take_along_axis(stream.values, np.maximum(last, 0), axis=0)
    known = (last >= 0).all(axis=1)
    note = _noted(int((~known).sum()), "before every wheel had a command", "left out")
    return replace(stream, values=values).rows(known, *note)
