"""The search: exact gradients, and plans that end in a given attitude."""

from __future__ import annotations

import math
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from bayes_inertia.design.designer import paper_like_reference, random_plans
from bayes_inertia.design.feasible_region import region_within
from bayes_inertia.design.goals import parse_goal
from bayes_inertia.design.information_forecast import prepare_forecast
from bayes_inertia.design.limits import (
    Limits,
    hardware_limits,
)
from bayes_inertia.design.margins import broken_limits, planned_margins
from bayes_inertia.design.plan_problem import PlanProblem
from bayes_inertia.flight.plan import paper_like_plan
from bayes_inertia.flight.planned_motion import rigid_body, slew_arrays
from bayes_inertia.maths import quaternion
from bayes_inertia.physics.effects import by_name

DEGREE = math.pi / 180.0


def problem_of(mission, wanted="cross_terms", n=5, limits=None):
    forecast = prepare_forecast(paper_like_plan(), mission, by_name(parse_goal(wanted).effects))
    region = region_within(
        limits or Limits(rate=1.1 * DEGREE, total_time=1855.0), hardware_limits(mission.spacecraft)
    )
    theta = np.concatenate([mission.theta, np.zeros(len(forecast.layout.names) - 9)])
    return PlanProblem(parse_goal(wanted), forecast, theta[None], region)


@pytest.mark.long
@pytest.mark.slow
def test_gradient_of_the_criterion_is_that_of_finite_differences(mission):
    problem = problem_of(mission)
    x = problem.variables(slew_arrays(paper_like_plan()))
    value, slope = problem.log_value_and_gradient(x, 1)
    rng = np.random.default_rng(3)
    for _ in range(4):
        along, step = rng.normal(size=x.shape), 1e-5
        ends = [problem.log_value_and_gradient(x + s * step * along, 1)[0] for s in (1.0, -1.0)]
        assert (ends[0] - ends[1]) / (2 * step) == pytest.approx(np.sum(slope * along), rel=1e-5)
    assert np.exp(value) == pytest.approx(
        problem.value(x), rel=0.06
    )  # the smooth largest of three against the largest


@pytest.mark.long
@pytest.mark.slow
def test_the_end_attitude_is_reached_by_the_last_slew(mission):
    end = np.array([0.5, -0.5, 0.5, 0.5])
    problem = replace(problem_of(mission), end_attitude=end)
    slews = problem.slews(random_plans(problem, 5, 10, 0)[0][0])
    attitude = jnp.asarray(paper_like_plan().start_attitude)
    for turn in slews.rotation_B:
        attitude = quaternion.multiply(attitude, quaternion.exp(turn))
    np.testing.assert_allclose(quaternion.error(attitude, end), 0.0, atol=1e-12)


@pytest.mark.parametrize("hold", [{"max_torque": 0.0013}, {"max_momentum": 0.04}])
def test_the_reference_asks_of_wheels_what_they_can_give(mission, hold):
    craft = mission.at_prior_mean().spacecraft
    craft = replace(craft, wheels=tuple(replace(wheel, **hold) for wheel in craft.wheels))
    limits = Limits(rate=1.1 * DEGREE)
    region = region_within(limits, hardware_limits(craft))
    base = replace(paper_like_plan(), wheel_momentum=())
    plan = paper_like_reference(base, region, 3, math.inf, rigid_body(craft))
    assert not broken_limits(planned_margins(plan, craft, limits))
    assert min(slew.angle for slew in plan.slews) == pytest.approx(30.0 * DEGREE)
    (held,) = hold.values()
    used = [m.used for m in planned_margins(plan, craft, limits) if m.allowed == held]
    assert 0.7 * held < max(used) <= 0.8 * held  # all that there is but a reserve
    # Wheels that turn at the start leave no such angles, however slowly.
    turning = replace(paper_like_plan(), wheel_momentum=(0.0, 0.0, 0.76 * held))
    plan = paper_like_reference(turning, region, 3, math.inf, rigid_body(craft))
    assert not broken_limits(planned_margins(plan, craft, limits))


def test_the_reference_is_very_small_where_wheels_at_rest_can_give_next_to_nothing(mission):
    craft = mission.at_prior_mean().spacecraft
    wheels = tuple(replace(wheel, max_momentum=2e-4) for wheel in craft.wheels)
    craft = replace(craft, wheels=wheels)
    region = region_within(Limits(rate=1.1 * DEGREE), hardware_limits(craft))
    base = replace(paper_like_plan(), wheel_momentum=())
    plan = paper_like_reference(base, region, 3, math.inf, rigid_body(craft))
    assert max(slew.angle for slew in plan.slews) < 0.1 * DEGREE
