"""The one slew that best separates two effects which a campaign cannot tell apart.

The measure is that of `score_test`: sensitivities of both effects at their null, projected off
everything that is fitted, in units of their prior sds. The canonical correlation says how well one
can imitate the other. What is left of one's signal power after projecting off the other is its
non-centrality. The slew added is the one after which the two effects, fitted together, would be
known best.

The forecast of one more slew after a campaign, with two effects fitted together.

What the campaign told about everything fitted and about the two effects at their null stands in the
forecast's prior.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from bayes_inertia.design.after_campaign import as_loud, mission_after, plan_after
from bayes_inertia.design.feasible_region import draw_variables, region_within, require_three_axes
from bayes_inertia.design.goals import Goal
from bayes_inertia.design.information_forecast import (
    Forecast,
    conditions_of,
    forecast_of,
    last_environment,
)
from bayes_inertia.design.limits import Limits, hardware_limits, limits_of_next_slew, rate_turned_at
from bayes_inertia.design.margins import Margin, broken_limits, planned_margins
from bayes_inertia.design.numerics import NUMERICS
from bayes_inertia.design.plan_problem import PlanProblem
from bayes_inertia.errors import CampaignError, EffectError, require, require_kind
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import PlannedSlew
from bayes_inertia.flight.planned_motion import planned_slews
from bayes_inertia.flight.spacecraft import Spacecraft
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.objective import marginal_information, prior_equations
from bayes_inertia.maths.linear_algebra import canonical_correlation, inverse
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.named_effects import effects_named


@dataclass(frozen=True)
class Separation:
    """The slew that best separates two effects.

    Parameters
    ----------
    slew : PlannedSlew
        To be flown next.
    effects : (str, str)
        Names of the two effects, (a, b).
    correlation : (float, float)
        Largest canonical correlation of their sensitivities before and after the slew; at 1 one can
        imitate the other.
    noncentrality : ((float, float), (float, float))
        ((a before, a after), (b before, b after)): mean chi^2 that an effect of prior size leaves
        when the other effect and everything fitted try to imitate it.
    margins : tuple of Margin
        What the slew leaves of every limit.
    """

    slew: PlannedSlew
    effects: tuple[str, str]
    correlation: tuple[float, float]
    noncentrality: tuple[tuple[float, float], tuple[float, float]]
    margins: tuple[Margin, ...]


def separating_slew(
    estimate: Estimate, a: Effect, b: Effect, limits: Limits | None = None, *, seed: int = 0
) -> Separation:
    """The single feasible slew which, flown after a campaign, best separates two effects.

    Parameters
    ----------
    estimate : Estimate
        The campaign's fit; what it fitted is fitted along, but for a and b themselves.
    a, b : Effect
        The two effects.
    limits : Limits, optional
        None for 1.1 times the campaign's largest rate (1 deg/s if it rested), and twice the time
        of its longest slew.
    seed : int, optional
        Of the search.

    Returns
    -------
    Separation
        The slew, and how well it separates the two.

    Raises
    ------
    EffectError
        If an effect has no parameters in this campaign, or states of its own.
    CampaignError
        If the wheels do not span three axes, or no feasible slew was found (it names the limit).

    Examples
    --------
    It searches for seconds to minutes, so this is no doctest::

        a, b = effects_named(["wheel_command_lag", "wheel_torque_gain"])
        separation = separating_slew(estimate, a, b)
    """
    require_kind(estimate, Estimate, "estimate", "give what `estimate` returned")
    a, b = effects_named((a, b))
    campaign = estimate.model.campaign
    mission = Mission.of(campaign)
    require_three_axes(mission.spacecraft, CampaignError)
    spacecraft = mission_after(mission, estimate).spacecraft
    limits = limits or limits_of_next_slew(campaign)
    forecast, theta = forecast_separation(estimate, a, b)
    region = region_within(
        limits,
        hardware_limits(spacecraft),
        default_rate=rate_turned_at(campaign),
        scale_factor_sigma=float(estimate.sd[6 : estimate.model.n_base].max(initial=0.0)),
    )
    problem = PlanProblem(Goal("separate", (a.name, b.name)), forecast, theta[None], region)
    best, information = _search(problem, seed)
    slew = planned_slews(problem.slews(best[None]))[0]
    margins = planned_margins(replace(plan_after(estimate), slews=(slew,)), spacecraft, limits)
    for margin in broken_limits(margins):
        what = f"no slew that separates {a.name} from {b.name} was found within the limits"
        raise CampaignError(f"{what}: {margin.says}", where="limits", advice="loosen it")
    nothing = np.zeros_like(information)
    two = [_projected(problem, told) for told in (nothing, information)]  # before and after
    (start, stop), _ = problem.groups
    first = stop - start
    of_a, of_b = np.arange(first), np.arange(first, len(two[0]))
    before, after = (canonical_correlation(matrix, first) for matrix in two)
    power = [
        (noncentrality(two[0], *pair), noncentrality(two[1], *pair))
        for pair in ((of_a, of_b), (of_b, of_a))
    ]
    return Separation(slew, (a.name, b.name), (before, after), (power[0], power[1]), margins)


def _search(problem: PlanProblem, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The best slew (5,) and its information: random slews, then others ever closer to the best."""
    rng, forecast = np.random.default_rng([seed, 11]), problem.forecast

    def scored(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The goal (n,) of slews (n, 5), what is not allowed penalised, and their information."""
        value, slacks, _, information = problem.score(x[:, None])
        missing = sum(np.maximum(0.0, -s).reshape(len(x), -1).sum(1) for s in slacks.values())
        return value + NUMERICS.limit_penalty * missing, information[:, 0]

    body = forecast.body(problem.thetas[0])
    n = NUMERICS.first_batches * NUMERICS.slews_per_batch
    x = draw_variables(rng, n, 1, problem.region, forecast.layout.times, body)[:, 0]
    values, information = scored(x)
    width = NUMERICS.first_width
    for _ in range(NUMERICS.search_rounds):
        order = np.argsort(values)[: NUMERICS.kept_each_round]
        parents = rng.integers(0, NUMERICS.kept_each_round, NUMERICS.slews_per_batch)
        children = x[order][parents] * (1.0 + width * rng.normal(size=(len(parents), 5)))
        children[:, 3:] = np.clip(children[:, 3:], NUMERICS.smallest_fractions, 1.0)
        x = np.concatenate([x[order], children])
        values, information = (
            np.concatenate([old[order], new])
            for old, new in zip((values, information), scored(children), strict=True)
        )
        width *= 0.5
    best = int(np.argmin(values))
    return x[best], information[best]


def noncentrality(matrix: np.ndarray, effect: np.ndarray, imitator: np.ndarray) -> float:
    """Mean chi^2 that an effect drawn from its prior leaves when another has taken what it can.

    `effect` (m,); `imitator` (n,). `matrix` (k, k): information on the parameters of both effects,
    in prior sds.

    Examples
    --------
    >>> matrix = np.array([[4.0, 3.0], [3.0, 9.0]])
    >>> round(noncentrality(matrix, np.array([0]), np.array([1])), 9)
    3.0
    """
    across = matrix[np.ix_(imitator, effect)]
    inverted = np.linalg.pinv(matrix[np.ix_(imitator, imitator)], hermitian=True)
    left = matrix[np.ix_(effect, effect)] - across.T @ inverted @ across
    return float(max(np.trace(left), 0.0))


def _projected(problem: PlanProblem, information: np.ndarray) -> np.ndarray:
    """Information on both effects, projected off everything else that is fitted.

    `information` (d + 3, d + 3): what a slew told. Returns (k, k): in prior sds, without the
    effects' own priors; the first effect's k1 parameters before those of the second.
    """
    arrays = problem.forecast.arrays
    sd = np.asarray(arrays.prior_sd)
    effects = np.concatenate([np.arange(*group) for group in problem.groups])
    precision = np.asarray(arrays.prior) + information
    precision[effects, effects] -= sd[effects] ** -2.0
    rest = np.setdiff1d(np.arange(len(precision)), effects)
    across = precision[np.ix_(rest, effects)]
    taken = across.T @ inverse(precision[np.ix_(rest, rest)]) @ across
    matrix = precision[np.ix_(effects, effects)] - taken
    return matrix * np.outer(sd[effects], sd[effects])


def forecast_separation(estimate: Estimate, a: Effect, b: Effect) -> tuple[Forecast, np.ndarray]:
    """The forecast of one more slew after a campaign, with two effects fitted together.

    Its prior is what the campaign told. `estimate`: the campaign's fit; what it fitted is fitted
    along. Returns also (d,): the estimate, with both effects at their null.
    """
    campaign = estimate.model.campaign
    craft = mission_after(Mission.of(campaign), estimate).spacecraft
    for effect in (a, b):
        _require_flying(effect, craft)
    fitted = _names_of_fitted_effects(estimate) - {a.name, b.name}
    kept = tuple(effect for effect in estimate.model.effects if effect.name in fitted)
    model = Model(campaign, (*kept, a, b), estimate.model.structure.drive)
    for effect in (a, b):
        _require_parameters(model, effect)
    theta = _at_null_of_new(estimate, model, fitted)
    information, prior = _known(estimate, model, theta)
    for effect in (a, b):
        part = model.space.slice_of(effect.name)
        # A prior that ends at the null has a slope there; beside the data it counts by its width.
        prior[part, part] = np.diag(model.space.sd[part] ** -2.0)
    plan = plan_after(estimate)
    flown = as_loud(campaign, estimate)
    if campaign.wheels and model.structure.drive != "commanded":
        # Commands of zero, so that the commanded drive can be set up.
        wheels = len(campaign.wheels)
        still = (replace(s, wheel_torque=np.zeros((len(s.time), wheels))) for s in campaign.slews)
        flown = replace(flown, slews=tuple(still))
    commanded = Model(flown, (*kept, a, b), "commanded")
    conditions = conditions_of(
        commanded,
        craft,
        last_environment(campaign),
        first=len(campaign.slews),
        start_time=campaign.span[1] + plan.pause,
    )
    return forecast_of(commanded, craft, plan, conditions, information + prior), theta


def _require_flying(effect: Effect, craft: Spacecraft) -> None:
    device = [craft.device.record.name] if craft.device else []
    flies = effect.device in ("", *craft.names, *dict(craft.more_sensors), *device)
    what = "acts on a device that a planned slew does not fly"
    advice = "choose an effect of wheels, sensors, or the device that turns the spacecraft"
    require(flies, effect.name, what, advice, error=EffectError)


def _names_of_fitted_effects(estimate: Estimate) -> set[str]:
    """Names of the effects of which at least one parameter was fitted."""
    names, known = estimate.model.space.names, estimate.model.n_known
    return {names[i].partition(".")[0] for i in estimate.free if i >= known}


def _require_parameters(model: Model, effect: Effect) -> None:
    part = model.space.slice_of(effect.name)
    what, advice = "has no parameters in this campaign", "choose another effect"
    require(part.stop != part.start, effect.name, what, advice, error=EffectError)


def _at_null_of_new(estimate: Estimate, model: Model, fitted: set[str]) -> np.ndarray:
    """Parameters (d,) of the model: as estimated, where they were fitted, else at their null."""
    estimated = dict(zip(estimate.model.space.names, estimate.theta, strict=True))
    names, nulls = model.space.names, model.space.nulls
    own = set(names[: model.n_known])
    known = [name for name in names if name in own or name.partition(".")[0] in fitted]
    named = zip(names, nulls, strict=True)
    return np.array([estimated[name] if name in known else null for name, null in named])


def _known(estimate: Estimate, model: Model, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Estimate of (theta, bias) by the campaign, and prior precision, (d + b, d + b) both.

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
    precision, _ = prior_equations(model, point, columns)
    return information, block_diag(precision, np.eye(model.n_bias))
