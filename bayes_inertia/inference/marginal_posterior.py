"""The marginal log posterior of the sampled parameters, all nuisances integrated out.

Start states of each slew, slow tachometer noise (measured drive) and the rate bias are nuisances.
They enter the residuals almost linearly, so they are integrated out in closed form: the residuals
are evaluated on the ridge n(theta) = n0 + L (theta - theta0), the nuisances' best values for every
theta to first order, and what is left is projected by a Schur complement with the sensitivities at
theta0. On a linear model this is exact; the ridge keeps it accurate where theta moves far.

The priors of coefficients c = B(p) z are sampled, too. Around an optimum the data are linear in
the coefficients. With sensitivities S to the whitened coefficients z0 of the optimum's parameters
p0, those at p are S T, T = B(p0)^-1 B(p): one set of sensitivities serves all p, and nothing is
singular where B(p) vanishes. With A the data's normal matrix of all unknowns and g their gradient,
the integral over standard normal x, the unknowns being n + delta = n + W x + e, is

    log I = -1/2 (chi^2 - G^T M^-1 G) - 1/2 log det M,   M = W^T A W + 1,

with W = diag(1, T). The nuisances of a slew meet those of others only through what all slews share
(the rate bias; in `hyperparameters` J and K too), so that M is eliminated slew by slew: the cost is
linear in slews and, through A, in samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.linalg import solve_triangular

from bayes_inertia.inference.likelihood import (
    Point,
    Residuals,
    is_traced,
    of_slew,
    residuals,
    slew_pieces,
    whitened,
)
from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.inference.noise_model import Whitenings
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.device_arrays import filled, in_batches, on_device, padded_size, repeated
from bayes_inertia.maths.kept_programs import KeptProgram
from bayes_inertia.maths.values import AnyArray
from bayes_inertia.physics.equations_of_motion import computed_once
from bayes_inertia.physics.packing import Data
from bayes_inertia.physics.parameters import log_prior
from bayes_inertia.physics.prediction import Structure, predict_all, prior_blocks
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
    precision : (s, s) array
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


@KeptProgram
def _prior_roots(structure: Structure, theta: Array, contexts: SlewContext) -> Roots:
    active = structure.active_effects(theta)
    return jax.vmap(lambda slew: prior_blocks(active, structure.coefficients, slew))(contexts)


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
    shared_root = jnp.linalg.cholesky(equations.precision + left.sum(0))
    of_slews = jnp.sum(slope[:, :s] - jnp.einsum("ski,sk->si", across, step), 0)
    shared_step = solve_triangular(shared_root, equations.shared_gradient + of_slews, lower=True)
    return EliminatedSlews(constant, started, root, step, across, shared_root, shared_step)


def _changed(matrix: Array, gradient: Array, change: Roots, first: int) -> tuple[Array, Array]:
    """Normal equations with the unknowns from `first` on replaced by `change` times new ones."""

    def turned(rows: Array) -> Array:
        parts, start = [rows[..., :first]], first
        for block in change:
            stop = start + block.shape[1] * block.shape[2]
            parts.append(_times_blocks(rows[..., start:stop], block))
            start = stop
        return jnp.concatenate(parts, -1)

    both = turned(jnp.swapaxes(turned(matrix), 1, 2))
    return jnp.swapaxes(both, 1, 2), turned(gradient[:, None])[:, 0]


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


LogDensity = Callable[[np.ndarray], np.ndarray]


class Ridge(NamedTuple):
    """The nuisances that belong to any theta, to first order.

    Parameters
    ----------
    optimum : Point
        Where the nuisances' sensitivities were taken.
    bias : (n_bias, d) array
        How the bias follows theta.
    local : (slews, n_local, d) array
        How the local nuisances follow theta.
    """

    optimum: Point
    # Of numpy on the host, of JAX in compiled code.
    bias: AnyArray
    local: AnyArray

    def at(self, theta: AnyArray, held: Sequence[int] = ()) -> Point:
        """The point of theta (d,); parameters `held` stay at the optimum.

        Residuals depend on what coefficients are, not on the parameters of their prior.
        """
        xp, optimum = np if isinstance(theta, np.ndarray) else jnp, self.optimum
        theta = xp.where(np.isin(np.arange(len(theta)), held), optimum.theta, theta)
        shift = theta - optimum.theta
        return Point(theta, optimum.bias + self.bias @ shift, optimum.local + self.local @ shift)


class Marginal(NamedTuple):
    """Everything the marginal log posterior needs, frozen at an optimum: a pytree of JAX.

    Parameters
    ----------
    ridge : Ridge
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

    ridge: Ridge
    columns: Residuals
    root: Array
    prior: dict
    data: Data
    white: Whitenings
    coefficients: CoefficientPart | None = None


