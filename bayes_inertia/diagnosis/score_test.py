"""Fingerprints of candidate effects: what each would do to the residuals, beyond all that is fitted already.

The sensitivities of every candidate's parameters at their null are projected off the fitted
parameters and nuisances. With u the projected gradient and S the projected normal matrix, both in
units of the candidates' prior sd, u^T S^-1 u is the score statistic (Rao 1948): chi^2 with its rank as
degrees of freedom if the effect is absent. Directions in which a prior-sized effect would move the
residuals by less than one sigma in all are not counted: this campaign cannot see them.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy import stats

from bayes_inertia.diagnosis.evidence import log_bayes_factor_of
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.maths.linear_algebra import VISIBLE, canonical_correlation
from bayes_inertia.maths.values import array_dataclass


@array_dataclass
class Imprint:
    """A candidate that is not linear in its parameters: the best of its kind, given by what it gains and by columns near it.

    Attributes
    ----------
    columns : (slews, numbers, k) changes of the residuals, all channels one after the other, by small changes of its parameters.
    score : chi^2 that it gains, with `dof` degrees of freedom if the effect is absent, but for being the best of `trials`.
    log_bayes_factor : log evidence for it against nothing, to first order.
    """

    name: str
    columns: np.ndarray
    score: float
    dof: int
    trials: int
    log_bayes_factor: float


@array_dataclass
class Fingerprints:
    """Projected sensitivities of all candidates, in units of prior sd.

    Attributes
    ----------
    names : of the candidates. groups : indices of each candidate's columns.
    one_sided : whether a candidate is one parameter that cannot be negative.
    gradient : (c,) u. matrix : (c, c) S.
    imprints : candidates that are not linear in their parameters, by name; they were scored already.
    """

    names: tuple[str, ...]
    groups: tuple[np.ndarray, ...]
    one_sided: tuple[bool, ...]
    gradient: np.ndarray
    matrix: np.ndarray
    imprints: dict[str, Imprint]

    def visible(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Signal powers (r,) and directions (n, r) of candidate k that this campaign can see."""
        index = self.groups[k]
        powers, directions = np.linalg.eigh(self.matrix[np.ix_(index, index)])
        keep = powers > VISIBLE
        return powers[keep], directions[:, keep]

    def dof(self, k: int) -> int:
        """Degrees of freedom of candidate k's score."""
        imprint = self.imprints.get(self.names[k])
        return len(self.visible(k)[0]) if imprint is None else imprint.dof

    def score(self, k: int, gradient: np.ndarray | None = None) -> np.ndarray:
        """Score statistic of candidate k, for the data or (if it is linear) for other gradients (..., c)."""
        if self.names[k] in self.imprints:
            return np.asarray(self.imprints[self.names[k]].score)
        gradient = self.gradient if gradient is None else gradient
        powers, directions = self.visible(k)
        along = gradient[..., self.groups[k]] @ directions
        if self.one_sided[k]:
            along = np.maximum(along * np.sign(directions.sum(0)), 0.0)
        return np.sum(along**2 / powers, axis=-1)

    def p_value(self, k: int, score: np.ndarray) -> np.ndarray:
        """Probability of at least this score if the effect is absent: 1 if the campaign cannot see it, halved if it is one-sided,
        Sidak's if it is the best of many."""
        dof = self.dof(k)
        if dof == 0:
            return np.ones_like(score)
        single = np.where(np.asarray(score) > 0, stats.chi2.sf(score, dof), 1.0) * (
            0.5 if self.one_sided[k] else 1.0
        )
        imprint = self.imprints.get(self.names[k])
        return -np.expm1(
            (1 if imprint is None else imprint.trials) * np.log1p(-np.minimum(single, 1.0 - 1e-16))
        )

    def log_bayes_factor(self, k: int) -> float:
        """Log evidence for candidate k against nothing, to first order in its parameters (`evidence`)."""
        if self.names[k] in self.imprints:
            return self.imprints[self.names[k]].log_bayes_factor
        index = self.groups[k]
        powers, directions = np.linalg.eigh(self.matrix[np.ix_(index, index)])
        gradient = self.gradient[index]
        if self.one_sided[k]:
            gradient = np.maximum(gradient, 0.0)
        return log_bayes_factor_of(gradient @ directions, powers)

    def amplitude(self, k: int) -> np.ndarray:
        """Best amplitude of candidate k's parameters, in units of prior sd, to first order."""
        index = self.groups[k]
        block = self.matrix[np.ix_(index, index)]
        return np.linalg.solve(block + np.eye(len(index)), self.gradient[index])

    def canonical_correlation(self, j: int, k: int) -> float:
        """Largest correlation between what candidates j and k can do: 1 means that the data cannot tell them apart."""
        both = np.concatenate([self.groups[j], self.groups[k]])
        return canonical_correlation(self.matrix[np.ix_(both, both)], len(self.groups[j]))

    def threshold(
        self, false_alarms: float, rng: np.random.Generator, draws: int = 20_000
    ) -> float:
        """p-value below which the smallest of all candidates' p-values falls with probability `false_alarms` if none is present.

        By simulation of the joint distribution of all scores, so that correlated candidates do not cost double.
        """
        root = _root(self.matrix)
        gradients = rng.standard_normal((draws, root.shape[1])) @ root.T
        smallest = np.ones(draws)
        for k in range(len(self.names)):
            # The best of many was chosen by these data: what matters of it is that its corrected p-value is uniform.
            p = (
                rng.uniform(size=draws)
                if self.names[k] in self.imprints
                else self.p_value(k, self.score(k, gradients))
            )
            smallest = np.minimum(smallest, p)
        return float(np.quantile(smallest, false_alarms))


def _root(matrix: np.ndarray) -> np.ndarray:
    values, vectors = np.linalg.eigh(matrix)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def unfitted(at: Estimate) -> tuple[str, ...]:
    """Names of the effects of a model that have parameters and were held at their null."""
    parts = {e.name: at.model.space.slice_of(e.name) for e in at.model.effects}
    return tuple(
        name
        for name, part in parts.items()
        if part.stop > part.start and not np.isin(range(part.start, part.stop), at.free).any()
    )


def fingerprints(
    at: Estimate,
    names: tuple[str, ...],
    imprints: tuple[Imprint, ...] = (),
    fit: LinearisedFit | None = None,
) -> Fingerprints:
    """Fingerprints of candidate effects against all that is fitted.

    Parameters
    ----------
    at : an estimate of a model that holds the effects `names` at their null; only others' parameters were free.
    imprints : further candidates, given by their columns. fit : `at.linearised()`, if it is there already.
    """
    fit, space = fit or at.linearised(), at.model.space
    slices = [space.slice_of(name) for name in names]
    parts = [fit.parameters[..., s] * space.sd[s] for s in slices] + [i.columns for i in imprints]
    columns = np.concatenate(parts, -1) if parts else np.zeros((*fit.residual.shape, 0))
    taken = fit.imitated(columns)
    matrix = np.einsum("snj,snk->jk", columns, columns, optimize=True) - taken.T @ taken
    groups = tuple(
        np.arange(a, b) for a, b in pairwise(np.cumsum([0, *(p.shape[-1] for p in parts)]))
    )
    one_sided = [
        s.stop - s.start == 1 and space.lower[s.start] == space.nulls[s.start] for s in slices
    ] + [False] * len(imprints)
    labels = (*names, *(i.name for i in imprints))
    return Fingerprints(
        labels,
        groups,
        tuple(one_sided),
        fit.pull(columns, taken),
        matrix,
        {i.name: i for i in imprints},
    )
