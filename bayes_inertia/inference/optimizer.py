"""The optimizer: maximum of the posterior with all nuisances.

J moves in its log-Cholesky chart, so that no step leaves the physical tensors; everything reported
is in the elements of J. Several starts descend first with the data counted weakly, which widens the
basin of attraction, and the best of them with full weight.

Where the residuals show that the model is not complete (`residual_tests`), the likelihood of
every slew is discounted by the dispersion of its own residuals, and the estimate is repeated: a
model that is wrong by many sigmas would otherwise overrule all prior knowledge with its errors.

Which ends of the optimizer's gentle descents are worth following.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.inference.descent import descend, gentle_descents, guess_nuisances, roughly
from bayes_inertia.inference.hyperparameters import information_with_learnt, without_hyperparameters
from bayes_inertia.inference.laplace import Estimate, Starts, model_of
from bayes_inertia.inference.likelihood import Point, information_blocks
from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.inference.noise_model import (
    Densities,
    Whitenings,
    densities_of,
    discounted,
    estimated_noise,
    is_alike,
    n_data,
    of_densities,
    whitening,
)
from bayes_inertia.inference.objective import negative_log_posterior, normal_equations
from bayes_inertia.inference.residual_tests import dispersion, effective_parameters, residual_series
from bayes_inertia.maths.blas_threads import on_one_blas_thread
from bayes_inertia.maths.linear_algebra import inverse
from bayes_inertia.maths.robust_scale import SD_OVER_MAD
from bayes_inertia.maths.values import whole_number
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import parameter_vectors
from bayes_inertia.progress import Progress, as_callback, with_bar


@with_bar
@on_one_blas_thread
def estimate(
    model: Model | Campaign,
    *,
    seed: int = 0,
    starts: int = 3,
    start: np.ndarray | None = None,
    discount: bool = True,
    free: np.ndarray | None = None,
    progress: Progress | bool | None = None,
) -> Estimate:
    """Find the posterior's maximum.

    Parameters
    ----------
    model : Model or Campaign
        What is fitted to which campaign; of a campaign J and K alone.
    seed : int
        Seed of the further starts.
    starts : int
        Number of starts, the first at the prior mean, others drawn from the prior; more where
        none comes near the data.
    start : (d,) array, optional
        theta to begin from instead (one start).
    discount : bool
        Whether misfit discounts the slews. False keeps the stated noise whatever the residuals say;
        so does noise that is not as stated.
    free : (f,) array of int, optional
        Indices of the parameters that may move, J's elements among them. The others keep their
        start values. None: all.
    progress : bool or callable, optional
        True for a bar; or called with (stage, done, of), `of` 0 where a stage is not counted.

    Returns
    -------
    Estimate
        The maximum and its Laplace approximation.

    Raises
    ------
    EstimateError
        If no start gave a finite posterior.

    Examples
    --------
    It compiles for some seconds, so this is no doctest::

        fitted = estimate(read_campaign("my_campaign"))
        dict(zip(fitted.model.space.names, fitted.sd))
        # {'Jxx': 0.00022, ...}
    """
    model, say, seed = model_of(model), as_callback(progress), whole_number(seed, "seed")
    start = None if start is None else parameter_vectors(start, model.space.size, "start")
    say("descending from several starts", 0, 0)
    free = np.arange(model.space.size) if free is None else np.asarray(free)
    descents = gentle_descents(model, seed, starts, start, free)
    full = np.ones((model.n_slews, len(model.channels)))
    say("finding the optimum", 0, 0)
    optima = [
        (_best_optimum_with_noise(model, point, full, free), point, count)
        for point, count in distinct_optima(model, descents)
    ]
    best, gentle_end, _ = min(optima, key=lambda optimum: optimum[0][1])
    agreeing = sum(count for settled, _, count in optima if settled[1] < best[1] + 1.0)
    counts = Starts(agreeing, len(descents))
    fitted = _estimate_of(model, *best, full, free, counts)
    return _discounted_for_misfit(fitted, gentle_end) if discount else _with_densities(fitted)


def resumed(previous: Estimate, model: Model) -> Estimate:
    """The estimate with other readings or another noise of the same slews, from where one stands.

    `model`: of the same effects. Slews that were discounted stay so while residuals ask for it.
    """
    point, free, starts = previous.point, previous.free, previous.starts
    channels = np.any(previous.discount != 1.0, axis=0)
    if channels.any() and model.noise.is_stated:
        fitted = _discounted_fit(model, point, previous.discount, channels, free, starts)
        if fitted.is_too_large:
            return fitted
    full = np.ones_like(previous.discount)
    optimum = _optimum_with_noise(model, point, full, free)
    return _discounted_for_misfit(_estimate_of(model, *optimum, full, free, starts), point)


def _discounted_for_misfit(fitted: Estimate, gentle_end: Point) -> Estimate:
    """The estimate under the densities asked for, or with its slews discounted for their misfit."""
    if not fitted.model.noise.is_stated:
        return _with_densities(fitted)
    too_large = [test.too_large for test in fitted.tests.values()]
    if not any(too_large):
        return fitted
    model, channels = fitted.model, np.array(too_large[:-1]) | too_large[-1]
    # The gentle descent's end is nearer than the point that the model's errors have overruled.
    point, factors = gentle_end, np.full(fitted.discount.shape, LIMITS.gentle_weight)
    if model.structure.hyperparameters:
        # What has no fixed shape takes up most of the misfit: the optimum is near, and the sizes
        # learnt there save most of the rounds.
        point = fitted.point
        factors = _dispersions(model, point, whitening(model, point.theta))
    return _discounted_fit(model, point, factors, channels, fitted.free, fitted.starts)


def re_estimate(
    previous: Estimate,
    theta: np.ndarray,
    free: np.ndarray,
    *,
    weak_data_first: bool = False,
    tolerance: float = 1e-7,
) -> Estimate:
    """The maximum with other parameters free, from nuisances and noise of an earlier estimate.

    `theta` (d,); `free` (f,). `weak_data_first`: guess the nuisances afresh and descend with the
    data counted weakly first, which finds the way out of a local optimum.
    """
    model, discount, free = previous.model, previous.discount, np.asarray(free)
    point = _with_finite_telemetry(previous, np.asarray(theta, float))
    if weak_data_first:
        white = discounted(whitening(model, point.theta), LIMITS.gentle_weight * discount)
        guess = replace(point, local=guess_nuisances(model, point.theta))
        shaped = without_hyperparameters(model, free)
        point, _ = descend(model, guess, white, shaped, **LIMITS.gentle_stop)
    settled = _optimum_with_noise(model, point, discount, free, rounds=1, tolerance=tolerance)
    return _with_densities(_estimate_of(model, *settled, discount, free, Starts(1, 1)))


def _with_finite_telemetry(previous: Estimate, theta: np.ndarray) -> Point:
    """The point of theta (d,), or the nearest towards an earlier estimate that predicts numbers.

    Sizes of stochastic effects stay as asked: their null has no logarithm, and moves no telemetry.
    """
    point, model, back = previous.point, previous.model, theta - previous.theta
    back[list(model.structure.hyperparameters)] = 0.0
    for halvings in range(LIMITS.halvings):
        at = replace(point, theta=theta - back * (1.0 - 0.5**halvings))
        if np.isfinite(negative_log_posterior(model, at, previous.white)):
            return at
    return replace(point, theta=theta - back)


def without_effects(
    previous: Estimate, names: Collection[str], theta: np.ndarray | None = None, **stop: Any
) -> Estimate:
    """The estimate repeated with some effects held at their null: nothing is compiled anew.

    `theta` (d,): where to begin, with them as they are held; by default where the estimate stands.
    """
    space = previous.model.space
    held = np.array([name.split(".")[0] in names for name in space.names])
    theta = np.where(held, space.nulls, previous.theta) if theta is None else theta
    return re_estimate(previous, theta, previous.free[~held[previous.free]], **stop)


def move_to(previous: Estimate, model: Model) -> Estimate:
    """The same point in a model with other effects, those that are new held at their null."""
    names = previous.model.space.names
    values = dict(zip(names, previous.theta, strict=True))
    nulls = zip(model.space.names, model.space.nulls, strict=True)
    theta = np.array([values.get(name, null) for name, null in nulls])
    free_names = [names[i] for i in previous.free]
    free = np.flatnonzero(np.isin(model.space.names, free_names))
    # Its integration steps may be others, and its rows padded to another length.
    stated = whitening(model, theta)
    return replace(
        previous,
        model=model,
        point=replace(previous.point, theta=theta, local=_nuisances_in(previous, model)),
        stated=stated,
        white=discounted(stated, previous.discount),
        information=previous.information._replace(free=free),
    )


def _nuisances_in(previous: Estimate, model: Model) -> np.ndarray:
    """Nuisances (slews, n_local) of a model with other effects: new coefficients are zero."""
    old, new = previous.model.structure, model.structure
    local = np.asarray(previous.point.local)
    ends = old.n_start + np.cumsum(old.coefficients, dtype=int)
    known = {
        effect.name: local[:, end - count : end]
        for effect, count, end in zip(old.effects, old.coefficients, ends, strict=False)
    }
    parts = [
        known.get(effect.name, np.zeros((len(local), count)))
        for effect, count in zip(new.effects, new.coefficients, strict=False)
    ]
    return np.concatenate([local[:, : old.n_start], *parts], axis=1)


def with_noise(previous: Estimate, factors: dict[str, float]) -> Estimate:
    """The estimate repeated with other noise.

    Returns: the same object if its noise is that already.
    """
    model, free = previous.model, previous.free
    of_channels = [factors.get(c.name, 1.0) ** -2.0 for c in model.channels]
    discount = np.tile(of_channels, (model.n_slews, 1))
    if np.array_equal(discount, previous.discount):
        return previous
    settled = _optimum_with_noise(model, previous.point, discount, free)
    return _estimate_of(model, *settled, discount, free, previous.starts)


def _discounted_fit(
    model: Model,
    point: Point,
    factors: np.ndarray,
    channels: np.ndarray,
    free: np.ndarray,
    starts: Starts,
) -> Estimate:
    """Repeat the estimate, each slew counted as its own residuals scatter, until both agree.

    `factors` (slews, channels): to begin with; `channels`: those that are discounted.
    """
    factors = np.where(channels, factors, 1.0)
    stop: dict[str, Any] = {"rounds": 1, "tolerance": LIMITS.tolerance_of_discount}
    for _ in range(LIMITS.most_rounds_of_discount):
        point, _, stated = _optimum_with_noise(model, point, factors, free, **stop)
        previous, factors = factors, np.where(channels, _dispersions(model, point, stated), 1.0)
        if np.all(np.abs(np.log(factors / previous)) < LIMITS.settled):
            break
    settled = _optimum_with_noise(model, point, factors, free)
    return _estimate_of(model, *settled, factors, free, starts)


def _dispersions(model: Model, point: Point, stated: Whitenings) -> np.ndarray:
    """One over the dispersion of each slew's residuals, by channel (slews, 3)."""
    series = residual_series(model, point, stated)
    bursts = {channel.name: not channel.stream.is_series for channel in model.channels}
    each = [[dispersion(x, bursts=bursts[name]) for x in slews] for name, slews in series.items()]
    return 1.0 / np.array(each).T


