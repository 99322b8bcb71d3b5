"""What each slew tells of the unknowns that all slews share, its own nuisances eliminated.

The nuisances of one slew meet those of another only through what is shared. The normal matrix of
the shared unknowns is therefore a sum over slews (Schur complement, block by block), and leaving
slews out costs a small matrix, however many nuisances there are.
"""

from __future__ import annotations

import numpy as np

from bayes_inertia.inference.likelihood import Information
from bayes_inertia.maths.linear_algebra import inverse_root, solve
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

    `local` (slews, n_local) [prior sd]; `prior_precision` and `prior_gradient` (n_shared,).
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
        np.diag(prior_precision),
        prior_gradient,
    )
