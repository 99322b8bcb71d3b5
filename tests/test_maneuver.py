"""Closed-loop slews: physics, agreement with the model that is fitted to them, and with an independent simulator."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.errors import CampaignError, EffectError, OutputError
from bayes_inertia.flight.closed_loop import fly_slew
from bayes_inertia.flight.closed_loop_inputs import closed_loop_inputs
from bayes_inertia.flight.final_errors import predict_correction_slew, predict_final_errors
from bayes_inertia.flight.mission import Mission, most_like_mission
from bayes_inertia.flight.plan import Plan, PlannedSlew, angle_and_rate, paper_like_plan
from bayes_inertia.flight.plan_file import read_plan, write_plan
from bayes_inertia.flight.plan_flight import Flight, fly
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_flight, draw_spacecraft, simulate
from bayes_inertia.flight.spacecraft import (
    Controller,
    Spacecraft,
    most_like_prior,
)
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.maths import inertia_tensor, quaternion
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import (
    ConstantTorque,
    FlexibleMode,
    MagneticDipole,
    RateSensorDelay,
    StarTrackerMisalignment,
    WheelCommandLag,
)
from bayes_inertia.physics.forward_model import Model, predict
from bayes_inertia.physics.packing import Reference
from bayes_inertia.physics.parameters import Normal, scalar

CLEAN = Path(__file__).resolve().parents[2] / "shared" / "data" / "basilisk" / "clean"
ARCSECOND = math.radians(1.0 / 3600.0)
DIAGONAL = np.array([1.0, -2.0, 2.0]) / 3.0


@pytest.fixture(scope="module")
def mission() -> Mission:
    return most_like_mission()


@pytest.fixture(scope="module")
def craft(mission) -> Spacecraft:
    return mission.spacecraft


@pytest.fixture(scope="module")
def novice(mission) -> Controller:
    """A controller that knows no more than was known before flight."""
    return mission.controller()


@pytest.fixture(scope="module")
def expert(craft) -> Controller:
    return Controller(craft.inertia_B, craft.scale_factor)


@pytest.fixture(scope="module")
def noisy(mission) -> Flight:
    return fly(paper_like_plan(), mission, 11)


def theta_of(craft: Spacecraft) -> np.ndarray:
    return np.concatenate(
        [inertia_tensor.elements(jnp.asarray(craft.inertia_B)), craft.scale_factor]
    )


# --- plans ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("profile", ["trapezoid", "smooth"])
@pytest.mark.parametrize("degrees", [2.0, 45.0])
def test_profile_turns_the_angle_within_its_limits(profile, degrees):
    slew = PlannedSlew((0.0, 1.0, 0.0), math.radians(degrees), profile=profile)
    t = jnp.linspace(-5.0, slew.motion_time + 5.0, 20001)
    angle, rate = angle_and_rate(slew.angle, slew.rate, slew.acceleration, profile == "smooth", t)
    assert angle[0] == 0.0
    assert angle[-1] == pytest.approx(slew.angle, rel=1e-12)
    assert float(rate.max()) <= slew.rate * (1 + 1e-12)
    step = float(t[1] - t[0])
    # The second difference of an angle whose rate is linear by parts is its mean acceleration; rounding of the angle over step^2 remains.
    assert float(jnp.abs(jnp.diff(rate)).max()) / step <= slew.acceleration * (1 + 1e-6)
    trapezoid_rule = float(jnp.sum(0.5 * (rate[1:] + rate[:-1])) * step)
    assert trapezoid_rule == pytest.approx(slew.angle, rel=1e-6)
    before_end = angle_and_rate(
        slew.angle,
        slew.rate,
        slew.acceleration,
        profile == "smooth",
        jnp.asarray(slew.motion_time - 0.5),
    )
    assert float(before_end[1]) > 0.0


def test_paper_like_plan_is_the_one_flown_in_basilisk():
    if not CLEAN.exists():
        pytest.skip("../shared/data/basilisk/clean is absent")
    plan, flown = paper_like_plan(), read_campaign(CLEAN)
    np.testing.assert_allclose(plan.starts, [s.start for s in flown.slews], atol=1e-9)
    for i, (slew, other) in enumerate(zip(plan.slews, flown.slews, strict=True)):
        np.testing.assert_allclose(slew.axis_B, other.axis_B, atol=1e-6)
        assert slew.angle == pytest.approx(other.angle, rel=1e-9)
        np.testing.assert_allclose(plan.times(i), other.time, atol=1e-9)
        fixes = np.flatnonzero(np.isfinite(other.attitude).all(axis=1))
        np.testing.assert_array_equal(np.concatenate(plan.fixes(i)), fixes)


def test_plan_file_round_trip(tmp_path):
    plan = replace(
        paper_like_plan(),
        slews=(PlannedSlew((1.0, 2.0, 3.0), 0.3, 0.02, 5e-4, "smooth", 140.0),),
        orbit=None,
        pause=0.0,
    )
    path = write_plan(plan, tmp_path / "plan.toml")
    again = read_plan(path)
    assert again.slews[0].axis_B == plan.slews[0].axis_B
    assert again.slews[0].angle == pytest.approx(plan.slews[0].angle, rel=1e-15)
    assert replace(again, slews=plan.slews) == plan
    write_plan(plan, path)  # the same content is not in its own way
    with pytest.raises(OutputError, match="would overwrite"):
        write_plan(paper_like_plan(), path)
    write_plan(paper_like_plan(), path, overwrite=True)
    assert read_plan(path) == paper_like_plan()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "angle_deg",
            "angle_degree",
            r'slews\[1 of 5\]\.angle_degree: unknown key; did you mean "angle_deg"\?',
        ),
        ("angle_deg = 30.0", "angle_deg = -30.0", "turn|positive"),
        ("angle_deg = 30.0", 'angle_deg = "30"', "is not a finite number"),
        ("angle_deg = 30.0\n", "", "missing key"),
        ('profile = "trapezoid"', 'profile = "square"', "choose trapezoid or smooth"),
        ("settle_s = 33.0", "settle_s = 33.0.0", r"line \d+: not valid TOML"),
        ("rest_before_s = 20.0", "rest_before_s = 20.1", "multiple of telemetry_period"),
        ("bayes-inertia-plan/1", "bayes-inertia-plan/2", "write format"),
    ],
)
def test_plan_file_errors_say_where(tmp_path, old, new, message):
    path = write_plan(paper_like_plan(), tmp_path / "plan.toml")
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(CampaignError, match=message) as caught:
        read_plan(path)
    assert str(path) in str(caught.value)


# --- physics -------------------------------------------------------------------------------------


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
    # Between slews only the residual rate and aim of the rest differ: 1e-5 rad/s and 5e-5 rad, of 3 kg m^2 and 0.1 N m s.
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
    # After the settling time the believed attitude is on target; the true one misses it by the snapshot's error, integrated
    # since the last fixes, by readings of white noise, and by the mean of the fixes.
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
    # A slew turns part of one axis' error into another's and scales it by 1/K: a few per cent of the variance.
    assert abs(chi2 / errors.size - 1.0) < 4.0 * math.sqrt(2.0 / errors.size) + 0.05


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), tuple(DIAGONAL)])
def test_scale_factor_error_stays_in_the_final_attitude(mission, craft, axis):
    """The controller believes w_hat = K_c K^-1 w; so it turns about the axis D axis, D = K K_c^-1, by exp(D axis angle)."""
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
    other = fly(paper_like_plan(), mission, 12)
    for a, b, c in zip(
        noisy.campaign.slews, again.campaign.slews, other.campaign.slews, strict=True
    ):
        for key in ("rate", "attitude", "wheel_torque", "wheel_momentum"):
            np.testing.assert_array_equal(getattr(a, key), getattr(b, key))
            assert not np.array_equal(getattr(a, key), getattr(c, key), equal_nan=True)


# --- the model that is fitted ----------------------------------------------------------------------


def _predicted_minus_flown(
    flight: Flight, effects: tuple[Effect, ...]
) -> tuple[float, float, float]:
    """Largest difference of rate, momentum and attitude between a noise-free flight and the model at the truth."""
    craft, model = flight.spacecraft, Model(flight.campaign, effects)
    extra = [
        np.atleast_1d(craft.values[e.name][p.name])
        for e in effects
        for p in e.parameters(flight.campaign)
    ]
    theta = jnp.asarray(np.concatenate([theta_of(craft), *extra]))
    truth = Reference(
        *(
            jnp.stack([getattr(x, key)[0] for x in flight.truth])
            for key in ("rate_B", "attitude", "wheel_momentum")
        )
    )
    bias = (jnp.asarray(craft.bias) - model.data.sensors.bias) / model.data.scale.bias
    nothing = jnp.zeros(model.structure.n_local)

    def one(slew, telemetry, reference):
        return predict(
            model.structure, theta, nothing, bias, slew, telemetry, reference, model.data
        )

    telemetry = model.data.arrays.telemetry
    predicted = jax.jit(jax.vmap(one))(model.data.arrays.slews, telemetry, truth)
    rate = np.where(telemetry.rate_valid, predicted.rate - telemetry.rate, 0.0)
    momentum = np.where(telemetry.momentum_valid, predicted.momentum - telemetry.momentum, 0.0)
    attitude = np.where(
        np.asarray(telemetry.fix_valid)[..., None],
        quaternion.error(predicted.attitude, telemetry.attitude),
        0.0,
    )
    return np.abs(rate).max(), np.abs(momentum).max(), np.abs(attitude).max()


def test_the_model_reproduces_a_flight_exactly(mission):
    flight = fly(paper_like_plan(), mission, None)
    assert max(_predicted_minus_flown(flight, ())) < 1e-13


@pytest.mark.slow
def test_the_model_reproduces_effects_inside_and_around_the_loop(mission):
    """In-step hooks, own states on a refined grid, an environment, and three whole-history hooks at once."""
    effects = (
        FlexibleMode(),
        MagneticDipole(),
        WheelCommandLag(),
        RateSensorDelay(),
        StarTrackerMisalignment(),
    )
    plan = replace(paper_like_plan(), slews=(PlannedSlew(tuple(DIAGONAL), math.radians(30.0)),))
    template = planned_campaign(plan, mission)
    hidden = draw_spacecraft(template, np.random.default_rng(4), effects)
    flight = fly(plan, replace(mission, spacecraft=hidden), None)
    # The relaxation ends at 1e-9 of the largest command, 3e-3 N m; over 60 s on 2 kg m^2 that is 3e-9 rad at the very most.
    assert max(_predicted_minus_flown(flight, effects)) < 3e-9
    plain = fly(plan, flight.mission.without_effects(), None)
    assert np.abs(plain.campaign.slews[0].rate - flight.campaign.slews[0].rate).max() > 1e-5


def test_estimate_recovers_the_truth(noisy, craft):
    found = estimate(Model(noisy.campaign), seed=0)
    sd = np.sqrt(np.diag(found.covariance))
    z = (found.theta - theta_of(craft)) / sd
    # A product of nine correlated normals: the squared Mahalanobis distance is chi^2 with 9 degrees of freedom, 0.9999 quantile 33.7.
    distance = (found.theta - theta_of(craft)) @ np.linalg.solve(
        found.covariance, found.theta - theta_of(craft)
    )
    assert distance < 33.7, z
    prior = np.concatenate([most_like_prior().sd, craft.rate_sensor.scale_factor_sigma])
    assert np.all(sd[[0, 1, 2, 6, 7, 8]] < 0.25 * prior[[0, 1, 2, 6, 7, 8]])


# --- hidden effects and errors -----------------------------------------------------------------------


@dataclass(frozen=True)
class _Push(Effect):
    """A torque about x, as an outsider would write it."""

    name: ClassVar[str] = "push"

    def parameters(self, campaign):
        return (scalar("torque", unit="N m", prior=Normal(0.0, 1e-5)),)

    def body_torque(self, p, slew, t, state):
        return p["torque"] * jnp.array([1.0, 0.0, 0.0])


@dataclass(frozen=True)
class _Runaway(Effect):
    """Wheels that deliver many times what is commanded, with the wrong sign."""

    name: ClassVar[str] = "runaway"

    def delivered_torque(self, p, slew, torque):
        return -50.0 * torque


def test_an_outsiders_effect_flies(mission, craft, expert):
    plan = Plan("one", (PlannedSlew((0.0, 0.0, 1.0), math.radians(20.0)),))
    pushed = replace(craft, effects=(_Push(),), values={"push": {"torque": 1e-4}})
    flight = fly(plan, replace(mission, spacecraft=pushed), None, controller=expert)
    gained = flight.truth[0].wheel_momentum[-1] - flight.truth[0].wheel_momentum[0]
    # At rest again, the wheels hold the impulse 1e-4 N m * duration, turned from the inertial axes into the body's.
    assert np.linalg.norm(gained) == pytest.approx(
        1e-4 * np.linalg.norm(_mean_axis(flight) * plan.durations[0]), rel=0.02
    )


def _mean_axis(flight: Flight) -> np.ndarray:
    attitude = jnp.asarray(flight.truth[0].attitude)
    return np.asarray(
        quaternion.to_inertial(
            attitude, jnp.broadcast_to(jnp.array([1.0, 0.0, 0.0]), (len(attitude), 3))
        )
    ).mean(axis=0)


def test_what_cannot_be_flown_is_said(mission, craft):
    plan = Plan("one", (PlannedSlew((0.0, 0.0, 1.0), math.radians(20.0)),))
    with pytest.raises(EffectError, match="has no values"):
        replace(craft, effects=(_Push(),))
    with pytest.raises(EffectError, match=r"give the plan an \[orbit\]"):
        dipole = replace(craft, effects=(MagneticDipole(),), values={"magnetic_dipole": {}})
        fly(plan, replace(mission, spacecraft=dipole), 0)
    unlimited = tuple(replace(w, max_torque=None) for w in craft.wheels)
    with pytest.raises(EffectError, match="slew 1: the closed loop is not stable"):
        wild = replace(craft, wheels=unlimited, effects=(_Runaway(),), values={"runaway": {}})
        fly(plan, replace(mission, spacecraft=wild), 0)
    with pytest.raises(CampaignError, match="2 momenta for 3 wheels"):
        fly(replace(plan, wheel_momentum=(0.1, 0.1)), mission, 0)


# --- correction slews --------------------------------------------------------------------------------


def test_correction_slews_shrink_with_knowledge_of_the_scale_factors(mission, craft, novice):
    """Ferguson's 38 degree slew: thousands of arc seconds before the estimate, fewer after; K decides, not J."""
    plan = Plan("38 degrees", (PlannedSlew(tuple(DIAGONAL), math.radians(38.0)),))
    rng = np.random.default_rng(3)
    prior, truth = most_like_prior(), theta_of(craft)
    elements = rng.normal(prior.elements, prior.sd, (200, 6))
    wide = np.concatenate([elements, rng.normal(1.0, 0.03, (200, 3))], axis=1)
    angles = predict_correction_slew(wide, plan, mission, novice)
    turn = plan.slews[0].angle * DIAGONAL
    closed_form = np.asarray(
        quaternion.error(
            quaternion.exp(jnp.asarray(turn)), quaternion.exp(jnp.asarray(wide[:, 6:] * turn))
        )
    )
    np.testing.assert_allclose(angles, np.linalg.norm(closed_form, axis=1), rtol=0.05, atol=2e-4)
    narrow = np.concatenate([elements, rng.normal(truth[6:], 0.001, (200, 3))], axis=1)
    informed = Controller(craft.inertia_B, tuple(truth[6:]))
    assert np.median(predict_correction_slew(narrow, plan, mission, informed)) < 0.1 * np.median(
        angles
    )
    assert np.median(angles) > 500 * ARCSECOND


