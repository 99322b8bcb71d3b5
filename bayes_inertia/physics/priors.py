"""Priors of one number: Gaussian or log-normal, truncated where limits are given."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from bayes_inertia.errors import SettingsError


@dataclass(frozen=True)
class Normal:
    """Gaussian prior, truncated where limits are given.

    Parameters
    ----------
    mean, scale : float
        Mean and standard deviation of the Gaussian, in the parameter's unit.
    lower, upper : float, optional
        Ends of the support.

    Raises
    ------
    SettingsError
        If a number is not finite, the scale not above zero, or the ends not in order.

    Examples
    --------
    >>> Normal(0.0, 2.0).sd, Normal(0.0, 1.0, lower=0.0).sd
    (2.0, 0.602...)
    """

    mean: float
    scale: float
    lower: float = -np.inf
    upper: float = np.inf
    logarithmic = False

    def __post_init__(self) -> None:
        _require_distribution(self)

    @property
    def distribution(self) -> stats.rv_continuous:
        """The same distribution from `scipy.stats`."""
        a, b = (self.lower - self.mean) / self.scale, (self.upper - self.mean) / self.scale
        return stats.truncnorm(a, b, loc=self.mean, scale=self.scale)

    @property
    def sd(self) -> float:
        """Standard deviation, in the parameter's unit."""
        if np.isinf(self.lower) and np.isinf(self.upper):
            return float(self.scale)
        return float(self.distribution.std())


@dataclass(frozen=True)
class LogNormal:
    """Prior of a positive quantity known to a factor: log(x / median) is Gaussian.

    Parameters
    ----------
    median : float
        Median, in the parameter's unit.
    scale : float
        Standard deviation of the logarithm.
    lower, upper : float, optional
        Ends of the support.

    Raises
    ------
    SettingsError
        If a number is not finite, the scale not above zero, or the ends not in order.

    Examples
    --------
    >>> round(LogNormal(0.5, 0.1).sd, 4)
    0.0504
    """

    median: float
    scale: float
    lower: float = 0.0
    upper: float = np.inf
    logarithmic = True

    def __post_init__(self) -> None:
        _require_distribution(self)

    @property
    def mean(self) -> float:
        """Logarithm of the median: the centre of the Gaussian that log(x) follows."""
        return float(np.log(self.median))

    @property
    def distribution(self) -> stats.rv_continuous:
        """The same distribution from `scipy.stats`."""
        if self.lower <= 0.0 and np.isinf(self.upper):
            return stats.lognorm(self.scale, scale=self.median)
        with np.errstate(divide="ignore"):
            a, b = np.log(np.maximum([self.lower, self.upper], 0.0) / self.median) / self.scale
        return _TRUNCATED(self.scale, a, b, scale=self.median)

    @property
    def sd(self) -> float:
        """Standard deviation, in the parameter's unit."""
        return float(self.distribution.std())


Prior = Normal | LogNormal


class _TruncatedLogNormal(stats.rv_continuous):
    """exp(s z) of a standard Gaussian z between a and b; scipy has none that is frozen alike."""

    def _argcheck(self, s, a, b):
        return (s > 0.0) & (a < b)

    def _get_support(self, s, a, b):
        return np.exp(s * a), np.exp(s * b)

    def _pdf(self, x, s, a, b):
        return stats.truncnorm.pdf(np.log(x) / s, a, b) / (s * x)

    def _cdf(self, x, s, a, b):
        return stats.truncnorm.cdf(np.log(x) / s, a, b)

    def _ppf(self, q, s, a, b):
        return np.exp(s * stats.truncnorm.ppf(q, a, b))


_TRUNCATED = _TruncatedLogNormal(name="truncated log-normal")


def _require_distribution(prior: Prior) -> None:
    """Raise unless the numbers make a distribution."""
    centre = "median" if prior.logarithmic else "mean"
    given = getattr(prior, centre)
    for good, what, advice in (
        (np.isfinite(given), f"the {centre} is {given}", "give a number"),
        (given > 0.0 or not prior.logarithmic, f"the {centre} is {given}", "give one above zero"),
        (0.0 < prior.scale < np.inf, f"the scale is {prior.scale}", "give one above zero"),
        (
            max(prior.lower, 0.0 if prior.logarithmic else -np.inf) < prior.upper,
            f"no value lies between {prior.lower} and {prior.upper}",
            "give lower < upper",
        ),
    ):
        if not good:
            kind = type(prior).__name__
            raise SettingsError(what, where=f"{kind} prior", advice=advice)
