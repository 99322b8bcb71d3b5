"""The noise as the data show it: its white level, measured from second differences, which smooth misfit does not touch."""

from __future__ import annotations

import numpy as np

from bayes_inertia.estimate import Estimate

# Second differences of white noise: variance 6, correlations -4/6 and 1/6 with their neighbours.
_VARIANCE = 6.0
_SPREAD = 2.0 * (1.0 + 2.0 * (16.0 + 1.0) / 36.0)
_SIGMAS = 4.0
# Mean square of a standard normal number that is below three sigma.
_KEPT = 0.973337


def noise_factors(at: Estimate) -> dict[str, float]:
    """Factor by which each channel's white noise exceeds its stated sigma; 1 unless that is significant (four sigma).

    Smaller noise than stated is left alone: it makes the result cautious, not wrong.
    """
    return {channel: _factor(slews) for channel, slews in at.residual_series.items()}


def _factor(slews: list[np.ndarray]) -> float:
    squares = [np.diff(slew, n=2, axis=0) ** 2 for slew in slews if len(slew) > 2]
    values = np.concatenate([s[np.isfinite(s)] for s in squares]) if squares else np.zeros(0)
    if len(values) < 30:
        return 1.0
    power = _clipped_power(values)
    return float(np.sqrt(power)) if power > 1.0 + _SIGMAS * np.sqrt(_SPREAD / len(values)) else 1.0


def _clipped_power(values: np.ndarray) -> float:
    """White noise power from squared second differences, without the few jumps that an unmodelled step leaves.

    The median starts it; the mean below three sigma, which scatters far less, finishes it.
    """
    power = float(np.median(values)) / 0.454936
    for _ in range(20):
        power = float(np.mean(values[values < 9.0 * power])) / _KEPT
    return power / _VARIANCE
