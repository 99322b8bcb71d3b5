"""The marginal log posterior with Student-t noise, or with noise of sampled scale.

As in `marginal_posterior` the residuals are evaluated on the nuisances' ridge and continued from
there with their sensitivities A. With Gaussian noise of scale s the integral over the nuisances
n ~ N(0, 1) is exact: its normal matrix H = 1 + sum A^T A/s^2 and its determinant now depend on s.
With Student-t noise it is Laplace's: n is brought to the maximum of the integrand by a fixed
number of quasi-Newton steps (H with the mean curvature of each channel), and the determinant is
that of the observed curvature there (Tierney and Kadane 1986, J. Am. Stat. Assoc. 81, 82).

Normal matrices of nuisances: a few that all slews share, and blocks of each slew's own.

Factored slew by slew (a Schur complement on what is shared), inside compiled code.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.linalg import solve_triangular

from bayes_inertia.inference.channel_rows import measured
from bayes_inertia.inference.laplace import Estimate, marginal
from bayes_inertia.inference.likelihood import Residuals, whitened
from bayes_inertia.inference.marginal_posterior import (
    LogDensity,
    Marginal,
    in_batches,
    point_on_ridge,
)
from bayes_inertia.inference.noise_information import LEAST_CURVATURE
from bayes_inertia.inference.noise_parameters import NoiseRules, channel_rules, noise_values
from bayes_inertia.inference.point import Point
from bayes_inertia.inference.student_t import heavy_tail, location_information, log_norm
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.physics.parameters import log_prior
from bayes_inertia.physics.prediction import Structure, predict_all

# Quasi-Newton steps towards the nuisances' best values; without Student-t noise one is exact.
_STEPS = 4


class NoiseMarginal(NamedTuple):
    """Everything the marginal log posterior needs: a pytree of JAX.

    Parameters
    ----------
    base : Marginal
        With the noise as stated and sensitivities in stated sigmas.
    valid : Residuals
        What was measured, (slews, numbers) of bool by channel.
    gram : tuple of (slews, k, k) arrays
        A^T A by channel, k = 3 + n_local.
    products : tuple of (slews, numbers, k (k + 1)/2) arrays
        Products of each number's sensitivities, of Student-t channels; else without numbers.
    """

    base: Marginal
    valid: Residuals
    gram: tuple[Array, ...]
    products: tuple[Array, ...]


class NuisanceOptimum(NamedTuple):
    """The nuisances integrated out at one theta.

    Parameters
    ----------
    point : Point
        The nuisances' best values.
    loss : () array
        Minus the log density there, priors of the nuisances included.
    factor : ArrowFactor
        Of their normal matrix there.
    log_determinant : () array
        Of that matrix.
    """

    point: Point
    loss: Array
    factor: ArrowFactor
    log_determinant: Array


def noise_marginal(estimate: Estimate) -> NoiseMarginal:
    """What the marginal log posterior needs, frozen at an estimate.

    `estimate`: of all parameters, with the noise that its model was asked for.
    """
    base, rules = marginal(estimate), channel_rules(estimate.model)
    root = np.sqrt(estimate.discount)
    columns = [np.asarray(a) / root[:, c, None, None] for c, a in enumerate(base.columns)]
    upper = np.triu_indices(columns[0].shape[-1])
    products = tuple(
        jnp.asarray(a[..., upper[0]] * a[..., upper[1]]) if rule.heavy else jnp.zeros((0,))
        for rule, a in zip(rules, columns, strict=True)
    )
    return NoiseMarginal(
        base._replace(columns=Residuals(*map(jnp.asarray, columns)), white=estimate.stated),
        Residuals(*(jnp.asarray(v.reshape(len(v), -1)) for v in measured(estimate.model))),
        tuple(jnp.asarray(np.einsum("snk,snl->skl", a, a)) for a in columns),
        products,
    )


class _Channel(NamedTuple):
    """One channel at one theta: how its noise and its residuals are on the ridge."""

    heavy: bool
    residual: Array
    columns: Array
    valid: Array
    gram: Array
    products: Array
    scale: Array
    degrees: Array

    def loss(self, step: Array) -> Array:
        """Minus the log density with the nuisances a step off the ridge."""
        numbers = jnp.sum(self.valid)
        norm = numbers * jnp.log(self.scale)
        if self.heavy:
            loss = jnp.sum(heavy_tail(self._y(step), self.degrees).loss)
            return loss + norm + numbers * log_norm(self.degrees)
        half_bend = 0.5 * jnp.einsum("skl,sk,sl->", self.gram, step, step)
        start = 0.5 * jnp.sum(self.residual**2) + jnp.sum(self._pull() * step)
        return (start + half_bend) / self.scale**2 + norm

    def slope(self, step: Array) -> Array:
        """Its derivative (slews, k) with respect to the step."""
        if self.heavy:
            slope = heavy_tail(self._y(step), self.degrees).slope
            return jnp.einsum("sn,snk->sk", slope, self.columns) / self.scale
        bend = jnp.einsum("skl,sl->sk", self.gram, step)
        return (self._pull() + bend) / self.scale**2

    def mean_matrix(self) -> Array:
        """Its second derivative (slews, k, k), with the mean curvature of the numbers."""
        if not self.heavy:
            return self.gram / self.scale**2
        curvature = heavy_tail(self.residual / self.scale, self.degrees).curvature
        numbers = jnp.maximum(jnp.sum(self.valid), 1)
        mean = jnp.sum(jnp.where(self.valid, curvature, 0.0)) / numbers
        least = LEAST_CURVATURE * location_information(self.degrees)
        return jnp.maximum(mean, least) * self.gram / self.scale**2

    def matrix(self, step: Array) -> Array:
        """Its second derivative (slews, k, k)."""
        if not self.heavy:
            return self.gram / self.scale**2
        curvature = heavy_tail(self._y(step), self.degrees).curvature
        packed = jnp.einsum("sn,snp->sp", curvature, self.products) / self.scale**2
        k = self.columns.shape[-1]
        row, column = np.triu_indices(k)
        place = np.zeros((k, k), int)
        place[row, column] = place[column, row] = np.arange(len(row))
        return packed[:, place]

    def _pull(self) -> Array:
        """Slope (slews, k) of half the sum of squares, on the ridge."""
        return jnp.einsum("sn,snk->sk", self.residual, self.columns)

    def _y(self, step: Array) -> Array:
        """Residuals over their scale."""
        return (self.residual + jnp.einsum("snk,sk->sn", self.columns, step)) / self.scale


def nuisance_optimum(
    structure: Structure, rules: NoiseRules, frozen: NoiseMarginal, theta: Array
) -> NuisanceOptimum:
    """Bring the nuisances to their best values at one theta.

    `theta` (d,).
    """
    base = frozen.base
    point = point_on_ridge(base, theta)
    prediction = predict_all(structure, theta, point.local, point.bias, base.data)
    r = whitened(structure, prediction, base.data.arrays.telemetry, base.white)
    heavy = tuple(rule.heavy for rule in rules)
    values = (jnp.stack([jnp.asarray(v) for v in part]) for part in noise_values(rules, theta))
    parts = zip(
        heavy, r, base.columns, frozen.valid, frozen.gram, frozen.products, *values, strict=True
    )
    channels = [_Channel(*part) for part in parts if part[1].shape[-1]]
    shared = len(point.bias)
    first = factored(_sum(c.mean_matrix() for c in channels), shared)
    bias, local = point.bias, point.local
    for _ in range(_STEPS if any(heavy) else 1):
        slope = _sum(c.slope(_step(point, bias, local)) for c in channels)
        off = solved(first, slope[:, :shared].sum(0) + bias, slope[:, shared:] + local)
        bias, local = bias - off[0], local - off[1]
    step = _step(point, bias, local)
    loss = _sum(c.loss(step) for c in channels) + 0.5 * (jnp.sum(bias**2) + jnp.sum(local**2))
    if not any(heavy):
        return NuisanceOptimum(Point(theta, bias, local), loss, first, first.log_determinant)
    last = factored(_sum(c.matrix(step) for c in channels), shared)
    # Far out the observed curvature need not be positive.
    definite = jnp.isfinite(last.log_determinant)
    factor = jax.tree.map(partial(jnp.where, definite), last, first)
    return NuisanceOptimum(Point(theta, bias, local), loss, factor, factor.log_determinant)


def _sum(parts: Any) -> Any:
    return sum(parts)


def _step(ridge: Point, bias: Array, local: Array) -> Array:
    """How far nuisances lie from the ridge, by slew (slews, k)."""
    shared = jnp.broadcast_to(bias - ridge.bias, (len(local), len(bias)))
    return jnp.concatenate([shared, local - ridge.local], -1)


def log_posterior_with_noise(
    structure: Structure, rules: NoiseRules, frozen: NoiseMarginal, theta: Array
) -> Array:
    """Marginal log posterior density of one theta, noise parameters included, up to a constant.

    `theta` (d,). Returns: -inf where J is unphysical or a prior ends.
    """
    density = log_prior(frozen.base.prior, theta)
    allowed = inertia_tensor.is_physical(theta[:6]) & jnp.isfinite(density)
    safe = jnp.where(allowed, theta, frozen.base.optimum.theta)
    at = nuisance_optimum(structure, rules, frozen, safe)
    value = density - at.loss - 0.5 * at.log_determinant
    return jnp.where(allowed & jnp.isfinite(value), value, -jnp.inf)


@partial(jax.jit, static_argnums=(0, 1))
def _conditional(
    structure: Structure, rules: NoiseRules, frozen: NoiseMarginal, theta: Array, noise: Array
) -> Point:
    at = nuisance_optimum(structure, rules, frozen, theta)
    shared = len(at.point.bias)
    own = noise[shared:].reshape(at.point.local.shape)
    bias, local = drawn(at.factor, noise[:shared], own)
    return Point(theta, at.point.bias + bias, at.point.local + local)


def conditional_point_with_noise(
    estimate: Estimate, frozen: NoiseMarginal
) -> Callable[[np.ndarray, np.ndarray], Point]:
    """How nuisances are drawn from their posterior given theta (Laplace's normal distribution).

    Returns: from theta (d,) and standard normal numbers (3 + slews n_local,) to a point.
    """
    structure, rules = estimate.model.structure, channel_rules(estimate.model)

    def point(theta: np.ndarray, noise: np.ndarray) -> Point:
        drawn_point = _conditional(structure, rules, frozen, jnp.asarray(theta), jnp.asarray(noise))
        return jax.tree.map(np.asarray, drawn_point)

    return point


def log_density_with_noise(estimate: Estimate, *, batch: int) -> LogDensity:
    """The compiled marginal log posterior for arrays of numpy of any length.

    `estimate`: with the noise that its model was asked for.
    """
    structure, rules = estimate.model.structure, channel_rules(estimate.model)
    return in_batches(partial(_log_density, structure, rules, noise_marginal(estimate)), batch)


@partial(jax.jit, static_argnums=(0, 1))
def _log_density(
    structure: Structure, rules: NoiseRules, frozen: NoiseMarginal, thetas: Array
) -> Array:
    return jax.vmap(partial(log_posterior_with_noise, structure, rules, frozen))(thetas)


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

    `blocks` (slews, k, k): information of each slew on (shared nuisances, its own), without priors.

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

    `shared` (b,); `own` (slews, m). Returns `shared` (b,); `own` (slews, m).
    """
    inside = _forward(factor.inner, own[..., None])[..., 0]
    left = shared - jnp.einsum("sib,si->b", factor.across, inside)
    x = _backward(factor.shared, _forward(factor.shared, left[:, None]))[:, 0]
    rest = inside - jnp.einsum("sib,b->si", factor.across, x)
    return x, _backward(factor.inner, rest[..., None])[..., 0]


def drawn(factor: ArrowFactor, shared: Array, own: Array) -> tuple[Array, Array]:
    """Turn standard normal numbers into draws whose covariance is the inverse of the matrix.

    `shared` (b,); `own` (slews, m). Returns `shared` (b,); `own` (slews, m).
    """
    x = _backward(factor.shared, shared[:, None])[:, 0]
    rest = own - jnp.einsum("sib,b->si", factor.across, x)
    return x, _backward(factor.inner, rest[..., None])[..., 0]
