"""Noise of readings, from differences of neighbours, which hardly see smooth motion."""

from __future__ import annotations

import numpy as np

from bayes_inertia.faults.limits import LIMITS
from bayes_inertia.maths.robust_scale import SD_OVER_MAD


def second_difference_noise(second: np.ndarray) -> float:
    """White noise of which readings have these second differences (n,); outliers hardly count."""
    scale = LIMITS.second_difference_variance**0.5
    return SD_OVER_MAD * float(np.median(np.abs(second))) / scale


def smooth_noise(values: np.ndarray) -> float:
    """Noise of readings (n,) of a smooth motion; NaN for too few.

    Examples
    --------
    >>> values = np.random.default_rng(1).normal(size=400)
    >>> bool(abs(smooth_noise(values) - 1.0) < 0.1)
    True
    """
    values = values[np.isfinite(values)]
    if len(values) < LIMITS.rows_for_noise:
        return float("nan")
    return second_difference_noise(np.diff(values, 2))


def step_noise(values: np.ndarray) -> float:
    """Noise of readings (n,) of a slow motion, gaps among them; 0 for too few."""
    steps = np.abs(np.diff(values))
    steps = steps[np.isfinite(steps)]
    return float(SD_OVER_MAD * np.median(steps) / np.sqrt(2.0)) if len(steps) else 0.0