class _Pull(NamedTuple):
    """What tells how the data pull at the nuisances, with the slews as leading axis."""

    ridge: Ridge
    columns: Residuals
    data: Data
    white: Whitenings


class _Nuisances(NamedTuple):
    """What the integral over nuisances needs beside the pull, as `Marginal` has it."""

    ridge: Ridge
    root: Array
    prior: dict
    coefficients: CoefficientPart | None
    contexts: SlewContext | None


@KeptProgram
def _pulls(structure: Structure, pull: _Pull, thetas: Array) -> tuple[Array, Array]:
    """chi^2 (batch,) on the ridge; its half's gradient (batch, slews, k) to bias and nuisances."""
    return jax.vmap(partial(_pull_at, structure, pull))(thetas)


def _pull_at(structure: Structure, pull: _Pull, theta: Array) -> tuple[Array, Array]:
    point = pull.ridge.at(theta, structure.hyperparameters)
    prediction = predict_all(structure, point.theta, point.local, point.bias, pull.data)
    r = computed_once(whitened(structure, prediction, pull.data.arrays.telemetry, pull.white))
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
    point = nuisances.ridge.at(theta)
    bias, local = point.bias, point.local
    n = len(bias)
    every = jnp.concatenate([gradient[:, :n].sum(0) + bias, (gradient[:, n:] + local).ravel()])
    squares = chi2 + jnp.sum(bias**2) + jnp.sum(local**2)
    return -0.5 * (squares - jnp.sum((nuisances.root @ every) ** 2))


def _elimination(
    structure: Structure, nuisances: _Nuisances, theta: Array, chi2: Array, gradient: Array
) -> tuple[EliminatedSlews, Array]:
    """The integral over all nuisances at one theta, where their prior depends on it; the bias."""
    part, contexts = nuisances.coefficients, nuisances.contexts
    assert part is not None
    assert contexts is not None
    point = nuisances.ridge.at(theta, structure.hyperparameters)
    change = root_change(structure, part.inverse_roots, theta, contexts)
    bias, prior = point.bias, jnp.eye(len(point.bias))
    of_bias = prior, bias, bias @ bias
    equations = SlewEquations(chi2, part.information, gradient, *of_bias, point.local)
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
    safe = jnp.where(physical, theta, nuisances.ridge.optimum.theta)
    value = _log_integral(structure, nuisances, safe, chi2, gradient)
    value = value + log_prior(nuisances.prior, theta)
    return jnp.where(physical & jnp.isfinite(value), value, -jnp.inf)


def log_posterior_of(structure: Structure, marginal: Marginal, theta: Array) -> Array:
    """Marginal log posterior density of one theta, up to a constant.

    Differentiable. `log_density_of` is the compiled version for batches.

    `theta` (d,). Returns: -inf where J is unphysical or a prior ends.
    """
    pull = _Pull(marginal.ridge, marginal.columns, marginal.data, marginal.white)
    safe = _safe(theta[None], jnp.asarray(marginal.ridge.optimum.theta))[0]
    nuisances = _nuisances(marginal, marginal.data.arrays.slews.context)
    return _density(structure, nuisances, theta, *_pull_at(structure, pull, safe))


