"""The information forecast against the full model."""

from __future__ import annotations

import math
from dataclasses import replace

import jax
import numpy as np
import pytest
from support.other_spacecraft import by_rotors, by_thrusters, gyroless, two_axes_and_vectors

from bayes_inertia.campaign.hardware import CorrelatedNoise, InertiaPrior, RateSensor
from bayes_inertia.design.comparison import estimate_at_truth, expected_sd, likely_missions
from bayes_inertia.design.feasible_region import region_within
from bayes_inertia.design.goals import parse_goal
from bayes_inertia.design.information_forecast import planned_model, prepare_forecast
from bayes_inertia.design.information_matrix import expected_covariance
from bayes_inertia.design.limits import Limits, hardware_limits
from bayes_inertia.design.plan_problem import PlanProblem
from bayes_inertia.flight.mission import Mission, following_plan
from bayes_inertia.flight.plan import PlannedSlew, paper_like_plan
from bayes_inertia.flight.planned_motion import slew_arrays
from bayes_inertia.physics.effects import by_name
from bayes_inertia.physics.small_campaign import small_campaign

# Compiled in half the time: each program runs once.
_expected = jax.jit(
    expected_covariance, static_argnums=0, compiler_options={"xla_backend_optimization_level": 0}
)


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize(
    "names",
    [(), ("wheel_friction", "wheel_command_lag", "rate_sensor_delay", "magnetic_dipole")],
    ids=["J and K", "effects"],
)
def test_forecast_agrees_with_the_full_model_flown_in_closed_loop(mission, names):
    effects = by_name(names)
    forecast = prepare_forecast(paper_like_plan(), mission, effects)
    theta = np.concatenate([mission.theta, np.zeros(len(forecast.layout.names) - 9)])
    slews = slew_arrays(paper_like_plan())
    foreseen = np.sqrt(np.diag(_expected(forecast.layout, forecast.arrays, theta, slews)))
    exact = estimate_at_truth(paper_like_plan(), mission, effects)
    assert exact.model.space.names == forecast.layout.names
    np.testing.assert_allclose(foreseen / exact.sd, 1.0, atol=0.03 if not names else 0.08)


@pytest.mark.slow
def test_a_slew_is_expected_to_tell_the_moment_about_its_axis_only(mission):
    plan = replace(paper_like_plan(), slews=(PlannedSlew((1.0, 0.0, 0.0), 0.5),))
    sd = expected_sd(plan, mission, truths=1)[:6] / np.asarray(mission.prior.sd)
    assert sd[0] < 0.1
    assert sd[1:3].min() > 2.0 * sd[0]


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("kind", [by_thrusters, by_rotors, gyroless, two_axes_and_vectors])
def test_forecast_agrees_with_the_full_model_of_other_spacecraft(kind):
    campaign = kind()
    axes = ((1.0, 0.2, 0.3), (0.1, -1.0, 0.5), (0.3, 0.2, 1.0))
    slews = tuple(PlannedSlew(axis, math.radians(150.0), 0.03, 0.005) for axis in axes)
    mission, plan = Mission.of(campaign), replace(following_plan(campaign), slews=slews)
    forecast, exact = prepare_forecast(plan, mission), estimate_at_truth(plan, mission)
    assert exact.model.space.names == forecast.layout.names
    foreseen = _expected(forecast.layout, forecast.arrays, exact.theta, slew_arrays(plan))
    np.testing.assert_allclose(np.sqrt(np.diag(foreseen)) / exact.sd, 1.0, atol=0.05)


@pytest.mark.long
@pytest.mark.slow
def test_noise_that_is_stated_to_wander_counts_in_the_forecast():
    """Of the first gyro and tracker and of further ones; without it the sds were far smaller."""
    campaign = small_campaign()
    colour = CorrelatedNoise(0.9, 3.0)
    gyro = replace(campaign.rate_sensor, rate_random_walk=2e-6, correlated_noise=colour)
    coarse = RateSensor((1e-4,) * 3, bias_instability=3e-4, bias_instability_time=60.0)
    tracker = replace(campaign.star_tracker, low_frequency_sigma=3e-4)
    slews = (replace(s, more={"mems": s.rate, "second": s.attitude}) for s in campaign.slews)
    campaign = replace(
        campaign,
        rate_sensor=gyro,
        star_tracker=tracker,
        more_sensors=(("mems", coarse), ("second", tracker)),
        slews=tuple(slews),
    )
    axes = ((1.0, 0.2, 0.3), (0.1, -1.0, 0.5), (0.3, 0.2, 1.0))
    slews = tuple(PlannedSlew(axis, math.radians(60.0)) for axis in axes)
    plan = replace(following_plan(campaign), slews=slews, fixes_in_motion=False, fix_spacing=1.0)
    mission = Mission.of(campaign)
    forecast, exact = prepare_forecast(plan, mission), estimate_at_truth(plan, mission)
    foreseen = _expected(forecast.layout, forecast.arrays, exact.theta, slew_arrays(plan))
    np.testing.assert_allclose(np.sqrt(np.diag(foreseen)) / exact.sd, 1.0, atol=0.05)


@pytest.mark.slow
def test_sds_to_expect_of_a_design_are_averaged_over_the_truths_that_are_flown():
    """At the mean alone they were up to 2.6 times smaller where the size of J rests on a gain."""
    campaign = by_thrusters()
    J = np.diag(np.diag(campaign.inertia.tensor))
    campaign = replace(campaign, inertia=InertiaPrior(J, 0.05, 0.1))
    slews = tuple(PlannedSlew(axis, 0.5) for axis in np.eye(3))
    mission, plan = Mission.of(campaign), replace(following_plan(campaign), slews=slews)
    flown = expected_sd(plan, mission, truths=4, seed=1)
    drawn = np.array([m.theta for m in likely_missions(plan, mission, 5, 1)[1:]])
    region = region_within(Limits(), hardware_limits(mission.spacecraft))
    mean = planned_model(plan, mission).expected[None]
    problem = PlanProblem(parse_goal("inertia"), prepare_forecast(plan, mission), mean, region)
    x = problem.variables(slew_arrays(plan))
    (sds,) = problem.parameter_sds(x[None], drawn)
    np.testing.assert_allclose(list(sds.values())[:6], flown[:6], rtol=0.05)
    assert max(flown[3:6] / problem.score(x[None])[2][0, 3:6]) > 1.5
