"""Normal matrices of nuisances: a few that all slews share, and blocks of each slew's own.

Factored slew by slew (a Schur complement on what is shared), inside compiled code.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jax.scipy.linalg import solve_triangular


class ArrowFactor(NamedTuple):
    """Cholesky factor of a normal matrix in the form of an arrow.

    Parameters
    ----------
    inner : (slews, m, m) array
        Lower triangular factors of each slew's own blocks.
    across : (slews, m, b) array
        Each slew's coupling to what is shared, solved by `inner`.
    shared : (b, b) array
        Lower triangular factor of the Schur complement.
    log_determinant : () array
        Of the whole matrix; NaN where it is not positive definite.
    """

    inner: Array
    across: Array
    shared: Array
    log_determinant: Array


def factored(blocks: Array, shared: int) -> ArrowFactor:
    """Factor the normal matrix of nuisances with unit prior precision.

    Parameters
    ----------
    blocks : (slews, k, k) array
        Information of each slew on (shared nuisances, its own), without priors.
    shared : int
        How many are shared.

    Returns
    -------
    ArrowFactor

    Examples
    --------
    >>> float(factored(jnp.ones((1, 2, 2)), 1).log_determinant.round(6))  # log det [[2, 1], [1, 2]]
    1.098612
    """
    own = blocks[:, shared:, shared:] + jnp.eye(blocks.shape[-1] - shared)
    inner = jnp.linalg.cholesky(own)
    across = _forward(inner, blocks[:, shared:, :shared])
    complement = jnp.eye(shared) + blocks[:, :shared, :shared].sum(0)
    outer = jnp.linalg.cholesky(complement - jnp.einsum("sia,sib->ab", across, across))
    of_own = jnp.sum(jnp.log(jnp.diagonal(inner, axis1=-2, axis2=-1)))
    of_shared = jnp.sum(jnp.log(jnp.diagonal(outer)))
    return ArrowFactor(inner, across, outer, 2.0 * (of_own + of_shared))


# Only with a few right-hand sides: with many the compiled solver is hundreds of times slower.
def _forward(factor: Array, right: Array) -> Array:
    """factor^-1 right: lower triangular (..., n, n), right-hand sides (..., n, k)."""
    return solve_triangular(factor, right, lower=True)


def _backward(factor: Array, right: Array) -> Array:
    """factor^-T right, likewise."""
    return solve_triangular(factor, right, lower=True, trans="T")


def solved(factor: ArrowFactor, shared: Array, own: Array) -> tuple[Array, Array]:
    """Solve for a right-hand side.

    Parameters
    ----------
    factor : ArrowFactor
    shared : (b,) array
    own : (slews, m) array

    Returns
    -------
    shared : (b,) array
    own : (slews, m) array
    """
    inside = _forward(factor.inner, own[..., None])[..., 0]
    left = shared - jnp.einsum("sib,si->b", factor.across, inside)
    x = _backward(factor.shared, _forward(factor.shared, left[:, None]))[:, 0]
    rest = inside - jnp.einsum("sib,b->si", factor.across, x)
    return x, _backward(factor.inner, rest[..., None])[..., 0]


def drawn(factor: ArrowFactor, shared: Array, own: Array) -> tuple[Array, Array]:
    """Turn standard normal numbers into draws whose covariance is the inverse of the matrix.

    Parameters
    ----------
    factor : ArrowFactor
    shared : (b,) array
    own : (slews, m) array
        Standard normal numbers.

    Returns
    -------
    shared : (b,) array
    own : (slews, m) array
    """
    x = _backward(factor.shared, shared[:, None])[:, 0]
    rest = own - jnp.einsum("sib,b->si", factor.across, x)
    return x, _backward(factor.inner, rest[..., None])[..., 0]
