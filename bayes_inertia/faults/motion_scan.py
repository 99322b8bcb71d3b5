"""When the body moved and when it rested, told from the rates.

The rates are freed of single outliers (running median) and of noise (running mean), then held
against the rate at rest. A motion is where they pass `high`; it lasts as long as they stay above
`low` (hysteresis), so that noise at its edges does not cut it into pieces.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.ndimage import median_filter, uniform_filter1d

from bayes_inertia.errors import require
from bayes_inertia.faults.limits import LIMITS
from bayes_inertia.faults.noise import step_noise
from bayes_inertia.maths.values import array_dataclass


@array_dataclass
class MotionScan:
    """The rates over time and the motions in them."""

    time: np.ndarray  # (n,): times of the rate readings [s]
    speed: np.ndarray  # (n,): norm of the smoothed rates, relative to the rate at rest [rad/s]
    segment: np.ndarray  # (n,) of int: counts up after each pause of the log
    # low, high: the thresholds [rad/s]
    low: float
    high: float
    motions: np.ndarray  # (m, 2): start and end of each motion [s]
    rest_rate: np.ndarray  # (3,): rate readings at rest [rad/s]

    def segment_span(self, moment: float) -> tuple[float, float]:
        """First and last time [s] of the part of the log, between pauses, that a moment lies in."""
        row = min(int(np.searchsorted(self.time, moment)), len(self.time) - 1)
        rows = np.flatnonzero(self.segment == self.segment[row])
        return float(self.time[rows[0]]), float(self.time[rows[-1]])


def scan_motion(
    time: np.ndarray, values: np.ndarray, where: str, *, threshold: float | None, pause: float
) -> MotionScan:
    """The motions in rates (n, 3) [rad/s]; `threshold` None: from noise and largest rate."""
    segment = np.concatenate([[0], np.cumsum(np.diff(time) > pause)])
    rates, width = _smoothed(time, values, segment)
    norm = np.linalg.norm(rates, axis=1)
    rest_rate = np.median(rates[norm <= np.quantile(norm, LIMITS.slowest_share)], axis=0)
    speed = np.linalg.norm(rates - rest_rate, axis=1)
    noise = float(np.linalg.norm([step_noise(axis) for axis in values.T]))
    floor = LIMITS.sigmas_of_rest * noise / np.sqrt(width)
    largest = float(speed.max())
    high = threshold or _threshold(floor, largest, where)
    at_rest = speed[speed < high]
    if len(at_rest) < LIMITS.rests_for * len(speed):
        _require_rest(float(np.linalg.norm(rest_rate)), float(norm.max()), where)
    level = float(np.median(at_rest)) if len(at_rest) else 0.0
    # Near the noise, so that a slew is over only when it has settled.
    usual = min(LIMITS.low_over_high * high, LIMITS.low_above_rest * level)
    low = min(high, max(usual, 2.0 * level, 1e-3 * high))
    motions = _hysteresis(time, speed, segment, low, high)
    return MotionScan(time, speed, segment, low, high, motions, rest_rate)


def _require_rest(slowest: float, largest: float, where: str) -> None:
    """Refuse a log of a body that turns all the time."""
    rates = f"it turns by {slowest:.2g} rad/s at least, {largest:.2g} rad/s at most"
    rests = slowest <= LIMITS.rests_below * largest
    advice = "state [[slews]] with start and end, or give one file a slew"
    require(rests, f"rates in {where}", f"the body never rests: {rates}", advice)


def _smoothed(time: np.ndarray, values: np.ndarray, segment: np.ndarray) -> tuple[np.ndarray, int]:
    """Rates (n, 3) without outliers and with less noise, and the rows averaged.

    Missing readings are bridged here, where rates are only looked at.
    """
    step = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    width = max(LIMITS.averaged_rows, round(LIMITS.averaged_s / max(step, 1e-9)))
    width = min(width, len(time))
    smooth = np.empty_like(values)
    for k in np.unique(segment):
        rows = np.flatnonzero(segment == k)
        for axis in range(values.shape[1]):
            bridged = _bridged(time[rows], values[rows, axis])
            bridged = median_filter(bridged, min(LIMITS.outlier_rows, len(rows)), mode="nearest")
            smooth[rows, axis] = uniform_filter1d(bridged, width, mode="nearest")
    return smooth, width


def _bridged(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    given = np.isfinite(values)
    if not given.any():
        return np.zeros_like(values)
    return np.interp(time, time[given], values[given])


def _threshold(floor: float, largest: float, where: str) -> float:
    rates = f"the largest rate, {largest:.2g} rad/s, is hardly above the noise, {floor:.2g} rad/s"
    advice = "give files that hold slews, check unit and scale, or state [[slews]] with start "
    advice += "and end"
    moves = largest > LIMITS.visible_motion * floor and largest != 0.0
    require(moves, f"rates in {where}", f"no slew is to be seen: {rates}", advice)
    # Half way between noise and slew, on a logarithmic scale.
    between = np.sqrt(max(floor, 1e-4 * largest) * largest)
    return float(min(between, LIMITS.largest_threshold * largest))


def _hysteresis(
    time: np.ndarray, speed: np.ndarray, segment: np.ndarray, low: float, high: float
) -> np.ndarray:
    """Start and end (m, 2) of the runs above `low` that pass `high`."""
    above = _without_dips(time, speed > low, segment)
    new = np.concatenate([[True], (np.diff(above) != 0) | (np.diff(segment) != 0)])
    starts = np.flatnonzero(new)
    ends = np.append(starts[1:], len(time)) - 1
    spans = [(i, j) for i, j in zip(starts, ends, strict=True) if above[i]]
    runs = [(time[i], time[j]) for i, j in spans if speed[i : j + 1].max() > high]
    return np.array(runs).reshape(-1, 2)


def _without_dips(time: np.ndarray, above: np.ndarray, segment: np.ndarray) -> np.ndarray:
    """Which rows are above, short dips between two of them included."""
    rows = np.flatnonzero(above)
    closed = above.copy()
    for i, j in pairwise(rows.tolist()):
        if j - i > 1 and time[j] - time[i] < LIMITS.longest_dip_s and segment[i] == segment[j]:
            closed[i:j] = True
    return closed
