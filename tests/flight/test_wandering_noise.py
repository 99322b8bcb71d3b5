"""Noise that is stated to wander is drawn: a simulated campaign is as loud as it says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayes_inertia.campaign.hardware import CorrelatedNoise, RateSensor
from bayes_inertia.campaign.sensors import stream_named
from bayes_inertia.campaign.sensors.rate import RATE
from bayes_inertia.flight.example_flight import flown_again
from bayes_inertia.flight.plan import paper_like_plan
from bayes_inertia.flight.plan_flight import fly
from bayes_inertia.flight.planned_telemetry import wandering_noise
from bayes_inertia.maths import quaternion
from bayes_inertia.physics.small_campaign import small_campaign

DRAWS = 4000


def of_gyro(**stated):
    campaign = small_campaign()
    return replace(campaign, rate_sensor=replace(campaign.rate_sensor, **stated))


def drawn(campaign):
    """The wandering noise of the gyro (draws, 3) in all rows, by their time in the campaign."""
    every = wandering_noise(campaign, RATE, np.random.default_rng(1), (DRAWS,))
    return np.concatenate(every), np.concatenate([s.start + s.time for s in campaign.slews])


def assert_variance(values, expected):
    """Within four of the standard errors that so many draws leave."""
    assert abs(np.var(values) / expected - 1.0) < 4.0 * np.sqrt(2.0 / values.size)


def test_a_stated_walk_goes_on_through_the_campaign_and_is_zero_in_its_middle():
    campaign = of_gyro(rate_random_walk=2e-6)
    noise, time = drawn(campaign)
    middle = 0.5 * sum(campaign.span)
    for row in (0, 70, len(time) - 1):
        assert_variance(noise[row], 2e-6**2 * abs(time[row] - middle))
    assert_variance(noise[100] - noise[10], 2e-6**2 * (time[100] - time[10]))


def test_stated_instability_and_measured_colour_last_as_long_as_is_said():
    for stated, variance, lasting in (
        ({"bias_instability": 3e-5, "bias_instability_time": 200.0}, 3e-5**2, 200.0),
        ({"correlated_noise": CorrelatedNoise(0.3, 5.0)}, 0.3 * 2e-5**2, 5.0),
    ):
        noise, time = drawn(of_gyro(**stated))
        assert_variance(noise[0], variance)
        assert_variance(noise[-1], variance)
        for row in (5, 90):
            kept = np.exp(-(time[row] - time[0]) / lasting)
            assert_variance(noise[row] - kept * noise[0], variance * (1.0 - kept**2))


def test_white_noise_alone_draws_nothing_more():
    assert wandering_noise(small_campaign(), RATE, np.random.default_rng(1)) is None


@pytest.mark.slow
def test_a_flight_has_the_noise_that_is_stated_to_wander(mission):
    """Its mean in a slew is far from the white noise's, 2e-5 rad/s over 20, and 5 arcseconds."""
    craft = mission.spacecraft
    gyro = replace(craft.rate_sensor, rate_random_walk=1e-6)
    tracker = replace(craft.star_tracker, low_frequency_sigma=1e-3)
    plan = replace(paper_like_plan(), telemetry_period=1.0)
    means, turns = [], []
    for flown in (craft, replace(craft, rate_sensor=gyro, star_tracker=tracker)):
        flight = fly(plan, replace(mission, spacecraft=flown), 3)
        pairs = list(zip(flight.campaign.slews, flight.truth, strict=True))
        K, bias = np.array(flown.scale_factor), np.array(flight.spacecraft.bias)
        means.append([np.mean(s.rate * K - path.rate_B - bias, axis=0) for s, path in pairs])
        turns.append(
            [
                np.asarray(quaternion.error(path.attitude[rows], s.attitude[rows])).mean(axis=0)
                for s, path in pairs
                for rows in np.split(np.flatnonzero(s.fixes), [12])
            ]
        )
    (quiet, walks), (sharp, turned) = np.abs(means), np.abs(turns)
    assert quiet.max() < 1e-5 < np.sqrt(np.mean(walks**2)) < 1e-4
    assert sharp.max() < 3e-4 < np.sqrt(np.mean(turned**2)) < 3e-3


@pytest.mark.slow
def test_slews_flown_again_have_the_noise_that_is_stated_to_wander():
    """Of first and further sensors, by the forward model; each tracker has an error of its own."""
    campaign = of_gyro(rate_random_walk=1e-5)
    tracker = replace(campaign.star_tracker, low_frequency_sigma=1e-2)
    mems = RateSensor(1e-4, bias_instability=1e-2, bias_instability_time=1e5)
    slews = (replace(s, more={"mems": s.rate, "second": s.attitude}) for s in campaign.slews)
    campaign = replace(
        campaign,
        star_tracker=tracker,
        more_sensors=(("mems", mems), ("second", tracker)),
        slews=tuple(slews),
    )
    flown, _ = flown_again(campaign, (), {}, 2, draw=False)
    for name, least in (("rate", 3e-5), ("mems", 2e-3), ("attitude", 1e-3), ("second", 1e-3)):
        stream = stream_named(name, campaign)
        off = [
            np.nanmean(stream.of(new) - stream.of(old), axis=0)[:3]
            for new, old in zip(flown.slews, campaign.slews, strict=True)
        ]
        assert np.sqrt(np.mean(np.square(off))) > least, name
