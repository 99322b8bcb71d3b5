"""Noise of the sensors as their own readings show it."""

from __future__ import annotations

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.sensors import SensorStream
from bayes_inertia.conventions.limits import LIMITS
from bayes_inertia.faults.noise import smooth_noise


def noise_ratios(campaign: Campaign, stream: SensorStream) -> np.ndarray:
    """Noise in smooth rows over the stated noise, median over the slews.

    Returns: one number an axis or wheel; empty or NaN where nothing is known.
    """
    stated = _stated(campaign, stream)
    readings = [stream.of(slew) for slew in campaign.slews]
    seen = [[smooth_noise(c) for c in v.T] for v in readings if v is not None and v.shape[1]]
    if not seen or not len(stated):
        return np.zeros(0)
    ratios = np.array(seen) / stated
    return np.array(
        [np.median(r[np.isfinite(r)]) if np.isfinite(r).any() else np.nan for r in ratios.T]
    )


def believed_noise(campaign: Campaign, stream: SensorStream) -> np.ndarray:
    """The stated noise, but never much more than the readings show.

    So a reading in a smaller unit has less noise too, and cannot drown in a noise that was stated
    in a larger one.

    Returns: sd of each axis or wheel, 0 where nothing is stated.
    """
    stated = np.nan_to_num(_stated(campaign, stream))
    ratio = noise_ratios(campaign, stream)
    if len(ratio) != len(stated):
        return stated
    seen = np.where(np.isfinite(ratio), ratio, 1.0)
    return stated * np.minimum(1.0, LIMITS.noise_believed * seen)


def _stated(campaign: Campaign, stream: SensorStream) -> np.ndarray:
    return np.array([np.nan if s is None else s for s in stream.sigma(campaign)], dtype=float)
