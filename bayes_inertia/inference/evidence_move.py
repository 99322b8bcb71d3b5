"""Proposals where stochastic effects have sizes: sizes by their evidence, the rest given sizes.

To first order the data give J and K a normal distribution for each set of sizes. It is narrow
where sizes are small and wide where they are large, which no single ellipsoid resembles. Sizes
themselves are few: a short ensemble explores their evidence, which costs no simulation.
"""

from __future__ import annotations

import emcee
import jax
import jax.numpy as jnp
import numpy as np
from emcee.moves import MHMove
from scipy import stats

from bayes_inertia.inference.hyperparameters import Evidence, GivenSizes, given_sizes

# The ensemble that explores the evidence.
_WALKERS, _STEPS, _WARM_UP = 64, 60, 20
# Proposals that are evaluated at once.
_BATCH = 24
# Degrees of freedom of the proposals given sizes: tails somewhat heavier than normal.
_DEGREES = 20.0
# Log densities that are kept at most.
_MOST_KNOWN = 20_000


class EvidenceMove(MHMove):
    """Propose every walker anew: sizes by their evidence, then the rest given these sizes.

    An independence sampler (Tierney 1994, section 2.3.3): the density sampled is exact, and nearly
    every proposal is accepted where the data are nearly linear in J and K.

    Parameters
    ----------
    evidence : Evidence
        Around the maximum; all its parameters are free.
    random : numpy.random.RandomState
        Source of the exploration.
    """

    def __init__(self, evidence: Evidence, random: np.random.RandomState):
        self.evidence = evidence
        self.density = _explored(evidence, random)
        # Log densities of late proposals: walkers stand where they were proposed.
        self._known: dict[bytes, float] = {}
        super().__init__(self._propose, ndim=len(evidence.point.theta))

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """Log density of proposals, up to a constant.

        Parameters
        ----------
        x : (n, d) array
            Points.

        Returns
        -------
        (n,) array
        """
        charts = np.array([self.evidence.chart(theta) for theta in x])
        return self._log_density(x, charts, _given(self.evidence, charts))

    def draw(self, random: np.random.RandomState, n: int, *, stretch: float = 1.0) -> np.ndarray:
        """Draw proposals.

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
        return self._drawn(random, n, stretch)[0]

    def _drawn(
        self, random: np.random.RandomState, n: int, stretch: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Proposals and their log densities."""
        charts = self.density.resample(n, seed=random).T
        centre = self.density.dataset.mean(1)
        charts = centre + stretch * (charts - centre)
        given = _given(self.evidence, charts)
        z = random.standard_normal((n, given.mean.shape[1]))
        z = stretch * z * np.sqrt(_DEGREES / random.chisquare(_DEGREES, size=(n, 1)))
        off = np.linalg.solve(np.swapaxes(given.root, 1, 2), z[..., None])[..., 0]
        theta = np.array([self.evidence.theta(chart) for chart in charts])
        frozen = self.evidence.frozen
        theta[:, np.asarray(frozen.free)] = given.mean + off * np.asarray(frozen.scale)
        return theta, self._log_density(theta, charts, given)

    def _log_density(self, x: np.ndarray, charts: np.ndarray, given: GivenSizes) -> np.ndarray:
        """Of the sizes, and of the rest given them."""
        frozen = self.evidence.frozen
        off = (x[:, np.asarray(frozen.free)] - given.mean) / np.asarray(frozen.scale)
        z2 = np.sum(np.einsum("nji,nj->ni", given.root, off) ** 2, 1)
        log_det = np.sum(np.log(np.diagonal(given.root, axis1=1, axis2=2)), 1)
        rest = log_det - 0.5 * (_DEGREES + off.shape[1]) * np.log1p(z2 / _DEGREES)
        sizes = x[:, np.asarray(frozen.learnt)][:, np.asarray(frozen.priors["logarithmic"])]
        return self.density.logpdf(charts.T) - np.sum(np.log(sizes), 1) + rest

    def _propose(
        self, coords: np.ndarray, random: np.random.RandomState
    ) -> tuple[np.ndarray, np.ndarray]:
        """Proposals and the log ratio of their densities, as emcee asks for them."""
        proposed, density = self._drawn(random, len(coords), 1.0)
        keys = [theta.tobytes() for theta in coords]
        new = [k for k, key in enumerate(keys) if key not in self._known]
        before = np.array([self._known.get(key, np.nan) for key in keys])
        if new:
            before[new] = self.log_density(coords[new])
        if len(self._known) > _MOST_KNOWN:
            self._known.clear()
        self._known.update(zip(keys, before.tolist(), strict=True))
        self._known.update(
            (theta.tobytes(), value) for theta, value in zip(proposed, density, strict=True)
        )
        return proposed, before - density


def _given(evidence: Evidence, charts: np.ndarray) -> GivenSizes:
    """The rest given sizes, as numpy, in batches of one shape."""
    n = len(charts)
    padded = np.concatenate([charts, np.repeat(charts[-1:], -n % _BATCH, axis=0)])
    structure, frozen = evidence.model.structure, evidence.frozen
    parts = [
        given_sizes(structure, frozen, jnp.asarray(padded[i : i + _BATCH]))
        for i in range(0, len(padded), _BATCH)
    ]
    whole = jax.tree.map(lambda *values: np.concatenate(values)[:n], *parts)
    return GivenSizes(*whole)


def _explored(evidence: Evidence, random: np.random.RandomState) -> stats.gaussian_kde:
    """The distribution of sizes by their evidence, smoothed."""
    begin = evidence.chart(evidence.point.theta)
    walkers = max(_WALKERS, 2 * len(begin))
    starts = begin + 0.3 * random.standard_normal((walkers, len(begin)))
    sampler = emcee.EnsembleSampler(
        walkers,
        len(begin),
        lambda charts: _given(evidence, charts).log_evidence,
        vectorize=True,
        moves=[(emcee.moves.DEMove(), 0.8), (emcee.moves.DESnookerMove(), 0.2)],
    )
    sampler.random_state = random.get_state()
    sampler.run_mcmc(starts, _STEPS)
    random.set_state(sampler.random_state)
    return stats.gaussian_kde(sampler.get_chain(discard=_WARM_UP, thin=2, flat=True).T)
