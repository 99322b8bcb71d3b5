"""The sampler's independence move: from what it proposes, and where ensembles begin.

Where stochastic effects have sizes, these are proposed by their evidence and the rest given sizes.
To first order the data give J and K a normal distribution for each set of sizes. It is narrow
where sizes are small and wide where they are large, which no single ellipsoid resembles. Sizes
themselves are few: a short ensemble explores their evidence, which costs no simulation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import emcee
import jax
import numpy as np
from emcee.moves import MHMove
from scipy import linalg, special, stats

from bayes_inertia.errors import EstimateError
from bayes_inertia.inference.hyperparameters import Evidence, GivenSizes, curvature_of
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.inference.marginal_posterior import LogDensity
from bayes_inertia.maths.linear_algebra import cholesky_factor, inverse


@dataclass(frozen=True, eq=False)
class SizeProposal:
    """Where sizes are proposed: what was explored, smoothed, and a wide distribution around it.

    Parameters
    ----------
    explored : scipy.stats.gaussian_kde
        Of the sizes [prior sd].
    """

    explored: stats.gaussian_kde

    @property
    def centre(self) -> np.ndarray:
        """Mean (h,) of what was explored."""
        return self.explored.dataset @ self.explored.weights

    @cached_property
    def _wide(self) -> stats._multivariate.multivariate_t_frozen:
        covariance = np.cov(self.explored.dataset, aweights=self.explored.weights)
        return stats.multivariate_t(self.centre, np.atleast_2d(covariance), df=LIMITS.wide_degrees)

    def draw(self, random: np.random.RandomState, n: int) -> np.ndarray:
        """Standardised sizes (n, h)."""
        near = self.explored.resample(n, seed=random).T
        far = np.reshape(self._wide.rvs(n, random_state=random), near.shape)
        return np.where(random.random_sample((n, 1)) < LIMITS.wide_share, far, near)

    def log_density(self, standardised: np.ndarray) -> np.ndarray:
        """Log density (n,) of standardised sizes (n, h)."""
        near = self.explored.logpdf(standardised.T) + np.log1p(-LIMITS.wide_share)
        return np.logaddexp(
            near, np.atleast_1d(self._wide.logpdf(standardised)) + np.log(LIMITS.wide_share)
        )


@dataclass(eq=False, repr=False)
class EvidenceMove(MHMove):
    """Propose every walker anew: sizes by their evidence, then the rest given these sizes.

    The sizes take a few Metropolis steps that keep the distribution of the linearised model; what
    is accepted or not in the end is only what that model leaves out, so that the density sampled
    is exact (Tierney 1994, section 2.3.3; Liu 2001, section 5.4).

    Parameters
    ----------
    evidence : Evidence
        Around the maximum; all its parameters are free.
    sizes : SizeProposal
        Where sizes are proposed.
    degrees : float
        Of freedom of the proposals given sizes; fewer have heavier tails.
    """

    evidence: Evidence
    sizes: SizeProposal
    degrees: float = 20.0

    def __post_init__(self) -> None:
        super().__init__(self._propose, ndim=len(self.evidence.point.theta))

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """Log density (n,) of the linearised model at x (n, d), up to a constant."""
        return self._log_density(x, self.evidence.given(self.evidence.standardised(x)))

    def draw(self, random: np.random.RandomState, n: int, *, stretch: float = 1.0) -> np.ndarray:
        """Draw from the linearised model.

        `stretch`: multiplies their distance from the mean (for over-dispersed starts). Returns (n,
        d).
        """
        standardised = self.sizes.draw(random, n)
        standardised, given = self._moved(
            standardised, self.evidence.given(standardised), random, LIMITS.steps_of_draws
        )
        if stretch != 1.0:
            centre = self.sizes.centre
            standardised = centre + stretch * (standardised - centre)
            given = self.evidence.given(standardised)
        return self._drawn(standardised, given, random, stretch)

    def _moved(
        self, standardised: np.ndarray, given: GivenSizes, random: np.random.RandomState, steps: int
    ) -> tuple[np.ndarray, GivenSizes]:
        """Sizes after steps of an independence sampler of their evidence."""
        weight = given.log_evidence - self.sizes.log_density(standardised)
        for _ in range(steps):
            new = self.sizes.draw(random, len(standardised))
            new_given = self.evidence.given(new)
            new_weight = new_given.log_evidence - self.sizes.log_density(new)
            taken = np.log(random.random_sample(len(standardised))) < new_weight - weight
            standardised = np.where(taken[:, None], new, standardised)
            weight = np.where(taken, new_weight, weight)
            given = jax.tree.map(partial(_where, taken), new_given, given)
        return standardised, given

    def _drawn(
        self,
        standardised: np.ndarray,
        given: GivenSizes,
        random: np.random.RandomState,
        stretch: float = 1.0,
    ) -> np.ndarray:
        """Points (n, d) with these sizes."""
        z = random.standard_normal(given.mean.shape)
        z = stretch * z * np.sqrt(self.degrees / random.chisquare(self.degrees, size=(len(z), 1)))
        off = np.linalg.solve(np.swapaxes(given.root, 1, 2), z[..., None])[..., 0]
        theta, frozen = self.evidence.theta(standardised), self.evidence.frozen
        theta[:, np.asarray(frozen.free)] = given.mean + off * np.asarray(frozen.scale)
        return theta

    def _log_density(self, x: np.ndarray, given: GivenSizes) -> np.ndarray:
        """Of the sizes, by their evidence, and of the rest given them."""
        frozen, degrees = self.evidence.frozen, self.degrees
        off = (x[:, np.asarray(frozen.free)] - given.mean) / np.asarray(frozen.scale)
        z2 = np.sum(np.einsum("nji,nj->ni", given.root, off) ** 2, 1)
        log_det = np.sum(np.log(np.diagonal(given.root, axis1=1, axis2=2)), 1)
        rest = log_det - 0.5 * (degrees + off.shape[1]) * np.log1p(z2 / degrees)
        sizes = x[:, np.asarray(frozen.learnt)][:, np.asarray(frozen.priors["logarithmic"])]
        return given.log_evidence - np.sum(np.log(sizes), 1) + rest

    def _propose(
        self, coords: np.ndarray, random: np.random.RandomState
    ) -> tuple[np.ndarray, np.ndarray]:
        """Proposals and the log ratio of their densities, as emcee asks for them."""
        standardised = self.evidence.standardised(coords)
        before = self.evidence.given(standardised)
        standardised, given = self._moved(standardised, before, random, LIMITS.steps_of_proposal)
        proposed = self._drawn(standardised, given, random)
        return proposed, self._log_density(coords, before) - self._log_density(proposed, given)


def _where(taken: np.ndarray, new: np.ndarray, old: np.ndarray) -> np.ndarray:
    """The new row where it was taken, else the old one."""
    return np.where(taken.reshape(-1, *(1 for _ in old.shape[1:])), new, old)


def _short_sample(
    log_density: LogDensity,
    starts: emcee.State,
    random: np.random.RandomState,
    steps: int,
    **kept: int,
) -> np.ndarray:
    """Draws (n, d) of a short ensemble; `kept`: what emcee discards and how it thins."""
    sampler: Any = emcee.EnsembleSampler(
        *starts.coords.shape, log_density, vectorize=True, moves=emcee.moves.DEMove()
    )
    sampler.random_state = random.get_state()
    sampler.run_mcmc(starts, steps)
    random.set_state(sampler.random_state)
    return sampler.get_chain(flat=True, **kept)


def explored_sizes(evidence: Evidence, random: np.random.RandomState) -> SizeProposal:
    """The distribution of sizes by their evidence, explored by a short ensemble.

    It begins as wide as the evidence is curved: from wider starts a short ensemble does not come
    home, and sizes proposed as wide are hardly ever taken. Its tails are thin: rounds of importance
    sampling fill them (population Monte Carlo, Cappe et al. 2004), for a walker in a tail that is
    seldom proposed stays there, and tells the sampler little for its simulations.
    """
    begin = evidence.standardised(evidence.point.theta)
    walkers = max(LIMITS.size_walkers, 2 * len(begin))
    starts = random.multivariate_normal(begin, inverse(curvature_of(evidence)), walkers)
    explored = _short_sample(
        lambda standardised: evidence.given(standardised).log_evidence,
        emcee.State(starts),
        random,
        LIMITS.size_steps,
        discard=LIMITS.size_warm_up,
        thin=2,
    )
    sizes = SizeProposal(stats.gaussian_kde(explored.T))
    for _ in range(LIMITS.size_rounds):
        drawn = sizes.draw(random, LIMITS.size_draws)
        weights = importance_weights(evidence.given(drawn).log_evidence - sizes.log_density(drawn))
        # Not a number where none of the draws is possible.
        if not 1.0 / np.sum(weights**2) > LIMITS.effective_draws_a_size * len(begin):
            break
        sizes = SizeProposal(stats.gaussian_kde(drawn.T, weights=weights))
    return sizes


def importance_weights(log_ratios: np.ndarray) -> np.ndarray:
    """Weights (n,), of sum 1, of draws with these logs of wanted over proposed density.

    Larger ones are cut to 1 / sqrt(n) of the sum before (Ionides 2008): a single draw rules less.

    >>> importance_weights(np.log([1.0, 1.0, 1.0, np.nan])).round(3).tolist()
    [0.333, 0.333, 0.333, 0.0]
    """
    known = np.where(np.isfinite(log_ratios), log_ratios, -np.inf)
    most = special.logsumexp(known) - 0.5 * np.log(len(known))
    with np.errstate(invalid="ignore"):  # Where all are zero.
        return special.softmax(np.minimum(known, most))


@dataclass(eq=False, repr=False)
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

    mean: np.ndarray
    covariance: np.ndarray
    degrees: float = 20.0
    logarithmic: np.ndarray | None = None

    def __post_init__(self) -> None:
        d = len(self.mean)
        self._positive = np.zeros(d, bool) if self.logarithmic is None else self.logarithmic
        self._centre = self._unfolded(self.mean)
        slope = np.where(self._positive, 1.0 / np.where(self._positive, self.mean, 1.0), 1.0)
        self._root = cholesky_factor(self.covariance * np.outer(slope, slope))
        super().__init__(self._propose, ndim=d)

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """Log density (n,) of proposals x (n, d), up to a constant."""
        y, degrees = self._unfolded(x), self.degrees
        z = linalg.solve_triangular(self._root, (y - self._centre).T, lower=True)
        of_logarithms = -0.5 * (degrees + y.shape[1]) * np.log1p(np.sum(z**2, axis=0) / degrees)
        return of_logarithms - np.sum(y[:, self._positive], axis=1)

    def draw(self, random: np.random.RandomState, n: int, *, stretch: float = 1.0) -> np.ndarray:
        """Draw from the t distribution.

        `stretch`: multiplies their distance from the mean (for over-dispersed starts). Returns (n,
        d).
        """
        z = random.standard_normal((n, len(self.mean)))
        radius = np.sqrt(self.degrees / random.chisquare(self.degrees, size=(n, 1)))
        y = self._centre + stretch * (z * radius) @ self._root.T
        y[:, self._positive] = np.exp(y[:, self._positive])
        return y

    def _unfolded(self, x: np.ndarray) -> np.ndarray:
        """Points with positive parameters on their logarithm."""
        y = np.array(x, float)
        y[..., self._positive] = np.log(y[..., self._positive])
        return y

    def _propose(
        self, coords: np.ndarray, random: np.random.RandomState
    ) -> tuple[np.ndarray, np.ndarray]:
        """Proposals and the log ratio of their densities, as emcee asks for them."""
        proposed = self.draw(random, len(coords))
        return proposed, self.log_density(coords) - self.log_density(proposed)


Proposal = IndependenceMove | EvidenceMove


def find_proposal(
    estimate: Estimate, log_density: LogDensity, random: np.random.RandomState
) -> tuple[Proposal, float, int]:
    """The Laplace approximation as proposal, or, where that is poor, the shape of a pilot sample.

    Where stochastic effects have sizes: the Laplace approximation given the sizes.

    `log_density`: the density to be sampled, from thetas (n, d) to (n,). Returns `share`: of the
    sampler's steps that it should get; `evaluations`: of the density, spent here.
    """
    logarithmic = np.array([p.logarithmic for p in estimate.model.space.priors])
    move: Proposal = IndependenceMove(estimate.theta, estimate.covariance, logarithmic=logarithmic)
    if estimate.model.structure.hyperparameters:
        everything = np.arange(len(estimate.theta))
        evidence = Evidence(estimate.model, estimate.point, estimate.white, everything)
        move = EvidenceMove(evidence, explored_sizes(evidence, random))
    best, reached, spent = move, -1.0, 0
    for pilots_left in reversed(range(LIMITS.most_pilots + 1)):
        draws = move.draw(random, LIMITS.judged_draws)
        spent += len(draws)
        move, acceptance = _with_best_tails(move, draws, log_density(draws))
        if acceptance <= reached:
            # The pilot's shape is no better than what it began from: the next would not be.
            break
        best, reached = move, acceptance
        if reached > LIMITS.poor_acceptance or not pilots_left:
            break
        n = walkers_needed(LIMITS.pilot_walkers, len(estimate.theta))
        starts = finite_starts(move, log_density, random, n)
        steps, warm_up = LIMITS.pilot_steps, LIMITS.pilot_warm_up
        kept = _short_sample(log_density, starts, random, steps, discard=warm_up)
        spent += (steps + 1) * n
        move = IndependenceMove(kept.mean(0), np.cov(kept.T), 8.0, logarithmic)
    return best, float(np.clip(reached, LIMITS.least_share, LIMITS.largest_share)), spent


def _with_best_tails(
    move: Proposal, draws: np.ndarray, log_density: np.ndarray
) -> tuple[Proposal, float]:
    """The proposal with the tails that would be accepted most often, and how often.

    `draws` (n, d) are the move's own, with the log density (n,) that is to be sampled.
    """
    own = move.log_density(draws)
    moves = [replace(move, degrees=degrees) for degrees in LIMITS.tails]
    acceptances = [
        _expected_acceptance(log_density - own, each.log_density(draws) - own) for each in moves
    ]
    best = int(np.argmax(acceptances))
    return moves[best], acceptances[best]


def _expected_acceptance(log_weights: np.ndarray, log_ratios: np.ndarray) -> float:
    """Acceptance an independence sampler would have whose proposals differ from those drawn.

    `log_weights` (n,) are the log density to be sampled over that of the draws, `log_ratios` (n,)
    that of the proposals over that of the draws.
    """
    if not np.any(np.isfinite(log_weights)):
        return 0.0
    weights = np.exp(log_weights - log_weights.max())
    ratios = np.exp(log_ratios - log_ratios.max())
    pairs = weights[:, None] * ratios[None, :]
    return float(np.minimum(pairs, pairs.T).sum() / (weights.sum() * ratios.sum()))


def finite_starts(
    move: Proposal, log_density: LogDensity, random: np.random.RandomState, n: int
) -> emcee.State:
    """Over-dispersed points (n, d) with their log densities, all finite (emcee accepts others
    without a word).
    """
    points, densities = list[np.ndarray](), list[float]()
    for _ in range(LIMITS.most_draws):
        drawn = move.draw(random, n, stretch=LIMITS.over_dispersion)
        found = log_density(drawn)
        finite = np.isfinite(found)
        points.extend(drawn[finite])
        densities.extend(found[finite])
        if len(points) >= n:
            return emcee.State(np.array(points[:n]), log_prob=np.array(densities[:n]))
    raise EstimateError(
        "the posterior is not finite around its maximum",
        advice="check priors, and that every wheel and rate axis moves",
    )


def walkers_needed(requested: int, d: int) -> int:
    """Walkers of an ensemble: emcee's moves need twice as many as there are dimensions.

    Examples
    --------
    >>> walkers_needed(64, 40)
    80
    """
    return max(requested, 2 * d)
