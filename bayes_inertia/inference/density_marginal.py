"""The marginal log posterior under densities that are not Gaussian of the stated sigma.

As in `marginal_posterior` the residuals are evaluated on the nuisances' ridge and continued from
there with their sensitivities A. With Gaussian noise of scale s the integral over the nuisances
n ~ N(0, 1) is exact: its normal matrix H = 1 + sum A^T A/s^2 and its determinant now depend on s.
With other densities it is Laplace's: n is brought to the maximum of the integrand by a fixed number
of quasi-Newton steps (H with the mean curvature of each channel), and the determinant is that of
the observed curvature there (Tierney and Kadane 1986, J. Am. Stat. Assoc. 81, 82).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.inference.laplace import Estimate, marginal
from bayes_inertia.inference.likelihood import Point, Residuals, whitened
from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.inference.marginal_posterior import (
    EliminatedSlews,
    LogDensity,
    Marginal,
    SlewEquations,
    eliminated,
    log_integral,
    steps_given,
)
from bayes_inertia.inference.noise_model import (
    ChannelDensity,
    Densities,
    densities_of,
    mean_curvature,
    measured,
)
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.device_arrays import in_batches
from bayes_inertia.maths.kept_programs import KeptProgram
from bayes_inertia.physics.parameters import log_prior
from bayes_inertia.physics.prediction import Structure, predict_all


class DensityMarginal(NamedTuple):
    """Everything the marginal log posterior needs: a pytree of JAX.

    Parameters
    ----------
    base : Marginal
        With the noise as stated and sensitivities in stated sigmas.
    valid : tuple
        What was measured, (slews, numbers) of bool by channel.
    gram : tuple of (slews, k, k) arrays
        A^T A by channel, k = 3 + n_local.
    products : tuple of (slews, numbers, k (k + 1)/2) arrays
        Products of each number's sensitivities, of heavy channels; else without numbers.
    """

    base: Marginal
    valid: Residuals
    gram: tuple[Array, ...]
    products: tuple[Array, ...]


def density_marginal(estimate: Estimate) -> DensityMarginal:
    """What the marginal log posterior needs, frozen at an estimate of all parameters."""
    base, densities = marginal(estimate), densities_of(estimate.model)
    root = np.sqrt(estimate.discount)
    columns = [np.asarray(a) / root[:, c, None, None] for c, a in enumerate(base.columns)]
    upper = np.triu_indices(columns[0].shape[-1])
    products = tuple(
        jnp.asarray(a[..., upper[0]] * a[..., upper[1]]) if each.family.heavy else jnp.zeros((0,))
        for each, a in zip(densities, columns, strict=True)
    )
    return DensityMarginal(
        base._replace(columns=tuple(map(jnp.asarray, columns)), white=estimate.stated),
        tuple(jnp.asarray(v.reshape(len(v), -1)) for v in measured(estimate.model)),
        tuple(jnp.asarray(np.einsum("snk,snl->skl", a, a)) for a in columns),
        products,
    )


class _Channel(NamedTuple):
    """One channel at one theta: how its noise and its residuals are on the ridge."""

    density: ChannelDensity
    residual: Array
    columns: Array
    valid: Array
    gram: Array
    products: Array
    scale: Array
    shape: Array

    def loss(self, step: Array) -> Array:
        """Minus the log density with the nuisances a step (slews, k) off the ridge."""
        loss = self.density.family.loss(self._y(step), self.shape)
        return jnp.sum(jnp.where(self.valid, loss + jnp.log(self.scale), 0.0))

    def slope(self, step: Array) -> Array:
        """Its derivative (slews, k) with respect to the step."""
        slope = self.density.family.slope(self._y(step), self.shape)
        return jnp.einsum("sn,snk->sk", slope, self.columns) / self.scale

    def mean_matrix(self) -> Array:
        """Its second derivative (slews, k, k), with the mean curvature of the numbers."""
        family, y = self.density.family, self.residual / self.scale
        mean = mean_curvature(family, y, self.valid, self.shape)
        return mean * self.gram / self.scale**2

    def matrix(self, step: Array) -> Array:
        """Its second derivative (slews, k, k)."""
        if not self.density.family.heavy:
            return self.gram / self.scale**2
        curvature = self.density.family.curvature(self._y(step), self.shape)
        packed = jnp.einsum("sn,snp->sp", curvature, self.products) / self.scale**2
        k = self.columns.shape[-1]
        row, column = np.triu_indices(k)
        place = np.zeros((k, k), int)
        place[row, column] = place[column, row] = np.arange(len(row))
        return packed[:, place]

    def _y(self, step: Array) -> Array:
        """Residuals over their scale."""
        return (self.residual + jnp.einsum("snk,sk->sn", self.columns, step)) / self.scale


class NuisanceOptimum(NamedTuple):
    """The nuisances at (or next to) their best values at one theta, and their quadratic form."""

    point: Point
    parts: EliminatedSlews


def nuisance_optimum(
    structure: Structure, densities: Densities, frozen: DensityMarginal, theta: Array
) -> NuisanceOptimum:
    """Bring the nuisances to their best values at one theta (d,)."""
    base = frozen.base
    ridge = base.ridge.at(theta)
    prediction = predict_all(structure, theta, ridge.local, ridge.bias, base.data)
    r = whitened(structure, prediction, base.data.arrays.telemetry, base.white)
    values = [
        [jnp.asarray(getattr(each, of)(theta), float) for each in densities]
        for of in ("scale_of", "shape_of")
    ]
    of_channels = zip(
        densities, r, base.columns, frozen.valid, frozen.gram, frozen.products, *values, strict=True
    )
    channels = [_Channel(*parts) for parts in of_channels if parts[1].shape[-1]]
    mean, point = sum(c.mean_matrix() for c in channels), ridge

    def at(point: Point, matrix: Any) -> EliminatedSlews:
        shared = jnp.broadcast_to(point.bias - ridge.bias, (len(ridge.local), len(ridge.bias)))
        step = jnp.concatenate([shared, point.local - ridge.local], -1)
        matrix = sum(c.matrix(step) for c in channels) if matrix is None else matrix
        loss, slope = (sum(getattr(c, of)(step) for c in channels) for of in ("loss", "slope"))
        one, squares = jnp.eye(len(point.bias)), jnp.sum(point.bias**2)
        equations = SlewEquations(2.0 * loss, matrix, slope, one, point.bias, squares, point.local)
        return eliminated((), equations)

    if not any(each.family.heavy for each in densities):
        return NuisanceOptimum(point, at(point, mean))
    for _ in range(LIMITS.nuisance_steps):
        shared, local = steps_given(at(point, mean))
        point = Point(theta, point.bias + shared, local)
    rough, exact = at(point, mean), at(point, None)
    # Far out the observed curvature need not be positive.
    definite = jnp.isfinite(log_integral(exact))
    return NuisanceOptimum(point, jax.tree.map(partial(jnp.where, definite), exact, rough))


def log_posterior_with_densities(
    structure: Structure, densities: Densities, frozen: DensityMarginal, theta: Array
) -> Array:
    """Marginal log posterior density of one theta (d,), noise parameters included.

    Up to a constant; -inf where J is unphysical or a prior ends.
    """
    density = log_prior(frozen.base.prior, theta)
    allowed = inertia_tensor.is_physical(theta[:6]) & jnp.isfinite(density)
    safe = jnp.where(allowed, theta, frozen.base.ridge.optimum.theta)
    value = density + log_integral(nuisance_optimum(structure, densities, frozen, safe).parts)
    return jnp.where(allowed & jnp.isfinite(value), value, -jnp.inf)


@partial(KeptProgram, static=2)
def _conditional(
    structure: Structure, densities: Densities, frozen: DensityMarginal, theta: Array, noise: Array
) -> Point:
    at = nuisance_optimum(structure, densities, frozen, theta)
    shared, local = steps_given(at.parts, noise)
    return Point(theta, at.point.bias + shared, local)


def conditional_point_with_densities(
    estimate: Estimate,
) -> Callable[[np.ndarray, np.ndarray], Point]:
    """How nuisances are drawn from their posterior given theta (Laplace's normal distribution).

    Returns: from theta (d,) and standard normal numbers (3 + slews n_local,) to a point.
    """
    given = estimate.model.structure, densities_of(estimate.model), density_marginal(estimate)

    def point(theta: np.ndarray, noise: np.ndarray) -> Point:
        return jax.tree.map(np.asarray, _conditional(*given, jnp.asarray(theta), noise))

    return point


def log_density_with_densities(estimate: Estimate, *, batch: int) -> LogDensity:
    """The compiled marginal log posterior for arrays of numpy of any length."""
    given = estimate.model.structure, densities_of(estimate.model), density_marginal(estimate)
    return partial(in_batches, partial(_log_density, *given), size=batch)


@partial(KeptProgram, static=2)
def _log_density(
    structure: Structure, densities: Densities, frozen: DensityMarginal, thetas: Array
) -> Array:
    return jax.vmap(partial(log_posterior_with_densities, structure, densities, frozen))(thetas)
