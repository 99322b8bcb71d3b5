"""The optimizer: maximum of the posterior with all nuisances, its Laplace approximation, and what the slews themselves support.

J moves in its log-Cholesky chart, so that no step leaves the physical tensors; everything reported
is in the elements of J. Several starts descend first with the data counted weakly, which widens the
basin of attraction, and the best of them with full weight.

Where the residuals show that the model is not complete (`adequacy`), the likelihood of every slew is
discounted by the dispersion of its own residuals, and the estimate is repeated: a model that is wrong
by many sigmas would otherwise overrule all prior knowledge with its errors.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_inertia.campaign.channel_names import CHANNELS
from bayes_inertia.errors import EstimateError
from bayes_inertia.inference.laplace import Estimate, Starts, residual_series
from bayes_inertia.inference.likelihood import Whitening, discounted, information, whitening
from bayes_inertia.inference.objective import (
    N_BIAS,
    in_chart,
    moved,
    negative_log_posterior,
    normal_equations,
)
from bayes_inertia.inference.point import Point
from bayes_inertia.inference.residual_tests import dispersion
from bayes_inertia.inference.start_guess import begin
from bayes_inertia.maths.least_squares import descend
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import N_BASE

# Weight of the data in the first descent of every start.
_GENTLE = 1e-4
# Where such a descent may stop: its end is only a beginning. Ends nearer than this [prior sd] are one.
_SOON = {"steps": 60, "tolerance": 1e-3}
_SAME = 0.1
# Reduced chi^2 above which a gentle descent has lost its way, and starts that are tried at most until one has not.
_LOST, _MOST_STARTS = 1e3, 12


def estimate(
    model: Model,
    *,
    seed: int = 0,
    starts: int = 3,
    start: np.ndarray | None = None,
    discount: bool = True,
    free: np.ndarray | None = None,
) -> Estimate:
    """Find the posterior's maximum.

    Parameters
    ----------
    seed : of the further starts. starts : number of starts, the first at the prior mean, others drawn from the prior; more where none of them
        comes near the data.
    start : theta (d,) to begin from instead (one start).
    discount : whether misfit discounts the slews (False keeps the stated noise whatever the residuals say).
    free : indices of the parameters that may move, J's elements among them; the others keep their start values. None: all.

    Raises
    ------
    EstimateError : no start gave a finite posterior.
    """
    free = np.arange(model.space.size) if free is None else np.asarray(free)
    found = (
        _from_starts(model, seed, starts, free) if start is None else [_gently(model, start, free)]
    )
    if not np.isfinite(min(objective for objective, _ in found)):
        raise EstimateError(
            "the start of the optimizer gave no finite residuals",
            advice="check units and signs of the telemetry columns",
        )
    whole = np.ones((model.n_slews, len(CHANNELS)))
    ends = [
        (_best_settled(model, point, whole, free), point, count)
        for point, count in _different(model, found)
    ]
    best, point, _ = min(ends, key=lambda end: end[0][1])
    starts = Starts(
        sum(count for settled, _, count in ends if settled[1] < best[1] + 1.0), len(found)
    )
    fitted = _at(model, *best, whole, free, starts)
    if not discount or not any(test.too_large for test in fitted.tests.values()):
        return fitted
    channels = [
        test.too_large or fitted.tests["total"].too_large
        for test in list(fitted.tests.values())[:3]
    ]
    # Begin again from the gentle descent: it is nearer than the point that the model's errors have overruled.
    return _discounted_fit(model, point, np.array(channels), free, starts)


def re_estimate(
    previous: Estimate,
    theta: np.ndarray,
    free: np.ndarray,
    *,
    gently: bool = False,
    tolerance: float = 1e-7,
) -> Estimate:
    """The maximum with other parameters free, from nuisances and noise of an earlier estimate and from `theta` (d,).

    Parameters
    ----------
    gently : guess the nuisances afresh and descend with the data counted weakly first, which finds the way out of a local optimum.
    tolerance : of the objective, as `levenberg.descend`.
    """
    point, free = replace(previous.point, theta=np.asarray(theta, float)), np.asarray(free)
    if gently:
        white = discounted(whitening(previous.model, point.theta), _GENTLE * previous.discount)
        point, _ = _descend(
            previous.model,
            replace(point, local=begin(previous.model, point.theta)),
            white,
            free,
            **_SOON,
        )
    settled = _settled(
        previous.model, point, previous.discount, free, rounds=1, tolerance=tolerance
    )
    return _at(previous.model, *settled, previous.discount, free, Starts(1, 1))


def without_effect(previous: Estimate, name: str) -> Estimate:
    """The estimate repeated with an effect of its model held at its null."""
    part, theta = previous.model.space.slice_of(name), previous.theta.copy()
    theta[part] = previous.model.space.nulls[part]
    return re_estimate(
        previous, theta, previous.free[(previous.free < part.start) | (previous.free >= part.stop)]
    )


def move_to(previous: Estimate, model: Model) -> Estimate:
    """The same point in a model of the same campaign and drive with more effects, each held at its null."""
    theta = model.space.nulls
    here = dict(zip(previous.model.space.names, previous.theta, strict=True))
    free_names = {previous.model.space.names[i] for i in previous.free}
    for i, name in enumerate(model.space.names):
        theta[i] = here.get(name, theta[i])
    free = np.array([i for i, name in enumerate(model.space.names) if name in free_names])
    point = Point(theta, previous.point.bias, previous.point.local)
    return replace(
        previous, model=model, point=point, information=previous.information._replace(free=free)
    )


def with_noise(previous: Estimate, factors: dict[str, float]) -> Estimate:
    """The estimate repeated with each channel's stated noise multiplied by a factor."""
    discount = np.tile([factors[c] ** -2.0 for c in CHANNELS], (previous.model.n_slews, 1))
    if np.array_equal(discount, previous.discount):
        return previous
    point, objective, stated = _settled(previous.model, previous.point, discount, previous.free)
    return _at(previous.model, point, objective, stated, discount, previous.free, previous.starts)


