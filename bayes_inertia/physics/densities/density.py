"""The contract of a density: how the noise of one number is distributed over its scale.

A density states minus its log and how to draw from it. Slopes, curvatures and what a fit needs of
their means follow from that by calculus (Lange, Little and Taylor 1989, J. Am. Stat. Assoc. 84,
881). Gaussian noise is the trivial case: slope y, curvature 1.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy import stats


class Shape(NamedTuple):
    """The number beside the scale that a family has.

    Parameters
    ----------
    name, title : str
        In parameter names and in words.
    least : float
        The smallest that is allowed.
    median, spread : float
        Of its log-normal prior where it is sampled: median, sd of the logarithm.
    """

    name: str
    title: str
    least: float
    median: float
    spread: float


class Moments(NamedTuple):
    """Means over the density that a fit and its tests need; the Gaussian's stand behind.

    Parameters
    ----------
    information : (2, 2) array
        Fisher information of one number on (log scale, shape); 2 and 0.
    location : () array
        Fisher information on its mean; 1.
    per_parameter : () array
        By how much each fitted parameter lowers the sum of y psi(y); 1.
    worth : () array
        chi^2 degrees of freedom that one y psi(y) is worth, 2 mean^2/variance; 1.
    """

    information: Array
    location: Array
    per_parameter: Array
    worth: Array


@dataclass(frozen=True)
class Density(ABC):
    """A family of symmetric densities of y, a residual over its scale; methods are elementwise."""

    name: ClassVar[str]
    title: ClassVar[str]
    shape: ClassVar[Shape | None] = None
    # Its tails are heavy: outliers are part of it, and none is left out. All but the Gaussian.
    heavy: ClassVar[bool] = True

    @abstractmethod
    def loss(self, y: Any, shape: Any) -> Array:
        """Minus the log density, less log(2 pi)/2, in jax.numpy."""

    @abstractmethod
    def draw(self, rng: np.random.Generator, shape: Any, size: tuple[int, ...]) -> np.ndarray:
        """Random numbers."""

    @abstractmethod
    def upper_tail(self, y: np.ndarray, shape: float) -> np.ndarray:
        """Probability of more than y >= 0."""

    def normal_scores(self, y: np.ndarray, shape: float) -> np.ndarray:
        """The standard normal numbers of the same probability."""
        # By the upper tail, in which nothing is lost to rounding.
        return np.sign(y) * stats.norm.isf(self.upper_tail(np.abs(y), shape))

    def slope(self, y: Array, shape: Any) -> Array:
        """psi(y), the derivative of the loss."""
        return jax.jvp(lambda x: self.loss(x, shape), (y,), (jnp.ones_like(y),))[1]

    def curvature(self, y: Array, shape: Any) -> Array:
        """psi'(y)."""
        return jax.jvp(lambda x: self.slope(x, shape), (y,), (jnp.ones_like(y),))[1]

    def towards_shape(self, y: Array, shape: Any) -> Array:
        """Derivative of the loss by the shape."""
        return jax.jvp(lambda nu: self.loss(y, nu), (jnp.asarray(shape),), (jnp.ones(()),))[1]

    @partial(jax.jit, static_argnums=0)
    def moments(self, shape: Any) -> Moments:
        """Means over the density, by the double exponential rule: exact for tails of any power."""
        inner = 0.5 * np.pi * np.sinh(np.linspace(-4.0, 4.0, 401))
        y = jnp.asarray(np.sinh(inner))
        stretch = np.cosh(inner) * np.sqrt(inner**2 + (0.5 * np.pi) ** 2)
        weight = jnp.exp(-self.loss(y, shape)) * stretch
        weight = weight / weight.sum()
        slope = self.slope(y, shape)
        squares = y * slope
        towards = self.towards_shape(y, shape) if self.shape else jnp.zeros_like(y)
        scores = jnp.stack([1.0 - squares, towards])
        location = weight @ slope**2
        # The mean of the second derivative of y psi is that of psi times its first.
        bend = weight @ (slope * (slope + y * self.curvature(y, shape)))
        information = jnp.einsum("n,in,jn->ij", weight, scores, scores)
        return Moments(information, location, 0.5 * bend / location, 2.0 / information[0, 0])
