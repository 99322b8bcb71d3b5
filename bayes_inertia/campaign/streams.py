"""Telemetry at several rates and on several clocks, brought onto one list of times.

Each reading keeps its own time. Nothing is interpolated: where a stream has no reading at a time,
NaN stands there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayes_inertia.campaign.schema import ColumnsPart, SlewPart, TimeColumn
from bayes_inertia.errors import CampaignError

_SAME_TIME = 1e-9  # [s]; stamps closer than this are one time


@dataclass(frozen=True)
class Stream:
    """Entries of `[columns]` that share a table and a clock.

    Parameters
    ----------
    file : str
        The table, as the description names it.
    time : TimeColumn
        The column of stamps.
    offset_s : float
        True time minus stamp [s].
    keys : tuple of str
        The entries, such as "rate".
    """

    file: str
    time: TimeColumn
    offset_s: float
    keys: tuple[str, ...]


def streams_of(slew: SlewPart, columns: ColumnsPart) -> list[Stream]:
    """The streams of a slew, in the order of `[columns]`.

    `slew` [slews]. Returns: one if all entries share a table and a clock.
    """
    keys: dict[tuple[str, str, str, bool, float], tuple[TimeColumn, list[str]]] = {}
    for key, entry in columns.given().items():
        file = None if key == "time" else slew.file_of(key)
        if file is None:
            continue
        time = columns.time if entry.time is None else entry.time
        clock = (file, time.names[0], time.unit, time.regular, time.offset_s + entry.offset_s)
        keys.setdefault(clock, (time, []))[1].append(key)
    return [
        Stream(file, time, offset, tuple(entries))
        for (file, *_, offset), (time, entries) in keys.items()
    ]


def union(streams: Sequence[dict[str, np.ndarray]], label: str) -> dict[str, np.ndarray]:
    """The channels of several streams on the list of all their times.

    Times closer than a nanosecond, or than the rounding of large times, are one time.

    `streams`: channels (rows, width) by the name of `Slew`, each with its own "time" (rows,) [s].
    Returns: channels (n, width) with NaN where a stream has no reading, and "time" (n,) [s]; a
    single stream as it is.

    Examples
    --------
    >>> rate = {"time": np.array([0.0, 1.0]), "rate": np.zeros((2, 3))}
    >>> fix = {"time": np.array([0.5]), "attitude": np.array([[0.0, 0.0, 0.0, 1.0]])}
    >>> union([rate, fix], "slew 1")["attitude"][:, 3].tolist()
    [nan, 1.0, nan]
    """
    if len(streams) == 1:
        return dict(streams[0])
    streams = [_without_empty_rows(stream) for stream in streams]
    times = np.concatenate([stream["time"] for stream in streams])
    order = np.argsort(times, kind="stable")
    resolution = max(_SAME_TIME, 4.0 * float(np.spacing(np.abs(times).max())))
    is_new = np.concatenate([[True], np.diff(times[order]) > resolution])
    row = np.empty(len(times), dtype=int)
    row[order] = np.cumsum(is_new) - 1
    joined: dict[str, np.ndarray] = {"time": times[order][is_new]}
    begin = 0
    for stream in streams:
        rows = row[begin : begin + len(stream["time"])]
        begin += len(rows)
        if np.any(np.diff(rows) == 0):
            at = float(stream["time"][int(np.argmin(np.diff(rows)))])
            raise CampaignError(
                f"two rows near the time {at!r} s are closer than {resolution:.1g} s",
                where=label,
                advice="count time from the start of the slew, so that its digits suffice",
            )
        for name, values in stream.items():
            if name != "time":
                joined[name] = np.full((len(joined["time"]), values.shape[1]), np.nan)
                joined[name][rows] = values
    return joined


def _without_empty_rows(stream: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """A stream without rows that hold no reading, such as those of a tracker that has no fix."""
    readings = [values for name, values in stream.items() if name != "time"]
    if not readings:
        return {"time": stream["time"][:0]}
    filled = np.isfinite(np.concatenate(readings, axis=1)).any(axis=1)
    return {name: values[filled] for name, values in stream.items()}
