"""The noise as the data show it: its white level, measured from differences of the residuals.

Smooth misfit does not touch second differences.
"""

from __future__ import annotations

import numpy as np

from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.limits import LIMITS

# Differences of white noise, by order: variance, and the number of independent values that one is
# worth times two (from their correlations).
_DIFFERENCE_VARIANCE = {2: 6.0, 4: 70.0}
_DIFFERENCE_WORTH = {
    2: 2.0 * (1.0 + 2.0 * (16.0 + 1.0) / 36.0),
    4: 2.0 * (1.0 + 2.0 * (56.0**2 + 28.0**2 + 8.0**2 + 1.0) / 70.0**2),
}
_MEDIAN_OF_CHI2 = 0.454936  # with one degree of freedom
_POWER_BELOW_3_SIGMA = 0.973337  # mean square of a standard normal number that is below 3 sigma


def noise_factors(estimate: Estimate) -> dict[str, float]:
    """Measure by what factor each channel's white noise exceeds its stated sigma.

    Smaller noise than stated is left alone: it makes the result cautious, not wrong.

    `estimate`: A fit; its residuals are in stated sigmas. Processes of readings that it knows of
    are filtered out of them. Returns: {channel: factor}; 1 unless the excess is significant (four
    sigma).
    """
    series, campaign = dict(estimate.tested_residuals.series), estimate.model.campaign
    for channel in estimate.model.channels:
        if not channel.stream.is_series:
            times = (slew.time[channel.readings(campaign, slew).row] for slew in campaign.slews)
            series[channel.name] = [
                slew[burst]
                for time, slew in zip(times, series[channel.name], strict=True)
                for burst in bursts_of(time)
            ]
    return {channel: white_factor(pieces) for channel, pieces in series.items()}


def white_factor(pieces: list[np.ndarray]) -> float:
    """Measure by what factor the white noise of series exceeds one.

    Components (sensor axes, wheels) share one factor. Where one is significantly louder than all
    together it is the loudest one's, so that no uncertainty comes out too small. That one is
    measured from fourth differences, in which a ringing of one axis hardly counts.

    `pieces` (rows, components): series of even spacing; NaN where nothing was measured.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> white_factor([rng.normal(size=(500, 3))])
    1.0
    >>> round(white_factor([rng.normal(size=(5000, 3)) * [1.0, 1.0, 3.0]]), 1)
    3.0
    """
    together = np.concatenate([np.zeros(0), *_squares(pieces, 2)])
    if len(together) < LIMITS.fewest_differences:
        return 1.0
    power = _clipped_power(together, 2)
    scatter = LIMITS.significant_sigmas * np.sqrt(_DIFFERENCE_WORTH[2] / len(together))
    for component in _squares(pieces, 4):
        if len(component) < LIMITS.fewest_differences:
            continue
        component_power = _clipped_power(component, 4)
        component_scatter = LIMITS.significant_sigmas * np.sqrt(
            _DIFFERENCE_WORTH[4] / len(component)
        )
        if component_power > power * (1.0 + component_scatter):
            power, scatter = component_power, component_scatter
    return float(np.sqrt(power)) if power > 1.0 + scatter else 1.0


def _squares(pieces: list[np.ndarray], order: int) -> list[np.ndarray]:
    """Squared differences of some order, one array a component."""
    squares = [np.diff(piece, n=order, axis=0) ** 2 for piece in pieces if len(piece) > order]
    if not squares:
        return []
    return [column[np.isfinite(column)] for column in np.concatenate(squares).T]


def bursts_of(time: np.ndarray) -> list[np.ndarray]:
    """Star-tracker fixes of a slew, split at its gaps.

    What differs between before and after a slew is not noise.

    `time` (fixes,) [s].

    Examples
    --------
    >>> [burst.tolist() for burst in bursts_of(np.array([0.0, 1.0, 2.0, 50.0, 51.0]))]
    [[0, 1, 2], [3, 4]]
    """
    gaps, every = np.diff(time), np.arange(len(time))
    if not len(gaps):
        return [every]
    return np.split(
        every, 1 + np.flatnonzero(gaps > LIMITS.gap_in_spacings * np.quantile(gaps, 0.25))
    )


def _clipped_power(squares: np.ndarray, order: int) -> float:
    """White noise power from squared differences, without the few jumps of an unmodelled step.

    The median starts it, or the mean where most readings repeat, as those of an idle wheel or of a
    coarse counter do; the mean below three sigma, which scatters far less, finishes it.
    """
    power = float(np.median(squares)) / _MEDIAN_OF_CHI2 or float(np.mean(squares))
    for _ in range(20):
        below = squares[squares < 9.0 * power]
        if not below.any():
            return 0.0
        power = float(np.mean(below)) / _POWER_BELOW_3_SIGMA
    return power / _DIFFERENCE_VARIANCE[order]
