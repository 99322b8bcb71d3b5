"""The marginal log posterior of the sampled parameters, all nuisances integrated out.

Start states of each slew, slow tachometer noise (measured drive) and the rate bias are nuisances.
They enter the residuals almost linearly, so they are integrated out in closed form: the residuals
are evaluated on the ridge n(theta) = n0 + L (theta - theta0), the nuisances' best values for every
theta to first order, and what is left is projected by a Schur complement with the sensitivities at
theta0. On a linear model this is exact; the ridge keeps it accurate where theta moves far.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
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
    eliminated,
    log_integral,
    root_change,
    steps_given,
)
from bayes_inertia.inference.each_slew import of_slew, slew_pieces
from bayes_inertia.inference.likelihood import Residuals, residuals, whitened
from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.inference.noise_model import Whitenings
from bayes_inertia.inference.point import Point
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.device_arrays import filled, on_device, padded_size, repeated
from bayes_inertia.maths.kept_programs import KeptProgram
from bayes_inertia.physics.packing import Data
from bayes_inertia.physics.parameters import log_prior
from bayes_inertia.physics.prediction import Structure, predict_all
from bayes_inertia.physics.slew_context import SlewContext

LogDensity = Callable[[np.ndarray], np.ndarray]


class Marginal(NamedTuple):
    """Everything the marginal log posterior needs, frozen at an optimum: a pytree of JAX.

    Parameters
    ----------
    optimum : Point
        Where the nuisances' sensitivities were taken.
    ridge_bias : (n_bias, d) array
        How the bias follows theta.
    ridge_local : (slews, n_local, d) array
        How the local nuisances follow theta.
    columns : Residuals
        Sensitivities to the nuisances by channel, (slews, numbers, n_bias + n_local).
    root : (M, M) array
        Inverse root of the nuisances' normal matrix, M = n_bias + slews n_local.
    prior : dict of arrays
        The priors of theta.
    data : Data
    white : tuple of Whitening
        The noise as used.
    coefficients : CoefficientPart, optional
        What the integral over coefficients needs whose prior is sampled; None where there are none.
    """

    optimum: Point
    ridge_bias: Array
    ridge_local: Array
    columns: Residuals
    root: Array
    prior: dict
    data: Data
    white: Whitenings
    coefficients: CoefficientPart | None = None


def point_on_ridge(marginal: Any, theta: Array) -> Point:
    """The nuisances that belong to theta, to first order.

    `theta` (d,).
    """
    optimum = marginal.optimum
    shift = theta - optimum.theta
    return Point(
        theta,
        optimum.bias + marginal.ridge_bias @ shift,
        optimum.local + marginal.ridge_local @ shift,
    )


class _Pull(NamedTuple):
    """What tells how the data pull at the nuisances, with the slews as leading axis."""

    optimum: Point
    ridge_bias: Array
    ridge_local: Array
    columns: Residuals
    data: Data
    white: Whitenings


class _Nuisances(NamedTuple):
    """What the integral over nuisances needs beside the pull, as `Marginal` has it."""

    optimum: Point
    ridge_bias: Array
    ridge_local: Array
    root: Array
    prior: dict
    coefficients: CoefficientPart | None
    contexts: SlewContext | None


@KeptProgram
def _pulls(structure: Structure, pull: _Pull, thetas: Array) -> tuple[Array, Array]:
    """chi^2 (batch,) on the ridge; its half's gradient (batch, slews, k) to bias and nuisances."""
    return jax.vmap(partial(_pull_at, structure, pull))(thetas)


def _pull_at(structure: Structure, pull: _Pull, theta: Array) -> tuple[Array, Array]:
    fixed = jnp.asarray(structure.hyperparameters, int)
    # Residuals depend on what the coefficients are, not on their prior.
    point = point_on_ridge(pull, theta.at[fixed].set(pull.optimum.theta[fixed]))
    prediction = predict_all(structure, point.theta, point.local, point.bias, pull.data)
    r = whitened(structure, prediction, pull.data.arrays.telemetry, pull.white)
    chi2: Any = sum(jnp.sum(channel**2) for channel in r)
    return chi2, pulled(r, pull.columns, jnp)


def pulled(r: Residuals, columns: Residuals, xp: Any = np) -> Any:
    """Gradient (slews, k) of half the sum of squares by the nuisances, whose columns are given."""
    pairs = zip(r, columns, strict=True)
    return sum(xp.einsum("sn,snk->sk", channel, of_channel) for channel, of_channel in pairs)


