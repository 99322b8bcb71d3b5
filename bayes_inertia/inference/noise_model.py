"""The noise of every measurement: the factors that whiten residuals, and how these then count.

Each reading pulls with the slope of its own log density, so that outliers hardly pull; a channel's
normal matrix is that of Gaussian noise times the mean curvature of its log density. Scale and shape
have their Fisher information, and none across to J, K and the nuisances (Lange, Little and Taylor
1989). A fit is reweighted so at every step. Gaussian noise of the stated sigma has no density here:
its residuals count as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.inference.noise_filter import Memory, noise_memory
from bayes_inertia.maths.device_arrays import on_device
from bayes_inertia.maths.kept_programs import KeptProgram
from bayes_inertia.physics.channel_noise import NOISE_OWNER
from bayes_inertia.physics.densities import Density
from bayes_inertia.physics.forward_model import Model


class Pull(NamedTuple):
    """How the readings of one channel pull at a fit.

    Parameters
    ----------
    slope : (slews, numbers) array
        Derivative of the loss by each residual; the residual itself for Gaussian noise.
    weight : float
        Information of a reading over that of Gaussian noise of the stated sigma.
    chi2 : (slews,) array
        Sums of residual times slope, in the noise of that information.
    noise : ((slews, 2), (slews, 2, 2)) arrays, optional
        Derivative of the loss by scale and shape, and their Fisher information.
    """

    slope: np.ndarray
    weight: float
    chi2: np.ndarray
    noise: tuple[np.ndarray, np.ndarray] | None = None


@jax.tree_util.register_static
@dataclass(frozen=True)
class ChannelDensity:
    """The density of a channel, and where its numbers stand in theta.

    Parameters
    ----------
    family : Density
    shape : float
        Where it is given.
    scale_at, shape_at : int or None
        Where scale and shape stand in theta, if they are sampled.
    inflation : float
        Factor on the scale, above 1 while a descent begins among outliers.
    lost : float
        By how much fitting lowered the sum of y psi(y): the scale is that of the numbers left.
    """

    family: Density
    shape: float
    scale_at: int | None = None
    shape_at: int | None = None
    inflation: float = 1.0
    lost: float = 0.0

    def scale_of(self, theta: Any) -> Any:
        """The factor on the stated sigmas."""
        return self.inflation * (1.0 if self.scale_at is None else theta[self.scale_at])

    def shape_of(self, theta: Any) -> Any:
        """The number that shapes the family."""
        return self.shape if self.shape_at is None else theta[self.shape_at]

    def loss(self, r: Array, valid: np.ndarray, theta: np.ndarray) -> float:
        """Minus the log density of residuals in stated sigmas, up to a constant."""
        scale, shape = float(self.scale_of(theta)), float(self.shape_of(theta))
        summed = float(_summed(self.family, r, valid, scale, shape))
        return summed + (float(valid.sum()) - self.lost) * np.log(scale)

    def pull(self, r: Array, valid: np.ndarray, theta: np.ndarray) -> Pull:
        """How residuals (slews, numbers) in stated sigmas pull; `valid`: was measured."""
        scale, shape = float(self.scale_of(theta)), float(self.shape_of(theta))
        parts = _pull(self.family, r, valid, scale, shape)
        slope, curvature, squares, towards = (np.asarray(part) for part in parts)
        numbers = valid.sum(1)
        kept = numbers * (1.0 - self.lost / max(numbers.sum(), 1))
        information = np.asarray(self.family.moments(shape).information)
        return Pull(
            slope,
            float(curvature) / scale**2,
            curvature * squares,
            (
                np.stack([(kept - squares) / scale, towards], -1),
                kept[:, None, None] * information / np.outer([scale, 1.0], [scale, 1.0]),
            ),
        )

    def judged(
        self, series: list[np.ndarray], theta: np.ndarray, numbers: float, parameters: float
    ) -> tuple[list[np.ndarray], float, float]:
        """How residuals (rows, components) by slew are tested: by their own distribution.

        The size of residuals is the sum of y psi(y). Fitting lowers it by a share for each of the
        `parameters` that the channel pays for, and it scatters like chi^2 with more degrees of
        freedom than `numbers`. Whiteness is asked of normal scores.

        Returns the scores by slew, and chi^2 with its degrees of freedom.
        """
        scale, shape = float(self.scale_of(theta)), float(self.shape_of(theta))
        y = [slew / scale for slew in series]
        moments = self.family.moments(shape)
        worth, share = float(moments.worth), float(moments.per_parameter)
        slopes = [np.asarray(self.family.slope(jnp.asarray(x), shape)) for x in y]
        squares = float(sum(np.nansum(x * slope) for x, slope in zip(y, slopes, strict=True)))
        scores = [self.family.normal_scores(x, shape) for x in y]
        return scores, worth * squares, worth * (numbers - share * parameters)

    def noise_columns(self, free: np.ndarray) -> tuple[list[int], np.ndarray]:
        """Which of scale and shape are among the free parameters (f,), and where."""
        at = [self.scale_at, self.shape_at]
        kept = [i for i, index in enumerate(at) if index is not None and index in free]
        return kept, np.searchsorted(free, [at[i] or 0 for i in kept])


Densities = tuple[ChannelDensity, ...]


def densities_of(model: Model) -> Densities:
    """The density of each channel of a model."""
    place = {name: i for i, name in enumerate(model.space.names)}
    densities = []
    for channel in model.channels:
        noise = model.noise.of(channel.name)
        family, own = noise.density, f"{NOISE_OWNER}.{channel.name}_"
        shape_at = place.get(own + family.shape.name) if family.shape else None
        shape = (noise.degrees or 0.0) if family.shape else 0.0
        densities.append(ChannelDensity(family, shape, place.get(f"{own}scale"), shape_at))
    return tuple(densities)


@KeptProgram
def _summed(family: Density, r: Array, valid: Array, scale: Array, shape: Array) -> Array:
    return jnp.sum(jnp.where(valid, family.loss(r / scale, shape), 0.0))


@KeptProgram
def _pull(family: Density, r: Array, valid: Array, scale: Array, shape: Array) -> tuple[Array, ...]:
    """Slope by each residual, mean curvature, sums of y psi(y) and slope towards the shape."""
    y = r / scale
    slope = family.slope(y, shape)
    towards = family.towards_shape(y, shape) if family.shape else jnp.zeros_like(y)
    return (
        slope / scale,
        mean_curvature(family, y, valid, shape),
        jnp.sum(slope * y, -1),
        jnp.sum(jnp.where(valid, towards, 0.0), -1),
    )


def mean_curvature(family: Density, y: Array, valid: Array, shape: Array) -> Array:
    """Mean curvature of a channel's log density, no less than a share of what is expected."""
    curvature = jnp.where(valid, family.curvature(y, shape), 0.0)
    least = LIMITS.least_curvature * family.moments(shape).location
    return jnp.maximum(jnp.sum(curvature) / jnp.maximum(jnp.sum(valid), 1), least)


