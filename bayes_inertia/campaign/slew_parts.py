"""Parts of a slew that was cut, the records of each, and cuts where momentum is unknown.

A straight line bridges them, unless the torque changed so much that the star tracker or the rates
could tell the difference: then the slew is cut, each part with a start of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bayes_inertia.campaign.body_rates import rows_read
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import DirectionSensor, RateSensor, StarTracker
from bayes_inertia.campaign.limits import LIMITS
from bayes_inertia.campaign.sensors import STREAMS
from bayes_inertia.campaign.slew import PART, Slew
from bayes_inertia.errors import require
from bayes_inertia.faults.fault import Dirt
from bayes_inertia.faults.gaps import gap_note, missing_rows


def parts_of(slew: Slew, pieces: Sequence[dict[str, np.ndarray]]) -> list[Slew]:
    """A slew for each piece of its channels, with the inputs of its time; a single one is whole."""
    what = "hardly any row has a known torque"
    advice = "record commands or wheel momentum without gaps, or leave the slew out"
    require(bool(pieces), f"slews.{slew.name}", what, advice)
    slews = []
    for i, piece in enumerate(pieces):
        later = float(piece["time"][0] - slew.time[0])
        name = f"{slew.name}{PART}{i + 1} of {len(pieces)})"
        start = slew.start + later if later else slew.start
        given: dict[str, Any] = {k: v for k, v in piece.items() if not k.startswith(MORE)}
        more = {k.removeprefix(MORE): v for k, v in piece.items() if k.startswith(MORE)}
        given |= {"name": name, "start": start, "more": more or None}
        if slew.inputs is not None:
            span = float(piece["time"][0]), float(piece["time"][-1])
            given["inputs"] = {key: x.within(*span) for key, x in slew.inputs.items()}
        if len(pieces) == 1:
            given |= {"name": slew.name, "axis_B": slew.axis_B, "angle": slew.angle}
        slews.append(Slew(**given))
    return slews


def located(records: Sequence[tuple[Dirt, np.ndarray]], slews: Sequence[Slew]) -> list[Dirt]:
    """Records with names and rows of the parts of a slew that are nearest to their times."""
    dirt = []
    for record, times in records:
        if not len(times):
            dirt += [replace(record, slew=slew.name) for slew in slews]
            continue
        sides = [np.stack([slew.time[0] - times, times - slew.time[-1]]) for slew in slews]
        nearest = np.argmin([np.maximum(side.max(axis=0), 0.0) for side in sides], axis=0)
        for i in np.unique(nearest).tolist():
            time = slews[i].time
            rows = np.unique(np.searchsorted(0.5 * (time[1:] + time[:-1]), times[nearest == i]))
            dirt.append(replace(record, slew=slews[i].name, rows=tuple(rows.tolist())))
    return dirt


Channels = dict[str, np.ndarray]
"""Channels (n, width) of a slew by the name of `Slew`, with "time" (n,) [s]."""
# Channels of further sensors, and inputs of devices, are called so, with the name behind.
MORE, INPUTS = "more.", "inputs."


def with_rows_at(channels: Channels, times: np.ndarray, step: float) -> Channels:
    """Copies of channels that have a row at each of some times (m,) [s], or within `same_row`."""
    time = channels["time"]
    first = np.searchsorted(time, times - LIMITS.same_row * step)
    near = time[np.minimum(first, len(time) - 1)] <= times + LIMITS.same_row * step
    new = times[~((first < len(time)) & near)]
    at = np.searchsorted(time, new)
    grown = {name: np.insert(values, at, np.nan, axis=0) for name, values in channels.items()}
    return {**grown, "time": np.insert(time, at, new)}


def without_intervals(
    channels: Channels, intervals: Sequence[tuple[float, float]]
) -> list[Channels]:
    """Channels cut where nothing may lead across, without parts that have hardly any rate.

    `intervals`: from the last time before to the first time after each cut [s].
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
    rate = channels.get("rate")
    useful = np.ones(len(time), bool) if rate is None else np.isfinite(rate).any(axis=1)
    every = (part_of == part for part in range(len(intervals) + 1))
    return [
        {name: values[rows] for name, values in channels.items()}
        for rows in every
        if (rows & useful).sum() >= fewest
    ]


