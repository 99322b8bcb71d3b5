"""Fewer rows that look like all of them, and lose no outlier."""

from __future__ import annotations

from itertools import pairwise

import numpy as np


def thinned_rows(values: np.ndarray, most: int) -> np.ndarray:
    """Rows to show: evenly spaced ones, and in each stretch the lowest and the highest.

    Extremes alone would leave the middle of noise empty; evenly spaced rows alone would lose
    outliers.

    `values` (rows, components): in any unit; NaN where a component was not measured. Returns
    (kept,): indices in their order, of rows in which something was measured; all of them where
    there are not more.

    Examples
    --------
    >>> values = np.zeros((1000, 1))
    >>> values[[7, 901], 0] = 5.0, -4.0
    >>> rows = thinned_rows(values, 100)
    >>> 7 in rows, 901 in rows, len(rows) <= 100
    (True, True, True)
    """
    measured = np.flatnonzero(np.isfinite(values).any(1))
    if len(measured) <= most:
        return measured
    kept = set(np.linspace(0, len(measured) - 1, max(2, most // 2)).astype(int).tolist())
    stretches = max(1, most // (4 * values.shape[1]))
    edges = np.linspace(0, len(measured), stretches + 1).astype(int)
    for a, b in pairwise(edges):
        stretch = values[measured[a:b]]
        low = np.where(np.isfinite(stretch), stretch, np.inf).argmin(0)
        high = np.where(np.isfinite(stretch), stretch, -np.inf).argmax(0)
        kept.update((a + low).tolist(), (a + high).tolist())
    return measured[sorted(kept)]
