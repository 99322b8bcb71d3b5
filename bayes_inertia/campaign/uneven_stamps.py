"""Stamps that jitter about a regular clock, and whether the readings jitter with them.

A stamp that is off by e moves a reading y by y' e only if the reading was taken at the stamp. So
the readings themselves tell: regress their short-term part on that of y' e. A slope of 1 says that
sampling is uneven and the stamps are right; 0 says that sampling is regular and the stamps jitter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayes_inertia.maths.robust_scale import SD_OVER_MAD

# Jitter is less than this share of the step, else rows cannot be counted.
_FARTHEST = 0.45
# Means of so many rows may not stray further than white jitter does, by this factor.
_BLOCK, _WANDER = 20, 4.0
_FEWEST_ROWS = 20
# Rows of the curve that is taken for the motion, and of the line that is its slope.
_CURVE, _LINE = 7, 9
_OUTLYING = 6.0  # sd; a reading counts no more than this.
# Between the slope and one half, in sds, where readings are said to decide: the other of 0 and 1 is
# then twice as many sds away at least.
_SURE = 4.0


@dataclass(frozen=True)
class StampSlope:
    """How far readings move with the jitter of their stamps.

    Parameters
    ----------
    value : float
        1 where they were taken at the stamps, 0 where at the times of a regular clock.
    sd : float
        Its standard deviation; infinite where there is no motion.
    """

    value: float
    sd: float

    @property
    def sampling_is_regular(self) -> bool:
        """Whether the readings show that the stamps jitter, not the sampling."""
        return self.value + _SURE * self.sd < 0.5

    @property
    def sampling_is_uneven(self) -> bool:
        """Whether the readings show that they were taken at their stamps."""
        return self.value - _SURE * self.sd > 0.5


def row_numbers(time: np.ndarray) -> np.ndarray:
    """Numbers of rows on a regular clock, as far as single steps tell.

    `time` (n,). Returns (n,).

    Examples
    --------
    >>> row_numbers(np.array([0.0, 1.02, 1.99, 4.0])).tolist()
    [0.0, 1.0, 2.0, 4.0]
    """
    steps = np.diff(time)
    step = float(np.median(steps))
    near = steps[np.abs(steps - step) < 0.5 * step]
    return np.concatenate([[0.0], np.cumsum(np.round(steps / np.mean(near)))])


def clock_through(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """The regular clock that lies nearest to stamps.

    `time` (n,). Returns `fitted` (n,): times of the clock, counted from the first stamp; `rows`
    (n,): numbers of the rows on it; they do not increase everywhere where no clock fits.

    Examples
    --------
    >>> fitted, rows, step = clock_through(np.array([5.0, 6.0, 7.0, 9.0]))
    >>> fitted.round(9).tolist(), [round(row) for row in rows], round(float(step), 9)
    ([0.0, 1.0, 2.0, 4.0], [0, 1, 2, 4], 1.0)
    """
    rows = row_numbers(time)
    for _ in range(2):
        slope, start = np.polyfit(rows, time - time[0], 1)
        fitted = start + slope * rows
        rows = np.round((time - time[0] - start) / slope)
    return fitted, rows, slope


def regular_clock(time: np.ndarray) -> tuple[np.ndarray | None, str]:
    """Times of the regular clock about which stamps jitter.

    `time` (n,). Returns `time` (n,): times of the clock; None where no regular clock explains the
    stamps; `problem`: why there is none; "" where there is one.

    Examples
    --------
    >>> stamps = 0.5 * np.arange(99.0) + 0.02 * np.sin(np.arange(99.0) ** 2)
    >>> clock, _ = regular_clock(stamps)
    >>> bool(np.ptp(np.diff(clock)) < 1e-9)
    True
    """
    if len(time) < _FEWEST_ROWS:
        return None, f"there are only {len(time)} rows"
    fitted, rows, slope = clock_through(time)
    away = time - time[0] - fitted
    if np.any(np.diff(rows) < 1.0) or np.abs(away).max() > _FARTHEST * slope:
        return None, f"a stamp is {np.abs(away).max():.3g} off a clock with steps of {slope:.4g}"
    means = away[: len(away) // _BLOCK * _BLOCK].reshape(-1, _BLOCK).mean(axis=1)
    wander, white = float(np.sqrt(np.mean(means**2))), float(np.sqrt(np.mean(away**2) / _BLOCK))
    if wander > _WANDER * white:
        return None, f"the stamps wander by {wander:.3g} about a clock with steps of {slope:.4g}"
    return fitted + time[0], ""


def slope_of_readings(
    slews: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]],
) -> StampSlope:
    """Whether readings move with the jitter of their stamps.

    `slews`: for each slew the stamps (n,), the times of the regular clock (n,), and readings (n,
    width) of any unit, NaN where there is none.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> clock = 0.25 * np.arange(400.0)
    >>> stamps = clock + 0.02 * rng.uniform(-1.0, 1.0, 400)
    >>> readings = np.sin(clock)[:, None] + 1e-4 * rng.normal(size=(400, 1))
    >>> slope_of_readings([(stamps, clock, readings)]).sampling_is_regular
    True
    """
    products, squares = [], []
    for stamps, clock, readings in slews:
        for column in readings.T:
            x, y = _short_term(stamps, clock, column)
            if len(x):
                # A column counts by its own scatter; the slope is small beside the readings' noise.
                scale = np.sqrt(np.mean(y**2)) or 1.0
                products.append((x / scale, y / scale))
                squares.append(float(np.sum((x / scale) ** 2)))
    total = sum(squares)
    if not total > 0.0:
        return StampSlope(0.0, np.inf)
    value = sum(float(x @ y) for x, y in products) / total
    scores = [x * (y - value * x) for x, y in products]
    # Neighbours share readings: sums of blocks are nearly independent.
    blocks = [score[k : k + _BLOCK].sum() for score in scores for k in range(0, len(score), _BLOCK)]
    return StampSlope(value, float(np.sqrt(np.sum(np.square(blocks))) / total))


def _short_term(
    stamps: np.ndarray, clock: np.ndarray, readings: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What jitter would add to readings, and the readings, both less a curve through neighbours."""
    present = np.isfinite(readings)
    stamps, clock, readings = stamps[present], clock[present], readings[present]
    if len(readings) < _LINE + _CURVE:
        return np.zeros(0), np.zeros(0)
    step = float(np.median(np.diff(clock)))
    even = np.abs(np.diff(clock) - step) < 1e-3 * step
    rate = np.convolve(readings, _weights(_LINE, 1)[::-1], "valid") / step
    trim = _LINE // 2
    moved = rate * (stamps - clock)[trim:-trim]
    x, y = (
        np.convolve(v, _residual_weights()[::-1], "valid") for v in (moved, readings[trim:-trim])
    )
    width = _LINE + _CURVE - 2
    whole = np.convolve(even, np.ones(width), "valid") > width - 0.5
    x, y = x[whole], y[whole]
    spread = SD_OVER_MAD * float(np.median(np.abs(y))) if len(y) else 0.0
    return x, np.clip(y, -_OUTLYING * spread, _OUTLYING * spread) if spread > 0.0 else y


def _weights(width: int, order: int) -> np.ndarray:
    """Weights of a least-squares parabola (order 0) or line (order 1: its slope) at the middle."""
    at = np.arange(width) - width // 2
    powers = np.stack([at**p for p in range(3 - order)], axis=1).astype(float)
    return np.asarray(np.linalg.pinv(powers)[order])


def _residual_weights() -> np.ndarray:
    own = np.zeros(_CURVE)
    own[_CURVE // 2] = 1.0
    return own - _weights(_CURVE, 0)
