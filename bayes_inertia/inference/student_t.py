"""Student-t noise: its log density, what each reading counts, and how its residuals are judged.

With y a residual over its scale and nu degrees of freedom, minus the log density is
rho(y) = (nu + 1)/2 log(1 + y^2/nu) + const, its slope psi = w y with the weight
w = (nu + 1)/(nu + y^2), its curvature (nu + 1)(nu - y^2)/(nu + y^2)^2 (Lange, Little and Taylor
1989, J. Am. Stat. Assoc. 84, 881). Under the model w y^2/(nu + 1) follows Beta(1/2, nu/2): the
weighted squares w y^2 have mean 1 and variance 2 nu/(nu + 3), where those of Gaussian noise have
1 and 2. All formulas go over into the Gaussian ones where nu is large.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.special import gammaln
from scipy import special, stats


class Tail(NamedTuple):
    """Minus the log density of numbers with its first two derivatives.

    Parameters
    ----------
    loss : array
        rho(y), zero at y = 0.
    slope : array
        psi(y).
    curvature : array
        Derivative of psi; negative beyond the square root of the degrees of freedom.
    """

    loss: Array
    slope: Array
    curvature: Array


def heavy_tail(y: Array, degrees: float | Array) -> Tail:
    """Minus the log density of Student-t numbers, up to its constant, with derivatives.

    Examples
    --------
    >>> tail = heavy_tail(jnp.array([0.0, 2.0]), 4.0)
    >>> tail.slope.tolist(), tail.curvature.tolist()
    ([0.0, 1.25], [1.25, 0.0])
    """
    sum_of = degrees + y**2
    loss = 0.5 * (degrees + 1.0) * jnp.log1p(y**2 / degrees)
    slope = (degrees + 1.0) * y / sum_of
    return Tail(loss, slope, (degrees + 1.0) * (degrees - y**2) / sum_of**2)


def tail_of(heavy: bool, y: Array, degrees: float | Array) -> Tail:
    """Minus the log density of a channel's numbers, with derivatives."""
    return heavy_tail(y, degrees) if heavy else Tail(0.5 * y**2, y, jnp.ones_like(y))


def log_norm(degrees: float | Array) -> Array:
    """Constant of minus the log density, less the Gaussian's log(2 pi)/2.

    Examples
    --------
    >>> abs(float(log_norm(1e7))) < 1e-6
    True
    """
    gap = gammaln(0.5 * degrees) - gammaln(0.5 * (degrees + 1.0))
    return gap + 0.5 * jnp.log(0.5 * degrees)


def scale_information(degrees: float) -> np.ndarray:
    """Fisher information of one number on (log scale, degrees of freedom).

    Lange, Little and Taylor (1989), appendix B.

    Returns (2, 2).

    Examples
    --------
    >>> float(scale_information(1e6)[0, 0].round(3))
    2.0
    """
    nu = degrees
    of_scale = 2.0 * nu / (nu + 3.0)
    across = -2.0 / ((nu + 1.0) * (nu + 3.0))
    trigamma = special.polygamma(1, 0.5 * nu) - special.polygamma(1, 0.5 * (nu + 1.0))
    of_degrees = 0.25 * trigamma - 0.5 * (nu + 5.0) / (nu * (nu + 1.0) * (nu + 3.0))
    return np.array([[of_scale, across], [across, of_degrees]])


def location_information(degrees: float | Array) -> float | Array:
    """Fisher information of one number on its mean: (nu + 1)/(nu + 3), 1 for a Gaussian.

    Examples
    --------
    >>> location_information(4.0) == 5.0 / 7.0
    True
    """
    return (degrees + 1.0) / (degrees + 3.0)


@dataclass(frozen=True)
class WeightedSquares:
    """Squares of residuals, each with the weight (nu + 1)/(nu + y^2), and how their sum scatters.

    Parameters
    ----------
    degrees : float
        Of freedom; infinite for Gaussian noise, where all weights are 1.

    Examples
    --------
    >>> WeightedSquares(4.0).sum(np.array([2.0, np.nan])), WeightedSquares(4.0).worth
    (2.5, 1.75)
    """

    degrees: float

    @property
    def per_parameter(self) -> float:
        """By how much each fitted parameter lowers the sum: (nu + 2)/(nu + 5).

        To first order in parameters over numbers; 1 for a Gaussian.
        """
        nu = self.degrees
        return (nu + 2.0) / (nu + 5.0) if np.isfinite(nu) else 1.0

    @property
    def worth(self) -> float:
        """The chi^2 degrees of freedom that one square is worth: (nu + 3)/nu.

        2 mean^2/variance; 1 for a Gaussian. Weighted squares scatter less, since they are bounded.
        """
        nu = self.degrees
        return (nu + 3.0) / nu if np.isfinite(nu) else 1.0

    def sum(self, y: np.ndarray) -> float:
        """The sum over residuals.

        `y`: residuals over their scale, NaN where nothing was measured.
        """
        squares, nu = np.square(y[np.isfinite(y)]), self.degrees
        if not np.isfinite(nu):
            return float(squares.sum())
        return float(np.sum((nu + 1.0) * squares / (nu + squares)))


def normal_scores(y: np.ndarray, degrees: float) -> np.ndarray:
    """Student-t numbers as the standard normal numbers of the same probability.

    Examples
    --------
    >>> normal_scores(np.array([-3.0, 0.0, 30.0]), 4.0).round(2).tolist()
    [-2.05, 0.0, 4.48]
    """
    if not np.isfinite(degrees):
        return np.asarray(y)
    # By the upper tail, in which nothing is lost to rounding.
    return np.sign(y) * stats.norm.isf(stats.t.sf(np.abs(y), degrees))
