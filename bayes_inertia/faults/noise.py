"""Noise of readings: from differences of neighbours, and by an Allan-type fit at rest.

The variance of second differences of block means (the Hadamard variance, an Allan variance that no
steady drift enters) is fitted as a sum of what each kind of noise gives at each block length,
exactly, with weights by its degrees of freedom and no negative share. Slow real motion enters the
random walk, not the white noise.

References: D. W. Allan, Proc. IEEE 54, 221 (1966); IEEE Std 952-1997, annex C; R. A. Baugh, Proc.
25th Frequency Control Symposium, 222 (1971).
"""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal

import numpy as np

from bayes_inertia.faults.limits import LIMITS
from bayes_inertia.faults.quantisation import quantisation_sigma, quantisation_step
from bayes_inertia.maths.robust_scale import SD_OVER_MAD
from bayes_inertia.maths.values import array_dataclass


def second_difference_noise(second: np.ndarray) -> float:
    """White noise of which readings have these second differences (n,); outliers hardly count."""
    scale = LIMITS.second_difference_variance**0.5
    return SD_OVER_MAD * float(np.median(np.abs(second))) / scale


def smooth_noise(values: np.ndarray) -> float:
    """Noise of readings (n,) of a smooth motion; NaN for too few."""
    values = values[np.isfinite(values)]
    if len(values) < LIMITS.rows_for_noise:
        return float("nan")
    return second_difference_noise(np.diff(values, 2))


def step_noise(values: np.ndarray) -> float:
    """Noise of readings (n,) of a slow motion, gaps among them; 0 for too few."""
    steps = np.abs(np.diff(values))
    steps = steps[np.isfinite(steps)]
    return float(SD_OVER_MAD * np.median(steps) / np.sqrt(2.0)) if len(steps) else 0.0


@array_dataclass
class NoiseFit:
    """The noise of one reading.

    Parameters
    ----------
    white : float
        Standard deviation per sample, independent from sample to sample.
    white_error : float
        Its relative standard error.
    random_walk : float
        Standard deviation of the step that is added from sample to sample; 0 where none is seen.
    quantisation : float
        The step between neighbouring values; 0 where none is seen.
    flicker : float
        Floor of the averaged readings that longer averaging does not lower (bias instability); 0
        where none is seen.
    samples : int
        Number of readings.
    """

    white: float
    white_error: float
    random_walk: float
    quantisation: float
    flicker: float
    samples: int


