"""What each slew tells of the unknowns that all slews share, and how far slews disagree about it.

The nuisances of one slew meet those of another only through what is shared. The normal matrix of
the shared unknowns is therefore a sum over slews (Schur complement, block by block), and leaving
slews out costs a small matrix, however many nuisances there are.

At the optimum each slew pulls: its gradient g_s of the shared unknowns, its own nuisances
eliminated, would vanish if it agreed with all others. Under the model g_s has the covariance
M_s - M_s C M_s, with M_s the slew's normal matrix and C the covariance of the fit. All that is
known of disagreement stands in these pulls. It can be read for each parameter alone (sandwich
estimators clustered by slew) or pooled into one dispersion, the Birge ratio of metrology.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import stats

from bayes_inertia.inference.likelihood import Information
from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.maths.linear_algebra import inverse, inverse_root, solve
from bayes_inertia.maths.values import array_dataclass


@array_dataclass
class SlewShares:
    """Normal equations of the shared unknowns, by slew.

    Parameters
    ----------
    matrix : (slews, n_shared, n_shared) array
        Of each slew's data.
    gradient : (slews, n_shared) array
        Of half its squares.
    prior_matrix : (n_shared, n_shared) array
        Of the priors of what is shared.
    prior_gradient : (n_shared,) array
    """

    matrix: np.ndarray
    gradient: np.ndarray
    prior_matrix: np.ndarray
    prior_gradient: np.ndarray

    def without(self, slew: int) -> tuple[np.ndarray, np.ndarray]:
        """The fit without one slew.

        Returns `step` (n_shared,): to the optimum of the other slews; `matrix` (n_shared,
        n_shared): their normal matrix, priors included.
        """
        kept = np.arange(len(self.matrix)) != slew
        matrix = self.prior_matrix + self.matrix[kept].sum(0)
        gradient = self.prior_gradient + self.gradient[kept].sum(0)
        return -solve(matrix, gradient), matrix


def slew_shares(
    information: Information,
    local: np.ndarray,
    prior_precision: np.ndarray,
    prior_gradient: np.ndarray,
) -> SlewShares:
    """Eliminate the nuisances of every slew.

    `local` (slews, n_local) [prior sd]; `prior_precision` (n_shared, n_shared); `prior_gradient`
    (n_shared,).
    """
    shared, parts = len(prior_precision), []
    for block, slope, nuisances in zip(
        information.matrix, information.gradient, local, strict=True
    ):
        matrix, gradient = block.sum(0), slope.sum(0)
        root = inverse_root(matrix[shared:, shared:] + np.eye(len(nuisances)))
        across = root @ matrix[shared:, :shared]
        pull = root @ (gradient[shared:] + nuisances)
        parts.append(
            (
                matrix[:shared, :shared] - across.T @ across,
                gradient[:shared] - across.T @ pull,
            )
        )
    return SlewShares(
        np.array([matrix for matrix, _ in parts]),
        np.array([gradient for _, gradient in parts]),
        prior_precision,
        prior_gradient,
    )


class Dispersion(NamedTuple):
    """Disagreement of the slews, pooled over slews and parameters: the Birge ratio.

    Parameters
    ----------
    ratio : float
        Sum of the slews' squared pulls over what the model predicts; 1 where slews agree.
    dof : float
        Degrees of freedom of the sum.
    p_value : float
        Of slews that disagree so much by chance.
    """

    ratio: float
    dof: float
    p_value: float

    @property
    def factor(self) -> float:
        """Factor on sds; slews that disagree no more than chance allows change none."""
        return float(np.sqrt(self.ratio)) if self.p_value < LIMITS.disagree_below else 1.0

    def json(self) -> dict[str, float]:
        """As it stands in summary.json."""
        return self._asdict() | {"factor": self.factor}


@array_dataclass
class SlewScatter:
    """The pulls of the slews at the optimum.

    Parameters
    ----------
    shares : SlewShares
        Normal equations of the shared unknowns, by slew.
    """

    shares: SlewShares

    @cached_property
    def covariance(self) -> np.ndarray:
        """Of the shared unknowns (n_shared, n_shared)."""
        return inverse(self.shares.prior_matrix + self.shares.matrix.sum(0))

    @cached_property
    def _whitened(self) -> tuple[_Pull, ...]:
        """Pulls of the slews, whitened."""
        scale = np.sqrt(np.diag(self.covariance))
        covariance = self.covariance / np.outer(scale, scale)
        return tuple(
            _pull(matrix * np.outer(scale, scale), gradient * scale, covariance, scale)
            for matrix, gradient in zip(self.shares.matrix, self.shares.gradient, strict=True)
        )

    @cached_property
    def dispersion(self) -> Dispersion:
        """The Birge ratio: see Birge, Phys. Rev. 40 (1932) 207."""
        squares = sum(float(pull.pull @ pull.pull) for pull in self._whitened)
        dof = sum(float(np.sum(pull.tested)) for pull in self._whitened)
        return Dispersion(squares / dof, dof, float(stats.chi2.sf(squares, dof)))

    @property
    def cr2_sd(self) -> np.ndarray:
        """Bias-reduced sds (n_shared,), clustered by slew (Bell and McCaffrey 2002)."""
        steps = np.array([pull.weights @ pull.pull for pull in self._whitened])
        return np.sqrt(np.sum(steps**2, 0) + self._of_prior)

    @property
    def cr2_dof(self) -> np.ndarray:
        """Satterthwaite's degrees of freedom (n_shared,) of the bias-reduced variances."""
        rows = [pull.weights for pull in self._whitened]
        roots = [pull.root for pull in self._whitened]
        scale = np.sqrt(np.diag(self.covariance))
        covariance = self.covariance / np.outer(scale, scale)
        scattered = np.array(
            [
                [_covariance(rows, roots, covariance, s, t) for t in range(len(rows))]
                for s in range(len(rows))
            ]
        )
        return np.einsum("ssj->j", scattered) ** 2 / np.einsum("stj,tsj->j", scattered, scattered)

    @property
    def _of_prior(self) -> np.ndarray:
        """What the priors scatter, (n_shared,) variances."""
        return np.diag(self.covariance @ self.shares.prior_matrix @ self.covariance)