def test_predictions_are_flights(mission, craft, novice):
    plan = paper_like_plan()
    flight = fly(plan, mission, None)
    predicted = predict_final_errors(mission.theta[None], plan, mission, novice, index=4)
    np.testing.assert_allclose(predicted[0], flight.final_error_B[4], atol=1e-12)
    locked = Mission(craft, replace(mission.prior, includes_wheel_spin=True))
    same = predict_final_errors(locked.theta[None], plan, locked, novice, index=4)
    np.testing.assert_allclose(same[0], flight.final_error_B[4], atol=1e-12)
    pushed = replace(
        craft,
        effects=(ConstantTorque(),),
        values={"constant_torque": {"torque": np.array([0.0, 0.0, 5e-5])}},
    )
    draws = np.tile(theta_of(craft), (2, 1))
    own = predict_final_errors(draws, plan, replace(mission, spacecraft=pushed), novice, index=4)
    drawn = {"constant_torque": {"torque": np.array([[0.0, 0.0, 5e-5], [0.0, 0.0, 0.0]])}}
    each = predict_final_errors(
        draws, plan, replace(mission, spacecraft=pushed), novice, index=4, values=drawn
    )
    np.testing.assert_allclose(each[0], own[0], atol=1e-12)
    np.testing.assert_allclose(each[1], flight.final_error_B[4], atol=1e-9)
    assert np.max(np.abs(own[0] - flight.final_error_B[4])) > 5 * ARCSECOND
    noisy = predict_final_errors(
        np.tile(theta_of(craft), (50, 1)), plan, mission, novice, index=4, seed=1
    )
    assert np.all(noisy.std(axis=0) > 5 * ARCSECOND)


