"""The marginal log posterior of the sampled parameters, all nuisances integrated out.

Start states of each slew, slow tachometer noise (measured drive) and the rate bias are nuisances.
They enter the residuals almost linearly, so they are integrated out in closed form: the residuals
are evaluated on the ridge n(theta) = n0 + L (theta - theta0), the nuisances' best values for every
theta to first order, and what is left is projected by a Schur complement with the sensitivities at
theta0. On a linear model this is exact; the ridge keeps it accurate where theta moves far.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.inference.coefficients import (
    CoefficientPart,
    EliminatedSlews,
    SlewEquations,
    conditional_nuisances,
    eliminated,
    log_integral,
    root_change,
)
from bayes_inertia.inference.kept_programs import KeptProgram
from bayes_inertia.inference.likelihood import Residuals, residuals, whitened
from bayes_inertia.inference.noise_model import Whitening
from bayes_inertia.inference.point import Point
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.physics.parameters import log_prior
from bayes_inertia.physics.prediction import Data, Structure, predict_all

LogDensity = Callable[[np.ndarray], np.ndarray]


class Marginal(NamedTuple):
    """Everything the marginal log posterior needs, frozen at an optimum: a pytree of JAX.

    Parameters
    ----------
    optimum : Point
        Where the nuisances' sensitivities were taken.
    ridge_bias : (3, d) array
        How the bias follows theta.
    ridge_local : (slews, n_local, d) array
        How the local nuisances follow theta.
    columns : Residuals
        Sensitivities to the nuisances by channel, (slews, numbers, 3 + n_local).
    root : (M, M) array
        Inverse root of the nuisances' normal matrix, M = 3 + slews n_local.
    prior : dict of arrays
        The priors of theta.
    data : Data
    white : Whitening
        The noise as used.
    coefficients : CoefficientPart, optional
        What the integral over coefficients needs whose prior is sampled; None where there are none.
    unexplained : () array, optional
        chi^2 of what was taken out of the readings because no model can explain it
        (`reading_compression`).
    """

    optimum: Point
    ridge_bias: Array
    ridge_local: Array
    columns: Residuals
    root: Array
    prior: dict
    data: Data
    white: Whitening
    coefficients: CoefficientPart | None = None
    unexplained: Array | float = 0.0


def point_on_ridge(marginal: Marginal, theta: Array) -> Point:
    """The nuisances that belong to theta, to first order.

    Parameters
    ----------
    marginal : Marginal
    theta : (d,) array

    Returns
    -------
    Point
    """
    optimum = marginal.optimum
    shift = theta - optimum.theta
    return Point(
        theta,
        optimum.bias + marginal.ridge_bias @ shift,
        optimum.local + marginal.ridge_local @ shift,
    )


def _project(structure: Structure, marginal: Marginal, theta: Array) -> tuple[Array, Array]:
    """chi^2 () on the ridge, and the gradient (M,) of half of it with respect to the nuisances."""
    point = point_on_ridge(marginal, theta)
    bias, local = point.bias, point.local
    prediction = predict_all(structure, theta, local, bias, marginal.data)
    r = whitened(structure, prediction, marginal.data.arrays.telemetry, marginal.white)
    slew_gradient: Any = sum(
        jnp.einsum("sn,snk->sk", channel, columns)
        for channel, columns in zip(r, marginal.columns, strict=True)
    )
    gradient = jnp.concatenate(
        [slew_gradient[:, :3].sum(0) + bias, (slew_gradient[:, 3:] + local).ravel()]
    )
    chi2 = sum(jnp.sum(channel**2) for channel in r) + jnp.sum(bias**2) + jnp.sum(local**2)
    return chi2 + marginal.unexplained, gradient


def _nuisances_eliminated(
    structure: Structure, marginal: Marginal, theta: Array
) -> tuple[EliminatedSlews, Array]:
    """The integral over all nuisances at one theta, where their prior depends on it; the bias."""
    fixed = jnp.asarray(structure.hyperparameters)
    # Residuals depend on what the coefficients are, not on their prior.
    point = point_on_ridge(marginal, theta.at[fixed].set(marginal.optimum.theta[fixed]))
    r = residuals(structure, point, marginal.data, marginal.white)
    slew_gradient: Any = sum(
        jnp.einsum("sn,snk->sk", channel, columns)
        for channel, columns in zip(r, marginal.columns, strict=True)
    )
    chi2: Any = sum(jnp.sum(channel**2) for channel in r)
    part: Any = marginal.coefficients
    contexts = marginal.data.arrays.slews.context
    change = root_change(structure, part.inverse_roots, theta, contexts)
    bias = point.bias
    equations = SlewEquations(
        chi2, part.information, slew_gradient, jnp.ones(len(bias)), bias, bias @ bias, point.local
    )
    return eliminated(change, equations), bias


def log_posterior_of(structure: Structure, marginal: Marginal, theta: Array) -> Array:
    """Marginal log posterior density of one theta, up to a constant.

    Differentiable. `log_posterior` is the compiled version for batches.

    Parameters
    ----------
    structure : Structure
    marginal : Marginal
    theta : (d,) array

    Returns
    -------
    () array
        -inf where J is unphysical or a prior ends.
    """
    physical = inertia_tensor.is_physical(theta[:6])
    safe = jnp.where(physical, theta, marginal.optimum.theta)
    if marginal.coefficients is None:
        chi2, gradient = _project(structure, marginal, safe)
        explained = jnp.sum((marginal.root @ gradient) ** 2)
        value = log_prior(marginal.prior, theta) - 0.5 * (chi2 - explained)
    else:
        parts, _ = _nuisances_eliminated(structure, marginal, safe)
        value = log_prior(marginal.prior, theta) + log_integral(parts)
    return jnp.where(physical & jnp.isfinite(value), value, -jnp.inf)


@KeptProgram
def log_posterior(structure: Structure, marginal: Marginal, thetas: Array) -> Array:
    """The compiled marginal log posterior.

    The data are arguments: it is compiled once for all campaigns of one shape.

    Parameters
    ----------
    structure : Structure
    marginal : Marginal
    thetas : (batch, d) array

    Returns
    -------
    (batch,) array
        Log densities.
    """
    return jax.vmap(partial(log_posterior_of, structure, marginal))(thetas)


_compiled_elimination = jax.jit(_nuisances_eliminated, static_argnums=0)
# What is compiled for each shape of campaign, largest first.
PROGRAMS = (log_posterior, _compiled_elimination)


def conditional_point(
    structure: Structure, marginal: Marginal, theta: np.ndarray, noise: np.ndarray
) -> Point:
    """theta with nuisances drawn from their posterior given theta.

    Parameters
    ----------
    structure : Structure
    marginal : Marginal
    theta : (d,) array
    noise : (3 + slews n_local,) array
        Standard normal numbers; zeros give the conditional mean.

    Returns
    -------
    Point
    """
    if marginal.coefficients is not None:
        parts, bias = _compiled_elimination(structure, marginal, jnp.asarray(theta))
        step, local = conditional_nuisances(parts, noise)
        return Point(np.asarray(theta), np.asarray(bias) + step, local)
    theta, optimum = np.asarray(theta), jax.tree.map(np.asarray, marginal.optimum)
    shift = theta - optimum.theta
    bias = optimum.bias + np.asarray(marginal.ridge_bias) @ shift
    local = optimum.local + np.asarray(marginal.ridge_local) @ shift
    r = residuals(structure, Point(theta, bias, local), marginal.data, marginal.white)
    slew_gradient: Any = sum(
        np.einsum("sn,snk->sk", channel, columns)
        for channel, columns in zip(r, marginal.columns, strict=True)
    )
    gradient = np.concatenate(
        [slew_gradient[:, :3].sum(0) + bias, (slew_gradient[:, 3:] + local).ravel()]
    )
    root = np.asarray(marginal.root)
    step = root.T @ (noise - root @ gradient)
    return Point(theta, bias + step[:3], local + step[3:].reshape(local.shape))


def log_density_of(structure: Structure, marginal: Marginal, *, batch: int) -> LogDensity:
    """The compiled marginal log posterior for arrays of numpy of any length.

    Parameters
    ----------
    structure : Structure
    marginal : Marginal
    batch : int
        Draws evaluated at once.

    Returns
    -------
    callable
        From thetas (n, d) to log densities (n,).
    """
    return in_batches(partial(log_posterior, structure, marginal), batch)


def in_batches(compiled: Callable[[Any], Array], batch: int) -> LogDensity:
    """A compiled density for arrays of numpy of any length.

    Parameters
    ----------
    compiled : callable
        From thetas (batch, d) to log densities (batch,).
    batch : int
        Draws evaluated at once.

    Returns
    -------
    callable
        From thetas (n, d) to log densities (n,).
    """

    def log_density(thetas: np.ndarray) -> np.ndarray:
        n = len(thetas)
        padded = np.concatenate([thetas, np.repeat(thetas[-1:], -n % batch, axis=0)])
        parts = [compiled(padded[i : i + batch]) for i in range(0, len(padded), batch)]
        return np.concatenate([np.asarray(p) for p in parts])[:n]

    return log_density
