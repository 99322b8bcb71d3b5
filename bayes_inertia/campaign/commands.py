"""Torque commands that were not recorded, and what the wheels are known to have done meanwhile.

The wheel electronics hold a command until the next one, and so does the model. Where rows are
missing, the commands in them are unknown, and holding the last one is wrong: on the example
campaign a single lost row in 200 moves J by up to 4 sd, a gap of 3 s by 60 sd. So

* a gap in which the commands hardly changed is bridged by the last one;
* where every wheel has a tachometer, the slew's commands are left out: the wheels' measured
  momentum drives the model, which costs 3 to 7 % in the sd of J;
* else what the wheels did in the gap is unknown and the model integrates it out
  (`physics.stated_noise`): the slew stays whole;
* where there are too many gaps for that, and before the first command or after the last, the slew
  is cut, each part with a start of its own.

Rows whose torque command was lost, marked for a model that integrates them out.

In a gap the commands are guessed to lie on a straight line, and the model gives every piece of it
an unknown constant torque of each wheel beside that. How large, is measured: by the same lines
across rows of the slew that were not lost and whose ends differ no more than usual. Where the ends
of a gap differ more, half of that is added: a step inside the gap. In gaps of more than three rows
commands can have done anything: the largest command is the sd there.

Short gaps have a piece for each lost row. Where that makes too many, pieces grow longer, at least
two a gap: enough for any change of the motion across it. What was measured inside such a
gap is left out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_inertia.campaign.hardware import Wheel, unattainable
from bayes_inertia.campaign.limits import LIMITS
from bayes_inertia.campaign.sensors import STREAMS
from bayes_inertia.campaign.slew_parts import MORE, Channels, with_rows_at, without_intervals
from bayes_inertia.faults.fault import Dirt, Treatment
from bayes_inertia.faults.gaps import gap_note, is_regular, missing_rows, unbroken_rows
from bayes_inertia.faults.impossible import far_beyond
from bayes_inertia.faults.limits import LIMITS as FAULTS

Interval = tuple[float, float]


def with_known_torques(
    channels: Channels, every_wheel_is_read: bool, negligible: float
) -> tuple[list[Channels], list[tuple[Dirt, np.ndarray]]]:
    """Parts of a slew's channels in which every torque is known or none is given, and records.

    `negligible`: error of the wheels' momentum that does not matter [N m s].

    >>> torque = np.array([[np.nan], [0.1], [np.nan], [0.2]])
    >>> given = {"time": np.arange(4.0), "wheel_torque": torque}
    >>> parts, _ = with_known_torques(given, False, 0.0)
    >>> parts[0]["time"].tolist(), parts[0]["wheel_torque"][:, 0].tolist()
    ([1.0, 2.0, 3.0], [0.1, 0.1, 0.2])
    """
    if "wheel_torque" not in channels:
        return [channels], []
    time, torque = channels["time"], channels["wheel_torque"]
    known = np.isfinite(torque).all(axis=1)
    unknown = _unknown_intervals(time, torque, known, negligible)
    step = float(np.median(np.diff(time[known]))) if known.sum() > 1 else 0.0
    short = FAULTS.longest_step * step
    is_short = all(a == -np.inf and b - time[0] <= short for a, b in unknown)
    if unknown and not is_short and every_wheel_is_read:
        record = _record(unknown, "measured wheel momentum drives the model", "masked")
        others = {name: values for name, values in channels.items() if name != "wheel_torque"}
        return [others], [record]
    filled, unknown, records = _with_unknown_torques(channels, unknown, step)
    # What a row commands is known until the next row is due.
    unknown = [(a + 1.01 * step, b) for a, b in unknown]
    return without_intervals(filled, unknown), records


def _with_unknown_torques(
    channels: Channels, unknown: list[Interval], step: float
) -> tuple[Channels, list[Interval], list[tuple[Dirt, np.ndarray]]]:
    """Channels in which every row has a command, where still to cut, and records of both."""
    inside = [interval for interval in unknown if np.isfinite(interval).all()]
    largest = float(np.nanmax(np.abs(channels["wheel_torque"])))
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
    if time[-1] > at[-1] + FAULTS.longest_step * step and is_regular(at):
        unknown.append((float(at[-1]), np.inf))
    return unknown


_LEFT_OUT = {stream.field for stream in STREAMS}  # where a piece is longer than a row


def with_lost_commands(
    channels: Channels, intervals: Sequence[tuple[float, float]], step: float, largest: float
) -> Channels | None:
    """Channels with a row for every lost command, a guess of it, and how far it may be off.

    The pieces of gaps stand under "lost_command" (n,), 0 where the command is known, sds [N m]
    under "lost_command_sd" (n, wheels). None where there are too many gaps. `intervals`: times of
    the known commands before and after each gap [s]. `largest`: torque of a wheel [N m].
    """
    lost = [_lost_times(after, before, step) for after, before in intervals]
    size = _piece_count([len(times) for times in lost])
    if size is None:
        return None
    channels = with_rows_at(channels, np.concatenate(lost), step)
    time, torque = channels["time"], channels["wheel_torque"]
    pieces, sd = np.zeros(len(time), dtype=int), np.zeros(torque.shape)
    known = np.isfinite(torque).all(axis=1)
    usual = _usual_errors(time[known], torque[known], {len(t) for t in lost}, step, largest)
    for times, (after, before) in zip(lost, intervals, strict=True):
        count = min(size, len(times))
        starts = times[np.arange(count) * len(times) // count] - LIMITS.same_row * step
        inside = (time >= starts[0]) & (time < before)
        pieces[inside] = pieces.max() + np.searchsorted(starts, time[inside], side="right")
        ends = torque[np.searchsorted(time, [after, before])]
        share = ((time[inside] - after) / (before - after))[:, None]
        torque[inside] = ends[0] + share * (ends[1] - ends[0])
        rms, limit = usual[len(times)]
        change = np.abs(ends[1] - ends[0])
        step_sd = np.where(change > limit, 0.5 * change, 0.0)
        sd[inside] = np.minimum(np.hypot(LIMITS.line_error_safety * rms, step_sd), largest)
        if count < len(times):
            for name in (n for n in channels if n in _LEFT_OUT or n.startswith(MORE)):
                channels[name][inside & (time > starts[0] + 2.0 * LIMITS.same_row * step)] = np.nan
    return {**channels, "lost_command": pieces, "lost_command_sd": sd}


def _lost_times(after: float, before: float, step: float) -> np.ndarray:
    """When the lost commands of one gap began, at least one."""
    count = max(1, int(np.ceil((before - after) / step - 1.0 - LIMITS.whole_step)))
    if after + step < before:
        return after + step * np.arange(1, count + 1)
    return np.array([after + 0.5 * (before - after)])


def _piece_count(rows: Sequence[int]) -> int | None:
    """Pieces of a gap at most, so that all gaps together do not have too many."""
    for size in range(LIMITS.most_lost_in_gap, 1, -1):
        if sum(min(size, n) for n in rows) <= LIMITS.most_lost_in_slew:
            return size
    return None


def _usual_errors(
    at: np.ndarray, commands: np.ndarray, lengths: set[int], step: float, largest: float
) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Rms error of a line, and largest usual change of its ends [N m], by lost rows of a gap."""
    usual = {}
    for lost in lengths:
        trials = unbroken_rows(at, lost + 1, step)
        if len(trials) < LIMITS.fewest_trials or lost > LIMITS.most_rows_on_a_line:
            unknown = np.full(commands.shape[1], largest)
            usual[lost] = unknown, unknown
            continue
        first, last = commands[trials], commands[trials + lost + 1]
        change = np.abs(last - first)
        limit = LIMITS.smooth_factor * np.quantile(change, LIMITS.smooth_quantile, axis=0)
        share = np.arange(1, lost + 1)[:, None, None] / (lost + 1.0)
        rows = commands[trials + np.arange(1, lost + 1)[:, None]]
        squares = np.square(rows - first - share * (last - first)).mean(0)
        quiet = change <= limit
        usual[lost] = np.sqrt((squares * quiet).sum(0) / quiet.sum(0)), limit
    return usual


