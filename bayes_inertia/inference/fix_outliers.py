"""Star-tracker fixes that stand out from the others of their burst.

A missing torque turns the body from fix to fix. The rate sensor saw that turn, so that the fixes
are compared without it. The rate sensor may have an error of its own, so that an outlier is only
what stands out with that turn, too: in a long burst from the fixes on both sides, in a short one
from a steady drift.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage, stats

from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.noise_level import bursts_of
from bayes_inertia.inference.outliers import (
    FALSE_ALARM,
    NEIGHBOURS,
    READINGS_AROUND,
    distance_from_both_sides,
    lesser_distance,
)
from bayes_inertia.maths.robust_scale import SD_OVER_MAD

# More outliers than this share of all fixes are no outliers but their noise.
_MOST_OUTLIERS = 0.15
# Fewer fixes tell nothing.
_FEWEST_FIXES = 3
# What two or a few others let expect scatters itself: distances count by so much less.
_SCATTER_OF_MEDIAN, _SCATTER_OF_LINE = 1.25, 1.5
# Rates are smoothed over so many readings before they are integrated.
_SMOOTHED_OVER = 9


def outlying_fixes(
    slews: Sequence[np.ndarray],
    bursts: Sequence[Sequence[np.ndarray]],
    times: Sequence[np.ndarray] | None = None,
    turns: Sequence[np.ndarray] | None = None,
) -> list[np.ndarray]:
    """Star-tracker fixes that stand out from the others of their burst.

    Parameters
    ----------
    slews : sequence of (fixes, 3) arrays
        Residuals, NaN where there is no fix.
    bursts : sequence of sequences of arrays of int
        By slew, the fixes of each burst.
    times : sequence of (fixes,) arrays, optional
        Of the fixes [s]; evenly spaced by default.
    turns : sequence of (fixes, 3) arrays, optional
        How the rate sensor saw the body turn beyond what is predicted, in the unit of the
        residuals; not at all by default.

    Returns
    -------
    list of (fixes,) arrays of bool
        None of a burst of less than three fixes, where nobody can say which is wrong, and never
        more than a third of a burst.
    """
    times = [np.arange(float(len(slew))) for slew in slews] if times is None else times
    turns = [np.zeros(slew.shape) for slew in slews] if turns is None else turns
    distances = [np.full(slew.shape, np.nan) for slew in slews]
    for slew, distance, parts, time, turn in zip(
        slews, distances, bursts, times, turns, strict=True
    ):
        for part in parts:
            distance[part] = _distances(slew[part], slew[part] - turn[part], time[part])
    every = np.concatenate(distances)
    every = every[np.isfinite(every)]
    if len(every) < READINGS_AROUND:
        return [np.zeros(len(slew), bool) for slew in slews]
    limit = stats.norm.isf(0.5 * FALSE_ALARM / len(every))
    # A quarter more: what others let expect scatters itself. Never below what is stated. Zeros do
    # not count: they are fixes between the others.
    beyond = np.abs(every[every != 0.0])
    scatter = float(np.median(beyond)) if len(beyond) >= READINGS_AROUND else 0.0
    scale = _SCATTER_OF_MEDIAN * max(1.0, SD_OVER_MAD * scatter)
    flags = [(np.abs(np.nan_to_num(d)) > limit * scale).any(axis=1) for d in distances]
    for flag, parts in zip(flags, bursts, strict=True):
        for part in parts:
            flag[part] &= 3 * int(flag[part].sum()) <= len(part)
    share = sum(int(flag.sum()) for flag in flags) / max(1, sum(map(len, flags)))
    return [flag & (share <= _MOST_OUTLIERS) for flag in flags]


def _distances(burst: np.ndarray, unturned: np.ndarray, time: np.ndarray) -> np.ndarray:
    """How far each fix (m, 3) lies from what the others of its burst let expect."""
    if len(burst) < _FEWEST_FIXES:
        return np.full(burst.shape, np.nan)
    if len(burst) >= 2 * NEIGHBOURS + 1:
        drifting, still = (
            np.stack([distance_from_both_sides(axis) for axis in x.T], 1) for x in (burst, unturned)
        )
        return lesser_distance(still, drifting)
    distance = np.zeros(burst.shape)
    for i in range(len(burst)):
        others = np.delete(np.arange(len(burst)), i)
        still = unturned[i] - np.median(unturned[others], axis=0)
        if len(others) == 2:  # Which of three is wrong is known only where two agree.
            apart = np.abs(unturned[others[1]] - unturned[others[0]])
            still = np.where(apart < 0.5 * np.abs(still), still, 0.0)
        line = np.polynomial.polynomial.polyfit(time[others] - time[i], burst[others], 1)
        drifting = (burst[i] - line[0]) / _SCATTER_OF_LINE
        distance[i] = lesser_distance(still, drifting)
    return distance


def fix_outliers(estimate: Estimate, series: dict[str, list[np.ndarray]]) -> list[np.ndarray]:
    """Outliers among the fixes of an estimate's campaign.

    Parameters
    ----------
    estimate : Estimate
        A fit.
    series : dict of list of (rows, components) arrays
        Its residuals by channel and slew, in stated sigmas, noise that is correlated as it is.

    Returns
    -------
    list of arrays of int
        By slew, the rows of its telemetry.
    """
    slews = estimate.model.campaign.slews
    rows = [np.flatnonzero(slew.fixes) for slew in slews]
    fixes = [x[: len(k)] for x, k in zip(series["attitude"], rows, strict=True)]
    times = [slew.time[k] for slew, k in zip(slews, rows, strict=True)]
    bursts = [bursts_of(time) for time in times]
    turns = [_turn_seen(estimate, s, x, rows[s]) for s, x in enumerate(series["rate"])]
    flags = outlying_fixes(fixes, bursts, times, turns)
    return [k[flag] for k, flag in zip(rows, flags, strict=True)]


def _turn_seen(
    estimate: Estimate, slew: int, residuals: np.ndarray, rows: np.ndarray
) -> np.ndarray:
    """How the rate sensor saw the body turn beyond what is predicted (fixes, 3), whitened."""
    campaign, time = estimate.model.campaign, estimate.model.campaign.slews[slew].time
    residuals = residuals[: len(time)]
    given = np.isfinite(residuals)
    if not len(rows) or not given.any(axis=0).all():
        return np.zeros((len(rows), 3))
    white = np.asarray(estimate.stated.rate)[slew, : len(time)]
    # Nothing was measured where a factor's row is zero.
    filled = white + np.where(given[..., None], 0.0, np.eye(3))
    gap = np.linalg.solve(filled, np.nan_to_num(residuals)[..., None])[..., 0]
    smooth = [
        np.interp(time, time[k], ndimage.median_filter(axis[k], _SMOOTHED_OVER, mode="nearest"))
        for axis, k in zip(gap.T, given.T, strict=True)
    ]
    scaled = np.stack(smooth) * np.asarray(estimate.theta[6:9])[:, None]
    rate_B = np.linalg.solve(campaign.rate_sensor.axes, scaled).T
    mean = 0.5 * (rate_B[1:] + rate_B[:-1]) * np.diff(time)[:, None]
    turn_B = np.concatenate([np.zeros((1, 3)), np.cumsum(mean, axis=0)])[rows]
    factors = np.asarray(estimate.stated.attitude)[slew, : len(rows)]
    return np.einsum("fij,fj->fi", factors, turn_B)
