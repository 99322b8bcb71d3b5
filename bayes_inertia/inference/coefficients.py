"""The integral over nuisances some of whose priors are sampled: coefficients c = B(p) z.

Around an optimum the data are linear in the coefficients. With sensitivities S to the whitened
coefficients z0 of the optimum's parameters p0, those at p are S T, T = B(p0)^-1 B(p): one set of
sensitivities serves all p, and nothing is singular where B(p) vanishes. With A the data's normal
matrix of all nuisances and g their gradient, the integral over standard normal x, the nuisances
being n + delta = n + W x + e, is

    log I = -1/2 (chi^2 - G^T M^-1 G) - 1/2 log det M,   M = W^T A W + 1,

with W = diag(1, T). The nuisances of a slew meet those of others only through the rate bias, so
that M is eliminated slew by slew: the cost is linear in slews and, through A, in samples.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.linalg import solve_triangular

from bayes_inertia.inference.point import N_BIAS, Point
from bayes_inertia.physics.prediction import Structure
from bayes_inertia.physics.random_inputs import prior_root
from bayes_inertia.physics.slew_context import SlewContext


class CoefficientPart(NamedTuple):
    """What the integral needs, frozen at an optimum.

    Parameters
    ----------
    information : (slews, 3 + n_local, 3 + n_local) array
        Normal matrix of (bias, own nuisances), without priors.
    inverse_root : (slews, n_random, n_random) array
        Inverse of the root B of the coefficients' prior covariance there.
    """

    information: Array
    inverse_root: Array


class EliminatedSlews(NamedTuple):
    """The quadratic form of all nuisances, eliminated slew by slew.

    Parameters
    ----------
    constant : () array
        Twice the misfit where all eliminated steps are zero.
    point : Point
        Bias and nuisances there; coefficients count from zero.
    root : (slews, n_local, n_local) array
        Lower triangular; root root^T is each slew's normal matrix.
    step : (slews, n_local) array
        root^-1 times the gradient.
    across : (slews, n_local, 3) array
        root^-1 times what couples each slew to the bias.
    bias_root : (3, 3) array
        Of what is left for the bias.
    bias_step : (3,) array
        bias_root^-1 times the gradient left.
    """

    constant: Array
    point: Point
    root: Array
    step: Array
    across: Array
    bias_root: Array
    bias_step: Array


@partial(jax.jit, static_argnums=0)
def prior_roots(structure: Structure, theta: Array, contexts: SlewContext) -> Array:
    """The roots of the coefficients' prior covariance of all slews.

    Parameters
    ----------
    structure : Structure
    theta : (d,) array
        Parameters.
    contexts : SlewContext
        With the slews as leading axis.

    Returns
    -------
    (slews, n_random, n_random) array
    """
    active = structure.active_effects(theta)
    return jax.vmap(lambda slew: prior_root(active, structure.coefficients, slew))(contexts)


def eliminated(
    structure: Structure,
    part: CoefficientPart,
    theta: Array,
    contexts: SlewContext,
    point: Point,
    chi2: Array,
    gradient: Array,
) -> EliminatedSlews:
    """Eliminate all nuisances at one theta.

    Parameters
    ----------
    structure : Structure
    part : CoefficientPart
    theta : (d,) array
        Its parameters of stochastic effects fix the prior.
    contexts : SlewContext
        With the slews as leading axis.
    point : Point
        Where residuals were taken, with the optimum's parameters of stochastic effects.
    chi2 : () array
        Sum of squares there, without priors.
    gradient : (slews, 3 + n_local) array
        Of half of it with respect to (bias, own nuisances).

    Returns
    -------
    EliminatedSlews
    """
    n_start, first = structure.n_start, N_BIAS + structure.n_start
    bias, local = point.bias, point.local
    turn = part.inverse_root @ prior_roots(structure, theta, contexts)
    # Coefficients are counted from zero from here on.
    back = jnp.zeros_like(gradient).at[:, first:].set(-local[:, n_start:])
    moved = jnp.einsum("sij,sj->si", part.information, back)
    started = local.at[:, n_start:].set(0.0)
    constant = chi2 + jnp.sum((2.0 * gradient + moved) * back)
    constant = constant + jnp.sum(bias**2) + jnp.sum(started**2)
    matrix, slope = _turned(part.information, gradient + moved, turn, first)
    slope = slope.at[:, N_BIAS:].add(started)
    own = matrix[:, N_BIAS:, N_BIAS:] + jnp.eye(local.shape[1])
    root = jnp.linalg.cholesky(own)
    step = solve_triangular(root, slope[:, N_BIAS:, None], lower=True)[..., 0]
    across = solve_triangular(root, matrix[:, N_BIAS:, :N_BIAS], lower=True)
    left = matrix[:, :N_BIAS, :N_BIAS] - jnp.einsum("ski,skj->sij", across, across)
    bias_root = jnp.linalg.cholesky(jnp.eye(N_BIAS) + left.sum(0))
    left_gradient = bias + jnp.sum(slope[:, :N_BIAS] - jnp.einsum("ski,sk->si", across, step), 0)
    bias_step = solve_triangular(bias_root, left_gradient, lower=True)
    begin = Point(theta, bias, started)
    return EliminatedSlews(constant, begin, root, step, across, bias_root, bias_step)


def _turned(matrix: Array, gradient: Array, turn: Array, first: int) -> tuple[Array, Array]:
    """Normal equations with the unknowns from `first` on replaced by `turn` times new ones."""
    matrix = matrix.at[:, :, first:].set(matrix[:, :, first:] @ turn)
    rows = jnp.einsum("sji,sjk->sik", turn, matrix[:, first:, :])
    gradient = gradient.at[:, first:].set(jnp.einsum("sji,sj->si", turn, gradient[:, first:]))
    return matrix.at[:, first:, :].set(rows), gradient


def log_integral(parts: EliminatedSlews) -> Array:
    """Log of the integral over all nuisances, their priors included, up to a constant.

    Parameters
    ----------
    parts : EliminatedSlews

    Returns
    -------
    () array
    """
    explained = jnp.sum(parts.step**2) + jnp.sum(parts.bias_step**2)
    diagonals = (jnp.diagonal(parts.root, axis1=-2, axis2=-1), jnp.diagonal(parts.bias_root))
    half_log_det = sum(jnp.sum(jnp.log(d)) for d in diagonals)
    return -0.5 * (parts.constant - explained) - half_log_det


def conditional_nuisances(
    parts: EliminatedSlews, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Nuisances drawn from their posterior given theta.

    Parameters
    ----------
    parts : EliminatedSlews
    noise : (3 + slews n_local,) array
        Standard normal numbers; zeros give the conditional mean.

    Returns
    -------
    bias : (3,) array
    local : (slews, n_local) array
        Coefficients whitened by the prior at theta.
    """
    local = np.asarray(parts.point.local)
    bias_root = np.asarray(parts.bias_root)
    bias_move = np.linalg.solve(bias_root.T, noise[:N_BIAS] - np.asarray(parts.bias_step))
    of_slews = noise[N_BIAS:].reshape(local.shape)
    right = of_slews - np.asarray(parts.step) - np.asarray(parts.across) @ bias_move
    root = np.swapaxes(np.asarray(parts.root), -1, -2)
    return (
        np.asarray(parts.point.bias) + bias_move,
        local + np.linalg.solve(root, right[..., None])[..., 0],
    )
