"""The integral over nuisances some of whose priors are sampled: coefficients c = B(p) z.

Around an optimum the data are linear in the coefficients. With sensitivities S to the whitened
coefficients z0 of the optimum's parameters p0, those at p are S T, T = B(p0)^-1 B(p): one set of
sensitivities serves all p, and nothing is singular where B(p) vanishes. With A the data's normal
matrix of all unknowns and g their gradient, the integral over standard normal x, the unknowns
being n + delta = n + W x + e, is

    log I = -1/2 (chi^2 - G^T M^-1 G) - 1/2 log det M,   M = W^T A W + 1,

with W = diag(1, T). The nuisances of a slew meet those of others only through what all slews share
(the rate bias; in `hyperparameters` J and K too), so that M is eliminated slew by slew: the cost is
linear in slews and, through A, in samples.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.linalg import solve_triangular

from bayes_inertia.inference.each_slew import is_traced, of_slew
from bayes_inertia.maths.values import AnyArray
from bayes_inertia.physics.prediction import Structure, prior_blocks
from bayes_inertia.physics.slew_context import SlewContext

# Roots of the coefficients' prior covariance of all slews: (slews, b, m, m) for each effect, the b
# blocks on the diagonal of its root.
Roots = tuple[AnyArray, ...]


class CoefficientPart(NamedTuple):
    """What the integral needs, frozen at an optimum.

    Parameters
    ----------
    information : (slews, 3 + n_local, 3 + n_local) array
        Normal matrix of (bias, own nuisances), without priors.
    inverse_roots : tuple of (slews, b, m, m) arrays
        Inverses of the roots B of the coefficients' prior covariance there.
    """

    information: AnyArray
    inverse_roots: Roots


class SlewEquations(NamedTuple):
    """Normal equations of (what slews share, own nuisances) at one point.

    Parameters
    ----------
    chi2 : () array
        Sum of squares there, without priors.
    matrix : (slews, s + n_local, s + n_local) array
        Of the data, without priors.
    gradient : (slews, s + n_local) array
        Of half of chi2.
    precision : (s,) array
        Of the prior of what slews share.
    shared_gradient : (s,) array
        Gradient of half the squares of that prior.
    shared_chi2 : () array
        Those squares.
    local : (slews, n_local) array
        The whitened nuisances of each slew, coefficients last.
    """

    chi2: AnyArray
    matrix: AnyArray
    gradient: AnyArray
    precision: AnyArray
    shared_gradient: AnyArray
    shared_chi2: AnyArray
    local: AnyArray


class EliminatedSlews(NamedTuple):
    """The quadratic form of all unknowns, eliminated slew by slew.

    Parameters
    ----------
    constant : () array
        Twice the misfit where all eliminated steps are zero.
    local : (slews, n_local) array
        Nuisances there; coefficients count from zero.
    root : (slews, n_local, n_local) array
        Lower triangular; root root^T is each slew's normal matrix.
    step : (slews, n_local) array
        root^-1 times the gradient.
    across : (slews, n_local, s) array
        root^-1 times what couples each slew to what slews share.
    shared_root : (s, s) array
        Of what is left for that.
    shared_step : (s,) array
        shared_root^-1 times the gradient left.
    """

    constant: Array
    local: Array
    root: Array
    step: Array
    across: Array
    shared_root: Array
    shared_step: Array


def prior_roots(structure: Structure, theta: Any, contexts: SlewContext) -> Roots:
    """The roots of the coefficients' prior covariance of all slews.

    `theta` (d,). `contexts`: with the slews as leading axis, of numpy (`Data.contexts`). Returns
    (slews, b, m, m).
    """
    if is_traced(theta, contexts):
        return _prior_roots(structure, theta, contexts)
    alone = (of_slew(k, contexts) for k in range(len(contexts.time)))
    parts = [_prior_roots(structure, theta, context) for context in alone]
    return jax.tree.map(lambda *roots: np.concatenate(roots), *parts)


@partial(jax.jit, static_argnums=0)
def _prior_roots(structure: Structure, theta: Array, contexts: SlewContext) -> Roots:
    active = structure.active_effects(theta)
    return jax.vmap(lambda slew: prior_blocks(active, structure.coefficients, slew))(contexts)


# What is compiled for each set of effects.
PROGRAMS = (_prior_roots,)


def root_change(
    structure: Structure, inverse_roots: Roots, theta: Array, contexts: SlewContext
) -> Roots:
    """How whitened coefficients change with the parameters: B(p0)^-1 B(p).

    `inverse_roots` (slews, b, m, m); `theta` (d,). Returns (slews, b, m, m).
    """
    roots = prior_roots(structure, theta, contexts)
    return tuple(before @ now for before, now in zip(inverse_roots, roots, strict=True))


def times(blocks: Roots, coefficients: np.ndarray) -> np.ndarray:
    """Coefficients of all slews times block-diagonal matrices.

    `blocks` (slews, b, m, m); `coefficients` (slews, n_random). Returns (slews, n_random).
    """
    parts, start = [], 0
    for block in blocks:
        slews, b, m, _ = block.shape
        part = coefficients[:, start : start + b * m].reshape(slews, b, m, 1)
        parts.append((block @ part).reshape(slews, b * m))
        start += b * m
    return np.concatenate(parts, -1)


def eliminated(change: Roots, equations: SlewEquations) -> EliminatedSlews:
    """Eliminate the nuisances of each slew, then what slews share.

    `change` (slews, b, m, m): of the coefficients' prior root from the point of the equations, see
    `root_change`.
    """
    s, n_local = len(equations.shared_gradient), equations.local.shape[1]
    n_start = n_local - sum(block.shape[1] * block.shape[2] for block in change)
    # Coefficients are counted from zero from here on.
    back = jnp.zeros_like(equations.gradient)
    back = back.at[:, s + n_start :].set(-equations.local[:, n_start:])
    moved = jnp.einsum("sij,sj->si", equations.matrix, back)
    started = equations.local.at[:, n_start:].set(0.0)
    constant = equations.chi2 + jnp.sum((2.0 * equations.gradient + moved) * back)
    constant = constant + equations.shared_chi2 + jnp.sum(started**2)
    matrix, slope = _changed(equations.matrix, equations.gradient + moved, change, s + n_start)
    own = matrix[:, s:, s:] + jnp.eye(n_local)
    root = jnp.linalg.cholesky(own)
    right = jnp.concatenate([(slope[:, s:] + started)[..., None], matrix[:, s:, :s]], -1)
    solved = solve_triangular(root, right, lower=True)
    step, across = solved[..., 0], solved[..., 1:]
    left = matrix[:, :s, :s] - jnp.einsum("ski,skj->sij", across, across)
    # (s,) where priors are independent, else (s, s).
    prior = equations.precision
    prior = jnp.diag(prior) if prior.ndim == 1 else prior
    shared_root = jnp.linalg.cholesky(prior + left.sum(0))
    of_slews = jnp.sum(slope[:, :s] - jnp.einsum("ski,sk->si", across, step), 0)
    shared_step = solve_triangular(shared_root, equations.shared_gradient + of_slews, lower=True)
    return EliminatedSlews(constant, started, root, step, across, shared_root, shared_step)


def _changed(matrix: Array, gradient: Array, change: Roots, first: int) -> tuple[Array, Array]:
    """Normal equations with the unknowns from `first` on replaced by `change` times new ones."""
    columns = [matrix[:, :, :first]]
    slopes = [gradient[:, :first]]
    start = first
    for block in change:
        stop = start + block.shape[1] * block.shape[2]
        columns.append(_times_blocks(matrix[:, :, start:stop], block))
        slopes.append(_times_blocks(gradient[:, None, start:stop], block)[:, 0])
        start = stop
    half = jnp.concatenate(columns, -1)
    rows = [half[:, :first]]
    start = first
    for block in change:
        stop = start + block.shape[1] * block.shape[2]
        across = jnp.swapaxes(half[:, start:stop], 1, 2)
        rows.append(jnp.swapaxes(_times_blocks(across, block), 1, 2))
        start = stop
    return jnp.concatenate(rows, 1), jnp.concatenate(slopes, -1)


def _times_blocks(rows: Array, blocks: Array) -> Array:
    """Rows (slews, n, b m) times block-diagonal matrices (slews, b, m, m)."""
    slews, b, m, _ = blocks.shape
    shaped = rows.reshape(slews, -1, b, m)
    if m == 1:
        return (shaped * blocks[:, None, :, :, 0]).reshape(rows.shape)
    return jnp.einsum("snbi,sbij->snbj", shaped, blocks).reshape(rows.shape)


def log_integral(parts: EliminatedSlews) -> Array:
    """Log of the integral over all unknowns, their priors included, up to a constant."""
    explained = jnp.sum(parts.step**2) + jnp.sum(parts.shared_step**2)
    diagonals = (jnp.diagonal(parts.root, axis1=-2, axis2=-1), jnp.diagonal(parts.shared_root))
    half_log_det = sum(jnp.sum(jnp.log(d)) for d in diagonals)
    return -0.5 * (parts.constant - explained) - half_log_det


def steps_given(parts: EliminatedSlews, noise: Array | float = 0.0) -> tuple[Array, Array]:
    """Steps drawn from the posterior of the unknowns, given all that is not among them.

    `noise` (s + slews n_local,): standard normal numbers; zeros give the conditional mean. Returns
    `shared` (s,): step of what slews share; `local` (slews, n_local): nuisances, coefficients
    whitened by their prior.
    """
    s, root = len(parts.shared_step), parts.root
    every = jnp.broadcast_to(noise, (s + parts.local.size,))
    pull = every[:s] - parts.shared_step
    shared = solve_triangular(parts.shared_root, pull, lower=True, trans="T")
    right = every[s:].reshape(parts.local.shape) - parts.step - parts.across @ shared
    own = solve_triangular(root, right[..., None], lower=True, trans="T")[..., 0]
    return shared, parts.local + own
