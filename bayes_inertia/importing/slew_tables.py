"""The telemetry of one slew as tables of a campaign folder: one a stream, its own times kept."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_inertia.importing.limits import LIMITS
from bayes_inertia.importing.logged_stream import LoggedStream
from bayes_inertia.importing.slew_cutting import SlewWindow


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
                np.round(stream.time - start, LIMITS.decimals_of_time),
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
    return len(steps) >= LIMITS.fewest_alike_steps and bool(
        np.quantile(steps, LIMITS.most_alike_steps) < 1.5 * torque.step
    )
