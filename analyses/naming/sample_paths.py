"""Random processes that were drawn on a grid of times, looked up at others."""

from __future__ import annotations

import numpy as np


def at_times(path: np.ndarray, t: np.ndarray | float, spacing: float) -> np.ndarray:
    """A path (n, 3) on the times 0, `spacing`, ... at other times (..., 3): straight in between.

    `np.interp` on its columns would copy all of them at every call.
    """
    place = np.asarray(t) / spacing
    below = np.minimum(place.astype(int), len(path) - 2)
    share = (place - below)[..., None]
    return (1.0 - share) * path[below] + share * path[below + 1]
