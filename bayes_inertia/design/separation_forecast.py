"""The forecast of one more slew after a campaign, with two effects fitted together.

What the campaign told about everything fitted and about the two effects at their null stands in the
forecast's prior.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.design.after_campaign import plan_after
from bayes_inertia.design.flight_conditions import conditions_of, last_environment
from bayes_inertia.design.information_forecast import Forecast, ForecastArrays, ForecastLayout
from bayes_inertia.design.plan_arrays import plan_start, plan_times
from bayes_inertia.errors import EffectError
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.objective import marginal_information, prior_rows
from bayes_inertia.inference.point import N_BIAS
from bayes_inertia.maths.linear_algebra import inverse
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.forward_model import Model


@array_dataclass
class SeparationForecast:
    """The forecast of one more slew that is to tell two effects apart.

    Parameters
    ----------
    forecast : Forecast
        Its prior is what the campaign told.
    theta : (d,) array
        The estimate, with both effects at their null.
    groups : ((int, int), (int, int))
        Where the parameters of the two effects stand: (first, behind the last) of each.
    """

    forecast: Forecast
    theta: np.ndarray
    groups: tuple[tuple[int, int], tuple[int, int]]

    def projected_information(self, information: np.ndarray) -> np.ndarray:
        """Information on both effects, projected off everything else that is fitted.

        Parameters
        ----------
        information : (d + 3, d + 3) array
            Of the slew to come; zero for none.

        Returns
        -------
        (k, k) array
            In prior sds, without the effects' own priors; the first effect's k1 parameters before
            those of the second.
        """
        sd = np.asarray(self.forecast.arrays.prior_sd)
        effects = np.concatenate([np.arange(*group) for group in self.groups])
        precision = np.asarray(self.forecast.arrays.prior) + information
        precision[effects, effects] -= sd[effects] ** -2.0
        rest = np.setdiff1d(np.arange(len(precision)), effects)
        across = precision[np.ix_(rest, effects)]
        matrix = (
            precision[np.ix_(effects, effects)]
            - across.T @ inverse(precision[np.ix_(rest, rest)]) @ across
        )
        return matrix * np.outer(sd[effects], sd[effects])


def forecast_separation(estimate: Estimate, a: Effect, b: Effect) -> SeparationForecast:
    """The forecast of one more slew after a campaign, with two effects fitted together.

    Parameters
    ----------
    estimate : Estimate
        The campaign's fit; what it fitted is fitted along.
    a, b : Effect
        The two effects.

    Returns
    -------
    SeparationForecast
        With what the campaign told as its prior.

    Raises
    ------
    EffectError
        If an effect has no parameters in this campaign.
    """
    campaign = estimate.model.campaign
    fitted = _names_of_fitted_effects(estimate) - {a.name, b.name}
    kept = tuple(effect for effect in estimate.model.effects if effect.name in fitted)
    model = Model(campaign, (*kept, a, b), estimate.model.structure.drive)
    for effect in (a, b):
        _require_parameters(model, effect)
    theta = _at_null_of_new(estimate, model, fitted)
    information, prior = _known(estimate, model, theta)
    slices = tuple(model.space.slice_of(effect.name) for effect in (a, b))
    for part in slices:
        # A prior that ends at the null has a slope there; beside the data it counts by its width.
        prior[part, part] = np.diag(model.space.sd[part] ** -2.0)
    plan = plan_after(estimate)
    conditions = conditions_of(
        model,
        last_environment(campaign),
        first=len(campaign.slews),
        slew_count=len(campaign.slews),
        start_time=campaign.span[1] + plan.pause,
        middle=0.5 * sum(campaign.span),
    )
    commanded = model
    if model.structure.drive != "commanded":
        commanded = Model(_with_commands(campaign), (*kept, a, b), "commanded")
    structure, space = replace(commanded.structure, refined=False), model.space
    layout = ForecastLayout(structure, space.names, space.units, plan_times(plan))
    arrays = ForecastArrays(
        conditions._replace(scale=commanded.data.scale),
        plan_start(plan, len(campaign.wheels)),
        model.space.sd,
        information + prior,
    )
    first, second = ((part.start, part.stop) for part in slices)
    return SeparationForecast(Forecast(layout, arrays), theta, (first, second))


def _names_of_fitted_effects(estimate: Estimate) -> set[str]:
    """Names of the effects of which at least one parameter was fitted."""
    names = estimate.model.space.names
    return {names[i].partition(".")[0] for i in estimate.free if i >= 9}


def _require_parameters(model: Model, effect: Effect) -> None:
    part = model.space.slice_of(effect.name)
    if part.stop == part.start:
        raise EffectError(
            "has no parameters in this campaign",
            where=effect.name,
            advice="choose another effect",
        )


def _at_null_of_new(estimate: Estimate, model: Model, fitted: set[str]) -> np.ndarray:
    """Parameters (d,) of the model: as estimated, where they were fitted, else at their null."""
    estimated = dict(zip(estimate.model.space.names, estimate.theta, strict=True))
    names, nulls = model.space.names, model.space.nulls
    known = [name for name in names if name.partition(".")[0] in fitted or "." not in name]
    return np.array(
        [
            estimated[name] if name in known else null
            for name, null in zip(names, nulls, strict=True)
        ]
    )


def _known(estimate: Estimate, model: Model, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What the campaign told about (theta, bias), and their prior precision, (d + 3, d + 3) both.

    Start states are integrated out. Where the campaign's fit holds all parameters of the model, its
    own compiled code serves.
    """
    names = model.space.names
    if set(names) <= set(estimate.model.space.names):
        point, model = estimate.theta.copy(), estimate.model
        for name, value in zip(names, theta, strict=True):
            point[model.space.names.index(name)] = value
    else:
        point = theta
    columns = np.array([model.space.names.index(name) for name in names])
    information = marginal_information(
        model, replace(estimate.point, theta=point), estimate.white, columns
    )
    slope = prior_rows(model, point)[0][columns]
    return information, np.diag(np.concatenate([slope**2, np.ones(N_BIAS)]))


def _with_commands(campaign: Campaign) -> Campaign:
    """The campaign with torque commands of zero, so that the commanded drive can be set up."""
    wheels = len(campaign.wheels)
    slews = (replace(s, wheel_torque=np.zeros((len(s.time), wheels))) for s in campaign.slews)
    return replace(campaign, slews=tuple(slews))