class _Pull(NamedTuple):
    """One slew: the root R of its information, its pull R^-1 g, the share of each direction that
    the others test, and the weights (n_shared, k) with which the pull shifts the estimate.
    """

    root: np.ndarray
    pull: np.ndarray
    tested: np.ndarray
    weights: np.ndarray


def _pull(
    matrix: np.ndarray, gradient: np.ndarray, covariance: np.ndarray, scale: np.ndarray
) -> _Pull:
    """Whiten the pull of one slew; all scaled to unit sds, `scale` (n_shared,)."""
    values, vectors = np.linalg.eigh(matrix)
    seen = values > LIMITS.untested * values.max()
    root = vectors[:, seen] * np.sqrt(values[seen])
    pull = (vectors[:, seen] / np.sqrt(values[seen])).T @ gradient
    tested, directions = np.linalg.eigh(np.eye(len(pull)) - root.T @ covariance @ root)
    tested, kept = np.maximum(tested, 0.0), tested > LIMITS.untested
    # The pull of a slew is smaller than its error: it drew the fit towards itself.
    corrected = (directions[:, kept] / np.sqrt(tested[kept])) @ directions[:, kept].T
    weights = scale[:, None] * (covariance @ root) @ corrected
    return _Pull(root, pull, tested, weights)


def _covariance(
    rows: list[np.ndarray], roots: list[np.ndarray], covariance: np.ndarray, s: int, t: int
) -> np.ndarray:
    """Covariance under the model of what slews s and t shift, (n_shared,)."""
    together = -np.einsum("jk,kl,jl->j", rows[s], roots[s].T @ covariance @ roots[t], rows[t])
    return together + (np.sum(rows[s] ** 2, 1) if s == t else 0.0)
