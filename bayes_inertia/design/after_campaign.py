"""What the fit of a campaign knows about the next one: where it begins, and what J and K are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.design.information_forecast import Forecast, with_noise_of
from bayes_inertia.flight.mission import Mission, following_plan, spacecraft_at
from bayes_inertia.flight.plan import Plan
from bayes_inertia.flight.spacecraft import spin_tensor
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.linear_algebra import inverse
from bayes_inertia.maths.physical_draws import draw_physical


def plan_after(estimate: Estimate) -> Plan:
    """A plan of one slew, yet to be chosen, that begins where the fitted campaign ended."""
    return following_plan(estimate.model.campaign, final_wheel_momentum(estimate))


def final_wheel_momentum(estimate: Estimate) -> np.ndarray:
    """Wheel momentum at the end of a fitted campaign.

    The fit holds the momentum at the first row of each slew. The torque commands since then change
    it: H' = u, with the body at rest at both ends of the slew (Ferguson's equation 6).

    Returns (wheels,): momentum relative to the body [N m s]. With the measured drive, which needs
    tachometers, that of the last slew's first row.
    """
    model = estimate.model
    slew, wheels = model.campaign.slews[-1], len(model.campaign.wheels)
    start = np.asarray(model.data.arrays.reference.wheel_momentum)[-1].copy()
    if model.structure.drive == "measured" or slew.wheel_torque is None:
        return start
    scale = np.asarray(model.data.scale.local)[6 : 6 + wheels]
    start += estimate.point.local[-1, 6 : 6 + wheels] * scale
    return start + np.diff(slew.time) @ slew.wheel_torque[:-1]


def forecast_after(forecast: Forecast, estimate: Estimate) -> Forecast:
    """A forecast with the noise of a campaign's fit, what that told in place of the prior."""
    model, names = estimate.model, forecast.layout.names
    # Errors of devices and sensors that do not fly are integrated out.
    fitted = [
        i for i in range(model.n_known) if i in estimate.free and model.space.names[i] in names
    ]
    columns = [list(estimate.free).index(i) for i in fitted]
    bias = np.arange(model.n_bias)
    known = np.concatenate([columns, len(estimate.free) + bias]).astype(int)
    rows = [names.index(model.space.names[i]) for i in fitted]
    place = np.concatenate([rows, len(names) + bias]).astype(int)
    prior = np.array(forecast.arrays.prior)
    prior[np.ix_(place, place)] = inverse(estimate.joint_covariance[np.ix_(known, known)])
    conditions = with_noise_of(forecast.arrays.conditions, forecast.layout.structure, estimate)
    arrays = forecast.arrays._replace(conditions=conditions, prior=prior)
    return replace(forecast, arrays=arrays)


def missions_after(estimate: Estimate, draws: int, seed: int) -> list[Mission]:
    """Missions to expect after a campaign."""
    rng, campaign = np.random.default_rng([seed, 5]), estimate.model.campaign
    n = estimate.model.n_base
    mean, covariance = estimate.theta[:n], estimate.quoted_covariance[:n, :n]
    drawn = draw_bodies(
        campaign,
        lambda k: rng.multivariate_normal(mean, covariance, k, method="cholesky"),
        draws - 1,
    )
    crafts = (spacecraft_at(campaign, x) for x in [mean, *drawn])
    return [Mission(craft, campaign.inertia, campaign.prior) for craft in crafts]


def draw_bodies(campaign: Campaign, draw: Callable[[int], np.ndarray], n: int) -> np.ndarray:
    """Draws around an estimate, every J one that a body can have.

    `campaign`: it tells whether the draws hold J or J_locked. `draw`: takes a number k and returns
    k draws (k, d); J's six elements [kg m^2] come first. Returns (n, d).
    """
    spin = None
    if campaign.inertia.includes_wheel_spin:
        spin = np.asarray(inertia_tensor.elements(jnp.asarray(spin_tensor(campaign.wheels))))
    return draw_physical(
        draw,
        n,
        wheel_spin=spin,
        where="the estimate",
        advice="hardly any tensor within its uncertainty is one of a body: fly more slews first",
    )