# --- campaigns in files and studies ------------------------------------------------------------------


def test_simulated_campaign_is_written_with_its_truth(mission, craft, tmp_path):
    flight = simulate(paper_like_plan(), mission, tmp_path / "run", 5)
    again = read_campaign(tmp_path / "run")
    for a, b in zip(flight.campaign.slews, again.slews, strict=True):
        for key in (
            "time",
            "rate",
            "attitude",
            "wheel_torque",
            "wheel_momentum",
            "magnetic_field_N",
            "position_N",
        ):
            np.testing.assert_array_equal(getattr(a, key), getattr(b, key))
    truth = json.loads((tmp_path / "run" / "truth.json").read_text())
    np.testing.assert_array_equal(truth["J_kgm2"], craft.inertia_B)
    np.testing.assert_array_equal(truth["b_radps"], flight.spacecraft.bias)
    assert truth["seed"] == 5
    if CLEAN.exists():
        assert set(json.loads((CLEAN / "truth.json").read_text())) - set(truth) <= {
            "bdot_radps2",
            "star_tracker_rotation_B",
            "star_tracker_shift_B",
            "vary",
            "integration_dt_s",
        }
    simulate(paper_like_plan(), mission, tmp_path / "run", 5)
    with pytest.raises(OutputError, match="overwrite"):
        simulate(paper_like_plan(), mission, tmp_path / "run", 6)


