"""Readings that nothing can reach, such as the -1e31 or the -9999 that marks a missing value."""

from __future__ import annotations

import numpy as np

from bayes_inertia.faults.fault import Fault, Series
from bayes_inertia.faults.limits import LIMITS


def detect(series: Series) -> list[Fault]:
    """Readings beyond what any spacecraft or wheel can cause, and marks beyond all readings."""
    mask = no_readings(series.values, series.unattainable)
    if not mask.any():
        return []
    worst = float(np.nanmax(np.abs(np.where(mask, series.values, np.nan))))
    beyond = worst > np.max(series.unattainable)
    what = "which nothing can reach" if beyond else "a mark of no reading"
    return [Fault("outliers", mask, "masked", f"readings up to {worst:.3g}, {what}", masks=True)]


def no_readings(values: np.ndarray, unattainable: float | np.ndarray) -> np.ndarray:
    """Which values (n, k) pass `unattainable` (k,), or are a mark beyond all others."""
    return (np.abs(np.nan_to_num(values)) > unattainable) | far_beyond(values, unattainable)


def far_beyond(values: np.ndarray, unattainable: float | np.ndarray) -> np.ndarray:
    """Which values (n, k) pass `unattainable` (k,) or are a mark, and are far beyond all others."""
    size = np.abs(np.nan_to_num(values))
    odd, marks = size > unattainable, _marks(values)[:, None]
    usual = size[~(odd | marks)].max(initial=0.0)
    return (odd | (marks & (usual > 0.0))) & (size > LIMITS.impossible_factor * usual)


def _marks(values: np.ndarray) -> np.ndarray:
    """Rows (n,) that may hold a mark of "no reading", however small.

    That is one number in all of several columns, the largest such, that stands alone here and there
    and never with the other sign: what turns a body lasts, and stops it again.
    """
    alike = (values == values[:, :1]).all(axis=1) & (values.shape[1] > 1)
    if not alike.any():
        return alike
    number = values[np.argmax(np.where(alike, np.abs(values[:, 0]), -1.0)), 0]
    rows = alike & (values[:, 0] == number)
    begins = int(np.sum(rows[1:] & ~rows[:-1])) + int(rows[0])
    alone = begins > 1 and np.sum(rows) < 2 * begins
    return rows & (alone and not np.any(alike & (values[:, 0] == -number)))
