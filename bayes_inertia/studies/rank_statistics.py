"""Are ranks uniform? The exact simultaneous band of their ECDF, and the coverage of intervals.

The ECDF of n uniform ranks leaves a band of c standard errors with a probability that is computed
exactly, by following the number of ranks below each value (Säilynoja, Bürkner and Vehtari 2022).
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from scipy import stats
from scipy.optimize import brentq
from scipy.special import gammaln, xlog1py, xlogy

from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.studies.limits import LIMITS


class Coverage(NamedTuple):
    """Coverage of a central interval."""

    level: float  # that the interval states
    share: float  # that it reached
    low: float  # 95 % interval of the share (Clopper and Pearson)
    high: float


@array_dataclass
class Ranks:
    """Ranks of truths, each among the draws of its posterior.

    >>> Ranks(np.arange(200), 199).coverage(0.9).share
    0.9
    """

    values: np.ndarray  # (n,) from 0 to `ranked`
    ranked: int  # draws that each truth was ranked among

    @property
    def departure(self) -> np.ndarray:
        """ECDF of the ranks minus that of uniform ones, at all but the last [standard errors]."""
        n, ranked = len(self.values), self.ranked
        p = np.arange(1, ranked + 1) / (ranked + 1)
        below = np.searchsorted(np.sort(self.values), np.arange(ranked), side="right") / n
        return (below - p) / np.sqrt(p * (1.0 - p) / n)

    @property
    def p_value(self) -> float:
        """Probability that uniform ranks depart as far as these."""
        largest = float(np.abs(self.departure).max())
        return max(0.0, 1.0 - probability_inside(len(self.values), self.ranked, largest - 1e-6))

    def coverage(self, level: float) -> Coverage:
        """Coverage of a central interval; its ends are draws."""
        outside = round((self.ranked + 1) * 0.5 * (1.0 - level))
        inside = (self.values >= outside) & (self.values <= self.ranked - outside)
        return coverage_from(int(inside.sum()), len(inside), level)


@cache
def probability_inside(n: int, ranked: int, width: float) -> float:
    """Probability that the ECDF of n uniform ranks stays within `width` standard errors everywhere.

    One rank among one draw is 0 or 1: half a standard error is never enough.

    >>> probability_inside(1, 1, 0.5), round(probability_inside(1, 1, 1.5), 6)
    (0.0, 1.0)
    """
    log_factorial = gammaln(np.arange(n + 2) + 1.0)
    counts, weight = np.array([0]), np.array([1.0])
    for k in range(1, ranked + 1):
        p = k / (ranked + 1)
        half = width * np.sqrt(n * p * (1.0 - p))
        low, high = int(np.ceil(n * p - half - 1e-9)), int(np.floor(n * p + half + 1e-9))
        allowed = np.arange(max(low, 0), min(high, n) + 1)
        more, left = allowed[:, None] - counts, n - counts
        possible = (more >= 0) & (more <= left)
        j, chance = np.where(possible, more, 0), 1.0 / (ranked + 2 - k)
        log_pmf = log_factorial[left] - log_factorial[j] - log_factorial[left - j]
        log_pmf = log_pmf + xlogy(j, chance) + xlog1py(left - j, -chance)
        weight = np.where(possible, np.exp(log_pmf), 0.0) @ weight
        counts = allowed
        if not len(counts):
            return 0.0
    return float(weight.sum())


@cache
def ecdf_band(n: int, ranked: int, level: float) -> float:
    """Half width [standard errors] of the band that holds n uniform ranks with this probability."""

    def beyond(width: float) -> float:
        return probability_inside(n, ranked, width) - level

    return float(brentq(beyond, LIMITS.narrowest_band, LIMITS.widest_band, xtol=1e-3))


def coverage_from(inside: int, of: int, level: float) -> Coverage:
    """Share of intervals that held the truth, with its binomial interval.

    >>> round(coverage_from(9, 10, 0.95).low, 3)
    0.555
    """
    interval = stats.binomtest(inside, of).proportion_ci(0.95)
    return Coverage(level, inside / of, float(interval.low), float(interval.high))
