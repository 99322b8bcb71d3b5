"""Proposal moves for emcee that know the shape of the posterior."""

from __future__ import annotations

import numpy as np
from emcee.moves import MHMove
from scipy import linalg

from bayes_inertia.maths.linear_algebra import cholesky_factor


class IndependenceMove(MHMove):
    """Propose every walker anew from a multivariate t distribution (an independence sampler).

    Where the t distribution (from the Laplace approximation) resembles the posterior, nearly
    every proposal is an independent draw; where it does not, fewer are accepted, but the density
    sampled is exact. Tierney 1994, section 2.3.3.

    Parameters
    ----------
    mean : (d,) array
        Centre of the t distribution.
    covariance : (d, d) array
        Its scale matrix.
    degrees : float
        Of freedom; fewer have heavier tails.
    logarithmic : (d,) array of bool, optional
        Which parameters are positive and proposed on their logarithm (none by default). The
        covariance is that of the parameters themselves, taken over to first order.

    Examples
    --------
    >>> IndependenceMove(np.zeros(2), np.eye(2), 5.0).log_density(np.zeros((1, 2))).tolist()
    [-0.0]
    """

    def __init__(
        self,
        mean: np.ndarray,
        covariance: np.ndarray,
        degrees: float = 20.0,
        logarithmic: np.ndarray | None = None,
    ):
        mean = np.asarray(mean, float)
        self._shape = (mean, np.asarray(covariance, float))
        self.logarithmic = (
            np.zeros(len(mean), bool) if logarithmic is None else np.asarray(logarithmic, bool)
        )
        self.mean, self.degrees = self._unfolded(mean), float(degrees)
        slope = np.where(self.logarithmic, 1.0 / np.where(self.logarithmic, mean, 1.0), 1.0)
        self.root = cholesky_factor(covariance * np.outer(slope, slope))
        super().__init__(self._propose, ndim=len(self.mean))

    def log_density(self, x: np.ndarray, degrees: float | None = None) -> np.ndarray:
        """Log density of proposals, up to a constant.

        Parameters
        ----------
        x : (n, d) array
            Points.
        degrees : float, optional
            Of freedom; those of this move where none are given.

        Returns
        -------
        (n,) array
        """
        degrees = self.degrees if degrees is None else degrees
        y = self._unfolded(x)
        z = linalg.solve_triangular(self.root, (y - self.mean).T, lower=True)
        of_logarithms = -0.5 * (degrees + len(self.mean)) * np.log1p(np.sum(z**2, axis=0) / degrees)
        return of_logarithms - np.sum(y[:, self.logarithmic], axis=1)

    def with_degrees(self, degrees: float) -> IndependenceMove:
        """The same centre and scale, with lighter or heavier tails.

        Parameters
        ----------
        degrees : float
            Of freedom.

        Returns
        -------
        IndependenceMove
        """
        return IndependenceMove(*self._shape, degrees, self.logarithmic)

    def draw(self, random: np.random.RandomState, n: int, *, stretch: float = 1.0) -> np.ndarray:
        """Draw from the t distribution.

        Parameters
        ----------
        random : numpy.random.RandomState
            Source of the draws.
        n : int
            How many.
        stretch : float
            Multiplies their distance from the mean (for over-dispersed starts).

        Returns
        -------
        (n, d) array
        """
        z = random.standard_normal((n, len(self.mean)))
        radius = np.sqrt(self.degrees / random.chisquare(self.degrees, size=(n, 1)))
        y = self.mean + stretch * (z * radius) @ self.root.T
        y[:, self.logarithmic] = np.exp(y[:, self.logarithmic])
        return y

    def _unfolded(self, x: np.ndarray) -> np.ndarray:
        """Points with positive parameters on their logarithm."""
        y = np.array(x, float)
        y[..., self.logarithmic] = np.log(y[..., self.logarithmic])
        return y

    def _propose(
        self, coords: np.ndarray, random: np.random.RandomState
    ) -> tuple[np.ndarray, np.ndarray]:
        """Proposals and the log ratio of their densities, as emcee asks for them."""
        proposed = self.draw(random, len(coords))
        return proposed, self.log_density(coords) - self.log_density(proposed)