_CHANNELS = (*(stream.field for stream in STREAMS), "magnetic_field_N", "position_N")


def with_known_momentum(campaign: Campaign) -> Campaign:
    """The campaign with slews cut where no straight line bridges a gap of what drives the model."""
    running = campaign.without_locked_wheels()
    if running.has_commands or not running.wheels or not running.has_tachometers:
        return campaign
    inertia = float(np.linalg.eigvalsh(campaign.inertia.tensor)[0])
    noise = min(*campaign.with_body_rates.gyro.sigma, campaign.rate_noise)
    sag = LIMITS.momentum_line_of_rate_noise * inertia * noise
    bend = LIMITS.momentum_line_of_attitude_noise * inertia * campaign.attitude_noise
    slews: list[Slew] = []
    dirt: list[Dirt] = []
    for slew, seen in zip(campaign.slews, running.slews, strict=True):
        own = [(record, slew.time[list(record.rows)]) for record in campaign.dirt_of(slew.name)]
        given = {name: getattr(slew, name) for name in ("time", *_CHANNELS)}
        channels = {name: values for name, values in given.items() if values is not None}
        channels |= {MORE + name: values for name, values in (slew.more or {}).items()}
        fixes = slew.time[rows_read(campaign, slew, StarTracker | DirectionSensor)]
        rates = slew.time[rows_read(campaign, slew, RateSensor)]
        cuts = _unknown_momentum(seen, fixes, rates, bend, sag)
        parts = parts_of(slew, without_intervals(channels, cuts)) if cuts else [slew]
        if cuts:
            note = gap_note(len(cuts), max(b - a for a, b in cuts))
            record = Dirt("gap", "momentum", "", (), "masked", f"{note}; the slew is cut there")
            own.append((record, np.array(cuts).ravel()))
        slews += parts
        dirt += located(own, parts)
    everywhere = campaign.dirt_of("")
    return replace(campaign, slews=tuple(slews), dirt=(*dirt, *everywhere))


def _unknown_momentum(
    slew: Slew, fixes: np.ndarray, rates: np.ndarray, most_bend: float, most_sag: float
) -> list[tuple[float, float]]:
    """Gaps of tachometers (n, wheels) in which a straight line may be visibly wrong.

    `fixes`, `rates` (m,): times at which fixes and rates are read [s]. Wheels may be read at
    times of their own. `most_bend`, `most_sag`: what `_bend` may be where it does not matter.
    """
    found = set()
    for column in np.asarray(slew.wheel_momentum).T:
        rows = np.flatnonzero(np.isfinite(column))
        at = slew.time[rows]
        for k in missing_rows(at)[0] if len(at) > 1 else ():
            begin, end = float(at[k]), float(at[k + 1])
            bend, sag = _bend(at, column[rows], int(k))
            spanned = bool(len(fixes)) and fixes[0] < end and fixes[-1] > begin
            inside = bool(np.any((rates > begin) & (rates < end)))
            if (spanned and bend > most_bend) or (inside and sag > most_sag):
                found.add((begin, end))
    return sorted(found)


def _bend(at: np.ndarray, momentum: np.ndarray, k: int) -> tuple[float, float]:
    """Largest deviation of momentum from a straight line in the gap after reading k.

    Returns the integral over the gap [N m s^2] and the largest distance [N m s] of a torque that
    changes steadily from what it was before to what it was after, and of what it then lacks to
    the change of momentum that was measured.
    """
    length = at[k + 1] - at[k]
    n = LIMITS.readings_for_slope
    slopes = []
    for rows in (slice(max(0, k + 1 - n), k + 1), slice(k + 1, k + 1 + n)):
        t, h = at[rows], momentum[rows]
        slopes.append(np.polyfit(t - t[0], h, 1)[0] if len(t) > 1 else 0.0)
    mean = (momentum[k + 1] - momentum[k]) / length
    change = abs(slopes[1] - slopes[0])
    lack = abs(mean - 0.5 * (slopes[0] + slopes[1]))
    # After a wild stamp the gap is endless.
    with np.errstate(over="ignore"):
        bend = float((change / 12.0 + lack / 4.0) * length**2)
        sag = float((change / 8.0 + lack / 2.0) * length)
    return bend, sag
