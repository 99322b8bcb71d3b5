"""Gaussian noise: the trivial case, which every formula of the fit reduces to."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy import special

from bayes_inertia.physics.densities.density import Density


class Gaussian(Density):
    """The normal distribution.

    Examples
    --------
    >>> Gaussian().normal_scores(np.array([-3.0]), 0.0).tolist()
    [-3.0]
    """

    name = "gaussian"
    title = "Gaussian"
    heavy = False

    def loss(self, y: Any, shape: Any) -> Array:
        """Half the square."""
        return 0.5 * jnp.square(y)

    def draw(self, rng: np.random.Generator, shape: Any, size: tuple[int, ...]) -> np.ndarray:
        """Standard normal."""
        return rng.standard_normal(size)

    def upper_tail(self, y: np.ndarray, shape: float) -> np.ndarray:
        """Of the normal distribution."""
        return special.ndtr(-y)

    def normal_scores(self, y: np.ndarray, shape: float) -> np.ndarray:
        """The numbers themselves."""
        return np.asarray(y)
