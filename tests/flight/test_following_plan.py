"""A plan after a campaign is read by its sensors as often as the campaign was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayes_inertia.flight.mission import (
    Mission,
    devices_at_rest,
    following_plan,
    reading_periods,
    repeating_plan,
)
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.physics.small_campaign import small_campaign


def with_slews(change):
    campaign = small_campaign()
    return replace(campaign, slews=tuple(map(change, campaign.slews)))


def with_readings_in(slew, key, rows):
    values = np.full(getattr(slew, key).shape, np.nan)
    values[rows] = getattr(slew, key)[rows]
    return replace(slew, **{key: values})


@pytest.mark.parametrize(
    ("rows", "spacing", "throughout"),
    [
        (np.arange(64), 1.0, True),
        (np.array([0, 5, 50, 55, 60]), 5.0, False),
        (np.array([2, 60]), 58.0, False),
        (np.array([2]), 1.0, False),
    ],
)
def test_its_fixes_are_as_far_apart(rows, spacing, throughout):
    plan = following_plan(with_slews(lambda s: with_readings_in(s, "attitude", rows)))
    assert plan.fix_spacing == spacing
    assert plan.fixes_in_motion == throughout
    if spacing == 58.0:
        assert [len(x) for x in plan.fixes(0)] == [1, 1]


def test_its_tachometers_are_read_as_often_and_wheels_without_one_tell_nothing():
    campaign = with_slews(lambda s: with_readings_in(s, "wheel_momentum", np.arange(0, 64, 4)))
    x, *others = campaign.wheels
    campaign = replace(campaign, wheels=(replace(x, momentum_sigma=None), *others))
    assert reading_periods(campaign) == {"rate sensor": 1.0, "momentum": 4.0}
    mission, plan = Mission.of(campaign), following_plan(campaign)
    read = np.isfinite(planned_campaign(plan, mission).slews[0].wheel_momentum)
    assert not read[:, 0].any()
    np.testing.assert_array_equal(np.flatnonzero(read[:, 1]), np.arange(0, len(read), 4))
    silent = tuple(replace(wheel, momentum_sigma=None) for wheel in campaign.wheels)
    craft = replace(mission.spacecraft, wheels=silent)
    without = planned_campaign(plan, replace(mission, spacecraft=craft))
    assert without.slews[0].wheel_momentum is None


def test_a_plan_that_was_flown_begins_where_its_flight_began():
    rows = np.array([3, 5, 50, 55, 60])
    campaign = with_slews(lambda s: with_readings_in(s, "attitude", rows))
    campaign = replace(
        campaign,
        slews=tuple(with_readings_in(s, "wheel_momentum", rows[1:]) for s in campaign.slews),
    )
    first, plan = campaign.slews[0], repeating_plan(campaign)
    assert plan.start_attitude == pytest.approx(first.attitude[3])
    assert plan.wheel_momentum == tuple(first.wheel_momentum[5])
    after = following_plan(campaign)
    start = {"start_attitude": plan.start_attitude, "wheel_momentum": plan.wheel_momentum}
    assert plan == replace(after, **start) != after


def test_commands_that_telemetry_does_not_tell_are_said_to_count():
    assert devices_at_rest(small_campaign()) == ()
    (said,) = devices_at_rest(with_slews(lambda s: replace(s, wheel_torque=None)))
    assert said.startswith("the wheels' torques are taken as telemetered")
