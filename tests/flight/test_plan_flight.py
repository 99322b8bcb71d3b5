"""Flights in closed loop: momentum, final errors, limits, seeds, and an independent simulator."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest

import bayes_inertia
from bayes_inertia.campaign.hardware import Wheel
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.design.limits import Limits
from bayes_inertia.design.margins import flown_margins, planned_margins
from bayes_inertia.errors import BayesInertiaError, CampaignError, EffectError
from bayes_inertia.flight.mission import devices_at_rest, following_plan, spacecraft_at
from bayes_inertia.flight.plan import Plan, PlannedSlew, paper_like_plan
from bayes_inertia.flight.plan_flight import Flight, fly
from bayes_inertia.flight.spacecraft import (
    Controller,
)
from bayes_inertia.maths import quaternion
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.parameters import Normal, scalar
from bayes_inertia.physics.small_campaign import small_campaign

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"
ARCSECOND = math.radians(1.0 / 3600.0)
DIAGONAL = np.array([1.0, -2.0, 2.0]) / 3.0


@pytest.fixture(scope="module")
def expert(craft) -> Controller:
    return Controller(craft.inertia_B, craft.scale_factor)


@pytest.fixture(scope="module")
def noisy(mission) -> Flight:
    return fly(paper_like_plan(), mission, 11)


def test_momentum_is_conserved_and_the_pause_keeps_it(noisy, craft):
    locked = craft.inertia_B + np.diag([w.spin_inertia for w in craft.wheels])
    totals = []
    for path in noisy.truth:
        total_B = path.rate_B @ locked + path.wheel_momentum @ craft.wheel_axes_B.T
        total_N = np.asarray(
            quaternion.to_inertial(jnp.asarray(path.attitude), jnp.asarray(total_B))
        )
        assert np.abs(total_N - total_N[0]).max() < 1e-13
        totals.append(total_N[0])
    # Between slews only the residual rate and aim of the rest differ: 1e-5 rad/s and 5e-5 rad, of 3
    # kg m^2 and 0.1 N m s.
    assert np.ptp(totals, axis=0).max() < 10 * (3.3 * 1e-5 + 0.1 * 5e-5)
    assert np.linalg.norm(totals[0]) > 0.05


def test_with_perfect_knowledge_the_final_error_is_below_an_arcsecond(mission, expert):
    flight = fly(paper_like_plan(), mission, None, controller=expert)
    assert np.abs(flight.final_error_B).max() < ARCSECOND
    assert np.abs(flight.measured_error_B).max() < ARCSECOND


def test_noise_leaves_the_error_that_the_bias_snapshot_makes(mission, craft, expert):
    plan = paper_like_plan()
    errors = np.concatenate(
        [fly(plan, mission, seed, controller=expert).final_error_B for seed in range(12)]
    )
    # After the settling time the believed attitude is on target; the true one misses it by the
    # snapshot's error, integrated since the last fixes, by readings of white noise, and by the mean
    # of the fixes.
    sensor, period = craft.rate_sensor.sigma[0], plan.telemetry_period
    lasting = np.array(plan.durations) - 13.5
    expected = np.sqrt(
        (lasting * sensor) ** 2 * period / expert.snapshot_time + lasting * period * sensor**2
    )
    expected = np.sqrt(
        np.tile(expected, 12)[:, None] ** 2
        + np.array([craft.star_tracker.sigma_cross] * 2 + [craft.star_tracker.sigma_roll]) ** 2 / 12
    )
    chi2 = np.sum((errors / expected) ** 2)
    # A slew turns part of one axis' error into another's and scales it by 1/K: a few per cent of
    # the variance.
    assert abs(chi2 / errors.size - 1.0) < 4.0 * math.sqrt(2.0 / errors.size) + 0.05


@pytest.mark.slow
@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), tuple(DIAGONAL)])
def test_scale_factor_error_stays_in_the_final_attitude(mission, craft, axis):
    """The controller believes w_hat = K_c K^-1 w.

    So it turns by exp(D axis angle), D = K K_c^-1.
    """
    plan = Plan("one", (PlannedSlew(axis, math.radians(40.0)),))
    sizes = []
    for scale in (0.005, 0.01, 0.02):
        believed = np.array(craft.scale_factor) / (1.0 + scale * np.array([1.0, -0.5, 2.0]))
        controller = Controller(craft.inertia_B, tuple(believed))
        flight = fly(plan, mission, None, controller=controller)
        turn = plan.slews[0].angle * np.array(axis)
        D = np.array(craft.scale_factor) / believed
        closed_form = np.asarray(
            quaternion.error(
                quaternion.exp(jnp.asarray(turn)), quaternion.exp(jnp.asarray(D * turn))
            )
        )
        size = np.linalg.norm(closed_form)
        np.testing.assert_allclose(flight.final_error_B[0], closed_form, atol=3e-3 * size)
        sizes.append(np.linalg.norm(flight.final_error_B[0]))
    np.testing.assert_allclose(sizes / sizes[0], [1.0, 2.0, 4.0], rtol=0.01)


def test_commands_stay_within_the_wheels_limits(mission, craft):
    weak = replace(craft, wheels=tuple(replace(w, max_torque=0.002) for w in craft.wheels))
    flight = fly(paper_like_plan(), replace(mission, spacecraft=weak), 1)
    commands = np.concatenate([s.wheel_torque for s in flight.campaign.slews])
    assert np.abs(commands).max() <= 0.002 * (1 + 1e-12)
    assert flight.peak_torque.max() == pytest.approx(1.0, abs=1e-12)
    assert np.all(flight.peak_momentum < 1.0)
    assert np.all(flight.peak_momentum > 0.0)


def test_same_seed_same_campaign(mission, noisy):
    again = fly(paper_like_plan(), mission, 11)
    another = fly(paper_like_plan(), mission, 12)
    for a, b, c in zip(
        noisy.campaign.slews, again.campaign.slews, another.campaign.slews, strict=True
    ):
        for key in ("rate", "attitude", "wheel_torque", "wheel_momentum"):
            np.testing.assert_array_equal(getattr(a, key), getattr(b, key))
            assert not np.array_equal(getattr(a, key), getattr(c, key), equal_nan=True)


@dataclass(frozen=True)
class Push(Effect):
    """A torque about x, as an outsider would write it."""

    name: ClassVar[str] = "push"

    def parameters(self, campaign):
        return (scalar("torque", unit="N m", prior=Normal(0.0, 1e-5)),)

    def body_torque(self, p, slew, t, state):
        return p["torque"] * jnp.array([1.0, 0.0, 0.0])


@dataclass(frozen=True)
class Runaway(Effect):
    """Wheels that deliver many times what is commanded, with the wrong sign."""

    name: ClassVar[str] = "runaway"

    def delivered_torque(self, p, slew, torque):
        return -50.0 * torque


@pytest.mark.slow
def test_an_outsiders_effect_flies(mission, craft, expert):
    plan = Plan("one", (PlannedSlew((0.0, 0.0, 1.0), math.radians(20.0)),))
    pushed = replace(craft, effects=(Push(),), values={"push": {"torque": 1e-4}})
    flight = fly(plan, replace(mission, spacecraft=pushed), None, controller=expert)
    gained = flight.truth[0].wheel_momentum[-1] - flight.truth[0].wheel_momentum[0]
    # At rest again, the wheels hold the impulse 1e-4 N m * duration, turned from the inertial axes
    # into the body's.
    assert np.linalg.norm(gained) == pytest.approx(
        1e-4 * np.linalg.norm(mean_x_axis(flight) * plan.durations[0]), rel=0.02
    )


def mean_x_axis(flight: Flight) -> np.ndarray:
    attitude = jnp.asarray(flight.truth[0].attitude)
    return np.asarray(
        quaternion.to_inertial(
            attitude, jnp.broadcast_to(jnp.array([1.0, 0.0, 0.0]), (len(attitude), 3))
        )
    ).mean(axis=0)


def test_what_cannot_be_flown_is_said(mission, craft):
    plan = Plan("one", (PlannedSlew((0.0, 0.0, 1.0), math.radians(20.0)),))
    with pytest.raises(EffectError, match="has no values"):
        replace(craft, effects=(Push(),))
    for given, says in (
        ({"effects": ("magnetic_dipol",)}, "no effect of this name: 'magnetic_dipol'; perhaps mag"),
        ({"effects": ("magnetic_dipole",)}, "magnetic_dipole: has no values"),
        ({"wheels": (0.1,)}, "wheels: a float is no Wheel; give a Wheel"),
        ({"rate_sensor": 2e-5}, "rate_sensor: a float is no RateSensor"),
        ({"star_tracker": 1e-5}, "star_tracker: a float is no StarTracker"),
    ):
        with pytest.raises(BayesInertiaError, match=says):
            replace(craft, **given)
    dipole = replace(craft, effects=("magnetic_dipole",), values={"magnetic_dipole": {}})
    with pytest.raises(EffectError, match=r"give the plan an \[orbit\]"):
        fly(plan, replace(mission, spacecraft=dipole), 0)
    with pytest.raises(CampaignError, match="2 momenta for 3 wheels"):
        fly(replace(plan, wheel_momentum=(0.1, 0.1)), mission, 0)


@pytest.mark.slow
def test_a_closed_loop_that_is_not_stable_is_said(mission, craft):
    plan = Plan("one", (PlannedSlew((0.0, 0.0, 1.0), math.radians(20.0)),))
    unlimited = tuple(replace(w, max_torque=None) for w in craft.wheels)
    wild = replace(craft, wheels=unlimited, effects=(Runaway(),), values={"runaway": {}})
    with pytest.raises(EffectError, match="slew 1: the closed loop is not stable"):
        fly(plan, replace(mission, spacecraft=wild), 0)


def test_agrees_in_kind_with_an_independent_simulator(noisy):
    independent = read_campaign(EXAMPLE)
    truth = np.array([0.01, 0.02, -0.02])
    for i, (ours, theirs) in enumerate(zip(noisy.campaign.slews, independent.slews, strict=True)):
        assert ours.duration == pytest.approx(theirs.duration, abs=1e-6)
        peak = [np.linalg.norm(s.rate, axis=1).max() for s in (ours, theirs)]
        assert peak[0] == pytest.approx(peak[1], rel=0.01)
        torque = [np.abs(s.wheel_torque).max() for s in (ours, theirs)]
        assert torque[0] == pytest.approx(torque[1], rel=0.05)
        start = [s.wheel_momentum[0] for s in (ours, theirs)]
        np.testing.assert_allclose(start[0], start[1], atol=1e-4)
        errors = [measured_error(s) for s in (ours, theirs)]
        scale = np.linalg.norm(truth * ours.angle * np.array(ours.axis_B))
        # The same scale factors, another bias snapshot: within a few per cent of the error itself.
        np.testing.assert_allclose(errors[0], errors[1], atol=0.1 * scale, err_msg=f"slew {i + 1}")


def measured_error(slew) -> np.ndarray:
    fixes = np.flatnonzero(np.isfinite(slew.attitude).all(axis=1))
    first, last = (
        jnp.asarray(slew.attitude[rows])
        for rows in (fixes[slew.time[fixes] < 20.0], fixes[slew.time[fixes] > 20.0])
    )
    mean = jnp.mean(first * jnp.sign(first @ first[0])[:, None], axis=0)
    start = mean / jnp.linalg.norm(mean)
    goal = quaternion.multiply(start, quaternion.exp(slew.angle * jnp.asarray(slew.axis_B)))
    return np.asarray(quaternion.error(goal, last)).mean(axis=0)


def test_a_locked_wheel_is_a_part_of_the_body_that_flies():
    campaign = small_campaign()
    state = (*campaign.wheels[:2], replace(campaign.wheels[2], state="locked"))
    campaign = replace(campaign, wheels=state)
    theta = np.array([*campaign.inertia.elements, 1.0, 1.0, 1.0])
    craft = spacecraft_at(campaign, theta)
    assert [wheel.name for wheel in craft.wheels] == ["x", "y"]
    np.testing.assert_array_equal(craft.inertia_B, campaign.inertia.tensor)
    assert len(following_plan(campaign).wheel_momentum) == 2
    assert devices_at_rest(campaign)[0].endswith("left out: z")
    undriven = replace(campaign, wheels=tuple(replace(w, state="free") for w in campaign.wheels))
    with pytest.raises(CampaignError, match="no slew to design"):
        spacecraft_at(undriven, theta)


@pytest.mark.slow
def test_a_wheel_that_spins_freely_keeps_its_momentum_and_the_others_turn_the_body(mission, craft):
    free = Wheel("skew", tuple(DIAGONAL), 2e-3, state="free")
    craft = replace(craft, wheels=(*craft.wheels, free))
    plan = replace(paper_like_plan(), wheel_momentum=(0.02, 0.01, -0.01, 0.06))
    flight = fly(plan, replace(mission, spacecraft=craft), 3)
    for slew, path in zip(flight.campaign.slews, flight.truth, strict=True):
        assert not slew.wheel_torque[:, 3].any()
        absolute = path.wheel_momentum[:, 3] + 2e-3 * path.rate_B @ DIAGONAL
        assert np.ptp(absolute) < 1e-12
    asked = [margin.used for margin in planned_margins(plan, craft, Limits())]
    flown = [margin.used for margin in flown_margins(flight, Limits())]
    assert flown == pytest.approx(asked, rel=0.15)
