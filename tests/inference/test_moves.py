"""One harness for all moves, with moves that are wrong on purpose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import emcee
import numpy as np
import pytest
from scipy import stats
from support.chains import D

from bayes_inertia.inference.proposal import IndependenceMove


@dataclass(frozen=True)
class Target:
    """A density of x = root z whose components z are independent, with mean 0, variance 1 and known
    quantiles.

    `log_z` gives the log densities of standard components (n, D), `laws` the same as frozen scipy
    distributions.
    """

    log_z: Callable[[np.ndarray], np.ndarray]
    laws: tuple
    root: np.ndarray

    def log_density(self, x: np.ndarray) -> np.ndarray:
        return self.log_z(self.standard(x)).sum(1)

    def standard(self, x: np.ndarray) -> np.ndarray:
        return np.linalg.solve(self.root, x.T).T

    def draw(self, rng: np.random.Generator, n: int) -> np.ndarray:
        return np.stack([law.rvs(n, random_state=rng) for law in self.laws], 1) @ self.root.T

    @property
    def covariance(self) -> np.ndarray:
        return self.root @ self.root.T


def _root(seed: int = 5) -> np.ndarray:
    """Correlations up to 0.9 and scales from 1e-6 to 1e2."""
    rng = np.random.default_rng(seed)
    turned, _ = np.linalg.qr(rng.normal(size=(D, D)))
    correlated = turned * np.sqrt(np.geomspace(0.1, 3.0, D))
    return rng.permutation(np.geomspace(1e-6, 1e2, D))[:, None] * correlated


def _gaussian() -> Target:
    return Target(lambda z: -0.5 * z**2, (stats.norm(),) * D, _root())


def _skewed() -> Target:
    """Five Gumbel components (skewness 1.14, one exponential tail) and four of Student's t with
    eight degrees of freedom.
    """
    width, middle = np.sqrt(6.0) / np.pi, -np.euler_gamma * np.sqrt(6.0) / np.pi
    narrow = np.sqrt(6.0 / 8.0)
    laws = (stats.gumbel_r(middle, width),) * 5 + (stats.t(8, 0.0, narrow),) * 4

    def log_z(z: np.ndarray) -> np.ndarray:
        y = (z[:, :5] - middle) / width
        with np.errstate(over="ignore"):
            return np.concatenate(
                [-y - np.exp(-y), -4.5 * np.log1p((z[:, 5:] / narrow) ** 2 / 8.0)], 1
            )

    return Target(log_z, laws, _root(6))


TARGETS = {"gaussian": _gaussian(), "skewed": _skewed()}


LEVELS = np.array([0.01, 0.05, 0.5, 0.95, 0.99])


BATCHES = 40


def departures(target: Target, moves, steps: int, walkers: int = 64, seed: int = 1) -> np.ndarray:
    """Means, second moments and quantiles of a long run minus their true values, each in its own
    Monte Carlo error.

    The run starts in the target, and its error comes from the scatter of the means of 40 stretches
    of the run.
    """
    random = np.random.RandomState(np.random.MT19937(seed))
    sampler = emcee.EnsembleSampler(walkers, D, target.log_density, vectorize=True, moves=moves)
    start = target.draw(np.random.default_rng(seed), walkers)
    sampler.run_mcmc(emcee.State(start, random_state=random.get_state()), steps)
    z = target.standard(sampler.get_chain(flat=True)).reshape(BATCHES, -1, D)
    cuts = np.array([[law.ppf(p) for p in LEVELS] for law in target.laws])
    upper = np.triu_indices(D)
    means = z.mean(1)
    products = np.einsum("bni,bnj->bij", z, z)[:, *upper] / z.shape[1] - np.eye(D)[upper]
    below = np.stack([(z[..., None, i] < cuts[i]).mean(1) - LEVELS for i in range(D)], 1).reshape(
        BATCHES, -1
    )
    found = np.concatenate([means, products, below], 1)
    error = found.std(0, ddof=1) / np.sqrt(BATCHES)
    # What never changes during the run (a sampler that is stuck) is infinitely wrong.
    return np.divide(found.mean(0), error, out=np.full_like(error, np.inf), where=error > 0.0)


def limit(statistics: int) -> float:
    """No exact move exceeds this in one of 2000 runs: Student's t with as many degrees of freedom
    as stretches less one.
    """
    return float(stats.t.isf(0.5 / 2000 / statistics, BATCHES - 1))


def _right(t: Target) -> IndependenceMove:
    return IndependenceMove(np.zeros(D), t.covariance, 8.0)


def _wrong(t: Target) -> IndependenceMove:
    """Centre off by half a sigma in every component, widths off by factors of 0.8 to 1.6,
    correlations ignored in part.
    """
    z = np.diag(np.linspace(0.8, 1.6, D) ** 2) + 0.15
    return IndependenceMove(t.root @ np.full(D, 0.3), t.root @ z @ t.root.T, 5.0)


MOVES = {
    "independence": (lambda t: _right(t), 2000),
    "independence, wrong covariance": (lambda t: _wrong(t), 4000),
    "differential evolution": (lambda t: emcee.moves.DEMove(), 6000),
    "stretch": (lambda t: emcee.moves.StretchMove(), 10000),
    "as sample() mixes them": (lambda t: [(_right(t), 0.5), (emcee.moves.DEMove(), 0.5)], 3000),
}


def for_releases(names, of_emcee: tuple[str, ...]) -> list:
    """Names as parameters of a test; what runs emcee's own moves is long."""
    return [pytest.param(n, marks=pytest.mark.long if n in of_emcee else ()) for n in names]


