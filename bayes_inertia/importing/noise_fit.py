"""Noise of readings at rest: white, random walk and quantisation, by an Allan-type fit.

The variance of second differences of block means (the Hadamard variance, an Allan variance that no
steady drift enters) is fitted as a sum of what each kind of noise gives at each block length,
exactly, with weights by its degrees of freedom and no negative share. Slow real motion enters the
random walk, not the white noise.

References: D. W. Allan, Proc. IEEE 54, 221 (1966); IEEE Std 952-1997, annex C; R. A. Baugh, Proc.
25th Frequency Control Symposium, 222 (1971).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls

from bayes_inertia.maths.values import array_dataclass

_FEWEST_DIFFERENCES = 8
_SMALLEST_SERIES = 6
# Largest improvement of chi^2 that chance may give to a kind of noise that is not there.
_CHANCE = 9.0
_REWEIGHTINGS = 5
# A level that this share of steps between readings are multiples of is the step of a converter.
_ON_LEVELS = 0.98
_LEVEL_ROUNDING = 1e-3


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
    step : float
        Time between samples [s].
    samples : int
        Number of readings.
    lengths : (k,) array of int
        Block lengths [samples].
    deviations : (k,) array
        Hadamard deviation at each.
    """

    white: float
    white_error: float
    random_walk: float
    quantisation: float
    flicker: float
    step: float
    samples: int
    lengths: np.ndarray
    deviations: np.ndarray


def fit_noise(series: Sequence[np.ndarray], step: float) -> NoiseFit | None:
    """Fit the noise of readings in one or several uninterrupted series.

    Parameters
    ----------
    series : sequence of (n,) array
        Readings at rest, equally spaced, without gaps; short series do not count.
    step : float
        Time between readings [s].

    Returns
    -------
    NoiseFit or None
        The noise, in the readings' unit; None where there are too few of them.

    Examples
    --------
    >>> white = np.random.default_rng(1).normal(0.0, 2.0, 4000)
    >>> fit = fit_noise([white], 0.25)
    >>> round(fit.white, 1), fit.random_walk, fit.quantisation
    (2.0, 0.0, 0.0)
    """
    series = [values for values in series if len(values) >= _SMALLEST_SERIES]
    lengths, variances, freedom = _hadamard(series)
    if not len(lengths):
        return None
    samples = sum(len(values) for values in series)
    kinds = np.stack([_white(lengths), _walk(lengths), np.ones(len(lengths))], axis=1)
    shares = _shares(kinds, variances, freedom)
    white, walk, flicker = np.sqrt(shares)
    return NoiseFit(
        float(white),
        float(1.0 / np.sqrt(2.0 * freedom[0])),
        float(walk),
        _level(series),
        float(flicker),
        step,
        samples,
        lengths,
        np.sqrt(variances),
    )


def _hadamard(series: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Block lengths, Hadamard variances, and their degrees of freedom."""
    lengths, variances, freedom = [], [], []
    longest = max((len(values) for values in series), default=0)
    m = 1
    while 3 * m <= longest:
        squares = np.concatenate([_second_differences(values, m) ** 2 for values in series])
        independent = sum(max(len(values) // m - 2, 0) for values in series)
        if independent < _FEWEST_DIFFERENCES or squares.mean() == 0.0:
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


def _contrast(m: int) -> np.ndarray:
    """The weights of 3 m samples in a second difference, so scaled that white noise gives 1/m."""
    return np.repeat([1.0, -2.0, 1.0], m) / (m * np.sqrt(6.0))


def _white(lengths: np.ndarray) -> np.ndarray:
    return 1.0 / lengths


def _walk(lengths: np.ndarray) -> np.ndarray:
    """Variance that unit steps of a random walk give: each step enters all later samples."""
    return np.array([np.sum(np.cumsum(_contrast(m)[::-1]) ** 2) for m in lengths])


def _shares(kinds: np.ndarray, variances: np.ndarray, freedom: np.ndarray) -> np.ndarray:
    """Non-negative share of each kind (k,); beyond the first, only what chance does not give."""
    chosen = [0]
    best, misfit = _fitted(kinds, variances, freedom, chosen)
    while len(chosen) < kinds.shape[1]:
        others = [k for k in range(kinds.shape[1]) if k not in chosen]
        trials = [(*_fitted(kinds, variances, freedom, [*chosen, k]), k) for k in others]
        trial, trial_misfit, kind = min(trials, key=lambda found: found[1])
        if misfit - trial_misfit < _CHANCE:
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
    model = variances
    for _ in range(_REWEIGHTINGS):
        weights = np.sqrt(freedom / 2.0) / model
        found, _ = nnls(kinds[:, chosen] * weights[:, None], variances * weights)
        model = np.maximum(kinds[:, chosen] @ found, 1e-3 * variances)
    shares = np.zeros(kinds.shape[1])
    shares[chosen] = found
    ratio = variances / model
    return shares, float(np.sum(freedom * (ratio - 1.0 - np.log(ratio))))


def _level(series: Sequence[np.ndarray]) -> float:
    """The step between neighbouring values of a converter; 0 where none is seen."""
    values = np.unique(np.concatenate(series))
    gaps = np.diff(values)
    # Rounding of decimals makes gaps that are none.
    scale = float(np.abs(values).max())
    gaps = gaps[gaps > 1e-12 * scale]
    if not len(gaps):
        return 0.0
    level = float(np.median(gaps[gaps <= np.quantile(gaps, 0.1) * (1.0 + _LEVEL_ROUNDING)]))
    total = sum(len(v) for v in series)
    multiples = np.diff(np.concatenate(series)) / level
    on = np.abs(multiples - np.rint(multiples)) < _LEVEL_ROUNDING * np.maximum(1, np.abs(multiples))
    # Readings of many digits are all different: only values that return show a converter.
    repeated = len(values) < 0.5 * total
    return level if repeated and float(on.mean()) > _ON_LEVELS else 0.0
