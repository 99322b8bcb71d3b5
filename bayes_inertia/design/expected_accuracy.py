"""Expected accuracy of a plan, exactly.

The plan is flown in the closed loop. The model is linearised there as a fit of its telemetry is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan
from bayes_inertia.flight.plan_flight import Flight, fly
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_spacecraft
from bayes_inertia.flight.spacecraft import Controller
from bayes_inertia.inference.laplace import Estimate, Starts
from bayes_inertia.inference.likelihood import information_blocks
from bayes_inertia.inference.noise_model import whitening
from bayes_inertia.inference.objective import normal_equations
from bayes_inertia.inference.point import Point
from bayes_inertia.maths import quaternion
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.forward_model import Model


def estimate_at_truth(
    plan: Plan,
    mission: Mission,
    effects: Sequence[Effect] = (),
    *,
    controller: Controller | None = None,
    seed: int | None = None,
) -> Estimate:
    """The estimate that a plan would lead to, at the truth.

    `mission`: its spacecraft is the truth to expect; what else acts in it is left out.
    `controller`: none for one that knows the truth and flies just what was planned. `seed`: of the
    noise in the flight; None for none.
    """
    craft = mission.spacecraft
    bias = craft.rate_sensor.bias if craft.rate_sensor else ()
    quiet = replace(craft, bias=bias, effects=(), values={})
    mission = replace(mission, spacecraft=quiet)
    controller = controller or Controller(quiet.inertia_B, quiet.scale_factor)
    flight = fly(plan, mission, seed, controller=controller)
    model = Model(flight.campaign, tuple(effects))
    theta = model.expected
    theta[: model.n_base] = mission.theta
    for name, value in flight.parameters.items():
        theta[model.space.names.index(name)] = value
    return _at_truth(model, flight, theta)


def expected_sd(plan: Plan, mission: Mission, *, truths: int = 8, seed: int = 0) -> np.ndarray:
    """Sds (6 + axes,) of J and K to expect of a plan.

    The root mean square over flights with noise, each with a truth drawn from the prior, by a
    controller that believes the prior. What such a controller gets wrong shakes the spacecraft,
    which tells more than the planned motion alone: a third in slews that tell little.

    Returns: of Jxx Jyy Jzz Jxy Jxz Jyz [kg m^2] and K1 K2 K3, one an axis of the rate sensor.
    """
    controller = mission.controller()
    estimates = [
        estimate_at_truth(plan, truth, controller=controller, seed=seed + i)
        for i, truth in enumerate(likely_missions(plan, mission, truths + 1, seed)[1:])
    ]
    base = slice(len(mission.theta))
    return np.sqrt(np.mean([estimate.sd[base] ** 2 for estimate in estimates], axis=0))


def likely_missions(plan: Plan, mission: Mission, n: int, seed: int) -> list[Mission]:
    """Missions to expect before flight."""
    template = planned_campaign(plan, mission.without_effects())
    rng = np.random.default_rng([seed, 5])
    craft = mission.at_prior_mean().spacecraft
    drawn = (draw_spacecraft(template, rng, craft=craft) for _ in range(n - 1))
    return [mission.at_prior_mean(), *(replace(mission, spacecraft=x) for x in drawn)]


def _at_truth(model: Model, flight: Flight, theta: np.ndarray) -> Estimate:
    """Estimate of an optimizer that found the truth: nothing expected is left to luck."""
    reference, scale = model.data.arrays.reference, np.asarray(model.data.scale.local)
    start = [
        np.stack([np.asarray(getattr(path, key))[0] for path in flight.truth])
        for key in ("rate_B", "attitude", "wheel_momentum")
    ]
    turned = np.asarray(quaternion.error(reference.attitude, jnp.asarray(start[1])))
    local = (
        np.concatenate(
            [start[0] - reference.rate_B, turned, start[2] - reference.wheel_momentum], axis=1
        )
        / scale
    )
    coefficients = np.zeros((len(local), model.structure.n_local - local.shape[1]))
    local = np.concatenate([local, coefficients], axis=1)
    point = Point(theta, np.zeros(model.n_bias), local)
    white = whitening(model, theta)
    info = information_blocks(model, point, white)
    hessian, _ = normal_equations(model, point, info)
    objective = 0.5 * float(info.chi2.sum() + np.sum(local**2))
    return Estimate(
        model,
        point,
        white,
        white,
        np.ones(info.n_data.shape),
        info,
        hessian,
        objective,
        Starts(1, 1),
    )
