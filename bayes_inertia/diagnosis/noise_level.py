"""The noise as the data show it: its white level, measured from second differences, which smooth misfit does not touch."""

from __future__ import annotations

import numpy as np

from bayes_inertia.inference.laplace import Estimate

# Differences of white noise, by order: variance, and number of independent values that one is worth times two (from their correlations).
_VARIANCE = {2: 6.0, 4: 70.0}
_SPREAD = {
    2: 2.0 * (1.0 + 2.0 * (16.0 + 1.0) / 36.0),
    4: 2.0 * (1.0 + 2.0 * (56.0**2 + 28.0**2 + 8.0**2 + 1.0) / 70.0**2),
}
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
    fixes = [slew.time[slew.fixes] for slew in at.model.campaign.slews]
    series["attitude"] = [
        burst
        for t, slew in zip(fixes, series["attitude"], strict=True)
        for burst in _bursts(t, slew[: len(t)])
    ]
    return {channel: white_factor(pieces) for channel, pieces in series.items()}


def white_factor(pieces: list[np.ndarray]) -> float:
    """Factor by which the white noise of series (rows, components) exceeds one; 1 unless that is significant.

    Components (sensor axes, wheels) share one factor: where one is significantly louder than all together it is the loudest one's, so
    that no uncertainty comes out too small. That one is measured from fourth differences, in which a ringing of one axis hardly counts.

    >>> rng = np.random.default_rng(1)
    >>> white_factor([rng.normal(size=(500, 3))]), round(white_factor([rng.normal(size=(5000, 3)) * [1.0, 1.0, 3.0]]), 1)
    (1.0, 3.0)
    """
    together = np.concatenate([np.zeros(0), *_squares(pieces, 2)])
    if len(together) < _LEAST:
        return 1.0
    power = _clipped_power(together, 2)
    scatter = _SIGMAS * np.sqrt(_SPREAD[2] / len(together))
    columns = [column for column in _squares(pieces, 4) if len(column) >= _LEAST]
    for column in columns:
        own, own_scatter = _clipped_power(column, 4), _SIGMAS * np.sqrt(_SPREAD[4] / len(column))
        if own > power * (1.0 + own_scatter):
            power, scatter = own, own_scatter
    return float(np.sqrt(power)) if power > 1.0 + scatter else 1.0


def _squares(pieces: list[np.ndarray], order: int) -> list[np.ndarray]:
    """Squared differences of some order, one array a component."""
    long = [np.diff(piece, n=order, axis=0) ** 2 for piece in pieces if len(piece) > order]
    return [column[np.isfinite(column)] for column in np.concatenate(long).T] if long else []


def _bursts(time: np.ndarray, series: np.ndarray) -> list[np.ndarray]:
    """A series of fixes split at its gaps: what differs between before and after a slew is not noise."""
    gaps = np.diff(time)
    return (
        np.split(series, 1 + np.flatnonzero(gaps > 3.0 * np.quantile(gaps, 0.25)))
        if len(gaps)
        else [series]
    )


def _clipped_power(values: np.ndarray, order: int) -> float:
    """White noise power from squared differences of some order, without the few jumps that an unmodelled step leaves.

    The median starts it; the mean below three sigma, which scatters far less, finishes it.
    """
    power = float(np.median(values)) / 0.454936
    for _ in range(20):
        power = float(np.mean(values[values < 9.0 * power])) / _KEPT
    return power / _VARIANCE[order]