def rounding_sigmas(values: np.ndarray) -> np.ndarray:
    """Standard deviation of the rounding of each column, in its unit; 0 where none is seen.

    `values` (n, k): numbers of one quantity as they lie in a file; NaN where there is none. A
    column that never changes is taken to have the coarsest step of the others, whatever their
    decimals. Returns (k,).

    >>> speeds = np.array([[300.0, 100.0, 50.0], [150.0, 100.0, 50.5], [450.0, 100.0, 49.5]])
    >>> rounding_sigmas(speeds).round(2).tolist()
    [43.3, 43.3, 0.14]
    """
    # Coarse rounding, which alone matters, is seen in a part of a long log.
    values = values[:: max(1, len(values) // LIMITS.rows_of_rounding)]
    columns = [np.unique(column[np.isfinite(column)]) for column in values.T]
    # Two values alone show a step only where they are multiples of it themselves.
    three = (np.append(column, 0.0) if len(column) == 2 else column for column in columns)
    steps = [quantisation_step(column) or 0.0 for column in three]
    decimal = _decimal_step(columns)
    both, largest = zip(columns, steps, strict=True), max(steps, default=0.0)
    steps = [largest if len(column) == 1 else max(step, decimal) for column, step in both]
    return np.array([quantisation_sigma(step) for step in steps])


def _decimal_step(columns: Sequence[np.ndarray]) -> float:
    """The unit of the last decimal in which all numbers are written; 0 for too few numbers."""
    most = LIMITS.numbers_of_decimals
    some = (column[:: max(1, len(column) // most)].tolist() for column in columns)
    numbers = {number for column in some for number in column if number != 0.0}
    if len(numbers) < LIMITS.fewest_numbers:
        return 0.0
    # Twelve digits: products with a step have rounding of their own in the last ones.
    last = [Decimal(f"{number:.12g}").normalize().as_tuple().exponent for number in numbers]
    return 10.0 ** min(int(exponent) for exponent in last)


def fit_noise(series: Sequence[np.ndarray], rounding: float = 0.0) -> NoiseFit | None:
    """Fit the noise of readings in one or several uninterrupted series.

    `series` (n,): readings at rest, equally spaced, without gaps; short series do not count.
    `rounding`: standard deviation of the rounding of a reading, if the series do not show
    it: the white noise is never less than that of the rounding. Returns: the noise, in the
    readings' unit; None where there are too few of them, or where they show none at all.
    """
    series = [values for values in series if len(values) >= LIMITS.smallest_series]
    lengths, variances, freedom = _hadamard(series)
    samples = sum(len(values) for values in series)
    if samples:
        step_seen = quantisation_step(np.concatenate(series)) or 0.0
        rounding = max(rounding, quantisation_sigma(step_seen))
    if not len(lengths):
        # Rounding may leave one value only.
        still = all(np.ptp(values) == 0.0 for values in series)
        if samples <= LIMITS.fewest_differences or not still or rounding <= 0.0:
            return None
        error = float(1.0 / np.sqrt(2.0 * samples))
        return NoiseFit(rounding, error, 0.0, _steps_of(rounding), 0.0, samples)
    kinds = np.stack([1.0 / lengths, _walk(lengths), np.ones(len(lengths))], axis=1)
    shares = _shares(kinds, variances, freedom)
    white, walk, flicker = np.sqrt(shares)
    # A walk alone does not show how much less the white noise is; rounding that hides all does.
    if white == 0.0 and np.sqrt(variances[0]) > LIMITS.only_rounding * rounding:
        return None
    level, error = float(max(white, rounding)), float(1.0 / np.sqrt(2.0 * freedom[0]))
    return NoiseFit(level, error, float(walk), _steps_of(rounding), float(flicker), samples)


def _steps_of(rounding: float) -> float:
    """The step that leaves this standard deviation."""
    return rounding / quantisation_sigma(1.0)


def _hadamard(series: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Block lengths, Hadamard variances, and their degrees of freedom."""
    lengths, variances, freedom = [], [], []
    longest = max((len(values) for values in series), default=0)
    m = 1
    while 3 * m <= longest:
        squares = np.concatenate([_second_differences(values, m) ** 2 for values in series])
        independent = sum(max(len(values) // m - 2, 0) for values in series)
        if independent < LIMITS.fewest_differences or squares.mean() == 0.0:
            break
        lengths.append(m)
        variances.append(squares.mean() / 6.0)
        # Second differences of white noise are correlated: 18/35 of them count.
        freedom.append(independent * 18.0 / 35.0)
        m *= 2
    return np.array(lengths, dtype=int), np.array(variances), np.array(freedom)


def _second_differences(values: np.ndarray, m: int) -> np.ndarray:
    """Second differences of all means of m neighbours."""
    if len(values) < 3 * m:
        return np.zeros(0)
    sums = np.concatenate([[0.0], np.cumsum(values - values.mean())])
    means = (sums[m:] - sums[:-m]) / m
    return means[2 * m :] - 2.0 * means[m:-m] + means[: -2 * m]


def _walk(lengths: np.ndarray) -> np.ndarray:
    """Variance that unit steps of a random walk give: each step enters all later samples."""
    # Weights of 3 m samples in a second difference, so scaled that white noise gives 1/m.
    weights = [np.repeat([1.0, -2.0, 1.0], m) / (m * np.sqrt(6.0)) for m in lengths]
    return np.array([np.sum(np.cumsum(w[::-1]) ** 2) for w in weights])


def _shares(kinds: np.ndarray, variances: np.ndarray, freedom: np.ndarray) -> np.ndarray:
    """Non-negative share of each kind (k,); beyond the first, only what chance does not give."""
    chosen = [0]
    best, misfit = _fitted(kinds, variances, freedom, chosen)
    while len(chosen) < kinds.shape[1]:
        others = [k for k in range(kinds.shape[1]) if k not in chosen]
        trials = [(*_fitted(kinds, variances, freedom, [*chosen, k]), k) for k in others]
        trial, trial_misfit, kind = min(trials, key=lambda found: found[1])
        if misfit - trial_misfit < LIMITS.chance_improvement:
            break
        chosen.append(kind)
        best, misfit = trial, trial_misfit
    return best


def _fitted(
    kinds: np.ndarray, variances: np.ndarray, freedom: np.ndarray, chosen: list[int]
) -> tuple[np.ndarray, float]:
    """Non-negative shares of the chosen kinds, and -2 log likelihood less a constant.

    A variance of n degrees of freedom is distributed as that times chi^2 of n over n.
    """
    from scipy.optimize import nnls

    model = variances
    for _ in range(LIMITS.reweightings):
        weights = np.sqrt(freedom / 2.0) / model
        found, _ = nnls(kinds[:, chosen] * weights[:, None], variances * weights)
        model = np.maximum(kinds[:, chosen] @ found, 1e-3 * variances)
    shares = np.zeros(kinds.shape[1])
    shares[chosen] = found
    ratio = variances / model
    return shares, float(np.sum(freedom * (ratio - 1.0 - np.log(ratio))))
