"""The sampler's proposal: its tails follow those of the density that is sampled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import emcee
import numpy as np
import pytest
from scipy import stats

from bayes_inertia.inference import proposal
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.inference.proposal import find_proposal

STEPS, WALKERS = 400, 64


def _normal(estimate: Estimate) -> Callable:
    return stats.multivariate_normal(estimate.theta, estimate.covariance).logpdf


def _heavy(estimate: Estimate) -> Callable:
    return stats.multivariate_t(estimate.theta, estimate.covariance, df=6).logpdf


@pytest.mark.parametrize(("density", "degrees"), [(_normal, 200.0), (_heavy, 8.0)])
def test_tails_are_chosen_by_the_density_and_the_acceptance_is_foretold(small_at, density, degrees):
    log_density = density(small_at)
    random = np.random.RandomState(1)
    move, share, spent = find_proposal(small_at, log_density, random)
    assert move.degrees == degrees
    accepted = _acceptance(move, log_density, random)
    # The share is foretold from `spent` draws and measured on independent walkers.
    error = np.std(accepted, ddof=1) / np.sqrt(WALKERS) + 0.5 / np.sqrt(spent)
    assert share == pytest.approx(np.clip(np.mean(accepted), 0.5, 0.95), abs=3.0 * error)
    # Tails of the other kind, the negative control, are accepted less often.
    other = replace(move, degrees={200.0: 8.0, 8.0: 200.0}[degrees])
    assert np.mean(_acceptance(other, log_density, random)) < np.mean(accepted) - 3.0 * error


class _Evidence:
    """Sizes (n, 4) of which the first hardly differs from none: a long tail to the left."""

    point = SimpleNamespace(theta=np.zeros(4))

    def standardised(self, theta: np.ndarray) -> np.ndarray:
        return np.zeros(4)

    def given(self, x: np.ndarray) -> SimpleNamespace:
        tail = np.where(x[:, 0] < 0.0, 20.0, 0.25)
        log = -0.5 * np.sum(x[:, 1:] ** 2, 1) - 0.5 * (x[:, 0] / tail) ** 2
        return SimpleNamespace(log_evidence=log)


def _effective_share(monkeypatch, rounds: int, seed: int) -> float:
    """Of draws of the proposal of sizes that importance weights leave."""
    monkeypatch.setattr(proposal, "LIMITS", replace(LIMITS, size_rounds=rounds))
    evidence: Any = _Evidence()
    sizes = proposal.explored_sizes(evidence, np.random.RandomState(seed))
    draws = sizes.draw(np.random.RandomState(99), 4000)
    ratio = evidence.given(draws).log_evidence - sizes.log_density(draws)
    weights = np.exp(ratio - ratio.max())
    return float(weights.sum() ** 2 / np.sum(weights**2) / len(weights))


def test_rounds_of_importance_sampling_fill_the_tail_of_sizes(monkeypatch):
    monkeypatch.setattr(proposal, "curvature_of", lambda evidence: np.diag([16.0, 1.0, 1.0, 1.0]))
    shares = np.array([[_effective_share(monkeypatch, r, s) for s in range(6)] for r in (0, 2)])
    error = np.sqrt(np.sum(shares.var(1, ddof=1)) / shares.shape[1])
    assert shares[1].mean() - shares[0].mean() > 0.2 + 3.0 * error


@pytest.mark.parametrize("ratios", [np.r_[1e3, np.zeros(511)], np.full(512, -np.inf)])
def test_sizes_stay_as_explored_where_a_round_tells_nothing(monkeypatch, ratios):
    monkeypatch.setattr(proposal, "curvature_of", lambda evidence: np.eye(4))
    useless = proposal.importance_weights(ratios)
    monkeypatch.setattr(proposal, "importance_weights", lambda log_ratios: useless)
    evidence: Any = _Evidence()
    sizes = proposal.explored_sizes(evidence, np.random.RandomState(1))
    assert np.ptp(sizes.explored.weights) == 0.0
    assert np.isfinite(sizes.draw(np.random.RandomState(2), 100)).all()


def _acceptance(move: emcee.moves.Move, log_density: Callable, random) -> np.ndarray:
    """Of each walker."""
    starts = move.draw(random, WALKERS)
    sampler = emcee.EnsembleSampler(WALKERS, move.ndim, log_density, vectorize=True, moves=move)
    sampler.run_mcmc(emcee.State(starts, random_state=random.get_state()), STEPS)
    return sampler.acceptance_fraction
