"""Single readings far from their neighbours, before any model: one limit for all that read logs.

`inference/cleaning.py` judges residuals of a fit, with a false-alarm rate.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from bayes_inertia.faults.limits import LIMITS
from bayes_inertia.maths.robust_scale import SD_OVER_MAD


def outliers_at_rest(values: np.ndarray) -> np.ndarray:
    """Which readings (n,) are far from the running median, as no noise at rest is."""
    from scipy.ndimage import median_filter

    if len(values) < LIMITS.outlier_median_rows:
        return np.zeros(len(values), dtype=bool)
    away = np.abs(values - median_filter(values, LIMITS.outlier_median_rows, mode="nearest"))
    spread = SD_OVER_MAD * float(np.median(away))
    # Readings that are rounded coarsely have no spread to judge by.
    return (away > LIMITS.outlier_sds * spread) & (spread != 0.0)


def without_outliers(values: np.ndarray) -> np.ndarray:
    """Readings (n,) of a motion, outliers replaced by the running median: two in a row may be."""
    if len(values) < LIMITS.fewest_with_outliers:
        return values
    left, right, middle = values[:-2], values[2:], values[1:-1]
    off = np.abs(middle - 0.5 * (left + right))
    usual = SD_OVER_MAD * float(np.median(off)) + 1e-12 * float(np.abs(values).max())
    far = 1 + np.flatnonzero(off > LIMITS.outlier_sds * usual)
    padded = np.pad(values, LIMITS.outlier_rows // 2, mode="edge")
    mended = np.array(values)
    mended[far] = np.median(sliding_window_view(padded, LIMITS.outlier_rows)[far], axis=-1)
    return mended
