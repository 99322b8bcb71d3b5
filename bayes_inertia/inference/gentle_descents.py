"""First descents of the optimizer, with the data counted weakly: a wide basin of attraction."""

from __future__ import annotations

import numpy as np

from bayes_inertia.campaign.channel_names import CHANNELS
from bayes_inertia.errors import EstimateError
from bayes_inertia.inference.descent import descend
from bayes_inertia.inference.noise_model import discounted, whitening
from bayes_inertia.inference.point import N_BIAS, Point
from bayes_inertia.inference.precompilation import compiled_meanwhile
from bayes_inertia.inference.start_guess import guess_nuisances
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import N_BASE
from bayes_inertia.physics.stochastic_effect import StochasticEffect

# Weight of the data's information in the first, gentle descent of every start.
GENTLE_WEIGHT = 1e-4
# Where a gentle descent may stop: its end is only a beginning.
GENTLE_STOP = {"steps": 60, "tolerance": 1e-3}
# Reduced chi^2 above which a gentle descent has lost its way.
_LOST_REDUCED_CHI2 = 1e3
# Starts that are tried at most until one has not lost its way.
_MOST_STARTS = 12


def gentle_descents(
    model: Model, seed: int, starts: int, start: np.ndarray | None, free: np.ndarray
) -> list[tuple[float, Point]]:
    """Objective and end of each gentle descent.

    Effects without a fixed shape stay away: while the data count weakly they have nothing to
    explain, and their many coefficients cost time.

    `start` (d,); `free` (f,). `starts`: how many, the first at the prior mean, others drawn from
    the prior; more where none comes near the data.
    """
    if not model.structure.hyperparameters:
        return _descents(model, seed, starts, start, free)
    effects = tuple(e for e in model.effects if not isinstance(e, StochasticEffect))
    plain = Model(model.campaign, effects, model.structure.drive, model.noise)
    place = {name: i for i, name in enumerate(model.space.names)}
    shared = np.array([place[name] for name in plain.space.names])
    begin = None if start is None else np.asarray(start)[shared]
    whole = model.space.mean if start is None else np.array(start, float)
    silent = np.zeros((model.n_slews, model.structure.n_local))
    with compiled_meanwhile(model, Point(whole, np.zeros(N_BIAS), silent)):
        descents = _descents(plain, seed, starts, begin, np.flatnonzero(np.isin(shared, free)))
    return [(objective, _widened(model, whole, shared, end)) for objective, end in descents]


def _widened(model: Model, theta: np.ndarray, shared: np.ndarray, point: Point) -> Point:
    """A point of the model without stochastic effects in the model with them, all silent."""
    theta = np.array(theta)
    theta[shared] = point.theta
    local = np.zeros((model.n_slews, model.structure.n_local))
    local[:, : point.local.shape[1]] = point.local
    return Point(theta, point.bias, local)


def _descents(
    model: Model, seed: int, starts: int, start: np.ndarray | None, free: np.ndarray
) -> list[tuple[float, Point]]:
    """From the prior mean and from draws, more while none comes near the data."""
    if start is not None:
        return [_gentle_descent(model, start, free)]
    descents: list[tuple[float, Point]] = []
    readings = sum(3 * len(s.time) for s in model.campaign.slews)
    near = _LOST_REDUCED_CHI2 * GENTLE_WEIGHT * 0.5 * readings
    draws = model.draw_prior(np.random.default_rng(seed), max(starts, _MOST_STARTS) - 1)
    for k, theta in enumerate([model.space.mean, *draws]):
        if k >= starts and descents and min(o for o, _ in descents) < near:
            break
        objective, point = _gentle_descent(model, _inside_support(model, theta), free)
        if np.isfinite(objective):
            descents.append((objective, point))
    if not descents:
        raise EstimateError(
            "no start of the optimizer gave finite residuals",
            advice="check units and signs of the telemetry columns",
        )
    return descents


def _gentle_descent(model: Model, theta: np.ndarray, free: np.ndarray) -> tuple[float, Point]:
    """Objective and end of a descent with the data counted weakly.

    J, K and the nuisances move first: far from the optimum an effect would take over what they
    have to explain. Nuisances guessed at a J far from the truth can end in a local optimum: they
    are guessed again at the J that was reached.
    """
    theta = np.asarray(theta, float)
    weights = np.full((model.n_slews, len(CHANNELS)), GENTLE_WEIGHT)
    white = discounted(whitening(model, theta), weights)
    core = free[free < N_BASE]
    first = Point(theta, np.zeros(N_BIAS), guess_nuisances(model, theta))
    point, objective = descend(model, first, white, core, **GENTLE_STOP)
    if np.any(first.local):
        guess = Point(point.theta, point.bias, guess_nuisances(model, point.theta))
        second, lower = descend(model, guess, white, core, **GENTLE_STOP)
        if lower < objective:
            point, objective = second, lower
    if len(core) < len(free):
        point, objective = descend(model, point, white, free, **GENTLE_STOP)
    return objective, point


def _inside_support(model: Model, theta: np.ndarray) -> np.ndarray:
    """A prior draw moved a little into the support of priors that end at their null."""
    theta = np.array(theta, float)
    margin = 0.1 * model.space.sd
    theta[6:] = np.clip(theta, model.space.lower + margin, model.space.upper - margin)[6:]
    return theta
