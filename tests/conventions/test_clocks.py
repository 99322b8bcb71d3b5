"""A stream whose clock is wrong is named; a lateness that is physical is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.conventions.check import check_conventions
from bayes_inertia.physics.small_campaign import small_campaign

LATE = 2  # rows of one second


@pytest.fixture(scope="module")
def right() -> Campaign:
    return small_campaign()


def late(campaign: Campaign, channels: tuple[str, ...], rows: int = LATE) -> Campaign:
    """Readings that carry the time stamps of later rows; the torque before is the first one."""

    def moved(values: np.ndarray, channel: str) -> np.ndarray:
        empty = 0.0 if channel == "wheel_torque" else np.nan
        before = np.full((rows, values.shape[1]), empty)
        return np.concatenate([before, values[:-rows]])

    slews = [
        replace(slew, **{c: moved(getattr(slew, c), c) for c in channels})
        for slew in campaign.slews
    ]
    return replace(campaign, slews=tuple(slews))


@pytest.mark.parametrize(
    ("channels", "named", "seconds"),
    [
        (("attitude",), {"columns.attitude.offset_s"}, -LATE),
        (("rate",), {"columns.rate.offset_s"}, -LATE),
        (("wheel_momentum",), {"columns.wheel_momentum.offset_s"}, -LATE),
        (("wheel_torque",), {"columns.wheel_torque.offset_s"}, -LATE),
        (
            ("wheel_torque", "wheel_momentum"),
            {"columns.wheel_torque.offset_s", "columns.wheel_momentum.offset_s"},
            -LATE,
        ),
    ],
)
def test_the_stream_that_is_late_is_named_with_its_offset(right, channels, named, seconds):
    check = check_conventions(late(right, channels), quick=True)
    assert check.verdict == "wrong"
    proposed = [change for change in check.changes if change.proposal == 1]
    assert {change.key for change in proposed} == named
    for change in proposed:
        assert change.mended == pytest.approx(seconds, abs=0.15)
        assert change.sigma_before > 3.0 * change.sigma_after


def test_wheels_that_lag_their_commands_are_physical(right):
    early = [
        replace(slew, wheel_torque=np.concatenate([slew.wheel_torque[1:], np.zeros((1, 3))]))
        for slew in right.slews
    ]
    check = check_conventions(replace(right, slews=tuple(early)))
    assert check.verdict == "consistent"
    assert any("wheel_command_lag" in remark for remark in check.remarks)


@pytest.mark.parametrize("seconds", [0.2, -0.2])
def test_a_delay_is_named_where_rates_are_late_and_a_clock_where_they_are_early(right, seconds):
    def moved(slew):
        read = [np.interp(slew.time - seconds, slew.time, column) for column in slew.rate.T]
        return replace(slew, rate=np.stack(read, axis=1), attitude=None)

    slews = tuple(moved(slew) for slew in right.slews)
    check = check_conventions(replace(right, slews=slews), quick=True)
    assert check.verdict == "consistent"
    (remark,) = check.remarks
    assert ("rate_sensor_delay" in remark) == (seconds > 0.0)
    assert ("state it as `offset_s`" in remark) == (seconds < 0.0)


def under_a_torque(campaign: Campaign) -> Campaign:
    """The same where an untold torque along inertial axes comes and goes in each slew."""

    def pushed(slew):
        since = (slew.time - slew.time[0]) / np.ptp(slew.time)
        gained = np.outer(since**2 * (3.0 - 2.0 * since), [0.3, -0.2, 0.25])
        seen = np.isfinite(slew.attitude).all(axis=1)
        turned = Slerp(slew.time[seen], Rotation.from_quat(slew.attitude[seen]).inv())
        times = np.clip(slew.time, *slew.time[seen][[0, -1]])
        size = np.ptp(slew.wheel_momentum, axis=0).max()
        stored = slew.wheel_momentum + size * turned(times).apply(gained)
        return replace(slew, wheel_momentum=stored, wheel_torque=None)

    return replace(campaign, slews=tuple(pushed(slew) for slew in campaign.slews))


def test_a_wrong_clock_is_named_although_a_torque_acts(right):
    pushed = under_a_torque(right)
    assert check_conventions(pushed, quick=True).verdict == "consistent"
    check = check_conventions(late(pushed, ("rate",)), quick=True)
    assert check.changes[0].key == "columns.rate.offset_s"
    assert check.changes[0].mended == pytest.approx(-LATE, abs=0.1)


def without_fixes_in_motion(campaign: Campaign) -> Campaign:
    def kept(slew):
        # The body is turned from 8 to 54 s, and hardly before.
        at_rest = slew.time < 5.0
        return replace(slew, attitude=np.where(at_rest[:, None], slew.attitude, np.nan))

    return replace(campaign, slews=tuple(kept(slew) for slew in campaign.slews))


def test_a_late_star_tracker_is_said_to_be_invisible_at_rest(right):
    check = check_conventions(without_fixes_in_motion(right))
    assert check.verdict == "consistent"
    assert any("columns.attitude.offset_s" in words for words in check.cannot_show)
    moving = check_conventions(right)
    assert not any("columns.attitude.offset_s" in words for words in moving.cannot_show)


def test_without_fixes_in_motion_a_late_gyro_and_early_wheels_are_the_same(right):
    check = check_conventions(late(without_fixes_in_motion(right), ("rate",)), quick=True)
    keys = {change.proposal: set() for change in check.changes}
    for change in check.changes:
        keys[change.proposal].add(change.key)
    assert keys == {
        1: {"columns.rate.offset_s"},
        2: {"columns.wheel_torque.offset_s", "columns.wheel_momentum.offset_s"},
    }


@pytest.mark.parametrize(
    "channel", ["wheel_momentum", pytest.param("rate", marks=pytest.mark.slow)]
)
def test_a_known_offset_is_named(right, channel):
    check = check_conventions(late(right, (channel,), 18), quick=True)
    first = check.changes[0]
    assert (first.key, first.mended) == (f"columns.{channel}.offset_s", -18.0)
    assert "GPS time is ahead of UTC" in check.sentence


@pytest.mark.slow
@pytest.mark.parametrize("last", [55.0, np.inf])
def test_a_known_offset_is_named_although_it_costs_fixes(right, last):
    # Fixes lie before the motion, perhaps after it, and readings stamped before were not kept.
    def early(slew):
        at_rest = (slew.time < 6.0) | (slew.time > last)
        attitude = np.where(at_rest[:, None], slew.attitude, np.nan)
        momentum = np.concatenate([slew.wheel_momentum[18:], np.full((18, 3), np.nan)])
        return replace(slew, attitude=attitude, wheel_momentum=momentum)

    campaign = replace(right, slews=tuple(early(slew) for slew in right.slews))
    first = check_conventions(campaign, quick=True).changes[0]
    assert (first.key, first.mended) == ("columns.wheel_momentum.offset_s", 18.0)


def moved_outside(campaign: Campaign, channel: str, seconds: float) -> Campaign:
    """One channel by so much later, in rows of its own."""

    def moved(slew):
        rows = len(slew.time)
        own = {
            c: np.concatenate([v := np.array(getattr(slew, c)), np.full_like(v, np.nan)])
            for c in ("rate", "attitude", "wheel_momentum")
        }
        own[channel] = np.roll(own[channel], rows, axis=0)
        held = np.concatenate([slew.wheel_torque, 0.0 * slew.wheel_torque])
        time = np.concatenate([slew.time, slew.time + seconds])
        environment = {"magnetic_field_N": None, "position_N": None}
        return replace(slew, time=time, wheel_torque=held, **own, **environment)

    return replace(campaign, slews=tuple(moved(slew) for slew in campaign.slews))


@pytest.mark.parametrize(
    ("channel", "seconds", "offset"),
    [
        ("attitude", 3600.0, "columns.attitude.offset_s = -3600 (1 h, as of a time zone)"),
        (
            "attitude",
            7182.0,
            "columns.attitude.offset_s = -7182 (2 h, and GPS time is ahead of UTC)",
        ),
        (
            "wheel_momentum",
            3600.0,
            "columns.wheel_momentum.offset_s = -3600 (1 h, as of a time zone)",
        ),
        ("attitude", 5000.0, "state their clock's offset as columns.attitude.offset_s"),
    ],
)
def test_a_stream_outside_every_slew_is_doubtful_and_its_offset_said(
    right, channel, seconds, offset
):
    check = check_conventions(moved_outside(right, channel, seconds), quick=True)
    assert check.verdict == "doubtful"
    assert any("outside every slew" in doubt and offset in doubt for doubt in check.doubts)
