"""Faults of the telemetry that the check comes across: noise other than stated, a stale bias."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.dirt import Dirt
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.conventions import limits

# The sd of second differences of white noise, and of a normal distribution's median deviation.
_SECOND_DIFFERENCE, _MEDIAN_DEVIATION = 6.0**0.5, 1.4826
# Fewer rows than this do not tell a noise.
_FEW_ROWS = 30


def dirt_of(campaign: Campaign) -> tuple[dict[str, Any], ...]:
    """Everything that was found: by the reader, and by looking at the noise.

    Parameters
    ----------
    campaign : Campaign
        What was flown.

    Returns
    -------
    tuple of dict
        As `Dirt.json` writes them.
    """
    by_reader = getattr(campaign, "dirt", ())
    return tuple(dirt.json() for dirt in (*by_reader, *_noise_levels(campaign)))


def smooth_noise(values: np.ndarray) -> float:
    """Noise of readings (n,), from their second differences, which hardly see smooth motion.

    Parameters
    ----------
    values : (n,) array
        Readings at even steps.

    Returns
    -------
    float
        Standard deviation; NaN with few readings.

    Examples
    --------
    >>> bool(0.8 < smooth_noise(np.random.default_rng(1).normal(size=500)) < 1.2)
    True
    """
    values = values[np.isfinite(values)]
    if len(values) < _FEW_ROWS:
        return float("nan")
    second = np.abs(np.diff(values, 2))
    # The quieter half of the rows: rests, and smooth motion.
    return float(_MEDIAN_DEVIATION * np.median(second) / _SECOND_DIFFERENCE)


def _noise_levels(campaign: Campaign) -> list[Dirt]:
    rate = _level("rate", "the rate's noise", np.asarray(campaign.rate_sensor.sigma), campaign)
    sigmas = [wheel.momentum_sigma or np.nan for wheel in campaign.wheels]
    return [*rate, *_level("momentum", "the tachometers' noise", np.array(sigmas), campaign)]


def _level(channel: str, words: str, stated: np.ndarray, campaign: Campaign) -> list[Dirt]:
    if not len(stated):
        return []
    field = {"rate": "rate", "momentum": "wheel_momentum"}[channel]
    seen = [_of_slew(slew, field) for slew in campaign.slews]
    seen = [noise for noise in seen if noise is not None]
    if not seen:
        return []
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.nanmedian(np.array(seen), axis=0) / stated
    off = ratio[np.isfinite(ratio) & (ratio > 0.0)]
    if not len(off) or np.all((off < limits.NOISE_RATIO) & (off > 1.0 / limits.NOISE_RATIO)):
        return []
    worst = off[np.argmax(np.abs(np.log(off)))]
    note = f"{words} in smooth rows is {worst:.2g} times the stated one"
    return [Dirt("noise_level", channel, "", (), "ignored", note)]


def _of_slew(slew: Slew, field: str) -> np.ndarray | None:
    values = getattr(slew, field)
    if values is None or not values.shape[1]:
        return None
    return np.array([smooth_noise(column) for column in values.T])
