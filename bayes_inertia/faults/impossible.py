"""Readings that nothing can reach, such as the -1e31 that marks a missing value."""

from __future__ import annotations

import numpy as np

from bayes_inertia.faults.fault import Fault, Series


def detect(series: Series) -> list[Fault]:
    """Readings beyond what any spacecraft or wheel can cause."""
    mask = np.abs(np.nan_to_num(series.values)) > series.unattainable
    if not mask.any():
        return []
    worst = float(np.nanmax(np.abs(np.where(mask, series.values, np.nan))))
    note = f"readings up to {worst:.3g}, which nothing can reach"
    return [Fault("outliers", mask, "masked", note, masks=True)]
