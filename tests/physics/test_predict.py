"""What a model predicts for given parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import bayes_inertia as bi
from bayes_inertia.errors import BayesInertiaError, SettingsError
from bayes_inertia.physics.small_campaign import small_campaign


def test_the_truth_predicts_what_was_recorded():
    campaign = small_campaign()
    model = bi.Model(campaign)
    predicted = model.predict(model.space.mean[None])
    assert set(predicted) == {"rate", "attitude", "momentum"}
    assert predicted["rate"].shape == (1, 3, 64, 3)
    for k, slew in enumerate(campaign.slews):
        # The first reading of each is the start: rates of 1e-4 rad/s, no noise.
        np.testing.assert_allclose(predicted["rate"][0, k], slew.rate, atol=1e-6)
        np.testing.assert_allclose(predicted["momentum"][0, k], slew.wheel_momentum, atol=1e-6)


def test_a_larger_body_turns_slower_and_draws_differ():
    campaign = small_campaign()
    model = bi.Model(campaign)
    draws = model.draw_prior(np.random.default_rng(1), 4)
    larger = model.space.mean * np.where(np.arange(9) < 6, 1.05, 1.0)
    predicted = model.predict(np.vstack([model.space.mean, larger, draws]))
    largest = np.abs(predicted["rate"][:, 0]).max((1, 2))
    assert 0.94 < largest[1] / largest[0] < 0.97
    assert predicted["rate"].shape[0] == 6
    assert len(set(largest.tolist())) == 6


def test_what_was_not_measured_is_not_predicted():
    campaign = small_campaign()
    fixes = np.array(campaign.slews[0].attitude)
    fixes[5:] = np.nan
    slews = (replace(campaign.slews[0], attitude=fixes), *campaign.slews[1:])
    model = bi.Model(replace(campaign, slews=slews))
    attitude = model.predict(model.space.mean)["attitude"][0, 0]
    assert np.isfinite(attitude).all(-1).sum() == 5


def test_a_seed_draws_what_its_generator_draws(campaign):
    """The same number as seed of each parameter made all of them one."""
    model = bi.Model(campaign)
    draws = model.draw_prior(5, 300)
    np.testing.assert_array_equal(draws, model.draw_prior(np.random.default_rng(5), 300))
    correlation = np.corrcoef(draws.T) - np.eye(draws.shape[1])
    assert np.abs(correlation).max() < 4.5 / np.sqrt(300)
    for number in (5.0, -1):
        with pytest.raises(SettingsError, match="n: is"):
            model.draw_prior(5, number)


@pytest.mark.parametrize("theta", ["a", ["a"] * 9, np.zeros((0, 9))])
def test_what_is_no_parameter_vector_is_said(campaign, theta):
    with pytest.raises(BayesInertiaError, match="theta: "):
        bi.Model(campaign).predict(theta)
