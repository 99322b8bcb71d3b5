"""Torque commands that were not recorded, and what the wheels are known to have done meanwhile.

The wheel electronics hold a command until the next one, and so does the model. Where rows are
missing, the commands in them are unknown, and holding the last one is wrong: on the example
campaign a single lost row in 200 moves J by up to 4 sd, a gap of 3 s by 60 sd. So

* a gap in which the commands hardly changed is bridged by the last one;
* a few rows lost among smooth commands are filled by a curve, where that is good enough;
* else, where every wheel has a tachometer, the slew's commands are left out: the wheels' measured
  momentum drives the model, which costs 3 to 7 % in the sd of J;
* else what the wheels did in the gap is unknown and the model integrates it out
  (`physics.effects.lost_commands`): the slew stays whole;
* where there are too many gaps for that, and before the first command or after the last, the slew
  is cut, each part with a start of its own.
"""

from __future__ import annotations

import numpy as np

from bayes_inertia.campaign.dirt import Dirt, Treatment
from bayes_inertia.campaign.gaps import (
    LONGEST_STEP,
    Channels,
    gap_note,
    is_regular,
    missing_rows,
    without_intervals,
)
from bayes_inertia.campaign.lost_commands import with_lost_commands
from bayes_inertia.campaign.short_gaps import with_short_gaps_filled

Interval = tuple[float, float]


def with_known_torques(
    channels: Channels, every_wheel_is_read: bool, negligible: float, largest: float = np.inf
) -> tuple[list[Channels], list[tuple[Dirt, np.ndarray]]]:
    """The channels of a slew, in parts if need be, in which every torque is known or none is given.

    Parameters
    ----------
    channels : dict of str to array
        Channels (n, width) by the name of `Slew`, with "time"; NaN where no command was recorded.
    every_wheel_is_read : bool
        Whether every wheel has a tachometer of known noise.
    negligible : float
        Error of the wheels' momentum that does not matter [N m s].
    largest : float, optional
        The largest torque of a wheel [N m]; by default the largest command.

    Returns
    -------
    parts : list of dict of str to array
        The slew, or its parts; none if too little is left.
    dirt : list of (Dirt, array)
        What was done, without slew and rows, and the times [s] that it concerns.

    Examples
    --------
    >>> torque = np.array([[np.nan], [0.1], [np.nan], [0.2]])
    >>> given = {"time": np.arange(4.0), "wheel_torque": torque}
    >>> parts, _ = with_known_torques(given, False, 0.0)
    >>> parts[0]["time"].tolist(), parts[0]["wheel_torque"][:, 0].tolist()
    ([1.0, 2.0, 3.0], [0.1, 0.1, 0.2])
    """
    given = channels
    unknown: list[Interval] = []
    dirt: list[tuple[Dirt, np.ndarray]] = []
    if "wheel_torque" in channels:
        channels, dirt = with_short_gaps_filled(channels, negligible)
        time, torque = channels["time"], channels["wheel_torque"]
        known = np.isfinite(torque).all(axis=1)
        unknown = _unknown_intervals(time, torque, known, negligible)
        step = float(np.median(np.diff(time[known]))) if known.sum() > 1 else 0.0
        is_short = all(a == -np.inf and b - time[0] <= LONGEST_STEP * step for a, b in unknown)
        if unknown and not is_short and every_wheel_is_read:
            dirt = [_record(unknown, "measured wheel momentum drives the model", "masked")]
            channels = {name: values for name, values in given.items() if name != "wheel_torque"}
            unknown = []
        else:
            channels, unknown, records = _with_unknown_torques(channels, unknown, step, largest)
            dirt = dirt + records
        # What a row commands is known until the next row is due.
        unknown = [(a + 1.01 * step, b) for a, b in unknown]
    return without_intervals(channels, unknown), dirt


def _with_unknown_torques(
    channels: Channels, unknown: list[Interval], step: float, largest: float
) -> tuple[Channels, list[Interval], list[tuple[Dirt, np.ndarray]]]:
    """Channels in which every row has a command, where still to cut, and records of both."""
    inside = [interval for interval in unknown if np.isfinite(interval).all()]
    largest = min(largest, float(np.nanmax(np.abs(channels["wheel_torque"]))))
    marked = with_lost_commands(channels, inside, step, largest) if inside else None
    dirt = []
    if marked is not None:
        channels = marked
        unknown = [interval for interval in unknown if interval not in inside]
        dirt.append(_record(inside, "what the wheels did there is integrated out", "modelled"))
    if unknown:
        dirt.append(_record(unknown, "the slew is cut there", "masked"))
    torque = channels["wheel_torque"]
    known = np.isfinite(torque).all(axis=1)
    last = np.maximum.accumulate(np.where(known, np.arange(len(torque)), 0))
    return {**channels, "wheel_torque": torque[last]}, unknown, dirt


def _record(intervals: list[Interval], done: str, treated: Treatment) -> tuple[Dirt, np.ndarray]:
    ends = np.array([x for interval in intervals for x in interval])
    lengths = [b - a for a, b in intervals if np.isfinite([a, b]).all()]
    where = [gap_note(len(lengths), max(lengths))] if lengths else []
    where += ["none before the first"] * (intervals[0][0] == -np.inf)
    where += ["none after the last"] * (intervals[-1][1] == np.inf)
    note = f"{', '.join(where)}; {done}"
    return Dirt("gap", "torque", "", (), treated, note), ends[np.isfinite(ends)]


def _unknown_intervals(
    time: np.ndarray, torque: np.ndarray, known: np.ndarray, negligible: float
) -> list[Interval]:
    """Between which commands, or before the first and after the last, others are missing."""
    rows = np.flatnonzero(known)
    at = time[rows]
    before, step = missing_rows(at)
    unknown: list[Interval] = []
    if time[0] < at[0]:
        unknown.append((-np.inf, float(at[0])))
    for k in before:
        change = np.abs(torque[rows[k + 1]] - torque[rows[k]]).max()
        if change * (at[k + 1] - at[k] - step) > negligible:
            unknown.append((float(at[k]), float(at[k + 1])))
    # A log of changes is not regular, and its last command holds.
    if time[-1] > at[-1] + LONGEST_STEP * step and is_regular(at):
        unknown.append((float(at[-1]), np.inf))
    return unknown
