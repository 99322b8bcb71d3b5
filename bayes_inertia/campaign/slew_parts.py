"""Parts of a slew that was cut, and the records that belong to each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bayes_inertia.campaign.limits import LIMITS
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.errors import CampaignError
from bayes_inertia.faults.fault import Dirt


def parts_of(slew: Slew, pieces: Sequence[dict[str, np.ndarray]]) -> list[Slew]:
    """A slew for each piece of its channels.

    `pieces`: channels (rows, width) and "time" (rows,) [s] of each piece. Returns: A single piece
    keeps the name; axis and angle of the rotation are those of a whole slew.

    Examples
    --------
    >>> whole = Slew("a", 100.0, np.arange(4.0))
    >>> later = parts_of(whole, [{"time": whole.time[:2]}, {"time": whole.time[2:]}])[1]
    >>> later.name, later.start
    ('a (part 2 of 2)', 102.0)
    """
    if not pieces:
        raise CampaignError(
            "hardly any row has a known torque",
            where=f"slews.{slew.name}",
            advice="record commands or wheel momentum without gaps, or leave the slew out",
        )
    slews = []
    for i, piece in enumerate(pieces):
        later = float(piece["time"][0] - slew.time[0])
        name = f"{slew.name} (part {i + 1} of {len(pieces)})"
        start = slew.start + later if later else slew.start
        given: dict[str, Any] = {"name": name, "start": start, **piece}
        if len(pieces) == 1:
            given |= {"name": slew.name, "axis_B": slew.axis_B, "angle": slew.angle}
        slews.append(Slew(**given))
    return slews


def located(records: Sequence[tuple[Dirt, np.ndarray]], slews: Sequence[Slew]) -> list[Dirt]:
    """Records with the names and rows of the slews that hold the times they concern.

    `records`: records and the times [s] that each concerns; none if it concerns all rows. `slews`:
    the parts of one slew; a time between two of them belongs to the nearer one. Returns: one for
    each record and each slew that it concerns.

    Examples
    --------
    >>> slew = Slew("a", 0.0, np.arange(4.0))
    >>> located([(Dirt("gap", "rate", "", (), "ignored"), np.array([1.2]))], [slew])[0].rows
    (1,)
    """
    dirt = []
    for record, times in records:
        if not len(times):
            dirt += [replace(record, slew=slew.name) for slew in slews]
            continue
        distances = np.array([_distances(slew, times) for slew in slews])
        nearest = np.argmin(distances, axis=0)
        for i in np.unique(nearest).tolist():
            time = slews[i].time
            rows = np.unique(np.searchsorted(0.5 * (time[1:] + time[:-1]), times[nearest == i]))
            dirt.append(replace(record, slew=slews[i].name, rows=tuple(rows.tolist())))
    return dirt


def _distances(slew: Slew, times: np.ndarray) -> np.ndarray:
    """From times to the telemetry of a slew [s]."""
    return np.maximum(np.maximum(slew.time[0] - times, times - slew.time[-1]), 0.0)


Channels = dict[str, np.ndarray]
"""Channels (n, width) of a slew by the name of `Slew`, with "time" (n,) [s]."""


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
    first = np.searchsorted(time, times - LIMITS.same_row * step)
    near = time[np.minimum(first, len(time) - 1)] <= times + LIMITS.same_row * step
    new = times[~((first < len(time)) & near)]
    at = np.searchsorted(time, new)
    grown = {
        name: np.insert(values, at, np.nan, axis=0)
        for name, values in channels.items()
        if name != "time"
    }
    return {**grown, "time": np.insert(time, at, new)}


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
    fewest = LIMITS.fewest_rates_of_part if inside else 2
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
