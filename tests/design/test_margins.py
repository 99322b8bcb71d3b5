"""Margins of planned and flown slews, against hand computation."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from bayes_inertia.campaign.hardware import RateSensor, StarTracker, Wheel
from bayes_inertia.design.limits import (
    KeepOut,
    Limits,
)
from bayes_inertia.design.margins import broken_limits, flown_margins, planned_margins
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan, PlannedSlew, paper_like_plan
from bayes_inertia.flight.plan_flight import fly
from bayes_inertia.flight.spacecraft import (
    Controller,
    Spacecraft,
    axes_of_control,
)

DEGREE = math.pi / 180.0


def simple_craft(**changes) -> Spacecraft:
    wheels = tuple(
        Wheel(n, a, 1e-3, 0.02, 0.3, 5e-6) for n, a in zip("xyz", np.eye(3), strict=True)
    )
    tracker = StarTracker((0.0, 0.0, 1.0), 2e-5, 1e-4)
    return replace(
        Spacecraft(
            np.diag([3.0, 2.0, 2.5]), (1.0, 1.0, 1.0), wheels, RateSensor(sigma=2e-5), tracker
        ),
        **changes,
    )


def by_limit(found) -> dict:
    return {m.limit: m for m in found}


def test_torque_and_momentum_are_those_of_a_rigid_body():
    rate, acceleration, h = 0.01, 1e-3, 0.05
    plan = Plan(
        "one",
        (PlannedSlew((0.0, 1.0, 0.0), 1.0, rate, acceleration),),
        wheel_momentum=(0.0, 0.0, h),
    )
    found = by_limit(planned_margins(plan, simple_craft(), Limits(rate=0.02, total_time=200.0)))
    # The momentum about z, h, stays in inertial axes while the body turns about y: its part along
    # x goes to the wheel on x.
    assert found["torque of y"].used == pytest.approx(2.0 * acceleration, rel=1e-9)
    assert found["momentum of y"].used == pytest.approx((2.0 + 1e-3) * rate, rel=1e-9)
    assert found["momentum of x"].used == pytest.approx(h * math.sin(1.0), rel=1e-9)
    # w x h is largest where the ramp, 0.05 rad long, ends; the mean over a step of the grid is a
    # little less.
    assert found["torque of x"].used == pytest.approx(rate * h * math.cos(0.05), rel=2e-3)
    assert found["rate"].left == pytest.approx(0.5)
    assert found["torque of y"].left == pytest.approx(1.0 - 2.0 * acceleration / 0.02, rel=1e-9)
    assert found["total time"].used == pytest.approx(
        math.ceil((20.0 + 110.0 + 33.0 + 12.0) * 4) / 4
    )


def test_keep_out_is_the_angle_between_the_boresight_at_rest_and_the_cone():
    plan = Plan(
        "one", (PlannedSlew((1.0, 0.0, 0.0), 0.5 * math.pi),)
    )  # turns z of the body from +z to -y
    cones = (
        KeepOut("Sun", (0.0, -1.0, 0.2), 0.4),
        KeepOut("Moon", (0.0, 1.0, 0.0), 0.4),
        KeepOut("Earth", (0.0, 0.1, 1.0), 0.4),
    )
    found = by_limit(planned_margins(plan, simple_craft(), Limits(keep_out=cones)))
    assert found["keep-out Sun"].used == pytest.approx(math.atan(0.2), rel=1e-9)
    assert found["keep-out Sun"].where == "after slew 1"
    assert found["keep-out Earth"].used == pytest.approx(math.atan(0.1), rel=1e-9)
    assert found["keep-out Earth"].where == "at the start"
    assert found["keep-out Moon"].used == pytest.approx(0.5 * math.pi, rel=1e-9)
    assert [m.limit for m in broken_limits(found.values())] == ["keep-out Earth", "keep-out Sun"]


@pytest.mark.slow
def test_planned_margins_are_those_of_the_closed_loop(craft, prior):
    limits = Limits(rate=1.1 * DEGREE, total_time=1900.0)
    quiet = fly(
        paper_like_plan(),
        Mission(replace(craft, bias=(0.0, 0.0, 0.0)), prior),
        None,
        controller=Controller(craft.inertia_B, craft.scale_factor),
    )
    for planned, flown in zip(
        planned_margins(paper_like_plan(), craft, limits), flown_margins(quiet, limits), strict=True
    ):
        assert planned.limit == flown.limit
        assert flown.used == pytest.approx(planned.used, rel=0.03)


@pytest.mark.parametrize(("out_of_plane", "axes"), [(1e-8, 2), (0.1, 3)])
def test_wheels_nearly_in_one_plane_turn_about_two_axes(out_of_plane, axes):
    directions = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.6, 0.8, out_of_plane)
    wheels = [Wheel(name, axis, 1e-3) for name, axis in zip("abc", directions, strict=True)]
    assert axes_of_control(wheels) == axes
    assert axes_of_control([replace(wheel, state="free") for wheel in wheels]) == 0