def test_studies_draw_truth_from_the_prior(mission, craft):
    template = planned_campaign(paper_like_plan(), mission)
    rng = np.random.default_rng(8)
    drawn = np.array(
        [
            np.concatenate([theta_of(c), c.bias])
            for c in (draw_spacecraft(template, rng) for _ in range(300))
        ]
    )
    sensor, prior = craft.rate_sensor, most_like_prior()
    mean = np.concatenate([prior.elements, sensor.scale_factor, sensor.bias])
    sd = np.concatenate([prior.sd, sensor.scale_factor_sigma, sensor.bias_sigma])
    # The prior's tensor is far from the edge of the physical ones, so that hardly any draw is refused. Four sigma of 24 numbers.
    assert np.all(np.abs(drawn.mean(axis=0) - mean) < 4.0 * sd / math.sqrt(300))
    assert np.all(np.abs(drawn.std(axis=0) / sd - 1.0) < 4.0 / math.sqrt(600))


def test_studies_vary_the_slews_and_keep_their_length(mission):
    template = planned_campaign(paper_like_plan(), mission)
    flights = [draw_flight(template, paper_like_plan(), seed) for seed in (1, 2)]
    lengths = {len(s.time) for f in flights for s in f.campaign.slews}
    assert len(lengths) == 1
    angles = np.array([[s.angle for s in f.campaign.slews] for f in flights])
    assert len(np.unique(angles)) == angles.size
    assert angles.min() >= math.radians(20.0)
    assert angles.max() <= math.radians(60.0)
    repeated = draw_flight(template, paper_like_plan(), 2)
    np.testing.assert_array_equal(
        repeated.campaign.slews[3].rate, flights[1].campaign.slews[3].rate
    )


