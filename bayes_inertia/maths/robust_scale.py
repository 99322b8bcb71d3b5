"""The sd of a normal distribution from what outliers and long thin tails hardly move."""

from __future__ import annotations

from statistics import NormalDist
from typing import Any

SD_OVER_MAD = 1.4826
"""Sd of a normal distribution over its median absolute deviation."""


def sd_of_interval(low: Any, high: Any) -> Any:
    """The sd of a normal distribution with this 90 % interval.

    An average over models has long thin tails, which rule its sd and not what holds 90 %.

    >>> round(sd_of_interval(-1.6449, 1.6449), 4)
    1.0
    """
    return (high - low) / (2.0 * NormalDist().inv_cdf(0.95))
