"""What the fit of a campaign knows about the next one: where it begins, and what J and K are."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.linalg import block_diag

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.prior import GaussianPrior
from bayes_inertia.design.information_forecast import Forecast
from bayes_inertia.flight.mission import Mission, following_plan
from bayes_inertia.flight.plan import Plan
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.linear_algebra import inverse
from bayes_inertia.maths.values import AnyArray
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.slew_input import idle_slew


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


def known_after(estimate: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """Parameters of slews after a campaign, and their covariance with the whitened bias.

    J is the one after what changed it on the way. The covariance counts what the fit quotes beyond
    its model: slews that disagree, and what a former result quoted so. Returns theta (d,) and (d +
    b, d + b); zero for parameters held.
    """
    model, theta = estimate.model, estimate.theta
    d, b = len(theta), model.n_bias
    place = np.concatenate([estimate.free, d + np.arange(b)]).astype(int)
    known = np.zeros((d + b, d + b))
    n = len(place)
    known[np.ix_(place, place)] = estimate.dispersion_factor**2 * estimate.joint_covariance[:n, :n]
    known[:d, :d] += estimate.prior_beyond_shifts.T @ estimate.prior_beyond_shifts
    slope = block_diag(jax.jacfwd(lambda x: after_changes(model, x))(jnp.asarray(theta)), np.eye(b))
    return np.array(after_changes(model, theta)), slope @ known @ slope.T


def changed_inertia(effect: Effect, campaign: Campaign) -> bool:
    """Whether J is another one after a campaign than before, by as much as the campaign tells."""
    after = effect.afterwards()
    if after == effect or not effect.acts("inertia"):
        return False
    return after.parameters(campaign) == effect.parameters(campaign)


def after_changes(model: Model, theta: AnyArray) -> Array:
    """Parameters (d,) with the J that slews after the campaign have."""
    theta = jnp.asarray(theta)
    J, context = inertia_tensor.tensor(theta[:6]), idle_slew(np.array([0.0, 1.0])).context
    for effect, p in model.structure.active_effects(theta):
        if changed_inertia(effect, model.campaign):
            J = effect.afterwards().inertia(p, context, J)
    return jnp.concatenate([inertia_tensor.elements(J), theta[6:]])


def as_loud(hardware: Any, estimate: Estimate) -> Any:
    """A campaign or spacecraft whose sensors are as loud as a fit found them: by its `discount`."""
    further = dict(hardware.more_sensors)
    for channel, share in zip(estimate.model.channels, estimate.discount.mean(0), strict=True):
        if channel.stream.field or channel.name in further:
            hardware = channel.stream.louder(hardware, float(share) ** -0.5)
    return hardware


def mission_after(mission: Mission, estimate: Estimate) -> Mission:
    """The mission as the fit of a campaign leaves it: J and K as found, noise as loud as found."""
    theta, covariance = known_after(estimate)
    n_base = min(len(mission.theta), estimate.model.n_base)
    found = np.flatnonzero(np.diag(covariance)[:n_base])
    names = tuple(estimate.model.space.names[i] for i in found)
    known = GaussianPrior(names, theta[found], covariance[np.ix_(found, found)])
    craft = as_loud(mission.spacecraft, estimate)
    return replace(mission, spacecraft=craft, known=known).at_prior_mean()


def forecast_after(forecast: Forecast, estimate: Estimate) -> Forecast:
    """A forecast with what a campaign told in place of the prior."""
    model, names = estimate.model, forecast.layout.names
    # Errors of devices and sensors that do not fly are integrated out.
    fitted = [
        i for i in range(model.n_known) if i in estimate.free and model.space.names[i] in names
    ]
    bias = np.arange(model.n_bias)
    known = np.concatenate([fitted, len(estimate.theta) + bias]).astype(int)
    rows = [names.index(model.space.names[i]) for i in fitted]
    place = np.concatenate([rows, len(names) + bias]).astype(int)
    prior = np.array(forecast.arrays.prior)
    prior[np.ix_(place, place)] = inverse(known_after(estimate)[1][np.ix_(known, known)])
    return replace(forecast, arrays=forecast.arrays._replace(prior=prior))
