"""The telemetry of one slew as tables of a campaign folder: one a stream, its own times kept."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bayes_inertia.importing.logged_stream import LoggedStream
from bayes_inertia.importing.slew_cutting import SlewWindow

# Rows of a table are written to the nanosecond.
_DECIMALS_OF_TIME = 9


@dataclass(frozen=True)
class ColumnsOfStream:
    """How a stream is written.

    Parameters
    ----------
    suffix : str
        What the names of its tables end with.
    columns : tuple of str
        The columns; with "{}" one a wheel.
    sense : dict of str to str
        The other keys of its entry in `[columns]`.
    """

    suffix: str
    columns: tuple[str, ...]
    sense: dict[str, str]

    def names(self, wheels: int) -> list[str]:
        """The columns of a campaign with so many wheels.

        Parameters
        ----------
        wheels : int
            Number of wheels.

        Returns
        -------
        list of str
            The columns.
        """
        if "{}" not in self.columns[0]:
            return list(self.columns)
        return [self.columns[0].format(k + 1) for k in range(wheels)]


def written_streams() -> dict[str, ColumnsOfStream]:
    """How each stream is written, by the key of `[columns]`.

    Returns
    -------
    dict of str to ColumnsOfStream
        In the order of `[columns]`.
    """
    wheel = {"relative_to": "body"}
    quaternion = {"scalar": "last", "maps": "inertial_to_body"}
    inertial = {"frame": "inertial"}
    return {
        "rate": ColumnsOfStream("rate", ("w1_radps", "w2_radps", "w3_radps"), {"unit": "rad/s"}),
        "wheel_torque": ColumnsOfStream("torque", ("u{}_Nm",), {"unit": "N m", "acts_on": "wheel"}),
        "wheel_momentum": ColumnsOfStream("momentum", ("h{}_Nms",), {"unit": "N m s", **wheel}),
        "wheel_speed": ColumnsOfStream("speed", ("speed{}_radps",), {"unit": "rad/s", **wheel}),
        "attitude": ColumnsOfStream("tracker", ("q1", "q2", "q3", "q4"), quaternion),
        "magnetic_field": ColumnsOfStream(
            "field", ("Bx_N_T", "By_N_T", "Bz_N_T"), {"unit": "T", **inertial}
        ),
        "position": ColumnsOfStream(
            "position", ("rx_N_m", "ry_N_m", "rz_N_m"), {"unit": "m", **inertial}
        ),
    }


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

    Parameters
    ----------
    window : SlewWindow
        The part of the log.
    streams : dict of str to LoggedStream
        The whole log.

    Returns
    -------
    SlewTables
        Only the streams that have a reading in the slew.

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
    first = torque.rows(before[-1:])
    return LoggedStream(
        torque.holds,
        np.concatenate([[start], later.time]),
        np.concatenate([first.values, later.values]),
        np.concatenate([first.file, later.file]),
        torque.files,
    )


def csv_of(stream: LoggedStream, names: list[str]) -> str:
    """A stream as a table of CSV with all digits; an element without a reading is an empty cell.

    Parameters
    ----------
    stream : LoggedStream
        The stream.
    names : list of str
        Its columns.

    Returns
    -------
    str
        The table.

    Examples
    --------
    >>> rate = LoggedStream("rate", np.array([0.5]), np.array([[1., np.nan]]), np.zeros(1, int), ())
    >>> csv_of(rate, ["a", "b"])
    't_s,a,b\\n0.5,1.0,\\n'
    """
    rows: list[Any] = [["t_s", *names]]
    table = np.column_stack([stream.time, stream.values]).tolist()
    rows += [["" if cell != cell else repr(cell) for cell in row] for row in table]
    return "".join(",".join(row) + "\n" for row in rows)
