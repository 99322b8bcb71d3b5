"""The noise as the data show it: its white level, measured from second differences, which smooth misfit does not touch."""

from __future__ import annotations

import numpy as np

from bayes_inertia.estimate import Estimate

# Second differences of white noise: variance 6, correlations -4/6 and 1/6 with their neighbours.
_VARIANCE = 6.0
_SPREAD = 2.0 * (1.0 + 2.0 * (16.0 + 1.0) / 36.0)
_SIGMAS = 4.0
# Squared second differences that a level needs at least.
_LEAST = 30
# Mean square of a standard normal number that is below three sigma.
_KEPT = 0.973337


def noise_factors(at: Estimate) -> dict[str, float]:
    """Factor by which each channel's white noise exceeds its stated sigma; 1 unless that is significant (four sigma).

    Smaller noise than stated is left alone: it makes the result cautious, not wrong.
    """
    series = dict(at.residual_series)
    fixes = [slew.time[np.isfinite(slew.attitude).all(axis=1)] if slew.attitude is not None else np.zeros(0) for slew in at.model.campaign.slews]
    series["attitude"] = [burst for t, slew in zip(fixes, series["attitude"], strict=True) for burst in _bursts(t, slew[: len(t)])]
    return {channel: white_factor(pieces) for channel, pieces in series.items()}


def white_factor(pieces: list[np.ndarray]) -> float:
    """Factor by which the white noise of series (rows, components) exceeds one; 1 unless that is significant.

    Components (sensor axes, wheels) share one factor: where one is significantly louder than all together it is the loudest one's, so
    that no uncertainty comes out too small.

    >>> rng = np.random.default_rng(1)
    >>> white_factor([rng.normal(size=(500, 3))]), round(white_factor([rng.normal(size=(5000, 3)) * [1.0, 1.0, 3.0]]), 1)
    (1.0, 3.0)
    """
    squares = [np.diff(piece, n=2, axis=0) ** 2 for piece in pieces if len(piece) > 2]
    if not squares:
        return 1.0
    columns = [column[np.isfinite(column)] for column in np.concatenate(squares).T]
    counts = np.array([len(column) for column in columns])
    if counts.sum() < _LEAST:
        return 1.0
    power, count = _clipped_power(np.concatenate(columns)), counts.sum()
    if counts.min() >= _LEAST:
        powers = np.array([_clipped_power(column) for column in columns])
        power = float(counts @ powers / count)
        loudest = int(np.argmax(powers))
        if powers[loudest] > power * (1.0 + _SIGMAS * np.sqrt(_SPREAD / counts[loudest])):
            power, count = float(powers[loudest]), counts[loudest]
    return float(np.sqrt(power)) if power > 1.0 + _SIGMAS * np.sqrt(_SPREAD / count) else 1.0


def _bursts(time: np.ndarray, series: np.ndarray) -> list[np.ndarray]:
    """A series of fixes split at its gaps: what differs between before and after a slew is not noise."""
    gaps = np.diff(time)
    return np.split(series, 1 + np.flatnonzero(gaps > 3.0 * np.quantile(gaps, 0.25))) if len(gaps) else [series]


def _clipped_power(values: np.ndarray) -> float:
    """White noise power from squared second differences, without the few jumps that an unmodelled step leaves.

    The median starts it; the mean below three sigma, which scatters far less, finishes it.
    """
    power = float(np.median(values)) / 0.454936
    for _ in range(20):
        power = float(np.mean(values[values < 9.0 * power])) / _KEPT
    return power / _VARIANCE