def _optimum_with_noise(
    model: Model, point: Point, factors: np.ndarray, free: np.ndarray, rounds: int = 3, **stop
) -> tuple[Point, float, Whitenings]:
    """Optimum, objective and noise that belong together.

    In the measured drive noise depends on J; what a process does between knots, on its size.
    """
    stated = whitening(model, point.theta)
    rounds = rounds if model.structure.drive == "measured" else 1
    if estimated_noise(model, point.theta):
        rounds = max(rounds, LIMITS.rounds_between_knots)
    for _ in range(rounds - 1):
        # The noise is known roughly, too.
        used, to = stated, roughly(stop)
        point, _ = descend(model, point, discounted(used, factors), free, **to)
        stated = whitening(model, point.theta)
        if is_alike(used, stated):
            break
    point, objective = descend(model, point, discounted(stated, factors), free, **stop)
    return point, objective, whitening(model, point.theta)


def _best_optimum_with_noise(
    model: Model, point: Point, factors: np.ndarray, free: np.ndarray
) -> tuple[Point, float, Whitenings]:
    """As `_optimum_with_noise`, or from nuisances guessed afresh at the J reached, if better."""
    settled = _optimum_with_noise(model, point, factors, free)
    if model.structure.hyperparameters or _is_as_noise_makes_it(model, settled):
        # Coefficients of free shapes belong to their nuisances: guessed afresh they would be lost.
        return settled
    guess = replace(settled[0], local=guess_nuisances(model, settled[0].theta))
    if not np.any(guess.local):
        return settled
    again = _optimum_with_noise(model, guess, factors, free)
    return again if again[1] < settled[1] else settled


