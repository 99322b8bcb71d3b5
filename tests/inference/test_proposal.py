"""The sampler's proposal: its tails follow those of the density that is sampled."""

from __future__ import annotations

from collections.abc import Callable

import emcee
import numpy as np
import pytest
from scipy import stats

from bayes_inertia.inference.laplace import Estimate
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
    other = move.with_degrees({200.0: 8.0, 8.0: 200.0}[degrees])
    assert np.mean(_acceptance(other, log_density, random)) < np.mean(accepted) - 3.0 * error


def _acceptance(move: emcee.moves.Move, log_density: Callable, random) -> np.ndarray:
    """Of each walker."""
    starts = move.draw(random, WALKERS)
    sampler = emcee.EnsembleSampler(WALKERS, move.ndim, log_density, vectorize=True, moves=move)
    sampler.run_mcmc(emcee.State(starts, random_state=random.get_state()), STEPS)
    return sampler.acceptance_fraction
