"""Tachometers slower than the rates: what the wheels did in between is estimated along."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import bayes_inertia as bi
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.inference.optimizer import move_to
from bayes_inertia.physics.channel_noise import ChannelNoise, NoiseModel
from bayes_inertia.physics.effects import by_name
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.numerics import NUMERICS
from bayes_inertia.physics.simulator import simulate_slew
from bayes_inertia.physics.slew_input import Start, idle_slew
from bayes_inertia.physics.slow_tachometers import free_momentum
from bayes_inertia.physics.small_campaign import small_campaign

EVERY = 40  # rows of the rates to one reading of the tachometers


@pytest.fixture(scope="module")
def slow() -> Campaign:
    """Five smooth slews, rates at 4 Hz and tachometers at 0.1 Hz, no commands in the telemetry."""
    small, rng = small_campaign(), np.random.default_rng(8)
    J = np.array(small.inertia.tensor)
    time = np.arange(0.0, 80.25, 0.25)
    turns = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, -1, -1), (1, -1, 0.6)]
    slews = []
    for i, axis in enumerate(turns):
        s = np.clip((time - 10.0) / 60.0, 0.0, 1.0)
        torque = -2e-3 * np.sin(2.0 * np.pi * s)[:, None] * (J @ np.array(axis)) / 2.0
        torque = torque + 1.5e-5 * rng.normal(size=torque.shape)
        flown = idle_slew(
            time, wheel_axes_B=np.eye(3), spin_inertia=np.full(3, 1e-3), torque=torque
        )
        begin = Start(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.array([0.05, -0.04, 0.06]))
        path = simulate_slew(flown, begin, J)[0]
        rate = np.asarray(path.rate_B) + 2e-5 * rng.normal(size=(len(time), 3))
        momentum = np.asarray(path.wheel_momentum) + 5e-6 * rng.normal(size=(len(time), 3))
        momentum[np.arange(len(time)) % EVERY > 0] = np.nan
        slews.append(Slew(f"slew {i}", 300.0 * i, time, rate=rate, wheel_momentum=momentum))
    return replace(small, slews=tuple(slews))


@pytest.mark.long
@pytest.mark.slow
def test_the_finest_of_all_gyros_judges_lines_between_slow_readings(slow):
    """Beside a first gyro of noise too large to see what lines miss."""
    coarse = replace(slow, rate_sensor=replace(slow.rate_sensor, sigma=(2e-2,) * 3))
    assert free_momentum(coarse) is None
    slews = tuple(replace(slew, more={"fine": slew.rate}) for slew in slow.slews)
    both = replace(coarse, slews=slews, more_sensors=(("fine", slow.rate_sensor),))
    assert free_momentum(both) is not None


@pytest.mark.slow
def test_momentum_is_free_between_slow_readings_only(slow):
    free = free_momentum(slow)
    assert free is not None
    slew = slow.slews[0]
    grid = slew.time - slew.time[0]
    lines, shapes = free.on_grid(slew, grid)
    read = np.isfinite(slew.wheel_momentum[:, 0])
    np.testing.assert_allclose(lines[read], slew.wheel_momentum[read], atol=1e-12)
    np.testing.assert_allclose(shapes[read], 0.0, atol=1e-12)
    assert free.columns == 8 * free.inner
    assert np.abs(shapes).max() >= 1.0 - 1e-9


def test_knots_of_long_slews_are_free_where_the_wheels_speed_up():
    """160 intervals between readings; the wheel speeds up and slows down in 20 of them."""
    time = np.arange(0.0, 160.05, 0.1)
    moving = (time > 40.0) & (time < 60.0)
    h = np.sin(np.pi * (time - 40.0) / 20.0) ** 2 * (0.02 + 1e-3 * np.sin(3.0 * time)) * moving
    read = (np.arange(len(time)) % 10 == 0)[:, None]
    noise = 1e-6 * np.random.default_rng(3).normal(size=(len(time), 1))
    wheel = small_campaign().wheels[0]
    slew = Slew(
        "long",
        0.0,
        time,
        rate=2e-5 * np.random.default_rng(4).normal(size=(len(time), 3)) - h[:, None] / 2.0,
        wheel_momentum=np.where(read, h[:, None] + noise, np.nan),
    )
    wheels = (replace(wheel, momentum_sigma=1e-6),)
    free = free_momentum(replace(small_campaign(), slews=(slew,), wheels=wheels))
    assert free is not None
    assert free.columns == NUMERICS.most_free_knots // free.inner * free.inner
    lines, shapes = free.on_grid(slew, time)
    bent = moving & (np.abs(time - 50.0) < 9.0)
    assert (np.abs(shapes).max(axis=1)[bent & ~read[:, 0]] > 0.05).all()
    # Coefficients of the knots bring the spline to the momentum; without them it is far off.
    found = np.linalg.lstsq(shapes, h - lines[:, 0], rcond=None)[0]
    assert np.abs(h - lines[:, 0])[bent].max() > 50.0 * 1e-6
    assert np.std((h - lines[:, 0] - shapes @ found)[bent]) < 0.3 * np.std((h - lines[:, 0])[bent])
    assert np.abs(h - lines[:, 0])[time < 35.0].max() < 6e-6


@pytest.mark.slow
def test_fast_tachometers_are_left_as_they_are(slow):
    rng = np.random.default_rng(1)
    fast = tuple(
        replace(s, wheel_momentum=0.05 + 5e-6 * rng.normal(size=(len(s.time), 3)))
        for s in slow.slews
    )
    assert free_momentum(replace(slow, slews=fast)) is None
    still = tuple(
        replace(s, wheel_momentum=np.where(np.isfinite(s.wheel_momentum), f.wheel_momentum, np.nan))
        for s, f in zip(slow.slews, fast, strict=True)
    )
    # Slow, but a line is as good as the readings.
    assert free_momentum(replace(slow, slews=still)) is None


@pytest.mark.long
@pytest.mark.slow
def test_the_tensor_is_right_and_good_rates_are_no_outliers(slow):
    estimate = bi.estimate(Model(slow))
    truth = slow.inertia.elements
    z = (estimate.theta[:6] - truth) / estimate.sd[:6]
    assert np.abs(z).max() < 3.5
    rate = estimate.tests["rate"]
    assert not rate.rejected
    assert abs(rate.reduced_chi2 - 1.0) < 0.06
    assert estimate.sd[0] / truth[0] < 2e-3
    # In a model with an effect that is held at none, as in a diagnosis, residuals are the same.
    with_effect = move_to(estimate, Model(slow, by_name(["inertia_change"])))
    assert with_effect.tests["rate"].reduced_chi2 == pytest.approx(rate.reduced_chi2, abs=0.02)


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize(
    "noise",
    [
        ChannelNoise("student_t", degrees=30.0),
        ChannelNoise(scale_sampled=True),
    ],
)
def test_noise_that_is_not_as_stated_is_judged_as_well(slow, noise):
    rate = bi.estimate(Model(slow, noise=NoiseModel(rate=noise)), starts=1).tests["rate"]
    assert not rate.too_large


def test_the_tachometer_that_is_read_least_says_how_well_the_mean_is_known(slow):
    """Beside one in every row: the slow one's noise was taken for that of a mean of them all."""
    slew = slow.slews[0]
    momentum = np.array(slew.wheel_momentum)
    momentum[:, 0] = np.interp(slew.time, slew.time[::EVERY], momentum[::EVERY, 0])
    model = Model(replace(slow, slews=(replace(slew, wheel_momentum=momentum),)), drive="measured")
    modes = np.asarray(model.data.arrays.telemetry.tachometer_shapes)
    read = np.isfinite(momentum[:, 1]).sum()
    np.testing.assert_allclose(modes[0, :, 0], read**-0.5)
