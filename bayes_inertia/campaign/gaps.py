"""Gaps in telemetry: rows that a regular stream lacks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_inertia.campaign.dirt import Dirt
from bayes_inertia.campaign.slew import Slew

# A step this many times the median lacks a row.
LONGEST_STEP = 1.5
# A stream is regular if this share of its steps is within that fraction of the median.
_REGULAR, _JITTER = 0.8, 0.2
_FEWEST_STEPS = 5
_FEWEST_RATES = 10  # of a part of a slew
SAME_ROW = 0.01  # of a step: a row so close to a lost command takes it

Channels = dict[str, np.ndarray]
"""Channels (n, width) of a slew by the name of `Slew`, with "time" (n,) [s]."""


def missing_rows(time: np.ndarray) -> tuple[np.ndarray, float]:
    """Where a regular stream lacks rows.

    `time` (n,) [s]. Returns `before` (m,): the rows before the gaps; none if the stream is not
    regular, as a log of changes is; `step`: the median step [s]; 0 with fewer than two rows.

    Examples
    --------
    >>> missing_rows(np.array([0., 1., 2., 3., 4., 7., 8.]))
    (array([4]), 1.0)
    """
    steps = np.diff(time)
    if not len(steps):
        return np.zeros(0, dtype=int), 0.0
    step = float(np.median(steps))
    if not is_regular(time):
        return np.zeros(0, dtype=int), step
    return np.flatnonzero(steps > LONGEST_STEP * step), step


def is_regular(time: np.ndarray) -> bool:
    """Whether rows come at one step, but for jitter and gaps.

    `time` (n,) [s].

    Examples
    --------
    >>> is_regular(np.arange(9.0)), is_regular(np.arange(9.0) ** 2)
    (True, False)
    """
    steps = np.diff(time)
    if len(steps) < _FEWEST_STEPS:
        return False
    step = np.median(steps)
    return bool(np.mean(np.abs(steps - step) <= _JITTER * step) >= _REGULAR)


def unbroken_rows(time: np.ndarray, steps: int, step: float) -> np.ndarray:
    """Rows that so many regular steps follow.

    `time` (n,) [s]; `step` [s]. Returns (m,).

    Examples
    --------
    >>> unbroken_rows(np.array([0.0, 1.0, 2.0, 4.0, 5.0]), 2, 1.0).tolist()
    [0]
    """
    even = np.abs(np.diff(time) - step) <= _JITTER * step
    if len(even) < steps:
        return np.zeros(0, dtype=int)
    return np.flatnonzero(np.convolve(even, np.ones(steps), "valid") > steps - 0.5)


def with_rows_at(channels: Channels, times: np.ndarray, step: float) -> Channels:
    """Copies of channels that have a row at each of some times.

    `channels` [s]; `times` (m,) [s]. `step`: the regular step [s]; a row within `SAME_ROW` of it is
    the row of a time.

    Examples
    --------
    >>> given = {"time": np.array([0.0, 1.0, 3.0]), "rate": np.ones((3, 1))}
    >>> with_rows_at(given, np.array([1.0, 2.0]), 1.0)["rate"][:, 0].tolist()
    [1.0, 1.0, nan, 1.0]
    """
    time = channels["time"]
    first = np.searchsorted(time, times - SAME_ROW * step)
    near = time[np.minimum(first, len(time) - 1)] <= times + SAME_ROW * step
    new = times[~((first < len(time)) & near)]
    at = np.searchsorted(time, new)
    grown = {
        name: np.insert(values, at, np.nan, axis=0)
        for name, values in channels.items()
        if name != "time"
    }
    return {**grown, "time": np.insert(time, at, new)}


def gap_records(slew: Slew) -> list[Dirt]:
    """Gaps in the readings of the rate sensor and the tachometers.

    They cost information and nothing else: the motion is integrated across them.

    Returns: at most one a channel; its rows are those before the gaps.

    Examples
    --------
    >>> time = np.array([0., 1., 2., 3., 4., 7., 8.])
    >>> gap_records(Slew("a", 0.0, time, rate=np.zeros((7, 3))))[0].note
    '1 gap, the longest of 3 s'
    """
    records = []
    for channel, values in (("rate", slew.rate), ("momentum", slew.wheel_momentum)):
        if values is None:
            continue
        rows = np.flatnonzero(np.isfinite(values).any(axis=1))
        before, _ = missing_rows(slew.time[rows])
        if len(before):
            longest = float(np.diff(slew.time[rows])[before].max())
            note = gap_note(len(before), longest)
            records.append(
                Dirt("gap", channel, slew.name, tuple(rows[before].tolist()), "ignored", note)
            )
    return records


def gap_note(count: int, longest: float) -> str:
    """How many gaps there are, and how long they are.

    `longest` [s]. Returns: such as "3 gaps, the longest of 2.5 s".

    Examples
    --------
    >>> gap_note(3, 2.5)
    '3 gaps, the longest of 2.5 s'
    """
    return f"{count} gap{'' if count == 1 else 's'}, the longest of {longest:.3g} s"


def without_intervals(
    channels: Channels, intervals: Sequence[tuple[float, float]]
) -> list[Channels]:
    """Channels cut where nothing may lead across.

    `channels` [s]. `intervals`: from the last time before to the first time after each cut [s];
    rows between are left out. Infinite where rows before the first time or after the last are left
    out. Returns: the parts, in order; those with hardly any rate are left out.

    Examples
    --------
    >>> parts = without_intervals({"time": np.arange(30.0)}, [(11.0, 14.0)])
    >>> [(part["time"][0].item(), len(part["time"])) for part in parts]
    [(0.0, 12), (14.0, 16)]
    """
    if not intervals:
        return [channels]
    inside = any(np.isfinite(interval).all() for interval in intervals)
    fewest = _FEWEST_RATES if inside else 2
    time = channels["time"]
    part_of = np.zeros(len(time), dtype=int)
    for after, before in intervals:
        part_of[(time > after) & (time < before) & (part_of >= 0)] = -1
        part_of[(time >= before) & (part_of >= 0)] += 1
    parts = []
    for part in range(len(intervals) + 1):
        rows = part_of == part
        rate = channels.get("rate")
        useful = rows if rate is None else rows & np.isfinite(rate).any(axis=1)
        if useful.sum() >= fewest:
            parts.append({name: values[rows] for name, values in channels.items()})
    return parts