def test_agrees_in_kind_with_an_independent_simulator(noisy):
    if not CLEAN.exists():
        pytest.skip("../shared/data/basilisk/clean is absent")
    other = read_campaign(CLEAN)
    truth = np.array([0.01, 0.02, -0.02])
    for i, (mine, theirs) in enumerate(zip(noisy.campaign.slews, other.slews, strict=True)):
        assert mine.duration == pytest.approx(theirs.duration, abs=1e-6)
        peak = [np.linalg.norm(s.rate, axis=1).max() for s in (mine, theirs)]
        assert peak[0] == pytest.approx(peak[1], rel=0.01)
        torque = [np.abs(s.wheel_torque).max() for s in (mine, theirs)]
        assert torque[0] == pytest.approx(torque[1], rel=0.05)
        start = [s.wheel_momentum[0] for s in (mine, theirs)]
        np.testing.assert_allclose(start[0], start[1], atol=1e-4)
        errors = [_seen(s) for s in (mine, theirs)]
        scale = np.linalg.norm(truth * mine.angle * np.array(mine.axis_B))
        # The same scale factors, another bias snapshot: within a few per cent of the error itself.
        np.testing.assert_allclose(errors[0], errors[1], atol=0.1 * scale, err_msg=f"slew {i + 1}")


