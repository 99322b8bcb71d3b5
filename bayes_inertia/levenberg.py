"""Levenberg-Marquardt on normal equations, for problems whose parameters live on a manifold.

`scipy.optimize.least_squares` wants the whole Jacobian as one matrix and factors it at every step;
here normal equations come in blocks (slews) that are wanted anyway, and a step is followed along a
chart of the physical inertia tensors.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from scipy import linalg

X = TypeVar("X")


def descend[X](
    objective: Callable[[X], float],
    equations: Callable[[X], tuple[np.ndarray, np.ndarray]],
    move: Callable[[X, np.ndarray], X],
    x: X,
    *,
    steps: int = 60,
    tolerance: float = 1e-7,
) -> tuple[X, float]:
    """Minimise half a sum of squares with Nielsen's damping (Madsen, Nielsen, Tingleff 2004, algorithm 3.16).

    Parameters
    ----------
    objective : half the sum of squares at a point; infinite or NaN where there is none.
    equations : Gauss-Newton Hessian (n, n) and gradient (n,) at a point.
    move : the point reached by a step (n,).
    tolerance : stop when a step promises less than this.

    Returns
    -------
    The best point and its objective.

    >>> descend(lambda x: 0.5 * x @ x, lambda x: (np.eye(2), x), lambda x, s: x + s, np.ones(2))[0].round(3).tolist()
    [0.0, 0.0]
    """
    best, damping, growth = objective(x), 1e-4, 2.0
    hessian, gradient = equations(x)
    for _ in range(steps):
        step = _damped_step(hessian, gradient, damping)
        promised = -(gradient @ step + 0.5 * step @ hessian @ step)
        trial = move(x, step)
        reached = objective(trial)
        if np.isfinite(reached) and reached <= best:
            gain = (best - reached) / max(promised, 1e-300)
            x, best = trial, reached
            damping, growth = max(damping * max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3), 1e-12), 2.0
            if promised < tolerance:
                break
            hessian, gradient = equations(x)
        else:
            damping, growth = damping * growth, growth * 2.0
        if promised < 1e-3 * tolerance or damping > 1e12 or not np.all(np.isfinite(gradient)):
            break
    return x, best


def _damped_step(hessian: np.ndarray, gradient: np.ndarray, damping: float) -> np.ndarray:
    scale = np.sqrt(np.diag(hessian))
    scaled = hessian / np.outer(scale, scale)
    return -linalg.solve(scaled + damping * np.eye(len(scale)), gradient / scale, assume_a="pos") / scale


def solve(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """x with matrix x = vector for a symmetric positive definite matrix (n, n) of any scaling.

    >>> solve(np.diag([4.0, 0.25]), np.ones(2)).tolist()
    [0.25, 4.0]
    """
    root = inverse_root(matrix)
    return root.T @ (root @ vector)


def inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a symmetric positive definite matrix (n, n), scaled to unit diagonal first.

    >>> inverse(np.diag([4.0, 0.25])).tolist()
    [[0.25, 0.0], [0.0, 4.0]]
    """
    root = inverse_root(matrix)
    return root.T @ root


def inverse_root(matrix: np.ndarray) -> np.ndarray:
    """Lower triangular R (n, n) with R^T R the inverse of a symmetric positive definite matrix (n, n).

    >>> inverse_root(np.diag([4.0, 1.0])).tolist()
    [[0.5, 0.0], [0.0, 1.0]]
    """
    scale = np.sqrt(np.diag(matrix))
    factor = np.linalg.cholesky(matrix / np.outer(scale, scale))
    return linalg.solve_triangular(factor, np.eye(len(scale)), lower=True) / scale
