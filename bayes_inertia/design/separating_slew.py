"""The one slew that best separates two effects which a campaign cannot tell apart.

The measure is that of `fingerprint`: sensitivities of both effects at their null, projected off everything that is fitted,
in units of their prior sds. The canonical correlation says how well one can imitate the other; what is left of one's signal
power after projecting off the other is its non-centrality. The slew added is the one after which the two effects, fitted
together, would be known best.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.design.after_campaign import plan_after
from bayes_inertia.design.feasible_region import (
    SMALLEST_FRACTIONS,
    FeasibleRegion,
    constraint_slacks,
    draw_variables,
    flattened,
    region_within,
    slews_from_variables,
)
from bayes_inertia.design.goals import Goal, criterion
from bayes_inertia.design.information import (
    Forecast,
    Given,
    Shape,
    Surroundings,
    body_of,
    information,
    posterior,
    world_of,
)
from bayes_inertia.design.limits import Limits, hardware_limits
from bayes_inertia.design.margins import Margin, broken_limits, planned_margins
from bayes_inertia.design.planned_motion import (
    PlanStart,
    motion_of_slews,
    plan_times,
    planned_slews,
)
from bayes_inertia.errors import CampaignError, EffectError
from bayes_inertia.flight.follow_on import spacecraft_at
from bayes_inertia.flight.plan import Plan, PlannedSlew
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.linearised_fit import marginal_information
from bayes_inertia.inference.objective import N_BIAS, prior_rows
from bayes_inertia.maths.linear_algebra import canonical_correlation, inverse
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.forward_model import Model

_BATCH = 128
_ROUNDS = 5
_SURVIVORS = 10


@dataclass(frozen=True)
class Separation:
    """The slew that best separates two effects.

    Attributes
    ----------
    slew : to be flown next. effects : the two, (a, b).
    correlation : largest canonical correlation of their fingerprints before and after the slew; 1: one can be the other.
    noncentrality : ((a before, a after), (b before, b after)), chi^2 that an effect of prior size leaves, on average, when the other
        and everything fitted try to imitate it.
    margins : what the slew leaves of every limit.
    """

    slew: PlannedSlew
    effects: tuple[str, str]
    correlation: tuple[float, float]
    noncentrality: tuple[tuple[float, float], tuple[float, float]]
    margins: tuple[Margin, ...]


def separating_slew(
    at: Estimate, a: Effect, b: Effect, limits: Limits | None = None, *, seed: int = 0
) -> Separation:
    """The single feasible slew which, flown after a campaign, best separates two effects.

    Parameters
    ----------
    at : the campaign's estimate; what it fitted is fitted along, but for a and b themselves.
    limits : None for the campaign's own largest rate, and twice the time of its longest slew. seed : of the search.

    Raises
    ------
    EffectError : an effect without parameters, or with states of its own. CampaignError : no feasible slew was found (it names the limit).
    """
    campaign = at.model.campaign
    axes = np.linalg.matrix_rank(campaign.wheel_axes_B, tol=1e-6) if campaign.wheels else 0
    if axes < 3:
        raise CampaignError(
            f"the wheels turn the spacecraft about {axes} of three axes",
            where="wheels",
            advice="slews are designed for three",
        )
    longest = max(slew.duration for slew in campaign.slews)
    limits = limits or Limits(rate=1.1 * campaign.largest_rate(), total_time=2.0 * longest)
    ahead, theta, parts = _forecast(at, a, b)
    spacecraft = spacecraft_at(campaign, theta)
    region = region_within(
        limits,
        hardware_limits(spacecraft),
        default_rate=campaign.largest_rate(),
        scale_factor_sigma=float(at.sd[6:9].max()),
    )
    wanted = Goal("separate", (a.name, b.name))
    best, told = _search(
        partial(_score, wanted, ahead.shape, parts, ahead.given, theta, region),
        ahead,
        theta,
        region,
        seed,
    )
    slew = planned_slews(slews_from_variables(best[None], region))[0]
    left = planned_margins(replace(_plan(ahead), slews=(slew,)), spacecraft, limits)
    if broken_limits(left):
        what = f"no slew that separates {a.name} from {b.name} was found within the limits: {broken_limits(left)[0].says}"
        raise CampaignError(what, where="limits", advice="loosen it")
    matrices = [_projected(ahead, parts, extra) for extra in (np.zeros_like(told), told)]
    first = parts[0][1] - parts[0][0]
    sides = np.arange(first), np.arange(first, len(matrices[0]))
    correlation = tuple(canonical_correlation(matrix, first) for matrix in matrices)
    power = tuple(
        tuple(noncentrality(matrix, sides[i], sides[1 - i]) for matrix in matrices) for i in (0, 1)
    )
    return Separation(slew, wanted.effects, correlation, power, left)


def _plan(ahead: Forecast) -> Plan:
    t, origin = ahead.shape.times, ahead.given.origin
    turn = PlannedSlew((1.0, 0.0, 0.0), 1.0)
    return Plan(
        "next",
        (turn,),
        tuple(np.asarray(origin.attitude).tolist()),
        tuple(np.asarray(origin.wheel_momentum).tolist()),
        **t._asdict(),
    )


def _forecast(
    at: Estimate, a: Effect, b: Effect
) -> tuple[Forecast, np.ndarray, tuple[tuple[int, int], ...]]:
    """The forecast of one more slew; theta at the estimate with both effects at their null; where they stand."""
    old, campaign = at.model, at.model.campaign
    fitted = {old.space.names[i].partition(".")[0] for i in at.free if i >= 9} - {a.name, b.name}
    kept = tuple(e for e in old.effects if e.name in fitted)
    lean = Model(campaign, (*kept, a, b), old.structure.drive)
    space = lean.space
    for effect in (a, b):
        if space.slice_of(effect.name).stop == space.slice_of(effect.name).start:
            raise EffectError(
                "has no parameters in this campaign",
                where=effect.name,
                advice="choose another effect",
            )
    here = dict(zip(old.space.names, at.theta, strict=True))
    free = [n for n in space.names if n.partition(".")[0] in fitted or "." not in n]
    theta = np.array(
        [here[n] if n in free else null for n, null in zip(space.names, space.nulls, strict=True)]
    )
    told, prior = _told(at, lean, theta)
    last = campaign.slews[-1]
    times = plan_after(at)
    begin = campaign.span[1] + times.pause
    around = Surroundings(
        np.array([0.0, 1.0]),
        *(np.tile(_last_value(last, key), (2, 1)) for key in ("magnetic_field_N", "position_N")),
    )
    world = world_of(
        lean,
        around,
        first=len(campaign.slews),
        count=len(campaign.slews),
        begin=begin,
        middle=0.5 * sum(campaign.span),
    )
    commanded = (
        lean
        if lean.structure.drive == "commanded"
        else Model(_with_commands(campaign), (*kept, a, b), "commanded")
    )
    parts = tuple(space.slice_of(effect.name) for effect in (a, b))
    for part in parts:
        # A prior that ends at the null has a slope there; beside the data it counts as wide as it is.
        prior[part, part] = np.diag(space.sd[part] ** -2.0)
    origin = PlanStart(np.array(times.start_attitude), np.array(times.wheel_momentum))
    shape = Shape(replace(commanded.structure, refined=False), space.names, plan_times(times))
    ahead = Forecast(
        shape, Given(world._replace(scale=commanded.data.scale), origin, space.sd, told + prior)
    )
    return ahead, theta, tuple((part.start, part.stop) for part in parts)


def _told(at: Estimate, lean: Model, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What the campaign tells about (theta, bias), start states integrated out, and the prior of all but the two effects (d + 3, d + 3)."""
    known = set(lean.space.names) <= set(at.model.space.names)
    model = at.model if known else lean
    at_point = at.theta.copy() if known else theta
    if known:
        for name, value in zip(lean.space.names, theta, strict=True):
            at_point[model.space.names.index(name)] = value
    columns = np.array([model.space.names.index(n) for n in lean.space.names])
    told = marginal_information(model, replace(at.point, theta=at_point), at.white, columns)
    slope = prior_rows(model, at_point)[0][columns]
    return told, np.diag(np.concatenate([slope**2, np.ones(N_BIAS)]))


