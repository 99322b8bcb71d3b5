"""Rate axes that are telemetered in turn, missing or saturated: the motion is still told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import bayes_inertia as bi
from bayes_inertia.app.cli import main
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.campaign.writer import write_campaign
from bayes_inertia.design.designer import next_slew
from bayes_inertia.inference.descent import guess_nuisances
from bayes_inertia.observability.degeneracy import turned_axes
from bayes_inertia.physics.channels import channels_of
from bayes_inertia.physics.packing import longest_step, pack


def in_turn(campaign: Campaign) -> Campaign:
    """The campaign with one axis telemetered a row."""
    slews = []
    for slew in campaign.slews:
        row = np.arange(len(slew.time))[:, None]
        slews.append(replace(slew, rate=np.where(row % 3 == np.arange(3), slew.rate, np.nan)))
    return replace(campaign, slews=tuple(slews))


def saturated(campaign: Campaign, rows: slice) -> Campaign:
    """The campaign with readings of the first axis at the sensor's range in some rows."""
    slews = []
    for slew in campaign.slews:
        rate = slew.rate.copy()
        rate[rows, 0] = campaign.rate_sensor.range
        slews.append(replace(slew, rate=rate))
    return replace(campaign, slews=tuple(slews))


def start_rate(campaign: Campaign) -> np.ndarray:
    """The body rate that each slew is taken to start with."""
    return pack(campaign, channels_of(campaign, "commanded")).reference.rate_B


def test_axes_in_turn_tell_the_same_motion(flown):
    campaign, thinned = flown.campaign, in_turn(flown.campaign)
    assert thinned.largest_rate() == pytest.approx(campaign.largest_rate(), rel=0.02)
    assert thinned.scale_of_motion()[0] == pytest.approx(campaign.scale_of_motion()[0], rel=0.05)
    assert longest_step(thinned) == longest_step(campaign)
    np.testing.assert_allclose(turned_axes(thinned)[0], turned_axes(campaign)[0], rtol=0.05)
    np.testing.assert_allclose(start_rate(thinned), start_rate(campaign), atol=1e-4)


def test_axes_in_turn_tell_the_wheels_momentum(flown):
    def start(campaign):
        wheels = tuple(replace(wheel, momentum_sigma=None) for wheel in campaign.wheels)
        slews = tuple(replace(slew, wheel_momentum=None) for slew in campaign.slews)
        model = bi.Model(replace(campaign, wheels=wheels, slews=slews))
        return guess_nuisances(model, np.asarray(model.space.mean))[:, 6:]

    full = start(flown.campaign)
    assert np.abs(start(in_turn(flown.campaign)) - full).max() < 0.2 * np.abs(full).max()


def test_saturated_readings_are_not_counted(flown):
    campaign, spoilt = flown.campaign, saturated(flown.campaign, slice(0, 8))
    assert spoilt.largest_rate() == pytest.approx(campaign.largest_rate(), rel=0.02)
    np.testing.assert_allclose(turned_axes(spoilt)[0], turned_axes(campaign)[0], rtol=0.1)
    np.testing.assert_allclose(start_rate(spoilt), start_rate(campaign), atol=1e-3)


def test_check_prints_the_peak_rate_of_axes_in_turn(flown, tmp_path, capsys):
    write_campaign(in_turn(flown.campaign), tmp_path)
    with pytest.raises(SystemExit) as ended:
        main(["check", str(tmp_path)])
    assert ended.value.code == 0
    assert "nan" not in capsys.readouterr().out


@pytest.mark.long
@pytest.mark.slow
def test_a_campaign_with_axes_in_turn_is_fitted_and_a_slew_designed(flown):
    estimate = bi.estimate(bi.Model(in_turn(flown.campaign)))
    pull = (estimate.theta - flown.truth.theta) / estimate.sd
    assert np.abs(pull).max() < 4.0
    slew = next_slew(estimate).plan.slews[0]
    assert 0.0 < slew.rate <= 1.1 * flown.campaign.largest_rate()


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1.0))
def test_complete_rates_of_a_straight_line_are_exact(seed, share):
    rng = np.random.default_rng(seed)
    time = np.arange(40.0)
    line = time[:, None] * np.array([1.0, -2.0, 0.5])
    valid = rng.random(line.shape) < share
    slew = Slew("a", 0.0, time, rate=np.where(valid, line, np.nan))
    rows, rates = slew.complete_rates(valid)
    assert np.all(np.diff(rows) > 0)
    np.testing.assert_allclose(rates, line[rows], atol=1e-12)