def _is_as_noise_makes_it(model: Model, settled: tuple[Point, float, Whitenings]) -> bool:
    """Whether an optimum's squares are no more than noise predicts: no other is far below it.

    All unknowns have priors, so that twice the objective is chi^2 with as many degrees of freedom
    as there are readings.
    """
    _, objective, stated = settled
    readings = n_data(model, stated).sum()
    expected = readings + LIMITS.surplus_sd * np.sqrt(2.0 * readings)
    return model.noise.is_stated and bool(2.0 * objective < expected)


def _estimate_of(
    model: Model,
    point: Point,
    objective: float,
    stated: Whitenings,
    factors: np.ndarray,
    free: np.ndarray,
    starts: Starts,
) -> Estimate:
    """The estimate that an optimum is."""
    white = discounted(stated, factors)
    blocks = information_with_learnt(model, point, white, free)
    hessian, _ = normal_equations(model, point, blocks)
    return Estimate(model, point, stated, white, factors, blocks, hessian, objective, starts)


def _with_densities(fitted: Estimate) -> Estimate:
    """The estimate under the densities that its model was asked for.

    It begins at the maximum with Gaussian noise of the stated sigma. Heavy densities begin with the
    scale that the residuals have there, so that outliers far off lose their pull step by step.

    Returns: the very object where the noise is as stated.
    """
    model, free = fitted.model, fitted.free
    if model.noise.is_stated:
        return fitted
    densities, spread = densities_of(model), _spread(fitted)
    point = _at_noise_of_residuals(fitted, densities, spread)
    begin = _inflated(densities, spread, point.theta)
    if begin != densities:
        white = of_densities(whitening(model, point.theta), begin)
        point, _ = descend(model, point, white, free, **LIMITS.rough_stop)
    for _ in range(LIMITS.rounds_of_densities):
        stated = whitening(model, point.theta)
        white = of_densities(stated, densities)
        point, objective = descend(model, point, white, free)
        blocks = information_blocks(model, point, white, free)
        hessian, _ = normal_equations(model, point, blocks)
        paid = effective_parameters(model, point, blocks, inverse(hessian))
        moments = [x.family.moments(float(x.shape_of(point.theta))) for x in densities]
        densities = tuple(
            replace(x, lost=n * float(each.per_parameter))
            for x, n, each in zip(densities, paid.tolist(), moments, strict=True)
        )
    factor = np.tile(blocks.weight, (model.n_slews, 1))
    white = discounted(stated, factor)
    return Estimate(model, point, stated, white, factor, blocks, hessian, objective, fitted.starts)


