"""Student-t noise: its log density, what each reading counts, and how its residuals are judged.

With y a residual over its scale and nu degrees of freedom, minus the log density is
rho(y) = (nu + 1)/2 log(1 + y^2/nu) + const, its slope psi = w y with the weight
w = (nu + 1)/(nu + y^2), its curvature (nu + 1)(nu - y^2)/(nu + y^2)^2 (Lange, Little and Taylor
1989, J. Am. Stat. Assoc. 84, 881). Under the model w y^2/(nu + 1) follows Beta(1/2, nu/2): the
weighted squares w y^2 have mean 1 and variance 2 nu/(nu + 3), where those of Gaussian noise have
1 and 2. All formulas go over into the Gaussian ones where nu is large.
"""

from __future__ import annotations

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

    Parameters
    ----------
    y : array
        Residuals over their scale.
    degrees : float
        Of freedom.

    Returns
    -------
    Tail
        Of arrays shaped like `y`.

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
    """Minus the log density of a channel's numbers, with derivatives.

    Parameters
    ----------
    heavy : bool
        Student-t, or Gaussian.
    y : array
        Residuals over their scale.
    degrees : float
        Of freedom.

    Returns
    -------
    Tail
    """
    return heavy_tail(y, degrees) if heavy else Tail(0.5 * y**2, y, jnp.ones_like(y))


def log_norm(degrees: float | Array) -> Array:
    """Constant of minus the log density, less the Gaussian's log(2 pi)/2.

    Parameters
    ----------
    degrees : float
        Of freedom.

    Returns
    -------
    () array

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

    Parameters
    ----------
    degrees : float
        Of freedom.

    Returns
    -------
    (2, 2) array
        Positive definite.

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

    Parameters
    ----------
    degrees : float
        Of freedom, finite.

    Returns
    -------
    float

    Examples
    --------
    >>> location_information(4.0) == 5.0 / 7.0
    True
    """
    return (degrees + 1.0) / (degrees + 3.0)


def squares_per_parameter(degrees: float) -> float:
    """By how much each fitted parameter lowers the sum of weighted squares: (nu + 2)/(nu + 5).

    To first order in parameters over numbers; 1 for a Gaussian.

    Parameters
    ----------
    degrees : float
        Of freedom.

    Returns
    -------
    float

    Examples
    --------
    >>> round(squares_per_parameter(1e9), 6)
    1.0
    """
    return (degrees + 2.0) / (degrees + 5.0) if np.isfinite(degrees) else 1.0


def squares_worth(degrees: float) -> float:
    """The chi^2 degrees of freedom that one weighted square is worth: (nu + 3)/nu.

    2 mean^2/variance; 1 for a Gaussian. Weighted squares scatter less, since they are bounded.

    Parameters
    ----------
    degrees : float
        Of freedom.

    Returns
    -------
    float

    Examples
    --------
    >>> squares_worth(4.0)
    1.75
    """
    return (degrees + 3.0) / degrees if np.isfinite(degrees) else 1.0


def normal_scores(y: np.ndarray, degrees: float) -> np.ndarray:
    """Student-t numbers as the standard normal numbers of the same probability.

    Parameters
    ----------
    y : array
        Numbers over their scale; NaN stays NaN.
    degrees : float
        Of freedom.

    Returns
    -------
    array
        Shaped like `y`.

    Examples
    --------
    >>> normal_scores(np.array([-3.0, 0.0, 30.0]), 4.0).round(2).tolist()
    [-2.05, 0.0, 4.48]
    """
    if not np.isfinite(degrees):
        return np.asarray(y)
    # By the upper tail, in which nothing is lost to rounding.
    return np.sign(y) * stats.norm.isf(stats.t.sf(np.abs(y), degrees))