def _discounted_fit(
    model: Model, point: Point, channels: np.ndarray, free: np.ndarray, starts: Starts
) -> Estimate:
    """Repeat the estimate with each slew's information divided by the dispersion of its own residuals, until both agree."""
    factors = np.where(channels, _GENTLE, np.ones((model.n_slews, 3)))
    for _ in range(10):
        point, _, stated = _settled(model, point, factors, free, rounds=1)
        previous, factors = factors, np.where(channels, _dispersions(model, point, stated), 1.0)
        if np.all(np.abs(np.log(factors / previous)) < 0.02):
            break
    return _at(model, *_settled(model, point, factors, free), factors, free, starts)


def _dispersions(model: Model, point: Point, stated: Whitening) -> np.ndarray:
    series = residual_series(model, point, stated)
    return np.array(
        [
            [1.0 / dispersion(series[c][s], bursts=c == "attitude") for c in CHANNELS]
            for s in range(model.n_slews)
        ]
    )


def _from_starts(
    model: Model, seed: int, starts: int, free: np.ndarray
) -> list[tuple[float, Point]]:
    """Gentle descents from the prior mean and from draws of the prior, from more of them while none comes near the data."""
    found: list[tuple[float, Point]] = []
    near = _LOST * _GENTLE * 0.5 * sum(3 * len(s.time) for s in model.campaign.slews)
    for k, theta in enumerate(
        [
            model.space.mean,
            *model.draw_prior(np.random.default_rng(seed), max(starts, _MOST_STARTS) - 1),
        ]
    ):
        if k >= starts and found and min(o for o, _ in found) < near:
            break
        objective, point = _gently(model, _inside(model, theta), free)
        if np.isfinite(objective):
            found.append((objective, point))
    if not found:
        raise EstimateError(
            "no start of the optimizer gave finite residuals",
            advice="check units and signs of the telemetry columns",
        )
    return found


