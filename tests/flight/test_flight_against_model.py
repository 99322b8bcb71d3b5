"""The model that is fitted, against flights of the closed loop."""

from __future__ import annotations

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bayes_inertia.flight.mission import Mission, most_like_mission
from bayes_inertia.flight.plan import PlannedSlew, paper_like_plan
from bayes_inertia.flight.plan_flight import Flight, fly
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_spacecraft
from bayes_inertia.inference import optimizer
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import (
    FlexibleMode,
    MagneticDipole,
    RateSensorDelay,
    StarTrackerMisalignment,
    WheelCommandLag,
)
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.prediction import predict
from bayes_inertia.physics.slew_input import Start

DIAGONAL = np.array([1.0, -2.0, 2.0]) / 3.0


@pytest.fixture(scope="module")
def mission() -> Mission:
    return most_like_mission()


@pytest.fixture(scope="module")
def noisy(mission) -> Flight:
    return fly(paper_like_plan(), mission, 11)


def predicted_minus_flown(
    flight: Flight, effects: tuple[Effect, ...], *, each_row: bool = True
) -> tuple[float, float, float]:
    """Largest difference (rate, momentum, attitude) between a quiet flight and the model.

    The model integrates from row to row as the flight did, or in the steps that it chooses itself.
    """
    craft, model = flight.spacecraft, Model(flight.campaign, effects)
    structure = replace(model.structure, rows_per_step=1) if each_row else model.structure
    extra = [
        np.atleast_1d(craft.values[e.name][p.name])
        for e in effects
        for p in e.parameters(flight.campaign)
    ]
    theta = jnp.asarray(np.concatenate([flight.mission.theta, *extra]))
    truth = Start(
        *(
            jnp.stack([getattr(x, key)[0] for x in flight.truth])
            for key in ("rate_B", "attitude", "wheel_momentum")
        )
    )
    bias = (jnp.asarray(craft.bias) - model.data.sensors[0].bias) / model.data.scale.bias
    nothing = structure.nuisances(jnp.zeros(structure.n_local))

    def one(slew, telemetry, reference):
        return predict(structure, theta, nothing, bias, slew, telemetry, reference, model.data)

    telemetry = model.data.arrays.telemetry
    predicted = jax.jit(jax.vmap(one))(model.data.arrays.slews, telemetry, truth)
    rate, attitude, momentum = (
        float(np.abs(np.where(r.valid, channel.gap(r.values, p), 0.0)).max())
        for channel, r, p in zip(model.channels, telemetry.readings, predicted, strict=True)
    )
    return rate, momentum, attitude


@pytest.mark.slow
def test_the_model_reproduces_a_flight_exactly(mission):
    flight = fly(paper_like_plan(), mission, None)
    # The flight integrates from row to row with order four: 4e-11 rad after a minute.
    assert max(predicted_minus_flown(flight, ())) < 1e-10
    rate, momentum, attitude = predicted_minus_flown(flight, (), each_row=False)
    craft = flight.spacecraft
    assert 0.0 < rate < 0.01 * min(craft.rate_sensor.sigma)
    assert momentum < 0.01 * min(wheel.momentum_sigma for wheel in craft.wheels)
    assert attitude < 0.01 * craft.star_tracker.sigma_cross


@pytest.mark.long
@pytest.mark.slow
def test_the_model_reproduces_effects_inside_and_around_the_loop(mission):
    """In-step hooks, own states, a refined grid, an environment, three whole-history hooks."""
    effects = (
        FlexibleMode(),
        MagneticDipole(),
        WheelCommandLag(),
        RateSensorDelay(),
        StarTrackerMisalignment(),
    )
    plan = replace(paper_like_plan(), slews=(PlannedSlew(tuple(DIAGONAL), math.radians(30.0)),))
    template = planned_campaign(plan, mission)
    hidden = draw_spacecraft(template, np.random.default_rng(4), effects)
    flight = fly(plan, replace(mission, spacecraft=hidden), None)
    # The relaxation ends at 1e-9 of the largest command, 3e-3 N m; over 60 s on 2 kg m^2 that is
    # 3e-9 rad at the very most.
    assert max(predicted_minus_flown(flight, effects)) < 3e-9
    plain = fly(plan, flight.mission.without_effects(), None)
    assert np.abs(plain.campaign.slews[0].rate - flight.campaign.slews[0].rate).max() > 1e-5


@pytest.mark.slow
def test_estimate_recovers_the_truth(noisy):
    estimate = optimizer.estimate(Model(noisy.campaign), seed=0)
    sd = np.sqrt(np.diag(estimate.covariance))
    error = estimate.theta - noisy.mission.theta
    # A product of nine correlated normals: the squared Mahalanobis distance is chi^2 with 9 degrees
    # of freedom, 0.9999 quantile 33.7.
    distance = error @ np.linalg.solve(estimate.covariance, error)
    assert distance < 33.7, error / sd
    scale_factor_sigma = noisy.spacecraft.rate_sensor.scale_factor_sigma
    prior = np.concatenate([noisy.mission.prior.sd, scale_factor_sigma])
    assert np.all(sd[[0, 1, 2, 6, 7, 8]] < 0.25 * prior[[0, 1, 2, 6, 7, 8]])