class Whitening(NamedTuple):
    """Inverse roots of the noise of one channel, zero where nothing was measured.

    Parameters
    ----------
    factors : (slews, n, ...) array
        As the channel's `whitened` takes them.
    memory : Memory, optional
        What the noise keeps of the readings before; None where it is white.
    density : ChannelDensity, optional
        How whitened residuals count; None where they are Gaussian of unit scale.
    """

    factors: Array
    memory: Memory | None = None
    density: ChannelDensity | None = None


# Of each channel of a model.
Whitenings = tuple[Whitening, ...]


def whitening(model: Model, theta: np.ndarray) -> Whitenings:
    """Noise of every measurement.

    `theta` (d,): parameters; in the measured drive the noise of the rates depends on J and K, and
    what an effect's process does between its knots depends on its size and time.
    """
    white = []
    for channel, readings in zip(
        model.structure.channels, model.data.arrays.telemetry.readings, strict=True
    ):
        noise = channel.noise(model.campaign, theta, model.structure.drive)
        factors = channel.factors(noise, np.asarray(readings.valid))
        white.append(Whitening(on_device(factors), noise_memory(model, channel, theta)))
    return tuple(white)


def is_alike(one: Whitenings, other: Whitenings) -> bool:
    """Whether two noises of one model differ by no more than rounds of them settle to."""
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return all(np.allclose(a, b, rtol=LIMITS.settled_noise, atol=0.0) for a, b in pairs)


def with_memory(model: Model, white: Whitenings, theta: np.ndarray, **counted: bool) -> Whitenings:
    """The same noise with another memory; `counted`: as `noise_memory` takes it."""
    pairs = zip(model.channels, white, strict=True)
    return tuple(
        each._replace(memory=noise_memory(model, channel, theta, **counted))
        for channel, each in pairs
    )


def without_memory(white: Whitenings) -> Whitenings:
    """The same noise as if it were white and Gaussian."""
    return tuple(each._replace(memory=None, density=None) for each in white)


def of_densities(white: Whitenings, densities: Densities) -> Whitenings:
    """The same noise with other densities."""
    pairs = zip(white, densities, strict=True)
    return tuple(each._replace(density=density) for each, density in pairs)


def discounted(white: Whitenings, factors: np.ndarray) -> Whitenings:
    """The same noise with information taken away.

    `factors` (slews, channels): what each slew's and channel's information is multiplied by.
    """
    root = np.sqrt(np.asarray(factors))
    weak = []
    for c, each in enumerate(white):
        shape = -1, *(1 for _ in each.factors.shape[1:])
        weak.append(
            each._replace(factors=on_device(np.asarray(each.factors) * root[:, c].reshape(shape)))
        )
    return tuple(weak)


def log_normalisation(model: Model, white: Whitenings) -> float:
    """Log of what the density of readings is multiplied by, beside the exponential of squares.

    Returns: up to a constant that all noises of the same readings share.
    """
    return sum(float(logs.sum()) for logs in log_norms(model, white))


def log_norms(model: Model, white: Whitenings) -> list[np.ndarray]:
    """The same of each reading (slews, rows), by channel."""
    norms = []
    for channel, each in zip(model.structure.channels, white, strict=True):
        diagonal = channel.diagonal(np.asarray(each.factors))
        logs = np.log(np.where(diagonal > 0.0, diagonal, 1.0)).sum(-1)
        norms.append(logs if each.memory is None else logs + np.log(each.memory.scale).sum(-1))
    return norms


def n_data(model: Model, white: Whitenings) -> np.ndarray:
    """How many numbers were measured.

    Returns (slews, channels).
    """
    pairs = zip(model.structure.channels, white, strict=True)
    return np.stack(
        [np.count_nonzero(c.diagonal(np.asarray(w.factors)), axis=(1, 2)) for c, w in pairs], 1
    )
