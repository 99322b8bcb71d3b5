"""The throws' linear model: what effects explain, and what they predict of throws held out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.inference.objective import prior_rows

MAX_EFFECTS = 3
MIN_GAIN = 3.0  # in log density, for another effect


@dataclass(frozen=True)
class Term:
    """One effect as columns (throws, numbers, k) in units of prior sd.

    Shared by all throws, or different in each.
    """

    effect: str
    shared: bool
    columns: np.ndarray

    @property
    def label(self) -> str:
        """How the table calls it."""
        return f"{self.effect}, {'shared' if self.shared else 'each throw'}"


@dataclass(frozen=True)
class LinearThrows:
    """The base fit's linear model by throw.

    Residuals, columns of what is shared and of each throw's own unknowns, where those stand, and
    the prior of what all throws share.
    """

    residual: np.ndarray
    shared: np.ndarray
    local: np.ndarray
    local_at: np.ndarray
    precision: np.ndarray
    pull: np.ndarray

    @classmethod
    def of(cls, estimate: Estimate, fit: LinearisedFit) -> LinearThrows:
        """From an estimate and its linearised fit; columns: of "measured minus predicted"."""
        slope, distance = (
            rows[estimate.free] for rows in prior_rows(estimate.model, estimate.theta)
        )
        precision = np.concatenate([slope**2, np.ones(fit.n_shared - len(estimate.free))])
        pull = np.concatenate([slope * distance, estimate.point.bias])
        return cls(
            fit.residual,
            fit.shared,
            fit.local,
            estimate.point.local,
            precision,
            pull,
        )

    def misfit(self, terms: tuple[Term, ...]) -> float:
        """Squared residuals of all throws at the best amplitudes.

        Priors hold the amplitudes, but are not counted.
        """
        posterior = [self._messages(s, terms) for s in range(len(self.residual))]
        mean = -linalg.solve(
            sum(A for A, *_ in posterior) + np.diag(self._precision(terms)),
            sum(g for _, g, *_ in posterior) + self._pull(terms),
        )
        return float(
            sum(np.sum(self._residual_at(s, terms, mean) ** 2) for s in range(len(self.residual)))
        )

    def predictive(self, terms: tuple[Term, ...]) -> np.ndarray:
        """Log density (throws,) of each throw given the others.

        Up to a constant that all sets of terms share.
        """
        posterior = [self._messages(s, terms) for s in range(len(self.residual))]
        prior, pull = np.diag(self._precision(terms)), self._pull(terms)
        densities = []
        for s, (A, g, value, logdet) in enumerate(posterior):
            others = sum(p[0] for k, p in enumerate(posterior) if k != s) + prior
            toward = sum(p[1] for k, p in enumerate(posterior) if k != s) + pull
            mean = -linalg.solve(others, toward, assume_a="pos")
            # The throw's quadratic at the predicted mean, its uncertainty integrated out.
            slope = g + A @ mean
            height = value + g @ mean + 0.5 * mean @ A @ mean
            both = A + others
            densities.append(
                -height
                + 0.5 * slope @ linalg.solve(both, slope, assume_a="pos")
                - 0.5 * (np.linalg.slogdet(both)[1] - np.linalg.slogdet(others)[1])
                - logdet
            )
        return np.array(densities)

    def _precision(self, terms) -> np.ndarray:
        return np.concatenate(
            [self.precision, *(np.ones(t.columns.shape[-1]) for t in terms if t.shared)]
        )

    def _pull(self, terms) -> np.ndarray:
        return np.concatenate(
            [self.pull, *(np.zeros(t.columns.shape[-1]) for t in terms if t.shared)]
        )

    def _columns(self, s: int, terms) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Columns of throw s that are shared, those of its own unknowns, and where those stand."""
        shared = np.concatenate([self.shared[s], *(t.columns[s] for t in terms if t.shared)], -1)
        local = np.concatenate([self.local[s], *(t.columns[s] for t in terms if not t.shared)], -1)
        local_at = np.concatenate(
            [self.local_at[s], *(np.zeros(t.columns.shape[-1]) for t in terms if not t.shared)]
        )
        return shared, local, local_at

    def _messages(self, s: int, terms) -> tuple[np.ndarray, np.ndarray, float, float]:
        """What throw s says of everything shared, its own unknowns integrated out.

        Quadratic, slope, value and log determinant.
        """
        shared, local, local_at = self._columns(s, terms)
        r = self.residual[s]
        stiffness = local.T @ local + np.eye(local.shape[-1])
        factor = linalg.cho_factor(stiffness)
        across, gradient = local.T @ shared, local.T @ r + local_at
        A = shared.T @ shared - across.T @ linalg.cho_solve(factor, across)
        g = shared.T @ r - across.T @ linalg.cho_solve(factor, gradient)
        value = 0.5 * (r @ r + local_at @ local_at - gradient @ linalg.cho_solve(factor, gradient))
        return A, g, float(value), float(np.log(np.diag(factor[0])).sum())

    def _residual_at(self, s: int, terms, mean: np.ndarray) -> np.ndarray:
        """Residuals of throw s at the shared `mean` and the best of its own unknowns."""
        shared, local, local_at = self._columns(s, terms)
        r = self.residual[s] + shared @ mean
        return r - local @ linalg.solve(
            local.T @ local + np.eye(local.shape[-1]), local.T @ r + local_at, assume_a="pos"
        )


def search(linear: LinearThrows, terms: list[Term]) -> list[dict]:
    """Forward selection by what the throws held out say."""
    chosen: tuple[Term, ...] = ()
    density, plain_misfit, steps = linear.predictive(()), linear.misfit(()), []
    while len(chosen) < MAX_EFFECTS:
        trials = [t for t in terms if t.effect not in {c.effect for c in chosen}]
        densities = [linear.predictive((*chosen, t)) for t in trials]
        best = int(np.argmax([d.sum() for d in densities]))
        if densities[best].sum() < density.sum() + MIN_GAIN:
            break
        chosen, gain = (*chosen, trials[best]), densities[best] - density
        density = densities[best]
        steps.append(
            {
                "added": trials[best].label,
                "effect": trials[best].effect,
                "shared": trials[best].shared,
                "gain": float(gain.sum()),
                "throws_better": int((gain > 0).sum()),
                "explained": 1.0 - linear.misfit(chosen) / plain_misfit,
            }
        )
    return steps


def scores(linear: LinearThrows, terms: list[Term]) -> list[dict]:
    """Every candidate alone, best predictive gain first."""
    misfit, density = linear.misfit(()), linear.predictive(())
    rows = []
    for term in terms:
        gain = linear.predictive((term,)) - density
        rows.append(
            {
                "effect": term.effect,
                "shared": term.shared,
                "explained": 1.0 - linear.misfit((term,)) / misfit,
                "gain": float(gain.sum()),
                "throws_better": int((gain > 0).sum()),
            }
        )
    return sorted(rows, key=lambda row: -row["gain"])
