"""Rows whose torque command was lost, marked for a model that integrates them out.

In a gap the commands are guessed to lie on a straight line, and the model gives every piece of it
an unknown constant torque of each wheel beside that. How large, is measured: by the same lines
across rows of the slew that were not lost and whose ends differ no more than usual. Where the ends
of a gap differ more, half of that is added: a step inside the gap. In gaps of more than three rows
commands can have done anything: the largest command is the sd there.

Short gaps have a piece for each lost row. Where that makes too many, pieces grow longer, at least
two a gap: enough for any change of rate and of attitude across it. What was measured inside such a
gap is left out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_inertia.campaign.gaps import SAME_ROW, Channels, unbroken_rows, with_rows_at

# Pieces of one gap, and of all gaps of one slew: every piece costs one unknown a wheel.
_MOST_OF_GAP, _MOST_OF_SLEW = 8, 48
_LEFT_OUT = {"rate", "attitude", "wheel_momentum"}  # where a piece is longer than a row
_FEWEST_TRIALS = 30
_MOST_ON_A_LINE = 3  # lost rows of a gap; errors of longer lines add up
_SAFETY = 1.25  # times the rms error of the lines
# A change beyond twice that of nine in ten rows is a step: half of it may be missed.
_STEP, _MOST = 2.0, 0.9
_WHOLE = 0.2  # of a step: the last lost row stands at least so long before the next command


def with_lost_commands(
    channels: Channels, intervals: Sequence[tuple[float, float]], step: float, largest: float
) -> Channels | None:
    """Channels with a row for every lost command, a guess of it, and how far it may be off.

    Parameters
    ----------
    channels : dict of str to array
        Channels (n, width) by the name of `Slew`, with "time" and "wheel_torque"; NaN where no
        command was recorded.
    intervals : sequence of (float, float)
        Times of the known commands before and after each gap [s].
    step : float
        Between two commands [s].
    largest : float
        The largest torque of a wheel [N m]: what it may be off by where too few rows tell.

    Returns
    -------
    dict of str to array or None
        The same with new rows, NaN but for their time and torque, with the pieces of gaps under
        "lost_command" (n,), 0 where the command is known, and sds [N m] under "lost_command_sd"
        (n, wheels). None where there are too many gaps to be modelled.

    Examples
    --------
    >>> given = {"time": np.array([0.0, 1.0, 4.0]), "wheel_torque": np.array([[0.1], [0.1], [0.4]])}
    >>> marked = with_lost_commands(given, [(1.0, 4.0)], 1.0, 0.5)
    >>> marked["lost_command"].tolist(), marked["wheel_torque"][:, 0].round(3).tolist()
    ([0, 0, 1, 2, 0], [0.1, 0.1, 0.2, 0.3, 0.4])
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
        starts = times[np.arange(count) * len(times) // count] - SAME_ROW * step
        inside = (time >= starts[0]) & (time < before)
        pieces[inside] = pieces.max() + np.searchsorted(starts, time[inside], side="right")
        ends = torque[np.searchsorted(time, [after, before])]
        share = ((time[inside] - after) / (before - after))[:, None]
        torque[inside] = ends[0] + share * (ends[1] - ends[0])
        rms, limit = usual[len(times)]
        change = np.abs(ends[1] - ends[0])
        step_sd = np.where(change > limit, 0.5 * change, 0.0)
        sd[inside] = np.minimum(np.hypot(_SAFETY * rms, step_sd), largest)
        if count < len(times):
            for name in _LEFT_OUT & set(channels):
                channels[name][inside & (time > starts[0] + 2.0 * SAME_ROW * step)] = np.nan
    return {**channels, "lost_command": pieces, "lost_command_sd": sd}


def _lost_times(after: float, before: float, step: float) -> np.ndarray:
    """When the lost commands of one gap began, at least one."""
    count = max(1, int(np.ceil((before - after) / step - 1.0 - _WHOLE)))
    if after + step < before:
        return after + step * np.arange(1, count + 1)
    return np.array([after + 0.5 * (before - after)])


def _piece_count(rows: Sequence[int]) -> int | None:
    """Pieces of a gap at most, so that all gaps together do not have too many."""
    for size in range(_MOST_OF_GAP, 1, -1):
        if sum(min(size, n) for n in rows) <= _MOST_OF_SLEW:
            return size
    return None


def _usual_errors(
    at: np.ndarray, commands: np.ndarray, lengths: set[int], step: float, largest: float
) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """By lost rows of a gap: rms error of such a line, largest usual change of its ends [N m]."""
    usual = {}
    for lost in lengths:
        trials = unbroken_rows(at, lost + 1, step)
        if len(trials) < _FEWEST_TRIALS or lost > _MOST_ON_A_LINE:
            unknown = np.full(commands.shape[1], largest)
            usual[lost] = unknown, unknown
            continue
        first, last = commands[trials], commands[trials + lost + 1]
        change = np.abs(last - first)
        limit = _STEP * np.quantile(change, _MOST, axis=0)
        share = np.arange(1, lost + 1)[:, None, None] / (lost + 1.0)
        rows = commands[trials + np.arange(1, lost + 1)[:, None]]
        squares = np.square(rows - first - share * (last - first)).mean(0)
        quiet = change <= limit
        usual[lost] = np.sqrt((squares * quiet).sum(0) / quiet.sum(0)), limit
    return usual
