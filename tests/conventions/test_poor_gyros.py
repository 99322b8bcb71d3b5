"""A gyro of any number of axes is checked; an honest poor one, or none, is not accused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.marks import LIKE_ANOTHER

import bayes_inertia
from bayes_inertia.campaign.hardware import RateSensor
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.conventions.check import check_conventions
from bayes_inertia.conventions.laws import misfits_of
from bayes_inertia.conventions.motion import accumulated, matrix_to_start, of_angle
from bayes_inertia.physics.integration_plan import motion_scales

NOISES = (0.001, 0.005, 0.02, 0.05, 0.2)


@pytest.fixture(scope="module")
def good(flying, setup_type):
    return flying(6, setup_type(rows=320, dt=0.25)).campaign


@pytest.fixture(scope="module")
def example():
    return read_campaign(Path(bayes_inertia.__file__).parent / "example")


def louder(campaign, sigma, seed=1):
    """The campaign with honest noise of another size on all axes."""
    rng = np.random.default_rng(seed)
    slews = (
        replace(slew, rate=slew.rate + sigma * rng.normal(size=slew.rate.shape))
        for slew in campaign.slews
    )
    sensor = replace(campaign.rate_sensor, sigma=(sigma,), range=None)
    sensor = replace(sensor, sigma=(sigma,) * 3)
    return replace(campaign, rate_sensor=sensor, slews=tuple(slews))


def gyroless(campaign):
    slews = tuple(replace(slew, rate=None) for slew in campaign.slews)
    return replace(campaign, rate_sensor=None, slews=slews)


@pytest.mark.parametrize("sigma", NOISES)
def test_noise_of_a_poor_gyro_is_not_taken_for_motion(good, sigma):
    poor = louder(good, sigma)
    true, found = motion_scales(good), motion_scales(poor)
    assert 0.5 * true.frequency < found.frequency < 2.5 * true.frequency
    assert poor.scale_of_motion()[0] == pytest.approx(good.scale_of_motion()[0], rel=0.3)


@pytest.mark.parametrize("sigma", NOISES)
def test_the_doctor_counts_the_noise_that_rates_add_up_to(good, sigma):
    check = check_conventions(louder(good, sigma), quick=True)
    assert check.verdict == "consistent", check.sentence


def test_a_wrong_sign_of_the_wheels_is_found_without_a_gyro(flying, setup_type):
    setup = setup_type(fix_rows=tuple(range(96)))
    campaign = gyroless(flying(6, setup).campaign)
    assert check_conventions(campaign, quick=True).verdict == "consistent"
    slews = tuple(
        replace(s, wheel_torque=-s.wheel_torque, wheel_momentum=-s.wheel_momentum)
        for s in campaign.slews
    )
    check = check_conventions(replace(campaign, slews=slews), quick=True)
    assert check.verdict == "wrong"
    assert not any(change.key.startswith("columns.rate") for change in check.changes)


def test_a_good_gyro_is_taken_as_it_is(good):
    assert good.with_body_rates is good


SKEWED = np.array([[1, 1, 1], [-1, 1, 1], [-1, -1, 1], [1, -1, 1]]) / np.sqrt(3.0)
AXES = {"two axes": np.eye(3)[:2], "four skewed axes": SKEWED}


def with_axes(campaign, axes, misread):
    """The campaign, whose gyro has other axes (n, 3), and readings (rows, n) as misread."""
    own, rng = campaign.gyro, np.random.default_rng(1)
    sensor = RateSensor(own.sigma[0], axes, bias_sigma=own.bias_sigma[0])
    slews = []
    for slew in campaign.slews:
        readings = slew.rate @ axes.T
        readings += own.sigma[0] * rng.normal(size=readings.shape)
        slews.append(replace(slew, rate=misread(readings)))
    return replace(campaign, rate_sensor=sensor, slews=tuple(slews))


MISREAD = {
    "in another unit": (lambda w: np.degrees(w), "rate.unit", "deg/s"),
    "exchanged": (lambda w: w[:, [1, 0, *range(2, w.shape[1])]], "rate.names", None),
    "with a wrong sign": (lambda w: w * np.where(np.arange(w.shape[1]), 1, -1), None, None),
}


@pytest.mark.parametrize("axes", AXES.values(), ids=AXES)
def test_right_readings_of_any_axes_are_not_accused(example, axes):
    check = check_conventions(with_axes(example, axes, lambda w: w), quick=True)
    assert check.verdict == "consistent", check.sentence


@pytest.mark.parametrize("wrong", MISREAD.values(), ids=MISREAD)
@pytest.mark.parametrize("axes", AXES.values(), ids=AXES)
def test_a_wrong_key_of_a_gyro_of_any_axes_is_named(example, axes, wrong):
    misread, key, mended = wrong
    first = check_conventions(with_axes(example, axes, misread), quick=True).changes[0]
    if key is None:  # The axis of the reading is turned round.
        key, mended = "axes", [(-axes[0]).tolist(), *axes[1:].tolist()]
        np.testing.assert_allclose(first.mended, mended, atol=1e-9)
    elif key == "rate.names":
        names = [f"rate_{i + 1}" for i in range(len(axes))]
        assert first.mended == [names[1], names[0], *names[2:]]
    else:
        assert first.mended == mended
    assert first.key == f"sensors.rate sensor.{key}"


def test_what_no_axis_reads_is_as_doubtful_as_all_sensors_leave_it(example):
    """Else right campaigns of much stored momentum are accused: wheels alone tell it poorly."""
    campaign = with_axes(example, AXES["two axes"], lambda w: w)
    misfits = misfits_of(campaign)
    unread = campaign.with_body_rates.gyro.sigma
    assert unread[2] > 10.0 * campaign.gyro.sigma[0]
    np.testing.assert_allclose(misfits.noise["rate"][2:], unread)
    assert misfits.own_axes == 2


def test_fixes_at_rest_pull_no_rate_that_only_the_wheels_tell(example):
    """About the axis that a gyro of two axes lacks, slews turn as the wheels say."""
    full = example.gyro
    numbers = ("sigma", "scale_factor", "scale_factor_sigma", "bias", "bias_sigma")
    pair = {name: getattr(full, name)[:2] for name in numbers}
    slews = tuple(replace(slew, rate=slew.rate[:, :2]) for slew in example.slews)
    sensor = replace(full, axes=full.axes[:2], **pair)
    smoothed = replace(example, rate_sensor=sensor, slews=slews).with_body_rates
    for slew, other in zip(example.slews, smoothed.slews, strict=True):
        turned, told = (np.trapezoid(s.rate, s.time, axis=0) for s in (slew, other))
        np.testing.assert_allclose(told[2], turned[2], atol=0.15)  # J is wrong by 4 %


def with_stored_momentum(campaign, times):
    """The same motion with momentum stored in the wheels, so many times their largest.

    It keeps its direction in inertial axes, so that the wheels carry it round the body.
    """
    largest = max(np.abs(slew.wheel_momentum).max() for slew in campaign.slews)
    stored = times * largest * np.array([0.3, -0.5, 0.8])
    slews = []
    for slew in campaign.slews:
        steps = 0.5 * (slew.rate[1:] + slew.rate[:-1]) * np.diff(slew.time)[:, None]
        path = np.concatenate([[[0.0, 0.0, 0.0, 1.0]], accumulated(of_angle(steps))])
        in_body = np.einsum("nji,j->ni", matrix_to_start(path), stored)
        more = in_body @ np.linalg.inv(campaign.wheel_axes_B).T
        torque = np.gradient(more, slew.time, axis=0)
        changed = {"wheel_momentum": slew.wheel_momentum + more}
        slews.append(replace(slew, wheel_torque=slew.wheel_torque + torque, **changed))
    wheels = [replace(wheel, max_momentum=None, max_torque=None) for wheel in campaign.wheels]
    return replace(campaign, slews=tuple(slews), wheels=tuple(wheels))


def test_rates_that_wheels_tell_count_the_gyroscopic_torque_of_stored_momentum(example):
    """Left out, it made slew 1's rate about the axis without gyro 1.6 times wrong."""
    campaign = with_stored_momentum(example, 4.0)
    smoothed = with_axes(campaign, AXES["two axes"], lambda w: w).with_body_rates
    for slew, told in zip(campaign.slews, smoothed.slews, strict=True):
        size, left = (np.sqrt(np.mean(x**2)) for x in (slew.rate, (told.rate - slew.rate)[:, 2]))
        assert left < 0.5 * size


