"""Few combinations of high-rate readings tell what all of them do."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from support.high_rate import dense, thrown
from support.marginal import frozen_at_prior_mean

from bayes_inertia.campaign.hardware import CorrelatedNoise
from bayes_inertia.inference import reading_compression
from bayes_inertia.inference.marginal_posterior import log_density_of
from bayes_inertia.inference.reading_compression import compressed, why_not_compressed
from bayes_inertia.physics.effects import InertiaChange, RateSensorMisalignment
from bayes_inertia.physics.forward_model import Model

RATE = 2000  # rows a second of a throw, of which a step spans sixteen


def throws():
    """A quarter of a second of two throws."""
    return thrown(RATE, 0.25)


def slow():
    """Telemetry of which a step spans a few rows."""
    return thrown(200)


def without_an_axis():
    return with_gaps(axes=0)


def with_gaps(axes=slice(None)):
    """A fifth of the rates missing here and there, and a gap longer than an integration step."""
    campaign, rng, slews = throws(), np.random.default_rng(2), []
    for slew in campaign.slews:
        rate = np.array(slew.rate)
        rate[rng.random(len(rate)) < 0.2, axes] = np.nan
        rate[200:250, axes] = np.nan
        slews.append(replace(slew, rate=rate))
    return replace(campaign, slews=tuple(slews))


def correlated():
    """Half of the gyro's noise lasts for 10 ms."""
    campaign = throws()
    noise = CorrelatedNoise(0.5, 0.01)
    return replace(campaign, rate_sensor=replace(campaign.rate_sensor, correlated_noise=noise))


def commanded():
    """Wheels under command with noise on every channel, fixes while it turns."""
    campaign, rng, slews = dense(64), np.random.default_rng(4), []
    for slew in campaign.slews:
        n, half = len(slew.time), len(slew.time) // 2
        momentum = slew.wheel_momentum[:half] + 5e-6 * rng.normal(size=(half, 3))
        attitude = np.array(slew.attitude[:half])
        attitude[np.arange(half) % 50 > 0] = np.nan
        slews.append(
            replace(
                slew,
                time=slew.time[:half],
                rate=slew.rate[:half] + 2e-5 * rng.normal(size=(n, 3))[:half],
                attitude=attitude,
                wheel_torque=slew.wheel_torque[:half],
                wheel_momentum=momentum,
                magnetic_field_N=None,
                position_N=None,
            )
        )
    return replace(campaign, slews=tuple(slews))


def log_densities(model, marginal, n=8):
    """Around the prior mean, where each slew's start is guessed from its first readings."""
    step = 0.1 * np.random.default_rng(6).normal(size=(n, model.space.size))
    thetas = np.array(model.space.mean) + step * model.space.sd
    return log_density_of(model.structure, marginal, batch=n)(thetas)


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize(
    ("campaign", "effects"),
    [(with_gaps, ()), (commanded, (InertiaChange(),))],
    ids=["throws with gaps", "commanded, changed inertia"],
)
def test_the_posterior_is_the_same_from_fewer_numbers(monkeypatch, campaign, effects):
    model = Model(campaign(), effects)
    every = frozen_at_prior_mean(model)
    few = compressed(model.structure, every)
    assert why_not_compressed(model.structure, every) is None
    numbers = [m.data.arrays.telemetry.readings[0].values.shape[1] for m in (every, few)]
    assert numbers[1] < 0.8 * numbers[0]
    expected = log_densities(model, every)
    assert np.std(expected) > 1.0
    allowed = 1e-9 * np.abs(expected).max()
    assert np.abs(log_densities(model, few) - expected).max() < allowed
    # The control: a span that lacks the motion's curvature is not enough.
    monkeypatch.setattr(reading_compression, "_DEGREE", 1)
    fewer = compressed(model.structure, every)
    assert np.abs(log_densities(model, fewer) - expected).max() > 100.0 * allowed


@pytest.mark.parametrize(
    ("campaign", "effects", "reason"),
    [
        (throws, (RateSensorMisalignment(),), "on a sensor"),
        (correlated, (), "correlated"),
        (without_an_axis, (), "lack a reading"),
        (slow, (), "span few rows"),
    ],
    ids=["misalignment", "correlated", "an axis missing", "low rate"],
)
def test_readings_that_do_not_combine_are_kept(campaign, effects, reason):
    model = Model(campaign(), effects)
    frozen = frozen_at_prior_mean(model)
    assert compressed(model.structure, frozen) is frozen
    assert re.search(reason, why_not_compressed(model.structure, frozen))
