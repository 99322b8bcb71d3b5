"""Fingerprints of candidate effects: what each would do to the residuals, beyond all that is fitted already.

The sensitivities of every candidate's parameters at their null are projected off the fitted
parameters and nuisances. With u the projected gradient and S the projected normal matrix, both in
units of the candidates' prior sd, u^T S^-1 u is the score statistic (Rao 1948): chi^2 with its rank as
degrees of freedom if the effect is absent. Directions in which a prior-sized effect would move the
residuals by less than one sigma in all are not counted: this campaign cannot see them.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import stats

from bayes_inertia.estimate import N_BIAS, Estimate, block_index, prior_rows
from bayes_inertia.evidence import first_order_log_bayes_factor
from bayes_inertia.levenberg import inverse_root
from bayes_inertia.likelihood import padded_sensitivities
from bayes_inertia.parameters import ParameterSpace

# Signal-to-noise power, for an effect of prior size, below which a direction is invisible.
_VISIBLE = 1.0


@dataclass(frozen=True)
class Fingerprints:
    """Projected sensitivities of all candidates, in units of prior sd.

    Attributes
    ----------
    names : of the candidates. groups : indices of each candidate's columns.
    one_sided : whether a candidate is one parameter that cannot be negative.
    gradient : (c,) u. matrix : (c, c) S.
    """

    names: tuple[str, ...]
    groups: tuple[np.ndarray, ...]
    one_sided: tuple[bool, ...]
    gradient: np.ndarray
    matrix: np.ndarray

    def visible(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Signal powers (r,) and directions (n, r) of candidate k that this campaign can see."""
        index = self.groups[k]
        powers, directions = np.linalg.eigh(self.matrix[np.ix_(index, index)])
        keep = powers > _VISIBLE
        return powers[keep], directions[:, keep]

    def score(self, k: int, gradient: np.ndarray | None = None) -> np.ndarray:
        """Score statistic of candidate k, for the data or for other gradients (..., c)."""
        gradient = self.gradient if gradient is None else gradient
        powers, directions = self.visible(k)
        along = gradient[..., self.groups[k]] @ directions
        if self.one_sided[k]:
            along = np.maximum(along * np.sign(directions.sum(0)), 0.0)
        return np.sum(along**2 / powers, axis=-1)

    def p_value(self, k: int, score: np.ndarray) -> np.ndarray:
        """Probability of at least this score if the effect is absent (1 if the campaign cannot see it)."""
        dof = len(self.visible(k)[0])
        if dof == 0:
            return np.ones_like(score)
        return np.where(score > 0, stats.chi2.sf(score, dof), 1.0) * (0.5 if self.one_sided[k] else 1.0)

    def log_bayes_factor(self, k: int) -> float:
        """Log evidence for candidate k against nothing, to first order in its parameters (`evidence`)."""
        index = self.groups[k]
        powers, directions = np.linalg.eigh(self.matrix[np.ix_(index, index)])
        gradient = self.gradient[index]
        if self.one_sided[k]:
            gradient = np.maximum(gradient, 0.0)
        return first_order_log_bayes_factor(gradient @ directions, powers)

    def amplitude(self, k: int) -> np.ndarray:
        """Best amplitude of candidate k's parameters, in units of prior sd, to first order."""
        index = self.groups[k]
        block = self.matrix[np.ix_(index, index)]
        return np.linalg.solve(block + np.eye(len(index)), self.gradient[index])

    def canonical_correlation(self, j: int, k: int) -> float:
        """Largest correlation between what candidates j and k can do: 1 means that the data cannot tell them apart."""
        (p, a), (q, b) = self.visible(j), self.visible(k)
        if not (len(p) and len(q)):
            return 0.0
        cross = (a / np.sqrt(p)).T @ self.matrix[np.ix_(self.groups[j], self.groups[k])] @ (b / np.sqrt(q))
        return float(min(1.0, np.linalg.svd(cross, compute_uv=False)[0]))

    def mimicry(self, j: int, k: int) -> float:
        """Correlation between the signal that the data ascribe to candidate j and the best imitation of it by candidate k."""
        powers, directions = self.visible(k)
        amplitude = self.amplitude(j)
        own = float(amplitude @ self.matrix[np.ix_(self.groups[j], self.groups[j])] @ amplitude)
        if own <= 0.0 or not len(powers):
            return 0.0
        seen = directions.T @ self.matrix[np.ix_(self.groups[k], self.groups[j])] @ amplitude
        return float(np.sqrt(min(1.0, np.sum(seen**2 / powers) / own)))

    def threshold(self, false_alarms: float, rng: np.random.Generator, draws: int = 20_000) -> float:
        """p-value below which the smallest of all candidates' p-values falls with probability `false_alarms` if none is present.

        By simulation of the joint distribution of all scores, so that correlated candidates do not cost double.
        """
        root = _root(self.matrix)
        gradients = rng.standard_normal((draws, root.shape[1])) @ root.T
        smallest = np.ones(draws)
        for k in range(len(self.names)):
            smallest = np.minimum(smallest, self.p_value(k, self.score(k, gradients)))
        return float(np.quantile(smallest, false_alarms))