def _log_integral(
    structure: Structure, nuisances: _Nuisances, theta: Array, chi2: Array, gradient: Array
) -> Array:
    """Log of the integral over all nuisances at one theta, from the data's pull there."""
    if nuisances.coefficients is not None:
        return log_integral(_elimination(structure, nuisances, theta, chi2, gradient)[0])
    point = point_on_ridge(nuisances, theta)
    bias, local = point.bias, point.local
    n = len(bias)
    every = jnp.concatenate([gradient[:, :n].sum(0) + bias, (gradient[:, n:] + local).ravel()])
    squares = chi2 + jnp.sum(bias**2) + jnp.sum(local**2)
    return -0.5 * (squares - jnp.sum((nuisances.root @ every) ** 2))


def _elimination(
    structure: Structure, nuisances: _Nuisances, theta: Array, chi2: Array, gradient: Array
) -> tuple[EliminatedSlews, Array]:
    """The integral over all nuisances at one theta, where their prior depends on it; the bias."""
    fixed, part = jnp.asarray(structure.hyperparameters, int), nuisances.coefficients
    assert part is not None
    assert nuisances.contexts is not None
    point = point_on_ridge(nuisances, theta.at[fixed].set(nuisances.optimum.theta[fixed]))
    change = root_change(structure, part.inverse_roots, theta, nuisances.contexts)
    bias = point.bias
    equations = SlewEquations(
        chi2, part.information, gradient, jnp.ones(len(bias)), bias, bias @ bias, point.local
    )
    return eliminated(change, equations), bias


@jax.jit
def _safe(thetas: Array, optimum: Array) -> Array:
    """Where J is physical theta, elsewhere the optimum."""
    physical = inertia_tensor.is_physical(thetas[:, :6])
    return jnp.where(physical[:, None], thetas, optimum)


@KeptProgram
def _densities(
    structure: Structure, nuisances: _Nuisances, thetas: Array, chi2: Array, gradient: Array
) -> Array:
    """Log densities (batch,), from the data's pull at physical thetas."""
    return jax.vmap(partial(_density, structure, nuisances))(thetas, chi2, gradient)


def _density(
    structure: Structure, nuisances: _Nuisances, theta: Array, chi2: Array, gradient: Array
) -> Array:
    physical = inertia_tensor.is_physical(theta[:6])
    safe = jnp.where(physical, theta, nuisances.optimum.theta)
    value = _log_integral(structure, nuisances, safe, chi2, gradient)
    value = value + log_prior(nuisances.prior, theta)
    return jnp.where(physical & jnp.isfinite(value), value, -jnp.inf)


def log_posterior_of(structure: Structure, marginal: Marginal, theta: Array) -> Array:
    """Marginal log posterior density of one theta, up to a constant.

    Differentiable. `log_posterior` is the compiled version for batches.

    `theta` (d,). Returns: -inf where J is unphysical or a prior ends.
    """
    pull = _Pull(*(getattr(marginal, key) for key in _Pull._fields))
    safe = _safe(theta[None], jnp.asarray(marginal.optimum.theta))[0]
    nuisances = _nuisances(marginal, marginal.data.arrays.slews.context)
    return _density(structure, nuisances, theta, *_pull_at(structure, pull, safe))


def log_posterior(structure: Structure, marginal: Marginal, thetas: np.ndarray) -> np.ndarray:
    """The compiled marginal log posterior.

    `thetas` (n, d). Returns (n,).
    """
    return log_density_of(structure, marginal, batch=LIMITS.draws_at_once)(np.asarray(thetas))


def _compiled(structure: Structure, marginal: Marginal) -> LogDensity:
    """Each slew's pull by the program of one slew, and their integral by that of a few sizes."""
    pieces, nuisances = _pieces(marginal), _padded_nuisances(marginal)
    slews = len(nuisances.ridge_local)

    def densities(thetas: np.ndarray) -> np.ndarray:
        safe = _safe(thetas, nuisances.optimum.theta)
        pulls = [_pulls(structure, piece, safe) for piece in pieces]
        chi2 = sum(np.asarray(of_slew) for of_slew, _ in pulls)
        gradient = np.concatenate([np.asarray(slopes) for _, slopes in pulls], axis=1)
        return np.asarray(_densities(structure, nuisances, thetas, chi2, filled(gradient, slews)))

    return densities


def _pieces(marginal: Marginal) -> list[_Pull]:
    """What `_pulls` is given of each slew alone."""
    pieces = slew_pieces(marginal.optimum, marginal.data, marginal.white)
    ridge = np.asarray(marginal.ridge_local)
    columns = tuple(
        filled(np.asarray(x), round(x.shape[1] / max(1, len(given[0])) * len(padded[0])))
        for x, (given, *_), (padded, *_) in zip(
            marginal.columns, marginal.white, pieces[0].white, strict=True
        )
    )
    pulls = (
        _Pull(p.point, marginal.ridge_bias, of_slew(k, ridge), of_slew(k, columns), p.data, p.white)
        for k, p in enumerate(pieces)
    )
    return [jax.tree.map(on_device, pull) for pull in pulls]


