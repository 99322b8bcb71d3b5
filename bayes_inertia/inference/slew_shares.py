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

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import stats

from bayes_inertia.inference.likelihood import Information
from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.maths.linear_algebra import inverse, inverse_root, solve
from bayes_inertia.maths.values import array_dataclass


class Eliminated(NamedTuple):
    """Normal equations of what slews share, by slew, with their own nuisances eliminated."""

    matrix: np.ndarray  # (slews, n_shared, n_shared)
    gradient: np.ndarray  # (slews, n_shared)
    root: np.ndarray  # (slews, n_local, n_local), of the inverse of the nuisances' matrix
    pull: np.ndarray  # (slews, n_local), slope of the nuisances, whitened


def eliminated(information: Information, local: np.ndarray, shared: int) -> Eliminated:
    """Each slew's equations of the first `shared` unknowns; `local` (slews, n_local)."""
    parts = []
    for block, slope, nuisances in zip(
        information.matrix, information.gradient, local, strict=True
    ):
        matrix, gradient = block.sum(0), slope.sum(0)
        root = inverse_root(matrix[shared:, shared:] + np.eye(len(nuisances)))
        across, pull = root @ matrix[shared:, :shared], root @ (gradient[shared:] + nuisances)
        left = matrix[:shared, :shared] - across.T @ across
        parts.append((left, gradient[:shared] - across.T @ pull, root, pull))
    return Eliminated(*map(np.array, zip(*parts, strict=True)))


class SlewGroups(NamedTuple):
    """Two groups of slews that agree among themselves and not with each other.

    Parameters
    ----------
    slews : two tuples of int
        Numbers of the slews of each group, from 0; the first holds slew 0.
    p_value : float
        Of groups so far apart by chance, for all divisions of the slews that were possible.
    difference : (n_shared,) array
        What the second group tells of the shared unknowns minus what the first does.
    sd : (n_shared,) array
        Of the difference.
    """

    slews: tuple[tuple[int, ...], tuple[int, ...]]
    p_value: float
    difference: np.ndarray
    sd: np.ndarray


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
class SlewShares:
    """Normal equations of the shared unknowns at the optimum, by slew, and how far slews disagree.

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

    @cached_property
    def covariance(self) -> np.ndarray:
        """Of the shared unknowns (n_shared, n_shared)."""
        return inverse(self.prior_matrix + self.matrix.sum(0))

    @cached_property
    def _whitened(self) -> tuple[_Pull, ...]:
        """Pulls of the slews, whitened."""
        return _pulls(self.matrix, self.gradient, self.covariance)

    @cached_property
    def dispersion(self) -> Dispersion:
        """The Birge ratio: see Birge, Phys. Rev. 40 (1932) 207."""
        return _dispersion(self._whitened)

    @cached_property
    def groups(self) -> SlewGroups | None:
        """Two groups that explain why the slews disagree; None where they agree, or it does not.

        The division with the largest gain in chi^2 of two fits over one: the best in order of
        time, and what moving single slews makes better.
        """
        if self.dispersion.p_value >= LIMITS.disagree_below:
            return None
        n = len(self.matrix)
        in_order = [np.arange(n) >= k for k in range(1, n)]
        first_best = max(in_order, key=self._gain)
        best = _improved(first_best, self._gain)
        tries = float(np.log(n - 1)) if best is first_best else (n - 1) * float(np.log(2.0))
        p_value = np.exp(stats.chi2.logsf(self._gain(best), len(self.covariance)) + tries)
        (first, A, _), (second, B, _) = self._fit_of(~best), self._fit_of(best)
        parts = ((~best, first, A), (best, second, B))
        pulls = [pull for part in parts for pull in self._pulls_within(*part)]
        rest = _dispersion(pulls) if pulls else None
        explained = rest is not None and rest.p_value >= LIMITS.disagree_below
        if p_value >= LIMITS.disagree_below or not explained:
            return None
        slews = tuple(tuple(int(s) for s in np.flatnonzero(part)) for part in (~best, best))
        sd = np.sqrt(np.diag(A) + np.diag(B))
        return SlewGroups((slews[0], slews[1]), float(min(p_value, 1.0)), second - first, sd)

    def _fit_of(self, part: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Step (n_shared,) to the optimum of some slews (slews,), its covariance, fall of chi^2.

        They take their share of the prior, so that the parts of a division take it once.
        """
        share = float(np.mean(part))
        covariance = inverse(self.matrix[part].sum(0) + share * self.prior_matrix)
        gradient = self.gradient[part].sum(0) + share * self.prior_gradient
        step = -covariance @ gradient
        return step, covariance, float(-step @ gradient)

    def _gain(self, second: np.ndarray) -> float:
        """By how much chi^2 falls where the slews of a mask (slews,) are fitted by themselves."""
        return sum(self._fit_of(part)[-1] for part in (second, ~second))

    def _pulls_within(
        self, part: np.ndarray, step: np.ndarray, covariance: np.ndarray
    ) -> tuple[_Pull, ...]:
        """Pulls of some slews (slews,) at their own optimum; none of a slew by itself."""
        if part.sum() < 2:
            return ()
        matrix = self.matrix[part]
        return _pulls(matrix, self.gradient[part] + matrix @ step, covariance)

    @property
    def cr2_sd(self) -> np.ndarray:
        """Bias-reduced sds (n_shared,), clustered by slew (Bell and McCaffrey 2002)."""
        steps = np.array([pull.weights @ pull.pull for pull in self._whitened])
        of_prior = np.diag(self.covariance @ self.prior_matrix @ self.covariance)
        return np.sqrt(np.sum(steps**2, 0) + of_prior)

    @property
    def cr2_dof(self) -> np.ndarray:
        """Satterthwaite's degrees of freedom (n_shared,) of the bias-reduced variances."""
        rows = [pull.weights for pull in self._whitened]
        roots = [pull.root for pull in self._whitened]
        scale = np.sqrt(np.diag(self.covariance))
        covariance = self.covariance / np.outer(scale, scale)
        each = range(len(rows))
        pairs = [[_covariance(rows, roots, covariance, s, t) for t in each] for s in each]
        scattered = np.array(pairs)
        return np.einsum("ssj->j", scattered) ** 2 / np.einsum("stj,tsj->j", scattered, scattered)


