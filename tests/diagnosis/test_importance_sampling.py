"""Laplace's approximation of a fit, checked by importance sampling of all its unknowns."""

import numpy as np
import pytest
from scipy.special import log_ndtr

from bayes_inertia.diagnosis.score_test import sampled_evidence
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.physics.effects import WheelCommandLag
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.small_campaign import small_campaign


def sampled(fit, seed=1):
    return sampled_evidence(fit, np.random.default_rng(seed))


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
