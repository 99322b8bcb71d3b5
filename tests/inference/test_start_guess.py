"""Where the optimizer begins: from a wheel momentum that nothing measures, guessed from the motion,
every start finds the optimum.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import InertiaPrior, RateSensor, StarTracker
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.descent import guess_nuisances
from bayes_inertia.inference.likelihood import Point
from bayes_inertia.inference.noise_model import whitening
from bayes_inertia.inference.objective import negative_log_posterior
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.physics.forward_model import Model


@pytest.fixture(scope="module")
def deaf(flown):
    """The campaign of three slews without its tachometers."""
    wheels = tuple(replace(w, momentum_sigma=None) for w in flown.campaign.wheels)
    return replace(
        flown.campaign,
        wheels=wheels,
        slews=tuple(replace(s, wheel_momentum=None) for s in flown.campaign.slews),
    )


def test_the_guess_is_the_momentum_that_tachometers_would_have_shown(flown, deaf):
    model = Model(deaf)
    guess = guess_nuisances(model, flown.truth.theta)[:, 6:] * np.asarray(
        model.data.scale.local[6:]
    )
    for momentum, slew in zip(guess, flown.campaign.slews, strict=True):
        missed = deaf.wheel_axes_B @ (momentum - slew.wheel_momentum[0])
        # Momentum along the axis of the slew leaves no trace in the motion.
        axis = np.sum(slew.rate, axis=0) / np.linalg.norm(np.sum(slew.rate, axis=0))
        assert np.linalg.norm(missed - axis * (axis @ missed)) < 0.1 * np.linalg.norm(
            deaf.wheel_axes_B @ slew.wheel_momentum[0]
        )


def test_from_there_the_simulation_is_nearer_the_data(deaf):
    model = Model(deaf)
    theta, bias = model.space.mean, np.zeros(3)
    guessed, zero = (
        Point(theta, bias, x)
        for x in (guess_nuisances(model, theta), np.zeros_like(guess_nuisances(model, theta)))
    )
    near, far = (negative_log_posterior(model, p, whitening(model, theta)) for p in (guessed, zero))
    assert near < 0.2 * far


def test_every_start_finds_the_optimum_without_tachometers(deaf):
    at = estimate(Model(deaf), starts=6, discount=False)
    assert at.starts.agreeing == at.starts.tried == 6
    assert at.tests["total"].reduced_chi2 == pytest.approx(1.0, abs=0.2)


def test_only_an_optimum_worse_than_noise_makes_it_is_guessed_at_again(deaf, monkeypatch):
    guesses = []

    def counted(model, theta):
        guesses.append(theta)
        return guess_nuisances(model, theta)

    monkeypatch.setattr(optimizer, "guess_nuisances", counted)
    estimate(Model(deaf), starts=1, discount=False)
    assert not guesses
    sigma = tuple(0.5 * s for s in deaf.rate_sensor.sigma)
    louder = replace(deaf, rate_sensor=replace(deaf.rate_sensor, sigma=sigma))
    estimate(Model(louder), starts=1, discount=False)
    assert len(guesses) == 1


def test_what_is_measured_needs_no_guess(flown):
    assert not guess_nuisances(Model(flown.campaign), flown.truth.theta).any()


def _tumble(seed=3):
    """A body that nothing turns, eight turns a slew, with J some per cent off its prior."""
    J = np.array([[3.0, 0.03, 0.0], [0.03, 2.2, -0.02], [0.0, -0.02, 1.7]])
    K, rng, time = np.array([1.01, 1.02, 0.99]), np.random.default_rng(seed), np.arange(0, 140, 0.5)

    def moves(_, x):
        q, w = x[:4], x[4:]
        turned = np.append(np.cross(q[:3], w) + q[3] * w, -q[:3] @ w) / 2.0
        return np.concatenate([turned, np.linalg.solve(J, -np.cross(w, J @ w))])

    slews = []
    for k, rate in enumerate(([0.3, 0.1, 0.2], [0.1, 0.35, 0.1], [-0.2, 0.1, 0.3])):
        start = np.array([0.0, 0.0, 0.0, 1.0, *rate])
        x = integrate.solve_ivp(moves, (0, 140), start, t_eval=time, rtol=1e-10, atol=1e-12).y.T
        fixes = np.where((np.arange(280) % 279 < 3)[:, None], x[:, :4], np.nan)
        readings = x[:, 4:] / K + 2e-5 * rng.standard_normal((280, 3))
        slews.append(Slew(f"slew {k + 1}", 400.0 * k, time, rate=readings, attitude=fixes))
    prior = InertiaPrior(np.diag([2.85, 2.3, 1.8]), 0.04, 0.03)
    sensor = RateSensor(sigma=2e-5, scale_factor_sigma=0.03, bias_sigma=2e-6)
    return Campaign("tumble", prior, (), sensor, StarTracker((0, 0, 1), 2e-5, 1e-4), slews), J


@pytest.mark.long
@pytest.mark.slow
def test_every_start_finds_the_optimum_of_a_body_that_nothing_turns():
    campaign, J = _tumble()
    at = estimate(Model(campaign), starts=4)
    assert at.starts.agreeing == at.starts.tried == 4
    assert at.theta[:3] / at.theta[:3].sum() == pytest.approx(np.diag(J) / np.trace(J), rel=1e-4)