@pytest.mark.slow
@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("move", for_releases(MOVES, ("differential evolution", "stretch")))
def test_every_move_samples_its_target_exactly_in_nine_dimensions(move, target):
    make, steps = MOVES[move]
    t = departures(TARGETS[target], make(TARGETS[target]), steps)
    assert np.abs(t).max() < limit(len(t))


class _WrongSign(IndependenceMove):
    def _propose(self, coords, random):
        proposed, factors = super()._propose(coords, random)
        return proposed, -factors


class _NoCorrection(IndependenceMove):
    def _propose(self, coords, random):
        proposed, factors = super()._propose(coords, random)
        return proposed, np.zeros_like(factors)


class _OneDimensionTooMany(emcee.moves.StretchMove):
    def get_proposal(self, s, c, random):
        proposed, factors = super().get_proposal(s, c, random)
        return proposed, factors * D / (D - 1.0)


CONTROLS = {
    "wrong sign": ("gaussian", lambda t: _WrongSign(np.zeros(D), t.covariance, 8.0), 1000),
    "no correction": ("gaussian", lambda t: _NoCorrection(np.zeros(D), t.covariance, 8.0), 1000),
    "stretch with a wrong power": ("gaussian", lambda t: _OneDimensionTooMany(), 10000),
    # Its step is along a Euclidean direction: with scales as far apart as above it only ever moves
    # one component.
    "emcee's snooker move": (
        "isotropic",
        lambda t: [(emcee.moves.DEMove(), 0.8), (emcee.moves.DESnookerMove(), 0.2)],
        6000,
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "move", for_releases(CONTROLS, ("stretch with a wrong power", "emcee's snooker move"))
)
def test_the_harness_notices_moves_that_sample_another_density(move):
    name, make, steps = CONTROLS[move]
    target = {**TARGETS, "isotropic": replace(TARGETS["gaussian"], root=np.eye(D))}[name]
    t = departures(target, make(target), steps)
    assert np.abs(t).max() > 1.5 * limit(len(t))


def test_a_positive_parameter_is_proposed_on_its_logarithm():
    """With many degrees of freedom the move is a normal and a log-normal distribution, density and
    draws.
    """
    move = IndependenceMove(
        np.array([1.0, 0.2]), np.diag([4.0, 0.01]), 1e9, np.array([False, True])
    )
    x = np.stack([np.linspace(-3.0, 3.0, 7), np.geomspace(0.02, 2.0, 7)], axis=1)
    expected = stats.norm(1.0, 2.0).logpdf(x[:, 0]) + stats.lognorm(0.5, scale=0.2).logpdf(x[:, 1])
    np.testing.assert_allclose(np.diff(move.log_density(x)), np.diff(expected), atol=1e-5)
    drawn = move.draw(np.random.RandomState(1), 2000)
    assert stats.kstest(drawn[:, 1], stats.lognorm(0.5, scale=0.2).cdf).pvalue > 1e-3
    assert stats.kstest(drawn[:, 1], stats.norm(0.2, 0.1).cdf).pvalue < 1e-6
