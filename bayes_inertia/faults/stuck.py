"""Stuck readings: the same value to the last digit for longer than noise allows.

Nothing but the readings and the stated noise is used. A sensor whose resolution is coarser than
its noise repeats itself by right, and so does one without noise: neither is called stuck.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bayes_inertia.faults.fault import Fault, Series
from bayes_inertia.faults.limits import LIMITS
from bayes_inertia.faults.noise import second_difference_noise
from bayes_inertia.faults.quantisation import resolution


def stuck_readings(readings: np.ndarray, sigma: Sequence[float | None]) -> np.ndarray:
    """Which readings (n, k) repeat those before them for too long, in one axis or in all."""
    stuck = np.zeros(readings.shape, dtype=bool)
    chance = [None if s is None else _repetition(readings[:, k], s) for k, s in enumerate(sigma)]
    judged = [k for k, p in enumerate(chance) if p is not None]
    for k in judged:
        rows = np.flatnonzero(np.isfinite(readings[:, k]))
        stuck[rows, k] = _too_long(readings[rows, k][:, None], chance[k] or 0.0)
    if len(judged) > 1:
        rows = np.flatnonzero(np.isfinite(readings[:, judged]).all(axis=1))
        together = math.prod(chance[k] or 0.0 for k in judged)
        in_all = _too_long(readings[np.ix_(rows, judged)], together)
        stuck[np.ix_(rows, judged)] |= in_all[:, None]
    return stuck


def stuck_fixes(fixes: np.ndarray) -> np.ndarray:
    """Which fixes (n, 4) repeat those before them in runs of three and more, beside enough others.

    >>> stuck_fixes(np.full((9, 4), 0.5)).any()
    np.False_
    """
    stuck = np.zeros(len(fixes), dtype=bool)
    rows = np.flatnonzero(np.isfinite(fixes).all(axis=1))
    runs = _run_lengths(fixes[rows])
    others = runs < LIMITS.shortest_stuck_run_of_fixes
    if others.sum() >= LIMITS.fewest_fixes_beside_runs and np.all(runs[others] == 1):
        stuck[rows] = ~others
    return stuck


def always_zero(momentum: Sequence[np.ndarray], torque: Sequence[np.ndarray]) -> bool:
    """Whether a wheel is never commanded and its tachometer reads exactly 0 in every row.

    >>> always_zero([np.zeros(5)], [np.zeros(5)]), always_zero([np.zeros(5)], [np.ones(5)])
    (True, False)
    """
    read = np.concatenate([np.zeros(0), *(column[np.isfinite(column)] for column in momentum)])
    told = np.concatenate([np.zeros(0), *torque])
    return len(read) > 0 and not read.any() and not np.nan_to_num(told).any()


def _run_lengths(values: np.ndarray) -> np.ndarray:
    """For each row (n, k) the number of equal rows in the run that it belongs to."""
    if not len(values):
        return np.zeros(0, dtype=int)
    begins = np.concatenate([[True], np.any(values[1:] != values[:-1], axis=1)])
    run = np.cumsum(begins) - 1
    return np.bincount(run)[run]


def _repetition(values: np.ndarray, sigma: float) -> float | None:
    """The chance that the next reading of one axis is the same; None if it cannot be told."""
    values = values[np.isfinite(values)]
    others = _run_lengths(values[:, None]) < LIMITS.shortest_stuck_run
    if others.sum() < LIMITS.fewest_readings_beside_runs:
        return None
    inner = others[:-2] & others[1:-1] & others[2:]
    bends = (values[:-2] - 2.0 * values[1:-1] + values[2:])[inner]
    if not len(bends):
        return None
    noise = second_difference_noise(bends)
    step = resolution(values)
    if noise <= LIMITS.least_noise_to_judge * sigma or min(noise, sigma) <= 0.5 * step:
        return None
    white = math.sqrt(noise**2 - step**2 / 12.0)
    # A sensor that is read more often than it measures repeats itself, too.
    repeated = float(np.mean((values[1:] == values[:-1])[others[1:] & others[:-1]]))
    return max(repeated, math.erf(step / (2.0 * math.sqrt(2.0) * white)))


def _too_long(values: np.ndarray, chance: float) -> np.ndarray:
    """Which rows (n, k) stand in runs that noise makes less than once in a million slews."""
    shortest = LIMITS.shortest_stuck_run
    if chance > 0.0:
        needed = math.log(LIMITS.stuck_false_alarms / max(len(values), 1)) / math.log(chance)
        shortest = max(shortest, 1 + math.ceil(needed))
    return _run_lengths(values) >= shortest


def detect(series: Series) -> list[Fault]:
    """Readings that stand still for longer than noise allows."""
    if series.whole:
        stuck = stuck_fixes(series.values)
        mask = np.repeat(stuck[:, None], series.values.shape[1], axis=1)
    else:
        mask = stuck_readings(np.where(series.valid, series.values, np.nan), series.sigma)
    rows = int(mask.any(axis=1).sum())
    note = f"{rows} rows with the same value to the last digit"
    return [Fault("stuck", mask, "masked", note, masks=True)] if rows else []