def _nuisances(marginal: Marginal, contexts: SlewContext) -> _Nuisances:
    parts = {key: getattr(marginal, key) for key in _Nuisances._fields[:-1]}
    return _Nuisances(**parts, contexts=None if marginal.coefficients is None else contexts)


def _padded_nuisances(marginal: Marginal) -> _Nuisances:
    """With slews added of which no data speak: a few numbers of slews share a program."""
    plain = jax.tree.map(np.asarray, _nuisances(marginal, marginal.data.contexts))
    slews, n_local, _ = plain.ridge_local.shape
    size = padded_size(slews, 1, often=True)
    unknowns = len(plain.ridge_bias) + size * n_local
    part = plain.coefficients
    if part is not None:
        roots = tuple(repeated(x, size, axis=0) for x in part.inverse_roots)
        part = CoefficientPart(filled(part.information, size, axis=0), roots)
    padded = plain._replace(
        optimum=replace(plain.optimum, local=filled(plain.optimum.local, size, axis=0)),
        ridge_local=filled(plain.ridge_local, size, axis=0),
        root=filled(filled(plain.root, unknowns, axis=0), unknowns, axis=1),
        coefficients=part,
        contexts=jax.tree.map(lambda x: repeated(x, size, axis=0), plain.contexts),
    )
    return jax.tree.map(on_device, padded)


@partial(jax.jit, static_argnums=0)
def _drawn(
    structure: Structure,
    nuisances: _Nuisances,
    theta: Array,
    chi2: Array,
    gradient: Array,
    noise: Array,
) -> tuple[Array, Array]:
    """Bias and own nuisances of all slews at one theta, from standard normal numbers."""
    parts, bias = _elimination(structure, nuisances, theta, chi2, gradient)
    step, local = steps_given(parts, noise)
    return bias + step, local


# What is compiled for each size of slew, largest first.
PROGRAMS = (_pulls, _densities, _drawn)


def conditional_point(
    structure: Structure, marginal: Marginal, theta: np.ndarray, noise: np.ndarray
) -> Point:
    """theta with nuisances drawn from their posterior given theta.

    `theta` (d,); `noise` (n_bias + slews n_local,).
    """
    theta, optimum = np.asarray(theta), jax.tree.map(np.asarray, marginal.optimum)
    at = theta.copy()
    if marginal.coefficients is not None:
        # Residuals depend on what the coefficients are, not on their prior.
        at[list(structure.hyperparameters)] = optimum.theta[list(structure.hyperparameters)]
    shift = at - optimum.theta
    bias = optimum.bias + np.asarray(marginal.ridge_bias) @ shift
    local = optimum.local + np.asarray(marginal.ridge_local) @ shift
    r = residuals(structure, Point(at, bias, local), marginal.data, marginal.white)
    slew_gradient = pulled(r, jax.tree.map(np.asarray, marginal.columns))
    if marginal.coefficients is not None:
        nuisances = _padded_nuisances(marginal)
        slews, n_local, _ = nuisances.ridge_local.shape
        pull = sum(np.sum(x**2) for x in r), filled(slew_gradient, slews, 0)
        every = filled(np.asarray(noise), len(optimum.bias) + slews * n_local, 0)
        bias, own = _drawn(structure, nuisances, theta, *pull, every)
        return Point(theta, np.asarray(bias), np.asarray(own)[: len(local)])
    n = len(bias)
    gradient = np.concatenate(
        [slew_gradient[:, :n].sum(0) + bias, (slew_gradient[:, n:] + local).ravel()]
    )
    root = np.asarray(marginal.root)
    step = root.T @ (noise - root @ gradient)
    return Point(theta, bias + step[:n], local + step[n:].reshape(local.shape))


def log_density_of(structure: Structure, marginal: Marginal, *, batch: int) -> LogDensity:
    """The compiled marginal log posterior for arrays of numpy of any length."""
    return in_batches(_compiled(structure, marginal), batch)


def in_batches(compiled: Callable[[Any], Any], batch: int) -> LogDensity:
    """A compiled density for arrays of numpy of any length."""

    def log_density(thetas: np.ndarray) -> np.ndarray:
        n = len(thetas)
        padded = np.concatenate([thetas, np.repeat(thetas[-1:], -n % batch, axis=0)])
        parts = [compiled(padded[i : i + batch]) for i in range(0, len(padded), batch)]
        return np.concatenate([np.asarray(p) for p in parts])[:n]

    return log_density
