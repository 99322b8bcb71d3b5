"""The search for a plan: random plans scored in batches, then sequential quadratic programming with exact derivatives.

A plan is numbers (slews, 5) as in `region`; where the campaign must end in a given attitude, the last slew's rotation follows
from the others.
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy import optimize

from bayes_inertia.design.feasible_region import LEAST, Region, draw, in_a_row, room, slews_at
from bayes_inertia.design.goals import Goal, criterion
from bayes_inertia.design.information import Forecast, Given, Shape, body_of, covariance
from bayes_inertia.design.planned_motion import Slews, motion
from bayes_inertia.maths import quaternion
from bayes_inertia.maths.values import array_dataclass

_BATCH = 10
# Limits are kept this far away [fraction] while searching, so that rounding to an operator's digits does not cross them.
_CLEAR = 1e-3
# Steps of each descent.
_STEPS = 50
_QUICKLY = {"xla_backend_optimization_level": 0}


@array_dataclass
class Problem:
    """What is searched for: `goal` over the truths `thetas` (k, d), for slews as in `ahead`, inside `region`, ending in the attitude `end` (None: anywhere)."""

    goal: Goal
    ahead: Forecast
    thetas: np.ndarray
    region: Region
    end: np.ndarray | None = None

    @property
    def parts(self) -> tuple[tuple[int, int], ...]:
        """Where the parameters of the goal's effects stand."""
        return tuple(self.ahead.shape.slice_of(name) for name in self.goal.effects)

    def slews(self, x: Array) -> Slews:
        """The slews of numbers x (slews, 5)."""
        return _slews(self.ahead.given, self.region, self.end, x)

    def numbers(self, slews: Slews) -> np.ndarray:
        """Slews as numbers x (slews, 5)."""
        fractions = [
            np.asarray(slews.rate) / self.region.rate,
            np.asarray(slews.acceleration) / self.region.acceleration,
        ]
        return np.concatenate([np.asarray(slews.turn_B), np.stack(fractions, 1)], 1)

    def value(self, x: np.ndarray) -> float:
        """The goal's number for a plan x (slews, 5), geometric mean over the truths."""
        return float(
            np.exp(np.mean([self.score(x[None], k)[0][0] for k in range(len(self.thetas))]))
        )

    def left(self, x: np.ndarray) -> dict[str, float]:
        """The least that a plan x (slews, 5) leaves of each limit, beyond its reserve."""
        return {
            name: float(values.min(initial=np.inf))
            for name, values in self.score(x[None])[1].items()
        }

    def sd(self, x: np.ndarray) -> dict[str, float]:
        """Expected sds of all parameters for a plan x (slews, 5), at the first truth."""
        return dict(zip(self.ahead.shape.names, self.score(x[None])[2][0].tolist(), strict=True))

    def score(
        self, x: np.ndarray, truth: int = 0
    ) -> tuple[np.ndarray, dict[str, np.ndarray], np.ndarray]:
        """For plans x (n, slews, 5) at one truth: log of the goal's number (n,), what is left of every limit {name: (n, ...)}, expected sds (n, d)."""
        static = (self.goal, self.ahead.shape, self.parts)
        batches = [
            np.resize(x[i : i + _BATCH], (_BATCH, *x.shape[1:])) for i in range(0, len(x), _BATCH)
        ]
        parts = [
            _scores(*static, self.ahead.given, self.thetas[truth], self.region, self.end, batch)
            for batch in batches
        ]
        return jax.tree.map(lambda *pieces: np.concatenate(pieces)[: len(x)], *parts)

    def slope(self, x: np.ndarray, truths: int) -> tuple[float, np.ndarray]:
        """Log of the (smooth) number, mean over the first truths, and its exact gradient (slews, 5)."""
        static = (self.goal, self.ahead.shape, self.parts)
        found = [
            _slope(*static, self.ahead.given, theta, self.region, self.end, x)
            for theta in self.thetas[:truths]
        ]
        return float(np.mean([value for value, _ in found])), np.mean(
            [np.asarray(slope) for _, slope in found], axis=0
        )

    def room(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What is left of every limit (k,) for the first truth, and its derivative (k, slews, 5)."""
        value, slope = _room_and_slope(
            self.ahead.shape, self.ahead.given, self.thetas[0], self.region, self.end, x
        )
        return np.asarray(value), np.asarray(slope)


def _slews(given: Given, region: Region, end: Array | None, x: Array) -> Slews:
    slews = slews_at(x, region)
    if end is None:
        return slews
    attitude = jnp.asarray(given.origin.attitude)
    for turn in quaternion.exp(slews.turn_B[:-1]):
        attitude = quaternion.multiply(attitude, turn)
    return slews._replace(
        turn_B=jnp.asarray(slews.turn_B).at[-1].set(quaternion.error(attitude, end))
    )


def _rooms(
    shape: Shape, given: Given, theta: Array, region: Region, slews: Slews
) -> dict[str, Array]:
    flown = motion(slews, shape.times, body_of(shape.structure, theta, given.world), given.origin)
    return room(flown, slews, region, shape.times)


@partial(jax.jit, static_argnames=("goal", "shape", "parts"))
def _scores(goal, shape, parts, given, theta, region, end, x):
    def one(row: Array) -> tuple[Array, dict[str, Array], Array]:
        slews = _slews(given, region, end, row)
        expected = covariance(shape, given, theta, slews)
        value = jnp.log(criterion(goal, expected, theta, given.prior_sd, parts))
        return value, _rooms(shape, given, theta, region, slews), jnp.sqrt(jnp.diag(expected))

    return jax.lax.map(one, x)


# Compiled without optimization: half the time to compile, twice the 20 ms to run, some hundred times.
@partial(jax.jit, static_argnames=("goal", "shape", "parts"), compiler_options=_QUICKLY)
def _slope(goal, shape, parts, given, theta, region, end, x):
    def one(x: Array) -> Array:
        expected = covariance(shape, given, theta, _slews(given, region, end, x))
        return jnp.log(criterion(goal, expected, theta, given.prior_sd, parts, smooth=True))

    return jax.value_and_grad(one)(x)


@partial(jax.jit, static_argnames=("shape",), compiler_options=_QUICKLY)
def _room_and_slope(shape, given, theta, region, end, x):
    def left(x: Array) -> Array:
        return in_a_row(_rooms(shape, given, theta, region, _slews(given, region, end, x)))

    return left(x), jax.jacfwd(left)(x)


def random_plans(
    problem: Problem, slews: int, n: int, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """n random plans (n, slews, 5), the log of the goal's number of each (n,), and the least that is left of any limit (n,)."""
    rng = np.random.default_rng([seed, 7])
    x = draw(
        rng,
        n,
        slews,
        problem.region,
        problem.ahead.shape.times,
        problem.ahead.body(problem.thetas[0]),
    )
    values, left, _ = problem.score(x)
    return x, np.where(np.isfinite(values), values, np.inf), _least(left, n)


def improve(
    problem: Problem, x: np.ndarray, steps: int, truths: int
) -> tuple[np.ndarray, tuple[float, ...]]:
    """A plan (slews, 5) improved by sequential quadratic programming (Kraft 1988) over the first truths, and the goal's number on the way."""
    shape, path = x.shape, []

    def value(flat: np.ndarray) -> tuple[float, np.ndarray]:
        found, slope = problem.slope(flat.reshape(shape), truths)
        path.append(float(np.exp(found)))
        return found, slope.ravel()

    def left(flat: np.ndarray) -> np.ndarray:
        rooms = problem.room(flat.reshape(shape))[0]
        # What has no limit has infinite room, which the programme cannot hold.
        return np.minimum(rooms, 1e3) - _CLEAR

    def left_slope(flat: np.ndarray) -> np.ndarray:
        return np.nan_to_num(problem.room(flat.reshape(shape))[1]).reshape(-1, flat.size)

    bounds = ([(-np.pi, np.pi)] * 3 + [(LEAST[0], 1.0), (LEAST[1], 1.0)]) * len(x)
    found = optimize.minimize(
        value,
        x.ravel(),
        jac=True,
        method="SLSQP",
        bounds=bounds,
        constraints={"type": "ineq", "fun": left, "jac": left_slope},
        options={"maxiter": steps, "ftol": 1e-5},
    )
    return found.x.reshape(shape), tuple(path)


def search(
    problem: Problem, x: np.ndarray, values: np.ndarray, least: np.ndarray, starts: int
) -> tuple[list[np.ndarray], tuple[tuple[float, ...], ...]]:
    """Plans improved from the best of random ones, best first, and the goal's number on the way of each descent."""
    order = np.lexsort((values, -np.minimum(least, 0.0)))[:starts]  # feasible ones first
    found = [improve(problem, x[k], _STEPS, 1) for k in order]
    best = [found[k][0] for k in _ranked(problem, [plan for plan, _ in found])]
    final = improve(problem, best[0], _STEPS, len(problem.thetas))
    return [final[0], *best], (*(path for _, path in found), final[1])


def _ranked(problem: Problem, plans: list[np.ndarray]) -> np.ndarray:
    values, left, _ = problem.score(np.array(plans))
    return np.lexsort((values, -np.minimum(_least(left, len(plans)), 0.0)))


def _least(left: dict[str, np.ndarray], n: int) -> np.ndarray:
    """The least that each of n plans leaves of any limit."""
    return np.min(
        [rooms.reshape(n, -1).min(axis=1, initial=np.inf) for rooms in left.values()], axis=0
    )
