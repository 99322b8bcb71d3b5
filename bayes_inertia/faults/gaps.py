"""Gaps in telemetry: rows that a regular stream lacks."""

from __future__ import annotations

import numpy as np

from bayes_inertia.faults.fault import Fault, Series
from bayes_inertia.faults.limits import LIMITS


def missing_rows(time: np.ndarray) -> tuple[np.ndarray, float]:
    """Rows (m,) before the gaps of a regular stream, and its median step [s]; 0 of fewer than two.

    >>> missing_rows(np.array([0., 1., 2., 3., 4., 7., 8.]))
    (array([4]), 1.0)
    """
    steps = np.diff(time)
    step = float(np.median(steps)) if len(steps) else 0.0
    gaps = steps > LIMITS.longest_step * step if is_regular(time) else np.zeros(0)
    return np.flatnonzero(gaps), step


def is_regular(time: np.ndarray) -> bool:
    """Whether times (n,) come at one step, but for jitter and gaps.

    >>> is_regular(np.arange(9.0)), is_regular(np.arange(9.0) ** 2)
    (True, False)
    """
    steps = np.diff(time)
    if len(steps) < LIMITS.fewest_steps:
        return False
    step = np.median(steps)
    return bool(np.mean(np.abs(steps - step) <= LIMITS.step_jitter * step) >= LIMITS.regular_steps)


def unbroken_rows(time: np.ndarray, steps: int, step: float) -> np.ndarray:
    """Rows (m,) that so many steps of a regular length [s] follow."""
    even = np.abs(np.diff(time) - step) <= LIMITS.step_jitter * step
    if len(even) < steps:
        return np.zeros(0, dtype=int)
    return np.flatnonzero(np.convolve(even, np.ones(steps), "valid") > steps - 0.5)


def detect(series: Series) -> list[Fault]:
    """Gaps in readings, at most one fault: the rows before them.

    They cost information and nothing else: the motion is integrated across them.
    """
    rows = np.flatnonzero(np.isfinite(series.values).any(axis=1))
    time = series.time[rows]
    before, _ = missing_rows(time)
    if series.whole or not len(before):
        return []
    mask = np.zeros(series.values.shape, dtype=bool)
    mask[rows[before]] = True
    longest = float(np.diff(time)[before].max())
    return [Fault("gap", mask, "ignored", gap_note(len(before), longest))]


def gap_note(count: int, longest: float) -> str:
    """Number and longest length [s] of gaps, in words."""
    return f"{count} gap{'' if count == 1 else 's'}, the longest of {longest:.3g} s"
