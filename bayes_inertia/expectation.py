"""What a plan would tell, exactly: flown without noise in the closed loop, and linearised there as a fit of its telemetry is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayes_inertia.campaign import InertiaPrior
from bayes_inertia.effect import Effect
from bayes_inertia.estimate import Estimate, estimate
from bayes_inertia.maneuver import fly, planned_campaign
from bayes_inertia.model import Model
from bayes_inertia.plan import Plan
from bayes_inertia.simulation import draw_spacecraft
from bayes_inertia.spacecraft import Controller, Spacecraft, spin_tensor


def theta_of(spacecraft: Spacecraft, prior: InertiaPrior) -> np.ndarray:
    """J's six elements and K (9,) as the fit of a campaign names them (with the wheels' spin where the prior's tensor includes it).

    >>> from bayes_inertia.spacecraft import most_like_prior, most_like_spacecraft
    >>> theta_of(most_like_spacecraft(), most_like_prior())[3].item()
    -0.0119
    """
    J = spacecraft.inertia_B + (spin_tensor(spacecraft.wheels) if prior.includes_wheel_spin else 0.0)
    return np.array([J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2], *spacecraft.scale_factor])


def rehearse(plan: Plan, spacecraft: Spacecraft, prior: InertiaPrior, effects: Sequence[Effect] = ()) -> Estimate:
    """The estimate that a plan would lead to without noise; its `sd` and `covariance` are those to expect.

    Parameters
    ----------
    spacecraft : the truth to expect (what else acts in it is left out). effects : fitted along, absent in truth.
    """
    quiet = replace(spacecraft, bias=spacecraft.rate_sensor.bias, effects=(), values={})
    controller = Controller(quiet.inertia_B, quiet.scale_factor)
    centred = replace(prior, tensor=quiet.inertia_B + (spin_tensor(quiet.wheels) if prior.includes_wheel_spin else 0.0))
    # Prior sds are fractions of the tensor that the campaign will state, not of this truth.
    sized = replace(centred, relative_sigma=prior.relative_sigma * float(np.trace(prior.tensor) / np.trace(centred.tensor)))
    model = Model(fly(plan, quiet, controller, sized, None).campaign, tuple(effects))
    theta = np.concatenate([theta_of(quiet, prior), model.space.nulls[9:]])
    return estimate(model, start=theta, discount=False)


def likely_truths(plan: Plan, spacecraft: Spacecraft, prior: InertiaPrior, n: int, seed: int) -> list[Spacecraft]:
    """The spacecraft that the prior describes (its mean), and n - 1 drawn from the prior of J, K and bias."""
    template = planned_campaign(plan, replace(spacecraft, effects=(), values={}), prior)
    rng = np.random.default_rng([seed, 5])
    mean = replace(
        spacecraft,
        inertia_B=prior.tensor - (spin_tensor(spacecraft.wheels) if prior.includes_wheel_spin else 0.0),
        scale_factor=spacecraft.rate_sensor.scale_factor,
        effects=(),
        values={},
    )
    return [mean, *(draw_spacecraft(template, rng) for _ in range(n - 1))]
