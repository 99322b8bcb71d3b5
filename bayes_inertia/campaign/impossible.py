"""Readings that nothing can reach, such as the -1e31 that marks a missing value in some logs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_inertia.campaign.hardware import Wheel

FASTEST_RATE = 1e3  # [rad/s]; small bodies are torn apart by a tenth of it
_LARGEST_MOMENTUM = 1e6  # [N m s]; the largest gyros of space stations hold 5e3
_TIMES_THE_LIMIT = 100.0  # of a wheel


def impossible_rates(rate: np.ndarray) -> np.ndarray:
    """Which readings of a rate sensor no spacecraft can cause.

    Parameters
    ----------
    rate : (n, 3) array
        Readings [rad/s]; NaN where there is none.

    Returns
    -------
    (n, 3) array of bool
        True where they are faster than 1000 rad/s.

    Examples
    --------
    >>> impossible_rates(np.array([0.1, -1e31, np.nan])).tolist()
    [False, True, False]
    """
    return np.abs(np.nan_to_num(rate)) > FASTEST_RATE


def impossible_momentum(momentum: np.ndarray, wheels: Sequence[Wheel]) -> np.ndarray:
    """Which readings of the tachometers no wheel can cause.

    Parameters
    ----------
    momentum : (n, wheels) array
        Readings [N m s]; NaN where there is none.
    wheels : sequence of Wheel
        The wheels, with their limits where they are known.

    Returns
    -------
    (n, wheels) array of bool
        True beyond a hundred times the wheel's limit.

    Examples
    --------
    >>> wheel = Wheel("x", (1.0, 0.0, 0.0), 1e-3, max_momentum=0.3)
    >>> impossible_momentum(np.array([[0.4], [1e300]]), [wheel])[:, 0].tolist()
    [False, True]
    """
    limits = [
        _LARGEST_MOMENTUM if w.max_momentum is None else _TIMES_THE_LIMIT * w.max_momentum
        for w in wheels
    ]
    return np.abs(np.nan_to_num(momentum)) > np.array(limits)
