"""Noise of the sensors as their own readings show it."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.conventions import limits
from bayes_inertia.maths.robust_scale import SD_OVER_MAD

CHANNELS: Mapping[str, str] = MappingProxyType({"rate": "rate", "momentum": "wheel_momentum"})
"""Channels whose noise is looked at, and the fields of `Slew` that hold them."""

_SECOND_DIFFERENCE = 6.0  # variance of second differences of white unit noise
# Fewer rows than this do not tell a noise.
_FEW_ROWS = 30


def smooth_noise(values: np.ndarray) -> float:
    """Noise of readings (n,), from their second differences, which hardly see smooth motion.

    `values` (n,): readings at even steps; NaN where there is none.

    Examples
    --------
    >>> bool(0.8 < smooth_noise(np.random.default_rng(1).normal(size=500)) < 1.2)
    True
    """
    values = values[np.isfinite(values)]
    if len(values) < _FEW_ROWS:
        return float("nan")
    second = np.abs(np.diff(values, 2))
    return float(SD_OVER_MAD * np.median(second) / _SECOND_DIFFERENCE**0.5)


def noise_ratios(campaign: Campaign, channel: str) -> np.ndarray:
    """Noise in smooth rows over the stated noise, median over the slews.

    Returns: one number an axis or wheel; empty or NaN where nothing is known.
    """
    stated = _stated(campaign, channel)
    channels = [getattr(slew, CHANNELS[channel]) for slew in campaign.slews]
    seen = [[smooth_noise(c) for c in v.T] for v in channels if v is not None and v.shape[1]]
    if not seen or not len(stated):
        return np.zeros(0)
    ratios = np.array(seen) / stated
    return np.array(
        [np.median(r[np.isfinite(r)]) if np.isfinite(r).any() else np.nan for r in ratios.T]
    )


def believed_noise(campaign: Campaign, channel: str) -> np.ndarray:
    """The stated noise, but never much more than the readings show.

    So a reading in a smaller unit has less noise too, and cannot drown in a noise that was stated
    in a larger one.

    Returns: sd of each axis or wheel, 0 where nothing is stated.
    """
    stated = np.nan_to_num(_stated(campaign, channel))
    ratio = noise_ratios(campaign, channel)
    if len(ratio) != len(stated):
        return stated
    seen = np.where(np.isfinite(ratio), ratio, 1.0)
    return stated * np.minimum(1.0, limits.NOISE_BELIEVED * seen)


def _stated(campaign: Campaign, channel: str) -> np.ndarray:
    if channel == "rate":
        return np.asarray(campaign.rate_sensor.sigma)
    return np.array([wheel.momentum_sigma or np.nan for wheel in campaign.wheels])
