"""Normal matrices of nuisances: a few that all slews share, and blocks of each slew's own.

Factored slew by slew (a Schur complement on what is shared), inside compiled code.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax


class ArrowFactor(NamedTuple):
    """Cholesky factor of a normal matrix in the form of an arrow.

    Parameters
    ----------
    inner : (slews, m, m) array
        Inverses of the lower triangular factors of each slew's own blocks.
    across : (slews, m, b) array
        Each slew's coupling to what is shared, from the left multiplied by `inner`.
    shared : (b, b) array
        Inverse of the lower triangular factor of the Schur complement.
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
    inner, log_own = _inverse_factor(own)
    across = jnp.einsum("sij,sjb->sib", inner, blocks[:, shared:, :shared])
    complement = jnp.eye(shared) + blocks[:, :shared, :shared].sum(0)
    complement = complement - jnp.einsum("sia,sib->ab", across, across)
    outer, log_shared = _inverse_factor(complement)
    return ArrowFactor(inner, across, outer, jnp.sum(log_own) + log_shared)


def _inverse_factor(matrix: Array) -> tuple[Array, Array]:
    """Inverse of the lower triangular factor, and log determinant, of matrices (..., n, n)."""
    factor = jnp.linalg.cholesky(matrix)
    unit = jnp.broadcast_to(jnp.eye(matrix.shape[-1]), matrix.shape)
    root = lax.linalg.triangular_solve(factor, unit, left_side=True, lower=True)
    diagonal = jnp.diagonal(factor, axis1=-2, axis2=-1)
    return root, 2.0 * jnp.sum(jnp.log(diagonal), -1)


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
    inside = jnp.einsum("sij,sj->si", factor.inner, own)
    left = shared - jnp.einsum("sib,si->b", factor.across, inside)
    x = factor.shared.T @ (factor.shared @ left)
    rest = inside - jnp.einsum("sib,b->si", factor.across, x)
    return x, jnp.einsum("sij,si->sj", factor.inner, rest)


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
    x = factor.shared.T @ shared
    rest = own - jnp.einsum("sib,b->si", factor.across, x)
    return x, jnp.einsum("sij,si->sj", factor.inner, rest)
