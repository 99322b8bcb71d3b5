"""How much of a parameter's variance is due to which other unknowns.

The variance inflation C_ii H_ii is split among groups of unknowns by Shapley's value of log
variance (Shapley 1953; for variances Owen 2014): the factors multiply to the whole, and no order
of the groups is preferred.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import factorial

import numpy as np

from bayes_inertia.maths.linear_algebra import inverse


def inflation_by_group(
    precision: np.ndarray, groups: Sequence[np.ndarray], count: int
) -> np.ndarray:
    """Factors by which not knowing each group multiplies the variance of the first unknowns.

    A group that holds an unknown itself stands for the others in it.

    Parameters
    ----------
    precision : (n, n) array
        Inverse covariance H of all unknowns.
    groups : sequence of arrays of int
        Which unknowns each group holds.
    count : int
        How many of the unknowns, from the first, are asked about.

    Returns
    -------
    (count, groups) array
        Their product over groups is C_ii H_ii for C = H^-1.

    Examples
    --------
    >>> H = np.array([[1.0, 0.6, 0.0], [0.6, 1.0, 0.0], [0.0, 0.0, 1.0]])
    >>> groups = [np.array([0]), np.array([1]), np.array([2])]
    >>> inflation_by_group(H, groups, 1).round(4).tolist()
    [[1.0, 1.5625, 1.0]]
    """
    n, logs = len(groups), {}
    for mask in range(2**n):
        members = [group for k, group in enumerate(groups) if mask >> k & 1]
        uncertain = np.concatenate(members or [np.zeros(0, int)]).astype(int)
        logs[mask] = _log_variances(precision, uncertain, count)
    log_factors = np.zeros((count, n))
    for k in range(n):
        for mask in (m for m in range(2**n) if not m >> k & 1):
            size = mask.bit_count()
            weight = factorial(size) * factorial(n - size - 1) / factorial(n)
            log_factors[:, k] += weight * (logs[mask | 1 << k] - logs[mask])
    return np.exp(log_factors)


def _log_variances(precision: np.ndarray, uncertain: np.ndarray, count: int) -> np.ndarray:
    """Log variances (count,) where only `uncertain` and the unknown itself are not known."""
    alone = np.diag(precision)[:count].copy()
    if not len(uncertain):
        return -np.log(alone)
    covariance = inverse(precision[np.ix_(uncertain, uncertain)])
    cross = precision[np.ix_(uncertain, np.arange(count))]
    variance = np.zeros(count)
    outside = ~np.isin(np.arange(count), uncertain)
    variance[outside] = 1.0 / (
        alone[outside] - np.einsum("ki,kl,li->i", cross[:, outside], covariance, cross[:, outside])
    )
    for place, i in enumerate(uncertain):
        if i < count:
            variance[i] = covariance[place, place]
    return np.log(variance)
