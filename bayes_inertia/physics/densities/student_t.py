"""Student-t noise: outliers of every size cost the fit little.

With nu degrees of freedom rho(y) = (nu + 1)/2 log(1 + y^2/nu) + const; its slope is w y with the
weight w = (nu + 1)/(nu + y^2) (Lange, Little and Taylor 1989). Under the model w y^2/(nu + 1)
follows Beta(1/2, nu/2): the weighted squares have mean 1 and variance 2 nu/(nu + 3).
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.special import gammaln
from scipy import stats

from bayes_inertia.physics.densities.density import Density, Shape


class StudentT(Density):
    """Student's t distribution of unit scale.

    Examples
    --------
    >>> StudentT().slope(jnp.array([0.0, 2.0]), 4.0).round(12).tolist()
    [0.0, 1.25]
    """

    name = "student_t"
    title = "Student-t"
    # Below 1 there is no mean, and no outlier would tell anything any more. Sampled: 95 % from 1.3
    # to 29.
    shape = Shape("degrees", "degrees of freedom", least=1.0, median=6.0, spread=0.8)

    def loss(self, y: Any, shape: Any) -> Array:
        """rho(y) with its constant, zero where nu is large."""
        gap = gammaln(0.5 * shape) - gammaln(0.5 * (shape + 1.0)) + 0.5 * jnp.log(0.5 * shape)
        return 0.5 * (shape + 1.0) * jnp.log1p(jnp.square(y) / shape) + gap

    def draw(self, rng: np.random.Generator, shape: Any, size: tuple[int, ...]) -> np.ndarray:
        """Of each entry's own degrees of freedom."""
        return rng.standard_t(np.broadcast_to(shape, size))

    def upper_tail(self, y: np.ndarray, shape: float) -> np.ndarray:
        """Of the t distribution."""
        return stats.t.sf(y, shape)
