"""Steps of many rows: far below every sensor's noise, of sixth order, whatever acts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.high_rate import dense, thrown
from support.marks import LIKE_ANOTHER
from support.slews import SKEWED, J, start_with

import bayes_inertia
from bayes_inertia.campaign.actuators import GimballedRotors
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import DirectionSensor, InertiaPrior, RateSensor, Wheel
from bayes_inertia.campaign.inputs import InputStream
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.inference.likelihood import Point, residuals
from bayes_inertia.inference.noise_model import whitening
from bayes_inertia.maths import quaternion
from bayes_inertia.physics import forward_model
from bayes_inertia.physics.effects import (
    ConstantTorque,
    FlexibleMode,
    GravityGradient,
    MagneticDipole,
    RateSensorDelay,
    StarTrackerTimeOffset,
    ViscousTorque,
    WheelCommandLag,
    WheelFriction,
    WheelTorqueGain,
)
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.integration_plan import (
    IntegrationPlan,
    integration_plan,
    longest_smooth_step,
    motion_scales,
)
from bayes_inertia.physics.numerics import NUMERICS
from bayes_inertia.physics.packing import refined_grid
from bayes_inertia.physics.prediction import predict_all
from bayes_inertia.physics.simulator import simulate_slew
from bayes_inertia.physics.small_campaign import small_campaign

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"
ALLOWED = 0.01  # of the noise of each sensor


# Compiled in half the time: each program runs once.
QUICKLY = {"xla_backend_optimization_level": 0}
_predict = jax.jit(predict_all, static_argnums=0, compiler_options=QUICKLY)


def errors(monkeypatch, campaign, effects=(), drive=None, parts=1) -> tuple[int, list[float]]:
    """Rows a step, and the largest error of rate, attitude and momentum in units of their noise."""
    model = Model(campaign, effects, drive)
    plan = integration_plan(campaign, effects, model.drive)
    spacing = min(plan.spacing, min(float(np.diff(s.time).min()) for s in campaign.slews))
    fine = IntegrationPlan(spacing / parts * (1.0 + 1e-9), 1)
    with monkeypatch.context() as patch:
        patch.setattr(forward_model, "integration_plan", lambda *_: fine)
        exact = Model(campaign, effects, drive)
    theta = jnp.asarray(model.draw_prior(np.random.default_rng(3), 1)[0])
    local = jnp.zeros((model.n_slews, model.structure.n_local))
    ours, best = (_predict(m.structure, theta, local, jnp.zeros(3), m.data) for m in (model, exact))
    valid = np.arange(min(ours[0].shape[1], best[0].shape[1])) < np.array(
        [[len(s.time)] for s in campaign.slews]
    )

    def largest(gap: np.ndarray, sigma: float) -> float:
        return float(np.abs(gap[:, : valid.shape[1]])[valid].max(initial=0.0)) / sigma

    n, tracker = valid.shape[1], campaign.star_tracker
    found = [largest(np.asarray(ours[0])[:, :n] - best[0][:, :n], campaign.rate_sensor.sigma[0])]
    if tracker is not None:
        turn = np.asarray(quaternion.error(ours[1], best[1]))
        found.append(float(np.abs(turn).max()) / tracker.sigma_cross)
    if model.drive == "commanded":
        gap = np.asarray(ours[2])[:, :n] - best[2][:, :n]
        found.append(largest(gap, campaign.wheels[0].momentum_sigma))
    return plan.rows_per_step, found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("campaign", "drive"),
    [
        pytest.param(read_campaign(EXAMPLE), "commanded", marks=pytest.mark.long),
        pytest.param(read_campaign(EXAMPLE), "measured", marks=LIKE_ANOTHER),
        pytest.param(thrown(), "measured", marks=pytest.mark.long),
        (dense(), "commanded"),
    ],
    ids=["closed loop", "closed loop, measured", "throws", "bang and ripple"],
)
def test_steps_of_many_rows_stay_far_below_the_noise(monkeypatch, campaign, drive):
    rows, found = errors(monkeypatch, campaign, (), drive)
    assert rows >= 4
    assert max(found) < ALLOWED, found


@pytest.mark.slow
def test_steps_far_too_long_are_seen(monkeypatch):
    """The control: the error that the plan avoids is there."""
    campaign = read_campaign(EXAMPLE)
    long = IntegrationPlan(0.2500001, 96)
    exact = Model(campaign)
    with monkeypatch.context() as patch:
        patch.setattr(forward_model, "integration_plan", lambda *_: long)
        model = Model(campaign)
    local = jnp.zeros((model.n_slews, model.structure.n_local))
    theta = jnp.asarray(model.space.mean)
    rates = [
        np.asarray(_predict(m.structure, theta, local, jnp.zeros(3), m.data)[0])
        for m in (model, exact)
    ]
    n = min(len(s.time) for s in campaign.slews)
    assert np.abs(rates[0][:, :n] - rates[1][:, :n]).max() > ALLOWED * campaign.rate_sensor.sigma[0]


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["commanded", pytest.param("measured", marks=pytest.mark.long)])
@pytest.mark.parametrize(
    "effects",
    [
        pytest.param(
            (ConstantTorque(), ViscousTorque(), MagneticDipole(), GravityGradient()),
            marks=pytest.mark.long,
        ),
        pytest.param((FlexibleMode(frequency=0.05, frequency_spread=0.1),), marks=pytest.mark.long),
        (WheelCommandLag(), WheelTorqueGain(), RateSensorDelay(), StarTrackerTimeOffset()),
        pytest.param((WheelFriction(),), marks=pytest.mark.long),
    ],
    ids=["torques", "own states", "commands and sensors", "friction"],
)
def test_effects_are_integrated_as_well(monkeypatch, effects, drive):
    rows, found = errors(monkeypatch, dense(), effects, drive)
    assert rows > 1 or any(e.name == "wheel_friction" for e in effects)
    assert max(found) < ALLOWED, found


@pytest.mark.slow
def test_a_mode_of_the_largest_damping_that_its_prior_allows_is_simulated():
    """What is damped far more strongly is stiff: it has no number at steps of a slow motion."""
    model = Model(dense(), (FlexibleMode(frequency=0.004),))
    assert model.structure.rows_per_step > 1
    theta, (damping,) = model.space.mean, np.flatnonzero(model.space.upper == 1.0)
    theta[model.space.slice_of("flexible_mode")] = [0.5, -0.4, 0.1, 0.004, 1.0]
    assert damping == model.space.slice_of("flexible_mode").stop - 1
    at = Point(theta, np.zeros(model.n_bias), np.zeros((model.n_slews, model.structure.n_local)))
    assert all(np.isfinite(x).all() for x in _residuals(model, at))
    theta[damping] = 300.0
    stiff = replace(at, theta=theta)
    assert not all(np.isfinite(x).all() for x in _residuals(model, stiff))


def _residuals(model: Model, point: Point) -> list[np.ndarray]:
    found = residuals(model.structure, point, model.data, whitening(model, point.theta))
    return [np.asarray(x) for x in found]


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["commanded", pytest.param("measured", marks=LIKE_ANOTHER)])
def test_steps_and_rows_within_them_are_of_sixth_order(slew_of, drive):
    """Smooth drive; errors at all rows, those within steps too."""
    time, wheels = np.arange(0.0, 48.0, 0.125), 4
    shape = 0.05 * np.sin(np.outer(0.25 * time, np.arange(1, wheels + 1)) + np.arange(wheels))
    slew = slew_of(time, shape, SKEWED, np.full(wheels, 0.02), 8.0 * shape)

    run = jax.jit(simulate_slew, static_argnums=(4, 5), compiler_options=QUICKLY)

    def path(rows: int):
        return run(slew, start_with(wheels), jnp.asarray(J), None, drive, rows)[0]

    exact, sizes = path(1), np.array([16, 32])
    gaps = []
    for rows in sizes:
        ours = path(int(rows))
        turn = np.abs(np.asarray(quaternion.error(ours.attitude, exact.attitude))).max()
        gaps.append(max(turn, np.abs(np.asarray(ours.rate_B - exact.rate_B)).max()))
    order = np.log2(gaps[1] / gaps[0])
    assert order > 5.0, (order, gaps)
    assert gaps[0] < 1e-2


def test_gaps_in_the_telemetry_are_bridged_by_steps_short_enough():
    campaign = thrown()
    slews = tuple(
        replace(
            s,
            time=np.delete(s.time, slice(200, 400)),
            rate=np.delete(s.rate, slice(200, 400), axis=0),
            wheel_momentum=np.delete(s.wheel_momentum, slice(200, 400), axis=0),
        )
        for s in campaign.slews
    )
    gapped = replace(campaign, slews=slews)
    plan, whole = (integration_plan(c, (), "measured") for c in (gapped, campaign))
    assert plan.rows_per_step > 1
    grid, _ = refined_grid(slews[0].time, plan.spacing)
    steps = grid[:: plan.rows_per_step]
    assert np.diff(steps).max() < 1.5 * whole.spacing * whole.rows_per_step
    model = Model(gapped)
    assert model.data.arrays.slews.context.time.shape[1] % plan.rows_per_step == 0


def test_the_finest_of_all_sensors_decides_whichever_stands_first():
    small = small_campaign()
    slews = [replace(s, more={"gyro": s.rate, "eye": s.attitude}) for s in small.slews]
    coarse = replace(small.rate_sensor, sigma=(1e-2,) * 3)
    blurred = replace(small.star_tracker, sigma_cross=1e-2, sigma_roll=1e-2)

    def steps(gyros, trackers):
        campaign = replace(
            small,
            rate_sensor=gyros[0],
            star_tracker=trackers[0],
            more_sensors=(("gyro", gyros[1]), ("eye", trackers[1])),
            slews=tuple(slews),
        )
        return integration_plan(campaign, (), "commanded")

    gyros, trackers = (small.rate_sensor, coarse), (small.star_tracker, blurred)
    finest = steps(gyros, trackers)
    assert steps(gyros[::-1], trackers) == finest
    assert steps(gyros, trackers[::-1]) == finest
    assert steps((coarse, coarse), (blurred, blurred)).spacing > finest.spacing


def test_directions_are_seen_by_the_plan():
    small = small_campaign()
    slews = [replace(s, rate=None, more={"sun": s.position_N / 7e6}) for s in small.slews]
    seen = [
        integration_plan(
            replace(
                small,
                rate_sensor=None,
                star_tracker=replace(small.star_tracker, sigma_cross=1.0, sigma_roll=1.0),
                more_sensors=(("sun", DirectionSensor(sigma, (1.0, 0.0, 0.0))),),
                slews=tuple(slews),
            ),
            (),
            "commanded",
        ).spacing
        for sigma in (1e-4, 1.0)
    ]
    assert seen[0] < seen[1]


def nutating(time, rate, axes=None, **more):
    """A body that turns about its largest axis, 10, 1.2 and 9.5 kg m^2 [rad/s]."""
    axes = np.eye(3) if axes is None else axes
    devices = {key: more.pop(key) for key in ("wheels", "actuators") if key in more}
    prior, sensor = InertiaPrior(np.diag([10.0, 1.2, 9.5]), 0.05, 0.1), RateSensor(1e-5, axes=axes)
    slew = Slew("a", 0.0, time, rate=rate @ axes.T, **more)
    given = {"wheels": (), "rate_sensor": sensor, "star_tracker": None, "slews": (slew,)}
    return Campaign("c", prior, **given | devices)


def test_stored_momentum_is_seen_whatever_tells_it():
    """Tachometers on a clock of their own, or a rotor on a gimbal: as one in every row tells it."""
    time = np.arange(400.0) * 0.1
    rate = np.tile([0.5, 0.0, 0.01], (400, 1))
    wheel = (Wheel("z", (0, 0, 1), 1e-3, momentum_sigma=1e-3),)
    momentum = np.full((400, 1), 20.0)
    every_row = nutating(time, rate, wheels=wheel, wheel_momentum=momentum)
    both = np.sort(np.concatenate([time, time[::10] + 0.03]))
    known = np.isin(both, time)
    rates, readings = np.full((len(both), 3), np.nan), np.full((len(both), 1), np.nan)
    rates[known], readings[~known] = rate, 20.0
    own_clock = nutating(both, rates, wheels=wheel, wheel_momentum=readings)
    rotors = (GimballedRotors("cmg", 20.0, [[1, 0, 0]], [[0, 0, 1]]),)
    angles = {"cmg": InputStream(time, np.zeros((400, 1)), "line")}
    gimballed = nutating(time, rate, actuators=rotors, inputs=angles)
    wanted = motion_scales(every_row).frequency
    assert wanted > 2.0 * motion_scales(nutating(time, rate)).frequency
    assert motion_scales(own_clock).frequency == pytest.approx(wanted)
    assert motion_scales(gimballed).frequency == pytest.approx(wanted)


def test_how_a_gyro_is_mounted_changes_nothing_of_the_motion():
    time, rate = np.arange(400.0) * 0.1, np.tile([0.5, 0.0, 0.01], (400, 1))
    skewed = np.array([[1.0, 0, 0], [np.cos(0.2), np.sin(0.2), 0], [0, 0.6, 0.8]])
    wanted = motion_scales(nutating(time, rate))
    for axes in (np.eye(3)[[1, 2, 0]], skewed):
        np.testing.assert_allclose(motion_scales(nutating(time, rate, axes)), wanted)


def test_a_momentum_wheel_that_nothing_measures_may_hold_what_a_rotor_can():
    """Ten times the body's own momentum was the prior sd: a biased wheel began beyond it."""
    small, held = small_campaign(), 1.0
    wheel = replace(small.wheels[0], spin_inertia=2e-3, momentum_sigma=None, max_momentum=None)
    slews = tuple(
        replace(s, wheel_torque=s.wheel_torque[:, :1], wheel_momentum=None) for s in small.slews
    )
    campaign = replace(small, wheels=(wheel,), slews=slews)
    assert Model(campaign).data.scale.local[6] > held
    assert motion_scales(campaign).frequency > held / small.inertia.tensor.max()
    limited = replace(campaign, wheels=(replace(wheel, max_momentum=0.3),))
    assert Model(limited).data.scale.local[6] == 0.3


def test_steps_are_as_long_as_the_motion_allows_to_a_twentieth(monkeypatch):
    """Rows that are just near enough need no step between them."""
    campaign = small_campaign()
    motion = motion_scales(campaign)
    steps = [longest_smooth_step(campaign, motion._replace(turn=k)) for k in np.geomspace(1, 9, 40)]
    # The step allowed, not rounded down.
    monkeypatch.setattr(
        "bayes_inertia.physics.integration_plan.NUMERICS",
        replace(NUMERICS, steps_an_octave=10**6),
    )
    exact = [longest_smooth_step(campaign, motion._replace(turn=k)) for k in np.geomspace(1, 9, 40)]
    shares = np.array(steps) / exact
    assert shares.min() > 0.95
    assert shares.max() <= 1.0 + 1e-9