@pytest.mark.slow
def test_wrong_keys_of_two_axes_are_named_beside_much_stored_momentum(example):
    campaign = with_stored_momentum(example, 4.0)
    right = with_axes(campaign, AXES["two axes"], lambda w: w)
    assert check_conventions(right, quick=True).verdict == "consistent"
    for misread, key, mended in (
        (np.degrees, "rate.unit", "deg/s"),
        (lambda w: w[:, ::-1], "rate.names", ["rate_2", "rate_1"]),
    ):
        wrong = with_axes(campaign, AXES["two axes"], misread)
        first = check_conventions(wrong, quick=True).changes[0]
        assert (first.key, first.mended) == (f"sensors.rate sensor.{key}", mended)


@pytest.mark.parametrize("late", [4.0, pytest.param(-4.0, marks=LIKE_ANOTHER)])
def test_a_wrong_clock_of_a_gyro_of_two_axes_is_named(example, late):
    campaign = with_axes(example, AXES["two axes"], lambda w: w)
    slews = []
    for slew in campaign.slews:
        read = [np.interp(slew.time - late, slew.time, axis) for axis in slew.rate.T]
        slews.append(replace(slew, rate=np.stack(read, axis=-1)))
    first = check_conventions(replace(campaign, slews=tuple(slews)), quick=True).changes[0]
    assert first.key == "sensors.rate sensor.rate.offset_s"
    assert first.mended == pytest.approx(-late, abs=0.4)