def _different(model: Model, found: list[tuple[float, Point]]) -> list[tuple[Point, int]]:
    """The ends of gentle descents that are not far worse than the best, without repetition, and how often each was reached.

    While the data count weakly an objective hardly tells two optima apart; places do.
    """
    found = sorted(found, key=lambda f: f[0])
    groups: list[list[Point]] = []
    for objective, point in found:
        here = _place(model, point)
        same = next((g for g in groups if np.max(np.abs(_place(model, g[0]) - here)) < _SAME), None)
        if same is not None:
            same.append(point)
        elif objective < found[0][0] + 1.0:
            groups.append([point])
    return [(g[0], len(g)) for g in groups]


def _place(model: Model, point: Point) -> np.ndarray:
    return np.concatenate([point.theta / model.space.sd, point.bias, point.local.ravel()])


def _gently(model: Model, theta: np.ndarray, free: np.ndarray) -> tuple[float, Point]:
    """Objective and end of a descent with the data counted weakly.

    J, K and the nuisances move first: far from the optimum an effect would take over what they have to explain. Nuisances guessed
    at a J far from the truth can end in a local optimum: they are guessed again at the J that was reached.
    """
    white = discounted(
        whitening(model, np.asarray(theta, float)), np.full((model.n_slews, len(CHANNELS)), _GENTLE)
    )
    core = free[free < N_BASE]
    first = Point(np.asarray(theta, float), np.zeros(N_BIAS), begin(model, theta))
    point, objective = _descend(model, first, white, core, **_SOON)
    if np.any(first.local):
        again, lower = _descend(
            model, replace(point, local=begin(model, point.theta)), white, core, **_SOON
        )
        point, objective = (again, lower) if lower < objective else (point, objective)
    if len(core) < len(free):
        point, objective = _descend(model, point, white, free, **_SOON)
    return objective, point


def _inside(model: Model, theta: np.ndarray) -> np.ndarray:
    """A prior draw moved a little into the support of priors that end at their null."""
    theta = np.array(theta, float)
    margin = 0.1 * model.space.sd
    theta[6:] = np.clip(theta, model.space.lower + margin, model.space.upper - margin)[6:]
    return theta


def _settled(
    model: Model, point: Point, factors: np.ndarray, free: np.ndarray, rounds: int = 3, **stop
) -> tuple[Point, float, Whitening]:
    """Optimum and noise that belong together: in the measured drive the noise depends on J."""
    stated = whitening(model, point.theta)
    for _ in range(rounds if model.structure.drive == "measured" else 1):
        point, objective = _descend(model, point, discounted(stated, factors), free, **stop)
        stated = whitening(model, point.theta)
    return point, objective, stated


def _best_settled(
    model: Model, point: Point, factors: np.ndarray, free: np.ndarray
) -> tuple[Point, float, Whitening]:
    """As `_settled`, and once more with the nuisances guessed at the J that was reached, if that is better."""
    settled = _settled(model, point, factors, free)
    again = replace(settled[0], local=begin(model, settled[0].theta))
    return (
        min(settled, _settled(model, again, factors, free), key=lambda s: s[1])
        if np.any(again.local)
        else settled
    )


def _at(
    model: Model,
    point: Point,
    objective: float,
    stated: Whitening,
    factors: np.ndarray,
    free: np.ndarray,
    starts: Starts,
) -> Estimate:
    white = discounted(stated, factors)
    blocks = information(model, point, white, free)
    hessian, _ = normal_equations(model, point, blocks)
    return Estimate(model, point, stated, white, factors, blocks, hessian, objective, starts)


def _descend(
    model: Model, point: Point, white: Whitening, free: np.ndarray, **stop
) -> tuple[Point, float]:
    def equations(x: Point) -> tuple[np.ndarray, np.ndarray]:
        blocks = information(model, x, white, free)
        return in_chart(x, *normal_equations(model, x, blocks))

    return descend(
        lambda x: negative_log_posterior(model, x, white),
        equations,
        lambda x, step: moved(model, x, step, free),
        point,
        **stop,
    )