def _root(matrix: np.ndarray) -> np.ndarray:
    values, vectors = np.linalg.eigh(matrix)
    return vectors * np.sqrt(np.maximum(values, 0.0))


@dataclass(frozen=True)
class Imprint:
    """Columns that a candidate would add to the residuals, given directly instead of by an effect's parameters.

    `columns` : by slew (numbers, k), all channels one after the other, in units of prior sd.
    """

    name: str
    columns: tuple[np.ndarray, ...]


def fingerprints(at: Estimate, names: tuple[str, ...], imprints: tuple[Imprint, ...] = ()) -> Fingerprints:
    """Fingerprints of candidate effects against all that is fitted.

    Parameters
    ----------
    at : an estimate of a model that holds the effects `names` at their null; only others' parameters were free.
    imprints : further candidates, given by their columns.
    """
    model, point, space = at.model, at.point, at.model.space
    d, m = space.size, point.local.shape[1]
    s = padded_sensitivities(model, point.theta, point.bias, point.local, at.white, np.arange(d))
    jacobian = np.concatenate([np.asarray(j)[..., : d + N_BIAS + m] for j in s.jacobian], 1)
    residual = np.concatenate([np.asarray(r) for r in s.residuals], 1)
    extra = sum(i.columns[0].shape[1] for i in imprints)
    local = d + extra + N_BIAS
    size = local + point.local.size
    hessian, gradient = np.zeros((size, size)), np.zeros(size)
    for k, (J, r) in enumerate(zip(jacobian, residual, strict=True)):
        columns = np.concatenate([J[:, :d], *(i.columns[k] for i in imprints), J[:, d:]], 1)
        index = block_index(local, m, k)
        hessian[np.ix_(index, index)] += columns.T @ columns
        gradient[index] += columns.T @ r
    slope, distance = prior_rows(model, point.theta)
    nuisances = np.arange(d + extra, size)
    hessian[at.free, at.free] += slope[at.free] ** 2
    gradient[at.free] += (slope * distance)[at.free]
    hessian[nuisances, nuisances] += 1.0
    gradient[nuisances] += np.concatenate([point.bias, point.local.ravel()])
    return _projected(space, names, imprints, hessian, gradient, np.concatenate([at.free, nuisances]))


def _projected(space: ParameterSpace, names, imprints, hessian: np.ndarray, gradient: np.ndarray, fitted: np.ndarray) -> Fingerprints:
    slices = [space.slice_of(name) for name in names]
    starts = np.cumsum([space.size, *(i.columns[0].shape[1] for i in imprints)])
    ranges = [np.arange(s.start, s.stop) for s in slices] + [np.arange(a, b) for a, b in pairwise(starts)]
    columns = np.concatenate(ranges) if ranges else np.zeros(0, int)
    root = inverse_root(hessian[np.ix_(fitted, fitted)])
    across = root @ hessian[np.ix_(fitted, columns)]
    matrix = hessian[np.ix_(columns, columns)] - across.T @ across
    pull = -(gradient[columns] - across.T @ (root @ gradient[fitted]))
    scale = np.concatenate([space.sd, np.ones(starts[-1] - space.size)])[columns]
    groups = tuple(np.arange(a, b) for a, b in pairwise(np.cumsum([0, *(len(r) for r in ranges)])))
    one_sided = [s.stop - s.start == 1 and space.lower[s.start] == space.nulls[s.start] for s in slices] + [False] * len(imprints)
    labels = (*names, *(i.name for i in imprints))
    return Fingerprints(labels, groups, tuple(one_sided), pull * scale, matrix * np.outer(scale, scale))