class _Pull(NamedTuple):
    """One slew: the root R of its information, its pull R^-1 g, the share of each direction that
    the others test, and the weights (n_shared, k) with which the pull shifts the estimate.
    """

    root: np.ndarray
    pull: np.ndarray
    tested: np.ndarray
    weights: np.ndarray


def _pulls(matrix: np.ndarray, gradient: np.ndarray, covariance: np.ndarray) -> tuple[_Pull, ...]:
    """Whitened pulls of slews, at the optimum whose covariance is given."""
    scale = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(scale, scale)
    return tuple(
        _pull(block * np.outer(scale, scale), slope * scale, correlation, scale)
        for block, slope in zip(matrix, gradient, strict=True)
    )


def _dispersion(pulls: Sequence[_Pull]) -> Dispersion:
    """The Birge ratio of pulls."""
    squares = sum(float(pull.pull @ pull.pull) for pull in pulls)
    dof = sum(float(np.sum(pull.tested)) for pull in pulls)
    return Dispersion(squares / dof, dof, float(stats.chi2.sf(squares, dof)))


def _improved(second: np.ndarray, gain: Callable[[np.ndarray], float]) -> np.ndarray:
    """A division of slews, with single slews moved as long as that gains; itself if none does."""
    best, reached = second, gain(second)
    while True:
        moved = [best ^ (np.arange(len(best)) == k) for k in range(1, len(best))]
        moved = [part for part in moved if part.any()]
        gains = [gain(part) for part in moved]
        if not gains or max(gains) <= reached * (1.0 + LIMITS.untested):
            return best
        reached = max(gains)
        best = moved[int(np.argmax(gains))]


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
