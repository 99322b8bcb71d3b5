"""Laplace's approximation of a fit, checked by importance sampling of all its unknowns."""

import numpy as np
import pytest
from scipy.special import log_ndtr

from bayes_inertia.diagnosis.score_test import pareto_k, sampled_evidence
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.physics.effects import WheelCommandLag
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.small_campaign import small_campaign


def sampled(fit, seed=1):
    return sampled_evidence(fit, np.random.default_rng(seed))


@pytest.mark.parametrize("k", [0.3, 0.7, 1.5])
def test_the_shape_is_that_of_the_upper_tail_of_the_weights(k):
    """Weights are Pareto by construction; their inverses have no tail."""
    log_weights = k * np.random.default_rng(1).standard_exponential((20, 4000))
    found = np.array([pareto_k(each) for each in log_weights])
    # The library's prior draws towards 0.5, as ten of the 189 weights of the tail would.
    expected = (k * 189 + 0.5 * 10) / 199
    assert found.mean() == pytest.approx(expected, abs=4.0 * found.std() / 20**0.5)
    assert max(pareto_k(-each) for each in log_weights) < 0.0


def test_one_weight_beyond_all_others_has_no_shape_and_equal_ones_no_tail():
    assert pareto_k(np.append(np.full(127, -800.0), 0.0)) == np.inf
    assert pareto_k(np.zeros(128)) == 0.0


@pytest.mark.slow
def test_a_posterior_that_is_nearly_normal_is_its_approximation():
    found = sampled(estimate(Model(small_campaign()), starts=1))
    assert abs(found.sampled_gain) < 0.05
    assert found.pareto_k < 0.7


@pytest.mark.long
@pytest.mark.slow
def test_a_lag_loses_the_share_of_its_approximation_that_is_negative():
    fit = estimate(Model(small_campaign(), (WheelCommandLag(),)), starts=1)
    k = fit.model.space.names.index("wheel_command_lag.tau")
    possible = log_ndtr(fit.theta[k] / fit.sd[k])
    found = sampled(fit)
    assert found.sampled_gain == pytest.approx(possible, abs=0.3)
    assert found.pareto_k < 0.7
