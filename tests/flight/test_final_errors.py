"""Predicted final errors and correction slews, against flights and closed forms."""

from __future__ import annotations

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bayes_inertia.flight.closed_loop import fly_slew
from bayes_inertia.flight.closed_loop_flights import (
    closed_loop_inputs,
    predict_correction_slew,
    predict_final_errors,
)
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan, PlannedSlew, paper_like_plan
from bayes_inertia.flight.plan_flight import fly
from bayes_inertia.flight.spacecraft import (
    Controller,
)
from bayes_inertia.maths import quaternion
from bayes_inertia.physics.effects import (
    ConstantTorque,
)

ARCSECOND = math.radians(1.0 / 3600.0)
DIAGONAL = np.array([1.0, -2.0, 2.0]) / 3.0


@pytest.fixture(scope="module")
def novice(mission) -> Controller:
    """A controller that knows no more than was known before flight."""
    return mission.controller()


@pytest.mark.long
@pytest.mark.slow
def test_correction_slews_shrink_with_knowledge_of_the_scale_factors(mission, craft, novice):
    """Ferguson's 38 degree slew: 1000s of arc seconds before the estimate; K decides, not J."""
    plan = Plan("38 degrees", (PlannedSlew(tuple(DIAGONAL), math.radians(38.0)),))
    rng = np.random.default_rng(3)
    prior, truth = mission.prior, mission.theta
    elements = rng.normal(prior.elements, prior.sd, (200, 6))
    wide = np.concatenate([elements, rng.normal(1.0, 0.03, (200, 3))], axis=1)
    angles = predict_correction_slew(wide, plan, mission, novice)
    turn = plan.slews[0].angle * DIAGONAL
    closed_form = np.asarray(
        quaternion.error(
            quaternion.exp(jnp.asarray(turn)), quaternion.exp(jnp.asarray(wide[:, 6:] * turn))
        )
    )
    np.testing.assert_allclose(angles, np.linalg.norm(closed_form, axis=1), rtol=0.05, atol=2e-4)
    narrow = np.concatenate([elements, rng.normal(truth[6:], 0.001, (200, 3))], axis=1)
    informed = Controller(craft.inertia_B, tuple(truth[6:]))
    assert np.median(predict_correction_slew(narrow, plan, mission, informed)) < 0.1 * np.median(
        angles
    )
    assert np.median(angles) > 500 * ARCSECOND


@pytest.mark.long
@pytest.mark.slow
def test_predictions_are_flights(mission, craft, novice):
    plan = paper_like_plan()
    flight = fly(plan, mission, None)
    predicted = predict_final_errors(mission.theta[None], plan, mission, novice, index=4)
    np.testing.assert_allclose(predicted[0], flight.final_error_B[4], atol=1e-12)
    locked = Mission(craft, replace(mission.prior, includes_wheel_spin=True))
    same = predict_final_errors(locked.theta[None], plan, locked, novice, index=4)
    np.testing.assert_allclose(same[0], flight.final_error_B[4], atol=1e-12)
    pushed = replace(
        craft,
        effects=(ConstantTorque(),),
        values={"constant_torque": {"torque": np.array([0.0, 0.0, 5e-5])}},
    )
    draws = np.tile(mission.theta, (2, 1))
    pushed_mission = replace(mission, spacecraft=pushed)
    of_spacecraft = predict_final_errors(draws, plan, pushed_mission, novice, index=4)
    drawn = {"constant_torque": {"torque": np.array([[0.0, 0.0, 5e-5], [0.0, 0.0, 0.0]])}}
    of_draws = predict_final_errors(draws, plan, pushed_mission, novice, index=4, values=drawn)
    np.testing.assert_allclose(of_draws[0], of_spacecraft[0], atol=1e-12)
    np.testing.assert_allclose(of_draws[1], flight.final_error_B[4], atol=1e-9)
    assert np.max(np.abs(of_spacecraft[0] - flight.final_error_B[4])) > 5 * ARCSECOND
    noisy = predict_final_errors(
        np.tile(mission.theta, (50, 1)), plan, mission, novice, index=4, seed=1
    )
    assert np.all(noisy.std(axis=0) > 5 * ARCSECOND)


@pytest.mark.slow
def test_a_loop_that_acts_every_ten_seconds_is_stable(mission, craft):
    """A large spacecraft's commands: with J and K known, a slew missed by 20 arc minutes."""
    turn = PlannedSlew((1.0, 0.0, 0.0), math.radians(60.0), rate=math.radians(0.2))
    plan = Plan("slow", (turn,), telemetry_period=10.0, fix_spacing=10.0, settle=120.0)
    informed = Controller(craft.inertia_B, craft.scale_factor)
    missed = predict_correction_slew(mission.theta[None], plan, mission, informed)
    assert missed[0] < 60 * ARCSECOND


@pytest.mark.long
@pytest.mark.slow
def test_gradient_of_the_final_error_with_respect_to_the_slew(mission, craft):
    """Slew design differentiates through a flight: reverse mode against a finite difference."""
    plan = Plan("one", (PlannedSlew((1.0, 0.0, 0.0), math.radians(20.0)),))
    _, loop = closed_loop_inputs(plan, mission)
    alone = {
        key: jax.tree.map(lambda x: x[0], getattr(loop, key))
        for key in ("slew", "schedule", "noise")
    }
    start = jax.tree.map(lambda x: x[0], loop.plant.start)
    loop = replace(loop, plant=loop.plant._replace(start=start), **alone)

    def error(angle):
        schedule = loop.schedule._replace(angle=angle)
        return fly_slew(replace(loop, schedule=schedule)).final_error_B[0]

    angle, step = 0.35, 1e-4
    error_and_slope = jax.jit(jax.value_and_grad(error))
    difference = float(error_and_slope(angle + step)[0] - error_and_slope(angle - step)[0]) / (
        2 * step
    )
    assert float(error_and_slope(angle)[1]) == pytest.approx(difference, rel=1e-3)
    assert difference == pytest.approx(0.01, rel=0.05)  # the error of K along x
