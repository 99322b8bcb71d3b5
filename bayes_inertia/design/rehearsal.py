"""What a plan would tell, exactly: flown without noise in the closed loop, and linearised there as a fit of its telemetry is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from bayes_inertia.campaign.inertia_prior import InertiaPrior
from bayes_inertia.flight.plan import Plan
from bayes_inertia.flight.plan_flight import Flight, fly, planned_campaign
from bayes_inertia.flight.simulated_campaigns import draw_spacecraft
from bayes_inertia.flight.spacecraft import Controller, Spacecraft, spin_tensor
from bayes_inertia.inference.laplace import Estimate, Starts
from bayes_inertia.inference.likelihood import information, whitening
from bayes_inertia.inference.objective import N_BIAS, normal_equations
from bayes_inertia.inference.point import Point
from bayes_inertia.maths import quaternion
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.forward_model import Model


def theta_of(spacecraft: Spacecraft, prior: InertiaPrior) -> np.ndarray:
    """J's six elements and K (9,) as the fit of a campaign names them (with the wheels' spin where the prior's tensor includes it).

    >>> from bayes_inertia.flight.spacecraft import most_like_prior, most_like_spacecraft
    >>> theta_of(most_like_spacecraft(), most_like_prior())[3].item()
    -0.0119
    """
    J = spacecraft.inertia_B + (
        spin_tensor(spacecraft.wheels) if prior.includes_wheel_spin else 0.0
    )
    return np.array(
        [J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2], *spacecraft.scale_factor]
    )


def rehearse(
    plan: Plan,
    spacecraft: Spacecraft,
    prior: InertiaPrior,
    effects: Sequence[Effect] = (),
    *,
    controller: Controller | None = None,
    seed: int | None = None,
) -> Estimate:
    """The estimate that a plan would lead to, at the truth; its `sd` and `covariance` are those to expect.

    Parameters
    ----------
    spacecraft : the truth to expect (what else acts in it is left out). effects : fitted along, absent in truth.
    controller : None for one that knows the truth and flies just what was planned. seed : of the noise in the flight, None without.
    """
    quiet = replace(spacecraft, bias=spacecraft.rate_sensor.bias, effects=(), values={})
    controller = controller or Controller(quiet.inertia_B, quiet.scale_factor)
    flight = fly(plan, quiet, controller, prior, seed)
    model = Model(flight.campaign, tuple(effects))
    return _at_truth(model, flight, np.concatenate([theta_of(quiet, prior), model.space.nulls[9:]]))


def expected_sd(
    plan: Plan, spacecraft: Spacecraft, prior: InertiaPrior, *, truths: int = 8, seed: int = 0
) -> np.ndarray:
    """Sds (9,) of J and K to expect of a plan: root mean square over flights with noise, each with a truth drawn from the prior, by a
    controller that believes the prior.

    What such a controller gets wrong shakes the spacecraft, which tells more than the planned motion alone: a third in slews that tell little.

    >>> from bayes_inertia.flight.plan import paper_like_plan
    >>> from bayes_inertia.flight.spacecraft import most_like_prior, most_like_spacecraft
    >>> bool(expected_sd(paper_like_plan(), most_like_spacecraft(), most_like_prior(), truths=2)[3] < 1e-4)
    True
    """
    controller = Controller.from_prior(prior, spacecraft.rate_sensor, spacecraft.wheels)
    drawn = likely_truths(plan, spacecraft, prior, truths + 1, seed)[1:]
    flown = [
        rehearse(plan, truth, prior, controller=controller, seed=seed + i)
        for i, truth in enumerate(drawn)
    ]
    return np.sqrt(np.mean([at.sd[:9] ** 2 for at in flown], axis=0))


def _at_truth(model: Model, flight: Flight, theta: np.ndarray) -> Estimate:
    """What an optimizer would find if it found the truth: nothing is left to luck in what is expected."""
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
    point = Point(theta, np.zeros(N_BIAS), local)
    white = whitening(model, theta)
    info = information(model, point, white)
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


def likely_truths(
    plan: Plan, spacecraft: Spacecraft, prior: InertiaPrior, n: int, seed: int
) -> list[Spacecraft]:
    """The spacecraft that the prior describes (its mean), and n - 1 drawn from the prior of J, K and bias."""
    template = planned_campaign(plan, replace(spacecraft, effects=(), values={}), prior)
    rng = np.random.default_rng([seed, 5])
    mean = replace(
        spacecraft,
        inertia_B=prior.tensor
        - (spin_tensor(spacecraft.wheels) if prior.includes_wheel_spin else 0.0),
        scale_factor=spacecraft.rate_sensor.scale_factor,
        effects=(),
        values={},
    )
    return [mean, *(draw_spacecraft(template, rng) for _ in range(n - 1))]