def without_impossible_torques(
    channels: dict[str, np.ndarray], wheels: Sequence[Wheel]
) -> tuple[dict[str, np.ndarray], list[tuple[Dirt, np.ndarray]]]:
    """Channels with NaN for commands that no wheel can follow, and a record with its times [s]."""
    torque = channels.get("wheel_torque")
    if torque is None:
        return channels, []
    limits = np.array([unattainable(wheel, "torque") for wheel in wheels])
    # The largest commands of a wrong unit go on where the others end: those are no dirt.
    absurd = far_beyond(torque, limits)
    # One number again and again is no command in another unit, but a mark of "no command".
    marked = np.sum(absurd) >= FAULTS.fewest_of_marker and len(np.unique(torque[absurd])) == 1
    most = FAULTS.share_of_marker if marked else FAULTS.few_impossible
    if not absurd.any() or np.mean(absurd.any(axis=1)) > most:
        return channels, []
    note = f"commands up to {np.abs(torque[absurd]).max():.3g} N m, which no wheel can follow"
    record = Dirt("outliers", "torque", "", (), "masked", note)
    rows = absurd.any(axis=1)
    kept = np.where(rows[:, None], np.nan, torque)
    return {**channels, "wheel_torque": kept}, [(record, channels["time"][rows])]
