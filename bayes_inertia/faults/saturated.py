"""Readings at the range of their sensor."""

from __future__ import annotations

import numpy as np

from bayes_inertia.faults.fault import Fault, Series
from bayes_inertia.faults.limits import LIMITS


def in_range(values: np.ndarray, largest: float | None) -> np.ndarray:
    """Which numbers are inside a sensor's range, if one is stated, and such as can be."""
    limit = min(LIMITS.saturated * (largest or np.inf), LIMITS.fastest_rate)
    return np.isfinite(values) & (np.abs(np.nan_to_num(values)) < limit)


def detect(series: Series) -> list[Fault]:
    """Readings outside the range; they stay, but no fit counts them."""
    mask = np.isfinite(series.values) & ~series.valid
    note = f"readings at the sensor's range of {series.limit}"
    return [Fault("saturated", mask, "masked", note)] if mask.any() else []
