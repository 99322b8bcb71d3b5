"""What the fit of a campaign knows about the next one: where it begins, and what J and K are.

Also the error of the next correction slew: what the base model promises, and what the effects found
in the data will make of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.linalg import block_diag

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import axis_names
from bayes_inertia.campaign.prior import GaussianPrior
from bayes_inertia.design.information_forecast import Forecast
from bayes_inertia.design.numerics import NUMERICS
from bayes_inertia.flight.closed_loop_flights import predict_correction_slew
from bayes_inertia.flight.mission import Mission, following_plan, spacecraft_at
from bayes_inertia.flight.orbit import Orbit
from bayes_inertia.flight.plan import Plan, PlannedSlew
from bayes_inertia.flight.simulated_campaigns import draw_bodies
from bayes_inertia.flight.spacecraft import Controller, Spacecraft, axes_of_control
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.linear_algebra import inverse
from bayes_inertia.maths.values import AnyArray, array_dataclass
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import ParameterSpace
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


Values = dict[str, dict[str, AnyArray]]


@dataclass(frozen=True)
class CorrectionForecast:
    """Correction slew after a slew of 60 degrees about the worst body axis.

    All angles are (median, 95 % quantile) over draws from the fit [rad].

    Parameters
    ----------
    axis : str
        "x", "y" or "z": the axis with the largest expected correction.
    promised : (float, float)
        If the base model were true and flown with its J and K.
    expected : (float, float)
        With the effects found, flown with the base model's J and K.
    updated : (float, float)
        With the effects found, flown with the J and K that were estimated together with them.
    """

    axis: str
    promised: tuple[float, float]
    expected: tuple[float, float]
    updated: tuple[float, float]


@dataclass(frozen=True)
class UpdateForecast:
    """Correction slew after a slew of 60 degrees about the worst body axis, without effects.

    All angles are (5 % quantile, median, 95 % quantile) over draws from the fit [rad].
    """

    axis: str  # "x", "y" or "z": the axis with the largest correction before
    before: tuple[float, float, float]  # flown with the old J and K
    after: tuple[float, float, float]  # flown with the new ones


@array_dataclass
class _Case:
    """What flies in one of the three cases: draws (n, d), effects' values, the believed craft."""

    thetas: np.ndarray
    values: Values
    believed: Spacecraft


def correction_forecast(
    base: Estimate, final: Estimate, *, seed: int = 0, draws: int = 48
) -> CorrectionForecast | None:
    """Predict the next correction slew before and after effects were added.

    J, K and the effects are drawn together. The controller knows J and K and compensates no effect:
    what remains in `updated` is what only a change of the on-board software, or a repair, would
    take away. Noise is left out.
    """
    campaign = final.model.campaign
    if not _can_slew(campaign):
        return None
    rng = np.random.default_rng([seed, 7])
    thetas = [_draws(estimate, rng, draws) for estimate in (base, final)]
    effects = _fully_fitted_effects(final)
    mission, cases = _mission_and_cases(base, final, effects, thetas, seed)
    orbit = Orbit() if any(effect.needs for effect in effects) else None
    plan = replace(plan_after(final), orbit=orbit)
    axis, found = _about_the_worst_axis(cases, plan, mission, judged=1)
    return CorrectionForecast(axis, *(case[1:] for case in found)) if axis else None


def correction_with_update(
    campaign: Campaign, draws: np.ndarray, old: np.ndarray, new: np.ndarray
) -> UpdateForecast | None:
    """Predict the next correction slew with the old and with the new J and K on board.

    Every draw is the truth once. Effects and noise are left out.
    """
    if not _can_slew(campaign):
        return None
    crafts = [replace(spacecraft_at(campaign, x), bias=(0.0, 0.0, 0.0)) for x in (old, new)]
    mission = Mission(crafts[1], campaign.inertia)
    cases = [_Case(draws, {}, craft) for craft in crafts]
    axis, found = _about_the_worst_axis(cases, following_plan(campaign), mission, judged=0)
    return UpdateForecast(axis, *found) if axis else None


def _about_the_worst_axis(
    cases: Sequence[_Case], plan: Plan, mission: Mission, *, judged: int
) -> tuple[str, list[tuple[float, float, float]]]:
    """The body axis with the largest median of one case, and the quantiles of all cases.

    `judged`: which case. Returns no axis where a flight went astray.
    """
    forecasts = []
    period = plan.telemetry_period
    plan = replace(plan, telemetry_period=period / math.ceil(period / NUMERICS.control_period))
    for axis in np.eye(3):
        one = replace(plan, slews=(PlannedSlew(tuple(axis), NUMERICS.corrected_turn),))
        forecasts.append([_quantiles(case, one, mission) for case in cases])
    worst = int(np.argmax([found[judged][1] for found in forecasts]))
    return "xyz"[worst] if np.isfinite(forecasts).all() else "", forecasts[worst]


