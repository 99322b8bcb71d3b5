"""Outliers among residuals: single readings, or runs of a few, that stand out from both sides.

A reading is compared with the median of those before it and of those after it, each for itself.
A missing effect cannot look like that: a slope lies above on one side and below on the other, a
step agrees with one side, a ringing is as large all around. What stands out just where the wheels'
torques change is left alone all the same, since an effect could do that where rows are few.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import stats

from bayes_inertia.campaign.slew import Slew
from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.maths.robust_scale import SD_OVER_MAD


def distance_from_both_sides(series: np.ndarray) -> np.ndarray:
    """How far each reading lies beyond its neighbours on both sides.

    `series` (n,). Returns (n,): the lesser of the distances from the medians of the readings before
    and after; 0 where they have opposite signs. At the ends the one side there is counts.

    Examples
    --------
    >>> spike = np.where(np.arange(13) == 6, 9.0, 0.0)
    >>> float(distance_from_both_sides(spike)[6])
    9.0
    >>> float(distance_from_both_sides(np.arange(13.0))[6])
    0.0
    """
    before = series - _median_before(series)
    after = series - _median_before(series[::-1])[::-1]
    before, after = (np.where(np.isfinite(a), a, b) for a, b in ((before, after), (after, before)))
    return lesser_distance(before, after)


def lesser_distance(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """The lesser of two distances.

    Examples
    --------
    >>> lesser_distance(np.array([-3.0, 1.0]), np.array([-2.0, -1.0])).tolist()
    [-2.0, 0.0]
    """
    least = np.minimum(np.abs(one), np.abs(other))
    return np.where(np.sign(one) == np.sign(other), np.sign(one) * least, 0.0)


def _median_before(series: np.ndarray) -> np.ndarray:
    """Median of the readings before each; NaN where there are fewer than three."""
    padded = np.concatenate([np.full(LIMITS.neighbours, np.nan), series[:-1]])
    windows = sliding_window_view(padded, LIMITS.neighbours).copy()
    few = np.isfinite(windows).sum(axis=1) < 3
    windows[few] = 0.0
    return np.where(few, np.nan, np.nanmedian(windows, axis=1))


def outlying_readings(
    slews: list[np.ndarray], steps: Sequence[float] | None = None
) -> list[np.ndarray]:
    """Readings of one channel that stand out from their neighbours.

    `slews` (rows, components). `steps`: to which multiples each component's readings are rounded,
    in the unit of the residuals; 0 where they are not. One step up or down is no outlier. Returns
    (rows, components): none at all where they are so many that they are the noise itself.

    Examples
    --------
    >>> calm = np.random.default_rng(1).normal(size=(400, 3))
    >>> spiked = calm.copy()
    >>> spiked[[50, 200, 201], [0, 1, 1]] += 12.0
    >>> int(outlying_readings([calm])[0].sum())
    0
    >>> np.argwhere(outlying_readings([spiked])[0]).tolist()
    [[50, 0], [200, 1], [201, 1]]
    """
    n = sum(int(np.isfinite(slew).sum()) for slew in slews)
    limit = stats.norm.isf(0.5 * LIMITS.reject_below / max(n, 1))
    flags = [np.zeros(slew.shape, bool) for slew in slews]
    for component in range(slews[0].shape[1]):
        rows = [np.flatnonzero(np.isfinite(slew[:, component])) for slew in slews]
        distances = [
            distance_from_both_sides(slew[k, component])
            if len(k) > 2 * LIMITS.neighbours
            else np.zeros(len(k))
            for slew, k in zip(slews, rows, strict=True)
        ]
        overall = _scale(np.concatenate(distances))
        for flag, k, distance in zip(flags, rows, distances, strict=True):
            scale = np.maximum(overall, _scale_around(distance))
            least = LIMITS.steps_beyond * steps[component] if steps is not None else 0.0
            flag[k, component] = np.abs(distance) > np.maximum(limit * scale, least)
    share = sum(int(flag.sum()) for flag in flags) / max(n, 1)
    return [flag & (share <= LIMITS.most_outliers) for flag in flags]


def _scale(distance: np.ndarray) -> float:
    """Standard deviation of white noise that would lie so far beyond its neighbours."""
    beyond = np.abs(distance[distance != 0.0])
    if len(beyond) < LIMITS.readings_around:
        return np.inf
    return float(np.median(beyond)) * SD_OVER_MAD / LIMITS.scale_of_white


def _scale_around(distance: np.ndarray) -> np.ndarray:
    """As `_scale`, of the readings around each."""
    width = 2 * LIMITS.readings_around + 1
    if len(distance) < width:
        return np.zeros(len(distance))
    beyond = np.where(distance != 0.0, np.abs(distance), np.nan)
    padded = np.pad(beyond, LIMITS.readings_around, mode="reflect")
    windows = sliding_window_view(padded, width)
    some = np.isfinite(windows).sum(axis=1) >= LIMITS.fewest_around
    around = np.zeros(len(distance))
    around[some] = np.nanmedian(windows[some], axis=1)
    return around * SD_OVER_MAD / LIMITS.scale_of_white


def away_from_switches(slews: tuple[Slew, ...], flags: list[np.ndarray]) -> list[np.ndarray]:
    """Take back outliers at changes of torque, if they gather there.

    `flags` (rows, components). Returns (rows, components).
    """
    near = [_near_switch(slew, len(flag)) for slew, flag in zip(slews, flags, strict=True)]
    share = sum(int(rows.sum()) for rows in near) / max(1, sum(map(len, near)))
    hit = [flag.any(axis=1) for flag in flags]
    there = sum(int((rows & flag).sum()) for rows, flag in zip(near, hit, strict=True))
    total = sum(int(flag.sum()) for flag in hit)
    if not total or stats.binom.sf(there - 1, total, share) > LIMITS.reject_below:
        return flags
    return [flag & ~rows[:, None] for flag, rows in zip(flags, near, strict=True)]


def _near_switch(slew: Slew, rows: int) -> np.ndarray:
    """Rows (rows,) beside a change of torque."""
    near = np.zeros(rows, bool)
    if slew.wheel_torque is None or len(slew.time) < 2:
        return near
    torque = slew.wheel_torque
    change = np.abs(np.diff(torque, axis=0)).max(axis=1, initial=0.0)
    largest = np.abs(torque).max(initial=0.0)
    for row in np.flatnonzero(change > LIMITS.switch * largest) if largest > 0.0 else ():
        near[max(0, row + 1 - LIMITS.rows_at_switch) : row + 2 + LIMITS.rows_at_switch] = True
    return near