def _with_commands(campaign: Campaign) -> Campaign:
    slews = tuple(
        replace(s, wheel_torque=np.zeros((len(s.time), len(campaign.wheels))))
        for s in campaign.slews
    )
    return replace(campaign, slews=slews)


def _last_value(slew, key: str) -> np.ndarray:
    values = getattr(slew, key)
    good = np.zeros(0, bool) if values is None else np.isfinite(values).all(1)
    return values[good][-1] if good.any() else np.zeros(3)


@partial(jax.jit, static_argnames=("goal", "shape", "parts"))
def _score(
    goal: Goal, shape: Shape, parts, given: Given, theta: Array, region: FeasibleRegion, x: Array
) -> tuple[Array, Array]:
    """Log criterion (n,) of slews x (n, 5), each flown alone, with a penalty for what is not allowed, and what each tells (n, d + 3, d + 3)."""
    body = body_of(shape.structure, theta, given.world)

    def one(row: Array) -> tuple[Array, Array]:
        slews = slews_from_variables(row[None], region)
        told = information(shape, given, theta, slews)
        left = flattened(
            constraint_slacks(
                motion_of_slews(slews, shape.times, body, given.origin), slews, region, shape.times
            )
        )
        missing = jnp.sum(jnp.maximum(0.0, -left))
        value = criterion(goal, posterior(given, told), theta, given.prior_sd, parts)
        return jnp.log(value) + 1e3 * missing, told[0]

    return jax.lax.map(one, x)


