"""Readings that stand more than once: a slow sensor that was polled faster (sample and hold).

A row that repeats the one before to the last digit is no new reading. Rounding makes such rows,
too: while a reading hardly changes, it stays within one step. So rows count as repeats only where
readings beside them differ by many steps, or by more than one after stays of one regular length; a
steady drift that is rounded moves by one step at a time, and noise stays for irregular times.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from bayes_inertia.faults.limits import LIMITS
from bayes_inertia.faults.quantisation import resolution
from bayes_inertia.maths.values import array_dataclass

_WORDS = ("once", "twice", "three", "four", "five", "six", "seven", "eight", "nine", "ten")


@array_dataclass
class HeldReadings:
    """Which readings of a channel only repeat those before them, in one slew."""

    # (n, k) of bool: true where a reading repeats the one before, False at the first of each run
    repeats: np.ndarray
    lengths: np.ndarray  # (runs,) of int: how often each reading stands

    def __str__(self) -> str:
        low, high = (int(q) for q in np.quantile(self.lengths, [0.1, 0.9], method="nearest"))
        if low == high:
            times = _WORDS[low - 1] if low <= len(_WORDS) else str(low)
            return f"each reading stands {times}{' times' if low > 2 else ''}"
        return f"each reading stands {low} to {high} times"


def held_readings(
    series: Sequence[tuple[np.ndarray, np.ndarray]], *, by_axis: bool = True
) -> list[HeldReadings | None]:
    """Repeated readings (n, k) of a sensor that was polled faster than it measures, of each slew.

    The first of equal readings counts as read; in runs that are much longer than usual there is one
    in each usual length. `by_axis`: whether axes may be held each by itself.
    """
    found = _found(series)
    if by_axis and not any(found):
        axes = [_found([(t, v[:, [k]]) for t, v in series]) for k in range(series[0][1].shape[1])]
        found = [_beside(of_axes) for of_axes in zip(*axes, strict=True)]
    return found


def _found(series: Sequence[tuple[np.ndarray, np.ndarray]]) -> list[HeldReadings | None]:
    """Whole rows that are held, in each series by its own evidence, or that of the others too."""
    found = [_held_rows([one])[0] for one in series]
    rest = [i for i, held in enumerate(found) if held is None]
    for i, held in zip(rest, _held_rows([series[i] for i in rest]), strict=True):
        found[i] = held
    for i, ((_, before), (_, values)) in enumerate(pairwise(series), 1):
        held = found[i]
        rows, earlier = (np.flatnonzero(np.isfinite(v).any(axis=1)) for v in (values, before))
        # What a slew begins with may stand since the one before it.
        if held and len(earlier) and np.array_equal(before[earlier[-1]], values[rows[0]]):
            repeats = held.repeats.copy()
            repeats[rows[0]] = True
            found[i] = replace(held, repeats=repeats)
    return found


def _beside(axes: Sequence[HeldReadings | None]) -> HeldReadings | None:
    """Held rows in some of the axes (each (n, 1)) of one slew."""
    held = [axis for axis in axes if axis is not None]
    if not held:
        return None
    none = np.zeros_like(held[0].repeats)
    repeats = [none if axis is None else axis.repeats for axis in axes]
    return HeldReadings(np.hstack(repeats), np.concatenate([axis.lengths for axis in held]))


def _held_rows(series: Sequence[tuple[np.ndarray, np.ndarray]]) -> list[HeldReadings | None]:
    """Held rows of each series, by the evidence of all; None where no row repeats another."""
    given = [np.flatnonzero(np.isfinite(values).any(axis=1)) for _, values in series]
    both = zip(series, given, strict=True)
    runs = [_run_starts(time[rows], values[rows]) for (time, values), rows in both]
    counts = [np.diff(np.append(f, len(r))) for (f, _), r in zip(runs, given, strict=True)]
    lengths = np.concatenate([np.zeros(0, dtype=int), *counts])
    held = lengths > 1
    if held.sum() < max(LIMITS.fewest_held_runs, LIMITS.fewest_held * len(lengths)):
        return [None] * len(series)
    usual = float(np.median(lengths[held]))
    firsts = [rows[first] for rows, (first, _) in zip(given, runs, strict=True)]
    readings = np.concatenate([v[rows] for (_, v), rows in zip(series, firsts, strict=True)])
    moved = _moved(readings, np.concatenate([joins for _, joins in runs]))
    if not _beyond_rounding(lengths, moved, usual):
        return [None] * len(series)
    found: list[HeldReadings | None] = []
    for (_, values), rows, first, count in zip(series, given, firsts, counts, strict=True):
        short = np.repeat(count <= LIMITS.longest_held_lengths * usual, count)
        since = np.arange(len(rows)) - np.repeat(np.searchsorted(rows, first), count)
        repeats = np.zeros(values.shape, dtype=bool)
        repeats[rows] = ((since > 0) & (short | (since % round(usual) > 0)))[:, None]
        lasting = count[count <= LIMITS.longest_held_lengths * usual]
        found.append(HeldReadings(repeats, lasting) if repeats.any() and len(lasting) else None)
    return found


def _beyond_rounding(lengths: np.ndarray, moved: np.ndarray, usual: float) -> bool:
    """Whether rounding cannot explain runs of these lengths with so many steps beside them."""
    held, far = lengths > 1, moved >= LIMITS.clearly_changed_steps
    if (held & far).sum() >= max(LIMITS.fewest_held_runs, LIMITS.held_share * far.sum()):
        return True
    drifts = np.nanmedian(np.append(moved[held], 0.0)) < LIMITS.drift_step
    regular = np.abs(lengths - usual) <= max(1.0, LIMITS.held_length_jitter * usual)
    return bool(
        not drifts
        and regular.mean() >= LIMITS.regular_held_lengths
        and np.mean(lengths == 1) <= LIMITS.most_single_readings
    )


def _run_starts(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First row of each run of equal rows (n, k), and whether the row before it is near in time."""
    if not len(time):
        return np.zeros(0, dtype=int), np.zeros(0, dtype=bool)
    same = (values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
    first = np.flatnonzero(np.append(True, ~same.all(axis=1)))
    steps = np.diff(time, prepend=-np.inf)
    return first, (steps <= LIMITS.break_steps * np.median(steps))[first]


def _moved(readings: np.ndarray, joins: np.ndarray) -> np.ndarray:
    """Steps of rounding from each reading (runs, k) to the nearer of its neighbours, NaN without.

    The axis counts that moves most; `joins` (runs,) says which follow the one before at once.
    """
    count = np.zeros(len(readings) - 1)
    for axis in readings.T:
        larger = np.fmax(np.abs(axis[1:]), np.abs(axis[:-1]))
        count = np.fmax(count, np.abs(np.diff(axis)) / _steps_of_rounding(axis, larger))
    count = np.where(joins[1:], count, np.nan)
    return np.fmin(np.append(np.nan, count), np.append(count, np.nan))


def _steps_of_rounding(axis: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Smallest steps between readings (n,) of these sizes (m,); digits may be those of the size."""
    decades, at = (np.floor(np.log10(np.fmax(np.abs(v), 1e-300))) for v in (axis, sizes))
    steps = np.full(len(sizes), np.inf)
    for decade in np.unique(at[np.isfinite(at)]):
        steps[at == decade] = resolution(axis[decades == decade]) or np.inf
    return steps