def _spread(fitted: Estimate) -> list[float]:
    """Standard deviation that the middle of each channel's residuals has."""
    spread = []
    for slews in fitted.residual_series.values():
        numbers = np.concatenate([np.zeros(0), *(slew[np.isfinite(slew)] for slew in slews)])
        middle = SD_OVER_MAD * float(np.median(np.abs(numbers))) if len(numbers) else 1.0
        spread.append(max(middle, 1e-3))
    return spread


def _at_noise_of_residuals(fitted: Estimate, densities: Densities, spread: list[float]) -> Point:
    """The point with sampled scales near those that the residuals have."""
    theta = fitted.theta.copy()
    for channel, density, sd in zip(fitted.model.channels, densities, spread, strict=True):
        if density.scale_at is not None and density.scale_at in fitted.free:
            width = 3.0 * fitted.model.noise.of(channel.name).scale_spread
            theta[density.scale_at] = np.clip(sd, np.exp(-width), np.exp(width))
    return replace(fitted.point, theta=theta)


def _inflated(densities: Densities, spread: list[float], theta: np.ndarray) -> Densities:
    """Heavy densities with the scales with which a descent should begin."""
    begin = []
    for density, sd in zip(densities, spread, strict=True):
        ratio = sd / float(density.scale_of(theta))
        large = density.family.heavy and ratio > LIMITS.inflated
        begin.append(replace(density, inflation=ratio) if large else density)
    return tuple(begin)


def distinct_optima(model: Model, descents: list[tuple[float, Point]]) -> list[tuple[Point, int]]:
    """The ends of gentle descents that are worth following, without repetition.

    While the data count weakly an objective hardly tells two optima apart; places do.

    Returns: ends not far worse than the best, best first, and how often each was reached.
    """

    def in_prior_sd(point: Point) -> np.ndarray:
        return np.concatenate([point.theta / model.space.sd, point.bias, point.local.ravel()])

    descents = sorted(descents, key=lambda descent: descent[0])
    groups: list[list[Point]] = []
    for objective, point in descents:
        apart = [np.max(np.abs(in_prior_sd(g[0]) - in_prior_sd(point))) for g in groups]
        same = [g for g, sds in zip(groups, apart, strict=True) if sds < LIMITS.same_place_sd]
        if same:
            same[0].append(point)
        elif objective <= descents[0][0] + LIMITS.most_objective_excess:
            groups.append([point])
    return [(group[0], len(group)) for group in groups]