def _compiled(structure: Structure, marginal: Marginal) -> LogDensity:
    """Each slew's pull by the program of one slew, and their integral by that of a few sizes."""
    pieces, nuisances = _pieces(marginal), _padded_nuisances(marginal)
    slews, part = len(nuisances.ridge.local), nuisances.coefficients

    def densities(thetas: np.ndarray) -> np.ndarray:
        safe = _safe(thetas, nuisances.ridge.optimum.theta)
        pulls = [_pulls(structure, piece, safe) for piece in pieces]
        chi2 = sum(np.asarray(of_slew) for of_slew, _ in pulls)
        gradient = np.concatenate([np.asarray(slopes) for _, slopes in pulls], axis=1)
        rows = thetas, chi2, filled(gradient, slews)
        at_once = len(thetas) if part is None else eliminated_at_once(part.information.size)
        return in_batches(lambda rows: _densities(structure, nuisances, *rows), rows, at_once)

    return densities


def eliminated_at_once(numbers: int) -> int:
    """How many equations of all slews, of so many numbers each, the processor's cache holds.

    >>> eliminated_at_once(10), eliminated_at_once(10**9)
    (16, 1)
    """
    return 2 ** int(np.log2(np.clip(LIMITS.cached_numbers / numbers, 1.0, LIMITS.sizes_at_once)))


def _pieces(marginal: Marginal) -> list[_Pull]:
    """What `_pulls` is given of each slew alone."""
    pieces = slew_pieces(marginal.ridge.optimum, marginal.data, marginal.white)
    bias, local = marginal.ridge.bias, np.asarray(marginal.ridge.local)
    columns = tuple(
        filled(np.asarray(x), round(x.shape[1] / max(1, len(given[0])) * len(padded[0])))
        for x, (given, *_), (padded, *_) in zip(
            marginal.columns, marginal.white, pieces[0][-1], strict=True
        )
    )
    pulls = (
        _Pull(Ridge(point, bias, of_slew(k, local)), of_slew(k, columns), data, white)
        for k, (point, data, white) in enumerate(pieces)
    )
    return [jax.tree.map(on_device, pull) for pull in pulls]


def _nuisances(marginal: Marginal, contexts: SlewContext) -> _Nuisances:
    parts = {key: getattr(marginal, key) for key in _Nuisances._fields[:-1]}
    return _Nuisances(**parts, contexts=None if marginal.coefficients is None else contexts)


def _padded_nuisances(marginal: Marginal) -> _Nuisances:
    """With slews added of which no data speak: a few numbers of slews share a program."""
    plain = jax.tree.map(np.asarray, _nuisances(marginal, marginal.data.contexts))
    (optimum, bias, local), part = plain.ridge, plain.coefficients
    size = padded_size(len(local), 1, often=True)
    unknowns = len(bias) + size * local.shape[1]
    optimum = replace(optimum, local=filled(optimum.local, size, axis=0))
    if part is not None:
        roots = tuple(repeated(x, size, axis=0) for x in part.inverse_roots)
        part = CoefficientPart(filled(part.information, size, axis=0), roots)
    padded = plain._replace(
        ridge=Ridge(optimum, bias, filled(local, size, axis=0)),
        root=filled(filled(plain.root, unknowns, axis=0), unknowns, axis=1),
        coefficients=part,
        contexts=jax.tree.map(lambda x: repeated(x, size, axis=0), plain.contexts),
    )
    return jax.tree.map(on_device, padded)


@KeptProgram
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


def conditional_point(
    structure: Structure, marginal: Marginal, theta: np.ndarray, noise: np.ndarray
) -> Point:
    """theta with nuisances drawn from their posterior given theta.

    `theta` (d,); `noise` (n_bias + slews n_local,).
    """
    theta, ridge = np.asarray(theta), jax.tree.map(np.asarray, marginal.ridge)
    point = ridge.at(theta, structure.hyperparameters)
    bias, local = point.bias, point.local
    r = residuals(structure, point, marginal.data, marginal.white)
    slew_gradient = pulled(r, jax.tree.map(np.asarray, marginal.columns))
    if marginal.coefficients is not None:
        nuisances = _padded_nuisances(marginal)
        slews, n_local, _ = nuisances.ridge.local.shape
        pull = sum(np.sum(x**2) for x in r), filled(slew_gradient, slews, 0)
        every = filled(np.asarray(noise), len(bias) + slews * n_local, 0)
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
    return partial(in_batches, _compiled(structure, marginal), size=batch)
