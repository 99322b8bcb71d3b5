"""The white noise is measured, and nothing else is taken for it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_inertia.campaign.hardware import DirectionSensor
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.cleaning import noise_factors
from bayes_inertia.inference.noise_colour import white_factor
from bayes_inertia.inference.treatment import with_measured_noise
from bayes_inertia.physics.effects import RateSensorNonlinearity
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.small_campaign import small_campaign


def noise(n, *sigmas, seed=3):
    return np.random.default_rng(seed).normal(size=(n, len(sigmas))) * sigmas


@pytest.mark.parametrize("sigma", [1.0, 1.5, 3.0])
def test_noise_of_all_axes_is_measured(sigma):
    n, trials = 600, 40
    found = [white_factor([noise(n, sigma, sigma, sigma, seed=k)]) for k in range(trials)]
    # Power from second differences scatters by sqrt(3.9 / number).
    error = sigma * 0.5 * np.sqrt(3.9 / (3 * n) / trials)
    assert abs(np.mean(found) - sigma) < 5.0 * error + (0.002 if sigma == 1.0 else 0.0)


def test_one_loud_axis_counts_in_full():
    found = white_factor([noise(600, 1.0, 1.0, 3.0)])
    assert abs(found - 3.0) < 5.0 * 3.0 * 0.5 * np.sqrt(3.9 / 600)
    pooled = np.sqrt((1.0 + 1.0 + 9.0) / 3.0)
    assert found > 1.3 * pooled  # which would leave the loud axis unexplained


def test_one_loud_slew_counts_in_full():
    slews = [noise(300, 1.0, 1.0, 1.0, seed=k) for k in range(5)]
    assert white_factor(slews) == 1.0
    slews[2] *= 2.0
    assert abs(white_factor(slews) - 2.0) < 5.0 * 2.0 * 0.5 * np.sqrt(3.9 / 900)


def test_noise_that_grows_with_the_reading_counts_as_where_readings_are_large():
    reading = np.sin(np.linspace(0.0, np.pi, 300))[:, None] * [1.0, 0.1, 0.1]
    large = [np.abs(reading) > 0.5 * np.abs(reading).max(0)] * 5
    slews = [noise(300, 1.0, 1.0, 1.0, seed=k) for k in range(5)]
    assert white_factor(slews, large) == 1.0
    louder = [slew * (1.0 + 2.0 * reading) for slew in slews]
    # Power 1 + 2 sin from 30 to 150 degrees, squared and averaged.
    expected = np.sqrt(np.mean((1.0 + 2.0 * reading[large[0][:, 0], 0]) ** 2))
    error = expected * 0.5 * np.sqrt(3.9 / (5 * 198))
    assert abs(white_factor(louder, large) - expected) < 5.0 * error
    assert white_factor(louder) < expected - 5.0 * error  # who does not look there


def test_the_noise_of_two_fixes_at_rest_is_measured_from_their_difference():
    pairs = [noise(2, 1.0, 1.0, 1.0, seed=k) + 20.0 * k for k in range(10)]
    assert white_factor(pairs) == 1.0
    loud = white_factor([3.0 * pair for pair in pairs])
    assert abs(loud - 3.0) < 5.0 * 3.0 * 0.5 * np.sqrt(2.0 / 30)
    assert white_factor([20.0 * fix[:1] for fix in pairs]) == 1.0  # alone it tells nothing


@pytest.mark.filterwarnings("error")
def test_readings_that_mostly_repeat_are_as_loud_as_they_are():
    # Three wheels idle, one three times as loud as stated.
    assert abs(white_factor([noise(600, 0.0, 0.0, 0.0, 3.0)]) - 3.0) < 0.5
    assert white_factor([noise(600, 0.0, 0.0, 0.0, 1.0)]) == 1.0
    assert white_factor([noise(600, 0.0, 0.0)]) == 1.0
    # A coarse counter: steps of 8 sigma, most differences zero.
    counts = 8.0 * np.round(noise(5000, 3.0, seed=1) / 8.0)
    assert (np.diff(counts, n=2, axis=0) == 0.0).mean() > 0.5
    assert abs(white_factor([counts]) / counts.std() - 1.0) < 0.2
    # A single jump is none of the noise.
    counts = np.zeros((600, 1))
    counts[300:] = 5.0
    assert white_factor([counts]) == 1.0


def test_a_ringing_of_one_axis_is_not_its_noise():
    ringing = np.sin(2.0 * np.pi * 0.15 * np.arange(600.0))[:, None] * [0.0, 4.0, 0.0]
    assert white_factor([noise(600, 1.0, 1.0, 1.0) + ringing]) < 1.4


def test_what_differs_between_the_fixes_before_and_after_a_slew_is_not_noise():
    time = np.concatenate([np.arange(3.0), 100.0 + np.arange(3.0)])
    jump = np.where(time > 50.0, 20.0, 0.0)[:, None]
    rows = [noise(6, 1.0, 1.0, 1.0, seed=k) + jump for k in range(12)]
    slews = [SimpleNamespace(time=time, fixes=np.ones(6, bool)) for _ in rows]
    calm = {
        "rate": [noise(400, 1.0, 1.0, 1.0)],
        "attitude": rows,
        "momentum": [noise(400, 1.0, 1.0, 1.0)],
    }
    fixes = SimpleNamespace(
        name="attitude",
        stream=SimpleNamespace(is_series=False),
        readings=lambda campaign, slew: SimpleNamespace(row=np.flatnonzero(slew.fixes)),
    )
    model = SimpleNamespace(campaign=SimpleNamespace(slews=slews), channels=(fixes,))

    def leaving(series):
        return SimpleNamespace(tested_residuals=SimpleNamespace(series=series), model=model)

    assert noise_factors(leaving(calm)) == {"rate": 1.0, "attitude": 1.0, "momentum": 1.0}
    assert white_factor(rows) > 3.0  # taken across the gap it would be noise
    loud = calm | {"attitude": [3.0 * r for r in rows]}
    assert noise_factors(leaving(loud))["attitude"] == pytest.approx(3.0, rel=0.5)


def test_in_the_measured_drive_tachometers_are_as_loud_as_the_residuals_they_cause():
    campaign = small_campaign()
    factors = {"rate": 2.0, "attitude": 1.0, "momentum": 1.0}
    assert (
        with_measured_noise(campaign, factors, "measured").wheels[0].momentum_sigma
        == 2.0 * campaign.wheels[0].momentum_sigma
    )
    assert (
        with_measured_noise(campaign, factors, "commanded").wheels[0].momentum_sigma
        == campaign.wheels[0].momentum_sigma
    )


def test_a_reading_outside_the_range_sets_no_priors():
    campaign = small_campaign()
    ranged = replace(campaign, rate_sensor=replace(campaign.rate_sensor, range=1.0))
    rate = ranged.slews[0].rate.copy()
    rate[7, 1] = 99.9
    spoilt = replace(ranged, slews=(replace(ranged.slews[0], rate=rate), *ranged.slews[1:]))
    assert spoilt.scale_of_motion() == pytest.approx(ranged.scale_of_motion(), rel=0.02)
    sd = [RateSensorNonlinearity().parameters(c)[0].priors[0].sd for c in (spoilt, ranged)]
    assert sd[0] == pytest.approx(sd[1], rel=1e-9)


def test_the_level_of_a_sun_sensor_is_measured_too(flown):
    """Two angles make one direction: its readings have three numbers and no size."""
    towards, rng = np.array([0.0, 0.6, 0.8]), np.random.default_rng(4)

    def watched(slew):
        n = len(slew.time)
        seen_B = towards + 0.01 * rng.normal(size=(n, 3))
        return replace(slew, more={"sun": seen_B})

    slews = tuple(map(watched, flown.campaign.slews))
    sun = ("sun", DirectionSensor(0.01, tuple(towards)))
    campaign = replace(flown.campaign, slews=slews, more_sensors=(sun,))
    levels = noise_factors(optimizer.estimate(Model(campaign), starts=1, discount=False))
    assert set(levels) == {"rate", "attitude", "momentum", "sun"}
