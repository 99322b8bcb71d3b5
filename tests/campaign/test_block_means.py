"""High-rate telemetry as block means: nothing of the motion is lost, and the noise is right."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support.other_spacecraft import by_rotors, by_thrusters, gyroless, two_axes_and_vectors

import bayes_inertia
from bayes_inertia.campaign.block_means import longest_block, reduced, without_surplus_rows
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import (
    CorrelatedNoise,
    InertiaPrior,
    RateSensor,
    StarTracker,
    Wheel,
)
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.campaign.slew import Slew

INERTIA = np.array([4.8e-4, 2.5e-4, 5.6e-4])  # [kg m^2]
WHEEL = 3e-4  # [N m s], along z
SIGMA = 0.015  # [rad/s]
EXAMPLE = Path(bayes_inertia.__file__).parent / "example"


def tumble(time: np.ndarray) -> np.ndarray:
    """Rates (n, 3) of a thrown body with a wheel that spins steadily [rad/s]."""

    def change(t, w):
        momentum = INERTIA * w + [0.0, 0.0, WHEEL]
        return -np.cross(w, momentum) / INERTIA

    span = (0.0, time.max() + 1e-3)
    start = [12.0, 9.0, -11.0]
    return solve_ivp(change, span, start, t_eval=np.sort(time), rtol=1e-11, atol=1e-11).y.T


def thrown(time: np.ndarray, noise: float = 0.0) -> Campaign:
    rng = np.random.default_rng(2)
    rate = tumble(time) + noise * rng.normal(size=(len(time), 3))
    momentum = np.full((len(time), 1), WHEEL)
    slew = Slew("throw", 5.0, time, rate=rate, wheel_momentum=momentum)
    wheel = Wheel("z", (0.0, 0.0, 1.0), 1e-6, momentum_sigma=1e-5)
    prior = InertiaPrior(np.diag(INERTIA), 0.3, 5e-5)
    return Campaign("c", prior, (wheel,), RateSensor(sigma=SIGMA), None, (slew,))


TIME = np.arange(2000) * 2.48e-4  # [s]


def test_tachometers_that_are_read_more_slowly_keep_their_momentum_and_its_noise():
    campaign = thrown(TIME)
    slower = (np.arange(len(TIME)) % 4 == 0)[:, None]
    momentum = np.where(slower, campaign.slews[0].wheel_momentum + TIME[:, None], np.nan)
    slew = replace(campaign.slews[0], wheel_momentum=momentum)
    means = reduced(replace(campaign, slews=(slew,)), block=8)
    of_rates = np.isfinite(means.slews[0].rate).all(axis=1)
    read = means.slews[0].wheel_momentum[of_rates, 0]
    truth = WHEEL + means.slews[0].time[of_rates]
    np.testing.assert_allclose(read[:-3], truth[:-3], rtol=1e-9)
    # After the last reading its value stays.
    np.testing.assert_allclose(read[-3:], truth[-3:], atol=3.0 * (TIME[1] - TIME[0]))
    assert means.wheels[0].momentum_sigma == pytest.approx(1e-5 / np.sqrt(2.0))


@pytest.mark.parametrize(
    ("own_rows", "block", "first"), [(False, 8, 0), (True, 8, 0), (False, 5, 2)]
)
def test_columns_that_are_read_too_seldom_for_blocks_keep_their_rows(own_rows, block, first):
    """Also where they are the middle row of a block."""
    campaign = thrown(TIME)
    slew, every = campaign.slews[0], np.arange(len(TIME)) % 100 == first
    momentum = np.where(every[:, None], slew.wheel_momentum + TIME[:, None], np.nan)
    field = np.where(every[:, None], 3e-5, np.full((len(TIME), 3), np.nan))
    rate = np.where(every[:, None] & own_rows, np.nan, slew.rate)
    slew = replace(slew, rate=rate, wheel_momentum=momentum, magnetic_field_N=field)
    campaign = replace(campaign, slews=(slew,))
    means = reduced(campaign, block=block)
    read = np.isfinite(means.slews[0].wheel_momentum[:, 0])
    np.testing.assert_array_equal(means.slews[0].time[read], TIME[every])
    np.testing.assert_array_equal(means.slews[0].wheel_momentum[read], momentum[every])
    np.testing.assert_array_equal(means.slews[0].magnetic_field_N[read], field[every])
    assert means.wheels[0].momentum_sigma == 1e-5
    assert means.has_tachometers
    # What the wheels did between their readings is told by each reading of the rates.
    assert without_surplus_rows(campaign) is campaign


def test_means_hold_the_motion_to_a_hundredth_of_their_noise():
    campaign = thrown(TIME)
    block = longest_block(campaign)
    assert block >= 8
    means = reduced(campaign)
    slew = means.slews[0]
    rows = np.isfinite(slew.rate).all(axis=1)
    assert rows.sum() == len(TIME) // block
    error = slew.rate[rows] - tumble(slew.time[rows])
    allowed = 0.01 * SIGMA / np.sqrt(block)
    # At the first and last block the curvature is told from one side only.
    assert np.abs(error[2:-2]).max() < allowed
    assert np.abs(error).max() < 5.0 * allowed
    # The control: plain means of such blocks, and blocks of four times the length.
    plain = tumble(TIME)[: block * rows.sum()].reshape(-1, block, 3).mean(axis=1)
    assert np.abs(plain - tumble(slew.time[rows])).max() > allowed
    long = reduced(campaign, block=4 * block).slews[0]
    rows = np.isfinite(long.rate).all(axis=1)
    error = (long.rate[rows] - tumble(long.time[rows]))[2:-2]
    assert np.abs(error).max() > 0.5 * allowed


def test_the_noise_of_the_means_is_stated():
    campaign = thrown(TIME, noise=SIGMA)
    means = reduced(campaign, block=8)
    assert means.rate_sensor.sigma == pytest.approx([SIGMA / np.sqrt(8)] * 3)
    assert means.wheels[0].momentum_sigma == pytest.approx(1e-5 / np.sqrt(8))
    slew = means.slews[0]
    rows = np.isfinite(slew.rate).all(axis=1)
    white = (slew.rate[rows] - tumble(slew.time[rows])) / means.rate_sensor.sigma[0]
    chi2 = np.mean(white**2)
    # The removed curvature adds less than one in a hundred.
    assert abs(chi2 - 1.0) < 4.0 * np.sqrt(2.0 / white.size) + 0.01


def test_blocks_stop_at_gaps_and_are_whole():
    campaign = thrown(np.delete(TIME, slice(803, 1000)))
    slew = reduced(campaign, block=10).slews[0]
    rows = np.isfinite(slew.rate).all(axis=1)
    assert rows.sum() == 80 + 100
    spans = np.diff(slew.time[rows])
    assert spans.max() == pytest.approx(210 * 2.48e-4)
    assert slew.start == 5.0
    assert (slew.time[0], slew.time[-1]) == (TIME[0], TIME[-1])


def test_fixes_and_changes_of_commands_keep_their_rows():
    campaign = thrown(TIME)
    attitude = np.full((len(TIME), 4), np.nan)
    attitude[[7, 1500]] = [0.0, 0.0, 0.0, 1.0]
    torque = np.where(TIME[:, None] < TIME[999], 1e-4, -1e-4)
    slew = replace(campaign.slews[0], attitude=attitude, wheel_torque=torque)
    tracker = StarTracker((0.0, 0.0, 1.0), 1e-5, 1e-4)
    means = reduced(replace(campaign, slews=(slew,), star_tracker=tracker), block=8).slews[0]
    assert means.time[means.fixes].tolist() == TIME[[7, 1500]].tolist()
    change = np.flatnonzero(np.diff(means.wheel_torque[:, 0]))
    assert means.time[change + 1].tolist() == [TIME[999]]


def test_slow_telemetry_with_ever_new_commands_stays_as_it_is():
    campaign = read_campaign(EXAMPLE)
    assert reduced(campaign) is campaign


@pytest.mark.parametrize("kind", [gyroless, by_thrusters, by_rotors, two_axes_and_vectors])
def test_spacecraft_of_other_kinds_stay_as_they_are(kind):
    campaign = kind()
    assert without_surplus_rows(campaign) is campaign
    assert campaign.rate_sensor or reduced(campaign) is campaign


def test_slews_with_lost_commands_stay_as_they_are():
    """Where their rows are at no regular step nothing says that a command is missing."""
    campaign = thrown(TIME)
    torque, lost = np.full((len(TIME), 1), 1e-5), np.zeros(len(TIME), dtype=int)
    lost[900:1000] = 1
    unknown = {"lost_command": lost, "lost_command_sd": torque}
    slew = replace(campaign.slews[0], wheel_torque=torque, **unknown)
    commanded = replace(campaign, slews=(slew,))
    assert reduced(commanded) is commanded
    known = replace(slew, lost_command=None, lost_command_sd=None)
    assert len(reduced(replace(campaign, slews=(known,))).slews[0].time) < len(TIME)


def test_a_diagnosis_takes_block_means_of_slews_with_far_more_rows_than_their_motion_asks_for():
    campaign = thrown(TIME, noise=SIGMA)
    means = without_surplus_rows(campaign)
    rows = np.isfinite(means.slews[0].rate).all(axis=1).sum()
    block = round((SIGMA / means.rate_sensor.sigma[0]) ** 2)
    assert 2 <= block <= longest_block(campaign)
    assert rows == len(TIME) // block >= 200
    assert without_surplus_rows(means) is means


def test_readings_stay_as_they_are_where_means_would_lose_something():
    few, many = thrown(TIME[:900]), thrown(TIME, noise=SIGMA)
    slew = many.slews[0]
    commanded = replace(slew, wheel_torque=np.full((len(TIME), 1), 1e-5))
    coarse = replace(slew, rate=np.round(slew.rate / (2.0 * SIGMA)) * 2.0 * SIGMA)
    lasting = CorrelatedNoise((0.5, 0.5, 0.5), (0.01, 0.01, 0.01))
    sensor = replace(many.rate_sensor, correlated_noise=lasting)
    for campaign in (
        few,
        replace(many, slews=(commanded,)),
        replace(many, slews=(coarse,)),
        replace(many, rate_sensor=sensor),
    ):
        assert without_surplus_rows(campaign) is campaign


def test_a_mean_holds_no_saturated_reading():
    """A block that is partly beyond the range would lie inside it, and be wrong."""
    campaign = thrown(TIME)
    exact, slew = reduced(campaign, 8).slews[0], campaign.slews[0]
    largest = 0.9 * float(np.abs(slew.rate).max())
    clipped = replace(slew, rate=np.clip(slew.rate, -largest, largest))
    sensor = RateSensor(sigma=SIGMA, range=largest)
    means = reduced(replace(campaign, rate_sensor=sensor, slews=(clipped,)), 8).slews[0]
    known = np.isfinite(means.rate)
    rows = np.searchsorted(exact.time, means.time)
    assert 0.5 < known.mean() < 0.99
    error = np.abs(means.rate - exact.rate[rows])[known]
    assert error.max() < 0.1 * SIGMA / np.sqrt(8)
