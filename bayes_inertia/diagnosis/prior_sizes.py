"""Sizes that an effect may have: what its prior allows, and what is beyond it.

A prior states how large an effect may plausibly be. It may be wrong: with a small probability the
size is log-uniform beyond it, so that a strong effect pays once for its unlikely size, and not with
the square of it.
"""

from __future__ import annotations

import numpy as np

# Probability that a stated prior is too narrow, sizes that are tried then, and how many times too
# narrow at most.
WRONG_PRIOR, WIDEST = 0.01, 100.0
_WIDER_SIZES = 12
# Smallest size: signal-to-noise amplitude in its clearest direction. It is at most this share of
# the largest.
INVISIBLE, LARGEST_START = 0.3, 0.1
# Largest size of an effect without a fixed shape: so many prior sds beyond its median.
LARGEST_RANDOM_SIZE = 2.0


def smallest_size(powers: np.ndarray, largest: float) -> float:
    """The size that a campaign can just not see, from which sizes are tried.

    `powers` (n,): information along the directions of an effect of size one.

    Examples
    --------
    >>> round(smallest_size(np.array([1.0, 900.0]), 1.0), 6), smallest_size(np.array([1.0]), 1.0)
    (0.01, 0.1)
    """
    strongest = max(float(powers.max(initial=0.0)), 1e-300)
    return float(min(INVISIBLE / np.sqrt(strongest), LARGEST_START * largest))


def sizes_with_weights(least: float, largest: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Sizes to average evidence over, even in their logarithm.

    Returns `sizes, weights` (count + 12,): the last twelve are beyond the prior; the weights add up
    to one.

    Examples
    --------
    >>> sizes, weights = sizes_with_weights(0.1, 1.0, 4)
    >>> float(sizes.max().round(6)), float(weights.sum().round(6))
    (100.0, 1.0)
    """
    stated = np.geomspace(least, largest, count)
    wider = np.geomspace(largest, WIDEST * largest, _WIDER_SIZES + 1)[1:]
    each = [(1.0 - WRONG_PRIOR) / count, WRONG_PRIOR / _WIDER_SIZES]
    return np.concatenate([stated, wider]), np.repeat(each, [count, _WIDER_SIZES])