def _seen(slew) -> np.ndarray:
    fixes = np.flatnonzero(np.isfinite(slew.attitude).all(axis=1))
    first, last = (
        jnp.asarray(slew.attitude[rows])
        for rows in (fixes[slew.time[fixes] < 20.0], fixes[slew.time[fixes] > 20.0])
    )
    start = quaternion.normalise(jnp.mean(first * jnp.sign(first @ first[0])[:, None], axis=0))
    goal = quaternion.multiply(start, quaternion.exp(slew.angle * jnp.asarray(slew.axis_B)))
    return np.asarray(quaternion.error(goal, last)).mean(axis=0)


@pytest.mark.slow
def test_gradient_of_the_final_error_with_respect_to_the_slew(mission, craft):
    """Slew design differentiates through a flight: reverse mode against a finite difference."""
    plan = Plan("one", (PlannedSlew((1.0, 0.0, 0.0), math.radians(20.0)),))
    inputs = closed_loop_inputs(plan, mission).of_slew(0)

    def error(angle):
        schedule = inputs.schedules._replace(angle=angle)
        flown = fly_slew(
            inputs.slews, schedule, inputs.plant, inputs.law, inputs.noise, inputs.active
        )
        return flown.final_error_B[0]

    angle, step = 0.35, 1e-4
    error_and_slope = jax.jit(jax.value_and_grad(error))
    difference = float(error_and_slope(angle + step)[0] - error_and_slope(angle - step)[0]) / (
        2 * step
    )
    assert float(error_and_slope(angle)[1]) == pytest.approx(difference, rel=1e-3)
    assert difference == pytest.approx(0.01, rel=0.05)  # the error of K along x
