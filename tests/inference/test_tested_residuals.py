"""Residuals are tested without the overfit of free shapes: white where the model is right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bayes_inertia.inference import optimizer
from bayes_inertia.inference.residual_tests import whiteness
from bayes_inertia.physics.effects import RateBiasInstability, TachometerNoiseWalk
from bayes_inertia.physics.forward_model import Model

BIAS, TIME = 2.5e-5, 20.0


def wandering_bias(campaign, rng, sd=BIAS):
    """The campaign with a Gauss-Markov bias of the rate sensor."""
    slews = []
    for slew in campaign.slews:
        kept = np.exp(-float(slew.time[1] - slew.time[0]) / TIME)
        bias = sd * rng.normal(size=slew.rate.shape)
        for row in range(1, len(bias)):
            bias[row] = kept * bias[row - 1] + np.sqrt(1.0 - kept**2) * bias[row]
        slews.append(replace(slew, rate=slew.rate + bias))
    return replace(campaign, slews=tuple(slews))


def walking_tachometers(campaign, rng):
    """The campaign with tachometers whose errors are random walks of a few sigmas a slew."""
    sigma, slews = campaign.wheels[0].momentum_sigma, []
    for slew in campaign.slews:
        step = rng.normal(size=slew.wheel_momentum.shape) / np.sqrt(len(slew.time))
        error = 3.0 * sigma * step.cumsum(0)
        slews.append(replace(slew, wheel_momentum=slew.wheel_momentum + error))
    return replace(campaign, slews=tuple(slews))


def fitted(campaign, *effects):
    return optimizer.estimate(Model(campaign, effects), discount=False)


@pytest.fixture(scope="module")
def with_bias(flown):
    return wandering_bias(flown.campaign, np.random.default_rng(5))


@pytest.mark.long
@pytest.mark.slow
def test_a_wandering_bias_that_is_estimated_leaves_white_residuals(with_bias):
    estimate = fitted(with_bias, RateBiasInstability())
    test = estimate.tests["rate"]
    assert not test.rejected
    assert test.reduced_chi2 == pytest.approx(1.0, abs=0.1)
    assert fitted(with_bias).tests["rate"].p_white < 1e-12


@pytest.mark.long
@pytest.mark.slow
def test_what_a_reduced_basis_leaves_is_not_white_by_itself(flown):
    """The control: residuals of a fit with many knots, tested as they are."""
    strong = wandering_bias(flown.campaign, np.random.default_rng(5), 4.0 * BIAS)
    estimate = fitted(strong, RateBiasInstability(knots=49))
    assert whiteness(estimate.residual_series["rate"]) < 1e-3
    assert estimate.tests["rate"].p_white > 1e-3


@pytest.mark.long
@pytest.mark.slow
def test_tachometers_that_walk_leave_white_residuals_too(flown):
    campaign = walking_tachometers(flown.campaign, np.random.default_rng(6))
    assert fitted(campaign).tests["momentum"].rejected
    estimate = fitted(campaign, TachometerNoiseWalk())
    assert not estimate.tests["momentum"].rejected


@pytest.mark.long
@pytest.mark.slow
def test_other_misfit_is_seen_beside_a_free_shape(with_bias):
    """A ringing that no Gauss-Markov process makes is still rejected."""
    slews = [
        replace(s, rate=s.rate + 2e-5 * np.sin(4.0 * s.time)[:, None]) for s in with_bias.slews
    ]
    campaign = replace(with_bias, slews=tuple(slews))
    assert fitted(campaign, RateBiasInstability()).tests["rate"].rejected


@pytest.mark.slow
def test_parameters_of_shapes_that_are_filtered_out_are_not_paid_for(with_bias):
    estimate = fitted(with_bias, RateBiasInstability())
    paid = estimate.tested_residuals.parameters
    plain = fitted(with_bias).effective_parameters
    assert estimate.effective_parameters[0] > plain[0] + 20.0
    # J, K, the bias, and a start state in each slew, little more than without the shape.
    assert 0.0 < paid.sum() < plain.sum() + 3.0


def test_without_free_shapes_residuals_are_tested_as_they_are(flown):
    estimate = fitted(flown.campaign)
    for tested, left in zip(
        estimate.tested_residuals.series["rate"], estimate.residual_series["rate"], strict=True
    ):
        np.testing.assert_array_equal(tested, left)
    np.testing.assert_array_equal(
        estimate.tested_residuals.parameters, estimate.effective_parameters
    )


def rejected_draws(series, level, n=400):
    """How many of n draws of residuals are rejected at a level."""
    rng = np.random.default_rng(0)
    return sum(whiteness([series(rng) for _ in range(5)]) < level for _ in range(n))


LOUDER = 1.0 + 4.0 * np.sin(np.linspace(0.0, np.pi, 300))[:, None] ** 4


@pytest.mark.parametrize(
    "series",
    [
        lambda rng: rng.normal(size=(300, 3)),
        lambda rng: LOUDER * rng.normal(size=(300, 3)),
        lambda rng: rng.standard_t(3, size=(300, 3)),
    ],
    ids=["white", "louder while the body turns", "heavy tails"],
)
def test_noise_without_memory_is_white_however_loud(series):
    # A right level, or a cautious one: above 99.9 % of binomial draws would be neither.
    assert rejected_draws(series, 0.05) <= stats.binom.ppf(0.999, 400, 0.05)


def test_a_little_memory_in_noise_that_is_louder_at_times_is_seen():
    def remembers(rng):
        noise = rng.normal(size=(301, 3))
        return LOUDER * (noise[1:] + 0.2 * noise[:-1])

    assert rejected_draws(remembers, 0.05, 50) > 45


def repeated_in_every_slew(rng, ripple=0.0):
    """Residuals of five slews; half of their variance is the same in all of them."""
    common, time = rng.normal(size=(300, 3)), np.arange(300.0)[:, None]
    waves = (ripple * np.sin(0.9 * time + rng.uniform(0.0, 6.0)) for _ in range(5))
    return [0.71 * (common + rng.normal(size=(300, 3))) + wave for wave in waves]


def test_noise_that_repeats_in_every_slew_is_no_line():
    rng = np.random.default_rng(2)
    level, n = 1e-3, 200
    p = np.array([whiteness(repeated_in_every_slew(rng)) for _ in range(n)])
    # Sums of such noise have heavier tails than chi^2: ten times the level, and a hundred before.
    assert np.sum(p < level) <= stats.binom.ppf(0.999, n, 10.0 * level)


def test_a_ripple_beside_noise_that_repeats_is_seen():
    rng = np.random.default_rng(3)
    assert all(whiteness(repeated_in_every_slew(rng, 0.5)) < 1e-4 for _ in range(30))
