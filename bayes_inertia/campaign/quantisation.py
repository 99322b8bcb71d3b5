"""Quantised readings: whole multiples of one step that the stated noise does not hide."""

from __future__ import annotations

import math

import numpy as np

from bayes_inertia.campaign.stuck import resolution

_MULTIPLES = 0.99  # of the differences between values must be whole multiples of the step
_ROUNDING = 0.01  # [steps]
_FEWEST_VALUES = 3  # different ones


def quantisation_step(values: np.ndarray) -> float | None:
    """The step of which all differences between readings are whole multiples.

    `values` (n,): readings of one axis; NaN where there is none. Returns: in the readings' unit;
    None if there is no such step, or too few different values.

    Examples
    --------
    >>> quantisation_step(np.array([0.0, 0.5, 1.5, 0.5]))
    0.5
    >>> quantisation_step(np.random.default_rng(1).normal(size=50)) is None
    True
    """
    different = np.unique(values[np.isfinite(values)])
    step = resolution(different)
    if len(different) < _FEWEST_VALUES or step == 0.0:
        return None
    multiples = (different - different[0]) / step
    whole = np.abs(multiples - np.round(multiples)) < _ROUNDING
    return step if np.mean(whole) >= _MULTIPLES else None


def quantisation_sigma(step: float) -> float:
    """Standard deviation of the error of rounding to a step.

    Examples
    --------
    >>> round(quantisation_sigma(12.0), 6)
    3.464102
    """
    return step / math.sqrt(12.0)
