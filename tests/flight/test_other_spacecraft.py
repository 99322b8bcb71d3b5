"""Plans of spacecraft that thrusters or gimballed rotors turn, or that fly by other sensors."""

from __future__ import annotations

import math
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from support.other_spacecraft import (
    ROTORS,
    THRUSTERS,
    by_rotors,
    by_thrusters,
    gyroless,
    two_axes_and_vectors,
)

from bayes_inertia.campaign.actuators import GimballedRotors, Thruster
from bayes_inertia.errors import CampaignError
from bayes_inertia.flight.example_flight import flown_again
from bayes_inertia.flight.mission import Mission, following_plan, spacecraft_at, why_no_plans
from bayes_inertia.flight.plan import PlannedSlew
from bayes_inertia.flight.plan_file import read_plan, write_plan
from bayes_inertia.flight.plan_flight import fly
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import truth_of, with_hidden_effects
from bayes_inertia.flight.steering import directions_B
from bayes_inertia.maths import quaternion
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.small_campaign import small_campaign

SLEWS = (
    PlannedSlew((1.0, 2.0, -1.0), math.radians(30.0)),
    PlannedSlew((0.0, -1.0, 1.0), math.radians(20.0)),
)


def plan_of(campaign):
    base = following_plan(campaign)
    return replace(base, slews=SLEWS, telemetry_period=1.0, rest_before=10.0, settle=8.0)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [by_thrusters, pytest.param(by_rotors, marks=pytest.mark.long)])
def test_the_input_of_a_device_turns_the_model_as_planned(kind):
    campaign = kind()
    mission, plan = Mission.of(campaign), plan_of(campaign)
    planned = planned_campaign(plan, mission)
    model = Model(planned)
    told = model.predict(model.space.mean[None])["attitude"][0]
    for seen, target in zip(told, plan.attitudes[1:], strict=True):
        last = seen[np.isfinite(seen).all(axis=1)][-1]
        off = quaternion.error(jnp.asarray(target), jnp.asarray(last))
        assert np.linalg.norm(off) < 1e-3 * SLEWS[1].angle


def test_thrusters_give_the_torque_that_is_asked_for_with_levels_they_can_have():
    device = spacecraft_of(by_thrusters()).device.array
    wanted_B = np.random.default_rng(3).normal(size=(20, 3)) * 0.3
    levels = np.asarray(device.inputs(jnp.asarray(wanted_B)))
    assert levels.min() >= 0.0
    assert levels.max() <= 1.0
    np.testing.assert_allclose(levels @ THRUSTERS, wanted_B, atol=1e-9)


def test_what_a_device_can_give_is_the_most_over_all_its_inputs():
    rng = np.random.default_rng(5)
    for campaign in (by_thrusters(), by_rotors()):
        device = spacecraft_of(campaign).device
        if device.carries_momentum:
            angles = rng.uniform(-np.pi, np.pi, (4000, len(ROTORS)))
            given = np.asarray(device.array.given_B(angles))
        else:
            given = rng.integers(0, 2, (4000, len(THRUSTERS))) @ THRUSTERS
        reached = (given @ directions_B().T).max(axis=0)
        assert np.all(reached <= device.reach * (1.0 + 1e-9))
        assert np.median(reached / device.reach) > 0.7


def spacecraft_of(campaign):
    return Mission.of(campaign).spacecraft


def test_nothing_flies_a_free_body_and_one_sentence_says_so():
    campaign = replace(by_thrusters(), actuators=())
    assert why_no_plans(campaign).endswith("nothing on board turns it")
    with pytest.raises(CampaignError, match="no slew to design"):
        Mission.of(campaign)


def test_thrusters_in_one_plane_turn_two_axes():
    flat = THRUSTERS[:, [0, 1, 2]] * [1.0, 1.0, 0.0]
    campaign = replace(by_thrusters(), actuators=(Thruster("jets", flat),))
    assert spacecraft_of(campaign).axes_of_control == 2


def test_parallel_gimbals_turn_two_axes():
    gimbals, spins = np.tile([0.0, 0.0, 1.0], (4, 1)), np.tile([1.0, 0.0, 0.0], (4, 1))
    rotors = GimballedRotors("cmg", 1.0, gimbals, spins)
    campaign = replace(by_rotors(), actuators=(rotors,))
    assert spacecraft_of(campaign).axes_of_control == 2


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", [pytest.param(gyroless, marks=pytest.mark.long), two_axes_and_vectors]
)
def test_every_sensor_of_the_campaign_tells_of_a_flight(kind, tmp_path):
    campaign = kind()
    mission, plan = Mission.of(campaign), plan_of(campaign)
    assert read_plan(write_plan(plan, tmp_path / "plan.toml")) == plan
    flight = fly(plan, mission, 4)
    assert flight.campaign.sensors.keys() == campaign.sensors.keys()
    model = Model(flight.campaign)
    read = [channel.name for channel in model.channels if channel.is_read(flight.campaign)]
    assert read == [c.name for c in Model(campaign).channels if c.is_read(campaign)]
    theta = np.array([flight.parameters[name] for name in model.space.names])
    np.testing.assert_allclose(theta[: model.n_base], mission.theta)


@pytest.mark.slow
def test_a_flight_that_follows_its_plan_is_measured_where_effects_leave_it():
    """It said that every slew ended on its target."""
    campaign = gyroless()
    plan = plan_of(campaign)
    still = fly(plan, Mission.of(campaign), 4)
    pushed = with_hidden_effects(Mission.of(campaign), plan, ["constant_torque.torque=1e-4,0,0"], 1)
    flight = fly(plan, pushed, 4)
    assert np.all(still.final_error_B == 0.0)
    assert np.all(np.isnan(flight.final_error_B))
    assert truth_of(flight)["slews"][0]["final_error_B_rad"] == [None, None, None]
    assert still.correction_slews.max() < 1e-3 < flight.correction_slews.min()


@pytest.mark.slow
def test_noise_of_gimbal_angles_is_drawn_once_on_the_angles():
    """Rates that it had shaken too were twice as noisy as the campaign says."""
    campaign = by_rotors()
    loud = (replace(campaign.actuators[0], angle_sigma=3e-3),)
    campaign = replace(campaign, actuators=loud)
    flight = fly(plan_of(campaign), Mission.of(campaign), 4)
    again, _ = flown_again(flight.campaign, (), {}, 5, draw=False)
    for before, slew, path in zip(flight.campaign.slews, again.slews, flight.truth, strict=True):
        noise = np.std(before.rate - path.rate_B, axis=0)
        assert np.all(noise < 2.0 * np.array(campaign.gyro.sigma))
        told = slew.inputs["cmg"].values - before.inputs["cmg"].values
        # The scatter of an sd from n numbers is a share of 1 / sqrt(2 n).
        assert np.std(told) == pytest.approx(3e-3, rel=4.0 / np.sqrt(2.0 * told.size))


def test_wheels_fly_where_they_turn_all_axes_though_thrusters_could():
    campaign = small_campaign()
    device = by_thrusters().actuators
    slews = (
        replace(slew, inputs=other.inputs)
        for slew, other in zip(campaign.slews, by_thrusters().slews, strict=True)
    )
    both = replace(campaign, actuators=device, slews=tuple(slews))
    theta = np.array([*campaign.inertia.elements, 1.0, 1.0, 1.0])
    assert spacecraft_at(both, theta).device is None
