"""Noise of inputs, moved from the input to the readings of the rates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import bayes_inertia as bi
from bayes_inertia.diagnosis.linear_system import linear_model
from bayes_inertia.flight.mission import most_like_mission
from bayes_inertia.flight.plan import paper_like_plan
from bayes_inertia.flight.plan_flight import fly
from bayes_inertia.inference.input_noise import with_likely_inputs
from bayes_inertia.inference.optimizer import estimate, move_to
from bayes_inertia.physics import integration_plan
from bayes_inertia.physics.effects import RateSensorDelay
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.integration_plan import shapes_of_input_noise
from bayes_inertia.physics.small_campaign import small_campaign

SEED = 5
GENTLE = ((0.12, 0.02, 0.0), (0.0, 0.14, 0.04), (0.02, -0.04, 0.16))  # turns [rad]


@pytest.fixture(scope="module")
def loud(flying, setup_type):
    """A right campaign with loud tachometers, and the same with a thousandth of their noise."""
    setup = setup_type(turns=GENTLE, momentum_sigma=4e-5)
    quiet = flying(SEED, replace(setup, momentum_sigma=4e-8)).campaign
    return flying(SEED, setup).campaign, quiet


@pytest.fixture(scope="module")
def fits(loud):
    """Its fit where tachometers drive the model, before and after."""
    before = estimate(Model(loud[0], (), "measured"), starts=1)
    return before, with_likely_inputs(before)


def momenta(campaign) -> np.ndarray:
    return np.array([slew.wheel_momentum for slew in campaign.slews])


@pytest.mark.slow
def test_what_is_taken_out_of_an_input_is_its_noise(loud, fits):
    noise = momenta(loud[0]) - momenta(loud[1])
    taken = momenta(loud[0]) - momenta(fits[1].model.campaign)
    # A conditional mean: the noise along it is as large as itself, and what is left is at right
    # angles to it; white noise of as many numbers says how nearly.
    numbers, share = taken.size, np.var(taken) / np.var(noise)
    assert 0.2 < share < 0.6
    slope = np.sum(noise * taken) / np.sum(taken**2)
    assert abs(slope - 1.0) < 3.5 * np.sqrt((1.0 / share - 1.0) / numbers)


@pytest.mark.slow
def test_residuals_and_result_stay(fits):
    before, after = fits
    for one, other in zip(*(x.residual_series["rate"] for x in fits), strict=True):
        assert np.nanmax(np.abs(one - other)) < 0.1
    # The noise bends what J does, too: by part of an sd.
    assert np.all(np.abs(after.theta - before.theta) < 0.5 * before.sd)


@pytest.mark.long
@pytest.mark.slow
def test_no_delay_is_seen_in_a_right_campaign(fits):
    scores = []
    for fit in fits:
        model = Model(fit.model.campaign, (RateSensorDelay(),), "measured")
        system = linear_model(move_to(fit, model)).system
        scores.append(system.gradient[0] / np.sqrt(system.matrix[0, 0]))
    # Noise of tachometers in rates and in what a delay does to them looks like one.
    assert abs(scores[0]) > 5.0
    assert abs(scores[1]) < 3.0


@pytest.mark.long
@pytest.mark.slow
def test_noise_is_taken_out_once(fits):
    assert with_likely_inputs(fits[1]) is fits[1]


@pytest.mark.slow
def test_exact_inputs_are_left_alone(fits):
    exact = Model(fits[0].model.campaign, (), "commanded")
    assert with_likely_inputs(replace(fits[0], model=exact)).model is exact


def of_a_gyrostat(sigma: float) -> bi.Campaign:
    """Slews beside twenty times as much momentum in the wheels, and nothing but tachometers."""
    mission, plan = most_like_mission(), replace(paper_like_plan(), wheel_momentum=(1.0, -0.7, 0.8))
    wheels = tuple(
        replace(wheel, max_momentum=None, momentum_sigma=sigma)
        for wheel in mission.spacecraft.wheels
    )
    mission = replace(mission, spacecraft=replace(mission.spacecraft, wheels=wheels))
    campaign = fly(plan, mission, 3).campaign
    slews = tuple(replace(slew, wheel_torque=None) for slew in campaign.slews)
    return replace(campaign, slews=slews)


@pytest.mark.slow
@pytest.mark.parametrize("of_nutation", [True, False])
def test_noise_at_the_nutation_adds_up_in_the_attitude(monkeypatch, of_nutation):
    """Without its shapes the model misses the rates: the body rings at that frequency."""
    if not of_nutation:
        limits = replace(integration_plan.NUMERICS, nutation_margin=-1e6)
        monkeypatch.setattr(integration_plan, "NUMERICS", limits)
    campaign = of_a_gyrostat(3e-5)
    tests = bi.estimate(bi.Model(campaign), starts=1).tests
    assert tests["rate"].too_large != of_nutation


def test_shapes_follow_the_nutation():
    usual = shapes_of_input_noise(small_campaign())
    campaign = of_a_gyrostat(1e-6)
    J1, J2, J3 = np.linalg.eigvalsh(campaign.inertia.tensor)
    shapes = shapes_of_input_noise(campaign)
    assert usual.tolist() == [list(range(12))] * len(usual)
    for slew, numbers in zip(campaign.slews, shapes.tolist(), strict=True):
        M = np.linalg.norm(slew.wheel_momentum[0])
        slowest, fastest = (M / np.sqrt(x) * slew.duration / np.pi for x in (J2 * J3, J1 * J2))
        assert {*range(12), *range(round(slowest), round(fastest) + 1)} <= {*numbers}
