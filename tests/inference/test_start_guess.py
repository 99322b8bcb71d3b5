"""Where the optimizer begins: from a wheel momentum that nothing measures, guessed from the motion,
every start finds the optimum.
"""

from dataclasses import replace

import numpy as np
import pytest

from bayes_inertia.inference import optimizer
from bayes_inertia.inference.descent import guess_nuisances
from bayes_inertia.inference.noise_model import whitening
from bayes_inertia.inference.objective import negative_log_posterior
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.inference.point import Point
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
