"""Linear algebra: normal matrices of any scaling, and products inside compiled steps."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy import linalg

from bayes_inertia.errors import EstimateError
from bayes_inertia.maths.numerics import NUMERICS


def solve(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """x with matrix x = vector for a symmetric positive definite matrix (n, n) of any scaling.

    `vector` (n,). Returns (n,).

    Examples
    --------
    >>> solve(np.diag([4.0, 0.25]), np.ones(2)).tolist()
    [0.25, 4.0]
    """
    root = inverse_root(matrix)
    return root.T @ (root @ vector)


def inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a symmetric positive definite matrix (n, n), scaled to unit diagonal first.

    Examples
    --------
    >>> inverse(np.diag([4.0, 0.25])).tolist()
    [[0.25, 0.0], [0.0, 4.0]]
    """
    root = inverse_root(matrix)
    return root.T @ root


def cholesky_factor(matrix: np.ndarray) -> np.ndarray:
    """Lower triangular L (n, n), L L^T a symmetric positive definite matrix.

    Examples
    --------
    >>> cholesky_factor(np.diag([4.0, 1.0])).tolist()
    [[2.0, 0.0], [0.0, 1.0]]
    """
    try:
        return np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError as error:
        raise EstimateError(
            "the fit has no covariance: its normal equations are not positive definite",
            advice="check units and signs of the telemetry columns (`bayes-inertia doctor "
            "CAMPAIGN`): J and K far from what was known before do this",
        ) from error


def inverse_root(matrix: np.ndarray) -> np.ndarray:
    """Lower triangular R (n, n), R^T R the inverse of a symmetric positive definite matrix.

    Examples
    --------
    >>> inverse_root(np.diag([4.0, 1.0])).tolist()
    [[0.5, 0.0], [0.0, 1.0]]
    """
    scale = np.sqrt(np.diag(matrix))
    factor = cholesky_factor(matrix / np.outer(scale, scale))
    return linalg.solve_triangular(factor, np.eye(len(scale)), lower=True) / scale


def canonical_correlation(matrix: np.ndarray, first: int) -> float:
    """Largest correlation between what two effects can do to the residuals.

    The first effect has the `first` columns of a projected normal matrix, the other the rest.
    Directions in which an effect of prior size moves the residuals by less than one sigma do not
    count.

    `matrix` (n, n): normal matrix in prior standard deviations, everything fitted projected off.
    Returns: from 0, told apart, to 1, not to be told apart.

    Examples
    --------
    >>> round(canonical_correlation(np.array([[4.0, 3.0], [3.0, 9.0]]), 1), 9)
    0.5
    """
    sides = []
    for block in (matrix[:first, :first], matrix[first:, first:]):
        powers, directions = np.linalg.eigh(block)
        keep = powers > NUMERICS.visible_power
        sides.append(directions[:, keep] / np.sqrt(powers[keep]))
    if not all(side.shape[1] for side in sides):
        return 0.0
    between = sides[0].T @ matrix[:first, first:] @ sides[1]
    return float(min(1.0, np.linalg.svd(between, compute_uv=False)[0]))


def fused_product(matrix: Array, vector: Array | np.ndarray) -> Array:
    """A matrix (m, k) times a vector (k,), as a part of what comes next.

    Compiled code calls another routine for each `@`, which in every step and for each derivative
    takes longer than the few products in it.

    Examples
    --------
    >>> fused_product(jnp.eye(2), jnp.array([3.0, 4.0])).tolist()
    [3.0, 4.0]
    """
    return jnp.sum(matrix * vector, axis=-1)