def _search(
    score, ahead: Forecast, theta: np.ndarray, region: FeasibleRegion, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Random slews, then ever closer ones around the best: (5,), and what it tells."""
    rng = np.random.default_rng([seed, 11])
    x = draw_variables(rng, 4 * _BATCH, 1, region, ahead.shape.times, ahead.body(theta))[:, 0]
    scored = [score(part) for part in np.split(x, 4)]
    values, told = (np.concatenate([np.asarray(s[i]) for s in scored]) for i in (0, 1))
    width = 0.3
    for _ in range(_ROUNDS):
        order = np.argsort(values)[:_SURVIVORS]
        children = x[order][rng.integers(0, _SURVIVORS, _BATCH)] * (
            1.0 + width * rng.normal(size=(_BATCH, 5))
        )
        children[:, 3:] = np.clip(children[:, 3:], SMALLEST_FRACTIONS, 1.0)
        x = np.concatenate([x[order], children])
        values, told = (
            np.concatenate([old[order], np.asarray(new)])
            for old, new in zip((values, told), score(children), strict=True)
        )
        width *= 0.5
    best = int(np.argmin(values))
    return x[best], told[best]


def _projected(ahead: Forecast, parts, extra: np.ndarray) -> np.ndarray:
    """Normal matrix of both effects' parameters in prior sds, a's before b's, projected off all that is fitted; without their own priors."""
    sd = np.asarray(ahead.given.prior_sd)
    own = np.concatenate([np.arange(*part) for part in parts])
    precision = ahead.given.prior + extra
    precision[own, own] -= sd[own] ** -2.0
    rest = np.setdiff1d(np.arange(len(precision)), own)
    across = precision[np.ix_(rest, own)]
    matrix = (
        precision[np.ix_(own, own)] - across.T @ inverse(precision[np.ix_(rest, rest)]) @ across
    )
    return matrix * np.outer(sd[own], sd[own])


def noncentrality(matrix: np.ndarray, own: np.ndarray, other: np.ndarray) -> float:
    """Mean chi^2 that an effect drawn from its prior leaves when another has taken what it can; `own` and `other` are their columns.

    >>> round(noncentrality(np.array([[4.0, 3.0], [3.0, 9.0]]), np.array([0]), np.array([1])), 9)
    3.0
    """
    across = matrix[np.ix_(other, own)]
    left = (
        matrix[np.ix_(own, own)]
        - across.T @ np.linalg.pinv(matrix[np.ix_(other, other)], hermitian=True) @ across
    )
    return float(max(np.trace(left), 0.0))
