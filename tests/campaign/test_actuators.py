"""Inputs of devices, and the devices of a campaign: pieces, cuts and what is refused."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime

import numpy as np
import pytest

from bayes_inertia.campaign.actuators import GimballedRotors, KnownTorque, Magnetorquer, Thruster
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.inputs import InputStream
from bayes_inertia.campaign.inspection import with_dirt_masked
from bayes_inertia.campaign.prior import GaussianPrior
from bayes_inertia.campaign.slew_parts import parts_of
from bayes_inertia.errors import CampaignError
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.small_campaign import small_campaign


def value_at(stream: InputStream, t: float) -> list[float]:
    edges, first, last = stream.pieces()
    piece = int(np.searchsorted(edges, t, side="right"))
    if piece in (0, len(edges)):
        return first[piece].tolist()
    s = (t - edges[piece - 1]) / (edges[piece] - edges[piece - 1])
    return (first[piece] + s * (last[piece] - first[piece])).tolist()


def test_each_kind_of_input_says_what_is_between_its_readings():
    time, values = [0.0, 1.0, 2.0], [[0.5], [0.25], [1.0]]
    expected = {"hold": 0.25, "mean": 0.25, "line": 0.4375, "on_time": 0.0}
    for between, at in expected.items():
        assert value_at(InputStream(time, values, between), 1.25) == [at]
    pulses = InputStream(time, values, "on_time")
    assert [value_at(pulses, t)[0] for t in (-1.0, 0.4, 0.6, 1.2, 2.9, 3.1)] == [0, 1, 0, 1, 1, 0]


def test_what_changes_nothing_is_no_edge():
    held = InputStream(np.arange(100.0), np.repeat([0.0, 1.0], 50))
    assert held.pieces()[0].tolist() == [50.0]


def test_pulses_that_touch_are_one():
    pulses = InputStream([0.0, 0.1, 0.2], [0.1, 0.1, 0.05], "on_time")
    assert np.allclose(pulses.pieces()[0], [0.0, 0.25])


def test_a_cut_input_is_the_same_input_there():
    rng = np.random.default_rng(3)
    time = np.cumsum(rng.uniform(0.1, 1.0, 40))
    for between in ("hold", "line", "on_time", "mean"):
        values = rng.uniform(0.0, 0.1, (40, 2))
        whole = InputStream(time, values, between)
        part = whole.within(7.0, 12.0)
        assert len(part.time) < 25
        for t in rng.uniform(7.0, 12.0, 50):
            assert value_at(part, t) == value_at(whole, t)


def test_a_slew_that_is_cut_keeps_its_inputs():
    whole = small_campaign().slews[0]
    torque = InputStream(whole.time, np.arange(3.0 * len(whole.time)).reshape(-1, 3))
    whole = replace(whole, inputs={"jets": torque})
    half = len(whole.time) // 2
    pieces = [{"time": whole.time[:half]}, {"time": whole.time[half:]}]
    first, second = parts_of(whole, pieces)
    assert first.inputs["jets"].time[0] == whole.time[0]
    assert value_at(second.inputs["jets"], second.time[3]) == value_at(torque, second.time[3])


def test_wrong_inputs_are_refused_in_words():
    for arguments, words in (
        (([1.0, 0.0], [0.0, 0.0]), "do not increase"),
        (([0.0, 1.0], [0.0, np.nan]), "finite"),
        (([0.0, 1.0], [0.0]), "shape"),
        (([0.0, 1.0], [1.5, 0.0], "on_time"), "lasts beyond the next reading"),
        (([0.0, 1.0], [0.5, 0.0], "step"), "choose one of hold"),
        ((np.array(["2026-01-01", "2026-01-02"], "datetime64[ms]"), [0.5, 0.0]), "of dates"),
        (([datetime(2026, 1, 1), datetime(2026, 1, 2)], [0.5, 0.0]), "of dates"),
    ):
        with pytest.raises(CampaignError, match=words):
            InputStream(*arguments)


def test_devices_and_their_inputs_must_fit():
    campaign = small_campaign()
    stream = InputStream([0.0], np.zeros((1, 2)))
    slews = tuple(replace(s, inputs={"jets": stream}) for s in campaign.slews)
    with pytest.raises(CampaignError, match="no input of this device"):
        replace(campaign, actuators=(KnownTorque("jets"),))
    with pytest.raises(CampaignError, match="2 numbers a reading, not 3"):
        replace(campaign, actuators=(KnownTorque("jets"),), slews=slews)
    dark = tuple(replace(s, magnetic_field_N=None) for s in slews)
    with pytest.raises(CampaignError, match="magnetic field"):
        replace(campaign, actuators=(Magnetorquer("jets", np.eye(3)[:2]),), slews=dark)
    kept = replace(campaign, actuators=(Thruster("jets", np.eye(3)[:2]),), slews=slews)
    assert kept.subset([1]).actuators == kept.actuators
    with pytest.raises(CampaignError, match="used twice"):
        replace(kept, actuators=kept.actuators * 2)


def test_impossible_devices_are_refused_in_words():
    for make, words in (
        (lambda: KnownTorque("t", -0.1), "no sd"),
        (lambda: KnownTorque("t", frame="sensor"), "choose body or inertial"),
        (lambda: Magnetorquer("m", 2.0 * np.eye(3)), "unit vectors"),
        (lambda: Thruster("j", np.eye(2)), "three numbers each"),
        (lambda: GimballedRotors("c", 1.0, np.eye(3), np.eye(3)), "leans 90 deg"),
        (lambda: GimballedRotors("c", -1.0, np.eye(3), np.eye(3)[[1, 2, 0]]), "not positive"),
    ):
        with pytest.raises(CampaignError, match=words):
            make()


def test_a_locked_wheel_is_a_part_of_the_body():
    campaign = small_campaign()
    wheels = (*campaign.wheels[:2], replace(campaign.wheels[2], state="locked"))
    locked = replace(campaign, wheels=wheels)
    bare = locked.without_locked_wheels()
    assert [wheel.name for wheel in bare.wheels] == ["x", "y"]
    assert bare.slews[0].wheel_torque.shape[1] == 2
    np.testing.assert_array_equal(
        bare.slews[1].wheel_momentum, campaign.slews[1].wheel_momentum[:, :2]
    )
    assert Model(locked).campaign == bare
    # A fit knows its slews again.
    assert locked.slew_digests == bare.slew_digests
    # It needs no tachometer.
    unread = tuple(
        replace(s, wheel_momentum=np.asarray(s.wheel_momentum) * [1.0, 1.0, np.nan])
        for s in campaign.slews
    )
    assert replace(locked, slews=unread).has_tachometers
    assert not replace(campaign, slews=unread).has_tachometers
    # A result of it is learnt from what a model takes: the slews without the wheel.
    prior = GaussianPrior(("Jxx",), [1.0], [[0.01]], learnt_from=locked.slew_digests["own"][1:])
    with pytest.raises(CampaignError, match="holds this telemetry already"):
        replace(locked, prior=prior)
    assert replace(campaign, prior=prior).prior.learnt_from
    assert Model(campaign).campaign is campaign
    none = replace(campaign, wheels=tuple(replace(w, state="locked") for w in campaign.wheels))
    assert none.without_locked_wheels().slews[0].wheel_momentum is None
    with pytest.raises(CampaignError, match="choose one of running"):
        replace(campaign.wheels[0], state="off")


def test_a_wheel_that_reads_exactly_zero_is_taken_as_locked_and_told():
    campaign = small_campaign()

    def with_third(torque: float) -> Campaign:
        slews = []
        for slew in campaign.slews:
            momentum, command = np.array(slew.wheel_momentum), np.array(slew.wheel_torque)
            momentum[:, 2], command[:, 2] = 0.0, torque
            slews.append(replace(slew, wheel_momentum=momentum, wheel_torque=command))
        return replace(campaign, slews=tuple(slews))

    off = with_dirt_masked(with_third(0.0))
    assert [wheel.state for wheel in off.wheels] == ["running", "running", "locked"]
    (record,) = [d for d in off.dirt if "locked" in d.note]
    assert "z reads exactly 0 in every row" in record.note
    assert with_dirt_masked(with_third(1e-4)).wheels[2].state == "running"
    assert with_dirt_masked(campaign).wheels == campaign.wheels
