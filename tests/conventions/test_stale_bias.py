"""A stale rate bias hides no wrong convention, and is itself no wrong convention."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import bayes_inertia
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.conventions.check import check_conventions
from bayes_inertia.conventions.laws import Misfits
from bayes_inertia.conventions.motion import sampled
from bayes_inertia.conventions.reading import stated_reading
from bayes_inertia.conventions.search import with_own_bias
from bayes_inertia.report.words import dirt_sentences

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"
# Share of the largest rate, and of each axis of it.
STALE = 0.08 * np.array([1.0, -0.8, 0.9])
WRONG = {
    "columns.rate.unit": lambda w: np.degrees(w),
    "rate_sensor.axes": lambda w: w * [1.0, -1.0, 1.0],
    "columns.rate.names": lambda w: w[:, [1, 0, 2]],
}


def changed(campaign: Campaign, **channels) -> Campaign:
    """The campaign with functions of its channels."""
    slews = [
        replace(slew, **{name: change(getattr(slew, name)) for name, change in channels.items()})
        for slew in campaign.slews
    ]
    return replace(campaign, slews=tuple(slews))


@pytest.fixture(scope="module")
def bias() -> np.ndarray:
    rates = [np.abs(slew.rate).max() for slew in read_campaign(EXAMPLE).slews]
    return STALE * max(rates)


@pytest.fixture(scope="module")
def stale(bias) -> Campaign:
    return changed(read_campaign(EXAMPLE), rate=lambda w: w + bias)


def named(campaign: Campaign):
    """The check, the keys of its proposal, and its kinds of dirt."""
    check = check_conventions(campaign)
    keys = {change.key for change in check.changes if change.proposal == 1}
    return check, keys, [dirt["kind"] for dirt in check.dirt]


@pytest.mark.parametrize("tracker", [True, False])
def test_a_stale_bias_alone_is_a_fault_and_no_wrong_convention(stale, bias, tracker):
    if not tracker:
        stale = replace(changed(stale, attitude=lambda q: None), star_tracker=None)
    check, keys, dirt = named(stale)
    assert (check.verdict, keys, dirt) == ("consistent", set(), ["stale_bias"])
    assert max(check.misfits.values()) < 1.0
    assert "stale" in check.sentence
    (told,) = dirt_sentences(check.dirt)
    assert told.startswith("Bias far from the stated one of the rate sensor")
    misfits = Misfits(stale, sampled(stale))
    stated = stated_reading(stale)
    assert with_own_bias(misfits, stated).bias_B == pytest.approx(bias, rel=0.1)


@pytest.mark.parametrize("key", WRONG)
def test_a_wrong_convention_of_the_rate_is_named_beside_it(stale, key):
    check, keys, dirt = named(changed(stale, rate=WRONG[key]))
    assert check.verdict == "wrong"
    assert keys == {key}
    assert "stale_bias" in dirt
    assert "stale" in check.sentence


def test_a_wrong_convention_of_the_wheels_is_named_beside_it(stale):
    without = changed(stale, attitude=lambda q: None, wheel_torque=np.negative)
    check, keys, dirt = named(replace(without, star_tracker=None))
    assert (check.verdict, keys, dirt) == (
        "wrong",
        {"columns.wheel_torque.acts_on"},
        ["stale_bias"],
    )


def test_no_bias_is_reported_where_none_is(bias):
    campaign = read_campaign(EXAMPLE)
    misfits = Misfits(campaign, sampled(campaign))
    own = with_own_bias(misfits, stated_reading(campaign)).bias_B
    assert np.abs(own).max() < 0.02 * np.abs(bias).max()
    assert named(campaign)[2] == []


def test_no_bias_larger_than_the_motion_is_believed(stale, bias):
    absurd = changed(stale, rate=lambda w: w + 100.0 * bias)
    misfits = Misfits(absurd, sampled(absurd))
    stated = stated_reading(absurd)
    assert with_own_bias(misfits, stated) is stated
