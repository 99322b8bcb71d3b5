"""Slope and curvature of a function that is cheap for several points at once."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import numpy as np

from bayes_inertia.maths.values import array_dataclass


@array_dataclass
class Quadratic:
    """A function near a point, to second order.

    Parameters
    ----------
    value : float
    gradient : (n,) array
    hessian : (n, n) array
    """

    value: float
    gradient: np.ndarray
    hessian: np.ndarray


def quadratic_at(
    function: Callable[[np.ndarray], np.ndarray],
    x: np.ndarray,
    step: float,
    value: float | None = None,
) -> Quadratic:
    """Take central differences of a function at a point.

    `scipy.differentiate.hessian` looks for its step and takes many times as many points.

    `x` (n,). `function`: from points (m, n) to values (m,). It is called once, for 1 + n + n^2
    points at most. `value`: of the function at the point, if it is known already.

    Examples
    --------
    >>> at = quadratic_at(lambda x: x[:, 0] ** 2 * x[:, 1], np.array([1.0, 3.0]), 1e-3)
    >>> at.gradient.round(3).tolist(), at.hessian.round(3).tolist()
    ([6.0, 1.0], [[6.0, 2.0], [2.0, 0.0]])
    """
    n = len(x)
    unit, pairs = step * np.eye(n), list(combinations(range(n), 2))
    away = np.array([*unit, *(unit[i] + unit[j] for i, j in pairs)])
    centre = x[None] if value is None else x[None][:0]
    values = function(np.concatenate([centre, x + away, x - away]))
    here = values[0] if value is None else value
    up, down = np.split(values[len(centre) :], 2)
    second = (up + down - 2.0 * here) / step**2
    hessian = np.diag(second[:n])
    for (i, j), along_both in zip(pairs, second[n:], strict=True):
        hessian[i, j] = hessian[j, i] = 0.5 * (along_both - second[i] - second[j])
    return Quadratic(float(here), (up - down)[:n] / (2.0 * step), hessian)
