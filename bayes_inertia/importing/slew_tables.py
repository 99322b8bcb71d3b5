"""The telemetry of one slew as tables of a campaign folder: one a stream, its own times kept."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bayes_inertia.importing.logged_stream import LoggedStream
from bayes_inertia.importing.slew_cutting import SlewWindow
from bayes_inertia.importing.written_columns import WrittenColumns

# Rows of a table are written to the nanosecond.
_DECIMALS_OF_TIME = 9
# Commands are logged at every step if this share of so many steps is alike.
_MOST, _FEWEST_STEPS = 0.9, 30


@dataclass(frozen=True)
class SlewTables:
    """One slew, ready to be written.

    Parameters
    ----------
    window : SlewWindow
        The part of the log.
    start : float
        Time of its first reading on the clock of the import [s].
    streams : dict of str to LoggedStream
        Readings of the slew with times from its start, by what they hold.
    """

    window: SlewWindow
    start: float
    streams: dict[str, LoggedStream]


def slew_tables(window: SlewWindow, streams: dict[str, LoggedStream]) -> SlewTables:
    """The readings of one slew, with times from its start.

    The command in force when the slew begins stands in its first row.

    Returns: only the streams that have a reading in the slew.

    Examples
    --------
    >>> command = LoggedStream("wheel_torque", np.array([0.0, 2.0]), np.array([[1.0], [3.0]]),
    ...                        np.zeros(2, dtype=int), ("a",))
    >>> rate = LoggedStream("rate", np.arange(1.0, 4.0), np.zeros((3, 3)), np.zeros(3, int), ("b",))
    >>> parts = slew_tables(SlewWindow("s", 1.0, 3.0), {"rate": rate, "wheel_torque": command})
    >>> parts.streams["wheel_torque"].time.tolist(), parts.streams["wheel_torque"].values.tolist()
    ([0.0, 1.0], [[1.0], [3.0]])
    """
    inside = {key: stream.between(window.start, window.end) for key, stream in streams.items()}
    inside = {key: stream for key, stream in inside.items() if len(stream.time)}
    start = min(float(stream.time[0]) for stream in inside.values())
    if "wheel_torque" in streams:
        inside["wheel_torque"] = _from_start(streams["wheel_torque"], start, window.end)
    return SlewTables(
        window,
        start,
        {
            key: LoggedStream(
                key,
                np.round(stream.time - start, _DECIMALS_OF_TIME),
                stream.values,
                stream.file,
                stream.files,
            )
            for key, stream in inside.items()
            if len(stream.time)
        },
    )


def _from_start(torque: LoggedStream, start: float, end: float) -> LoggedStream:
    """Commands of a slew, the first of which is the one in force at its start."""
    later = torque.between(start, end)
    before = np.flatnonzero(torque.time < start)
    if not len(before) or (len(later.time) and later.time[0] == start):
        return later
    if not len(later.time) and _at_every_step(torque):
        # None is in force: they were lost.
        return later
    first = torque.rows(before[-1:])
    return LoggedStream(
        torque.holds,
        np.concatenate([[start], later.time]),
        np.concatenate([first.values, later.values]),
        np.concatenate([first.file, later.file]),
        torque.files,
    )


def _at_every_step(torque: LoggedStream) -> bool:
    steps = np.diff(torque.time)
    return len(steps) >= _FEWEST_STEPS and bool(np.quantile(steps, _MOST) < 1.5 * torque.step)


def csv_of(stream: LoggedStream, columns: WrittenColumns) -> str:
    """A stream as a table of CSV with all digits; an element without a reading is an empty cell.

    Parameters
    ----------
    stream : LoggedStream
        The stream.
    columns : WrittenColumns
        How it is written.

    Returns
    -------
    str
        The table.

    Examples
    --------
    >>> speeds = np.array([[1.0, np.nan]])
    >>> stream = LoggedStream("wheel_speed", np.array([0.5]), speeds, np.zeros(1, dtype=int), ())
    >>> csv_of(stream, WrittenColumns("speed", ("a", "b"), {}, (0, 1), (1.0, 1.0)))
    't_s,a,b\\n0.5,1.0,\\n'
    """
    rows: list[list[str]] = [["t_s", *columns.names]]
    table = np.column_stack([stream.time, columns.cells(stream.values)]).tolist()
    rows += [["" if math.isnan(cell) else repr(cell) for cell in row] for row in table]
    return "".join(",".join(row) + "\n" for row in rows)