def _can_slew(campaign: Campaign) -> bool:
    """Whether correction slews are measured, and wheels turn the spacecraft about all axes."""
    measured = campaign.star_tracker is not None and len(axis_names(campaign.rate_sensor)) == 3
    return measured and axes_of_control(campaign.wheels) == 3


def _fully_fitted_effects(estimate: Estimate) -> tuple[Effect, ...]:
    """The effects of which all parameters were fitted.

    Without those of devices that do not fly, and without changes of J: draws have the J after them.
    """
    space, flying = estimate.model.space, ("", *estimate.model.campaign.names)
    held = {i for i in range(space.size) if i not in estimate.free}
    return tuple(
        effect
        for effect in estimate.model.effects
        if effect.device in flying
        and not changed_inertia(effect, estimate.model.campaign)
        and not set(range(*space.slice_of(effect.name).indices(space.size))) & held
    )


def _mission_and_cases(
    base: Estimate,
    final: Estimate,
    effects: tuple[Effect, ...],
    thetas: Sequence[np.ndarray],
    seed: int,
) -> tuple[Mission, tuple[_Case, _Case, _Case]]:
    """Sensors, wheels and effects that fly, and the three cases of `CorrectionForecast`."""
    campaign, model = final.model.campaign, final.model
    ends = [np.array(after_changes(x.model, x.theta)) for x in (base, final)]
    old, new = (replace(spacecraft_at(campaign, x), bias=(0.0, 0.0, 0.0)) for x in ends)
    fitted = _parameters_afterwards(model, effects, final.theta[None])
    at_estimate = {name: {k: x[0] for k, x in p.items()} for name, p in fitted.items()}
    afterwards = tuple(effect.afterwards() for effect in effects)
    acting = replace(new, effects=afterwards, values=at_estimate)
    # The base model is flown with the effects at their null: all cases share compiled code.
    plain, true = thetas
    nulls = np.tile(model.space.nulls, (len(plain), 1))
    disturbed = _parameters_afterwards(model, effects, true, np.random.default_rng([seed, 8]))
    undisturbed = _parameters_afterwards(model, effects, nulls)
    cases = _Case(plain, undisturbed, old), _Case(true, disturbed, old), _Case(true, disturbed, new)
    return Mission(acting, campaign.inertia), cases


def _quantiles(case: _Case, plan: Plan, mission: Mission) -> tuple[float, float, float]:
    """Quantiles 5 %, 50 % and 95 % of the correction slew [rad] in one case."""
    controller = Controller(case.believed.inertia_B, case.believed.scale_factor)
    angles = predict_correction_slew(
        case.thetas[:, :9], plan, mission, controller, values=case.values
    )
    low, median, high = np.quantile(angles, [0.05, 0.5, 0.95]).tolist()
    return low, median, high


def _draws(estimate: Estimate, rng: np.random.Generator, n: int) -> np.ndarray:
    """Draws (n, d) of what the fit quotes of all parameters, every J physical."""
    space, (mean, covariance) = estimate.model.space, known_after(estimate)
    covariance = covariance[: len(mean), : len(mean)]
    thetas = draw_bodies(
        estimate.model.campaign,
        lambda k: rng.multivariate_normal(mean, covariance, size=k),
        n,
        where="the estimate",
        advice="hardly any tensor within its uncertainty is one of a body: fly more slews first",
    )
    margin = 1e-9 * space.sd
    thetas[:, 6:] = np.clip(thetas, space.lower + margin, space.upper - margin)[:, 6:]
    return thetas


def _parameters_afterwards(
    model: Model,
    effects: tuple[Effect, ...],
    thetas: np.ndarray,
    rng: np.random.Generator | None = None,
) -> dict[str, dict[str, np.ndarray]]:
    """Parameters of effects in the next slew, for n draws (n, d): {effect: {parameter: (n, ...)}}.

    What the campaign does not tell of the next slew is drawn from its prior, or null without `rng`.
    """
    parameters = {}
    for effect in effects:
        after = effect.afterwards().parameters(model.campaign)
        space = ParameterSpace(tuple((effect.name, p) for p in after))
        if after == effect.parameters(model.campaign):
            rows = thetas[:, model.space.slice_of(effect.name)]
        elif rng is None:
            rows = np.tile(space.nulls, (len(thetas), 1))
        else:
            rows = space.draw(rng, len(thetas))
        drawn = [space.split(row).get(effect.name, {}) for row in rows]
        parameters[effect.name] = {
            key: np.stack([np.asarray(d[key]) for d in drawn]) for key in drawn[0]
        }
    return parameters
