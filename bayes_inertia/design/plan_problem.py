"""The problem that a search for a plan solves: goal, limits and exact derivatives.

A plan is design variables (slews, 5) as in `feasible_region`. Where the campaign must end in a
given attitude, the last slew's rotation follows from the others.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.design.feasible_region import (
    FeasibleRegion,
    constraint_slacks,
    slews_from_variables,
)
from bayes_inertia.design.goals import Goal, criterion
from bayes_inertia.design.information_forecast import (
    Forecast,
    ForecastArrays,
    ForecastLayout,
    rigid_body_at,
)
from bayes_inertia.design.information_matrix import (
    covariance_after,
    expected_covariance,
    information_matrices,
)
from bayes_inertia.design.numerics import NUMERICS
from bayes_inertia.flight.planned_motion import SlewArrays, motion_of_slews
from bayes_inertia.maths import quaternion
from bayes_inertia.maths.linear_algebra import inverse
from bayes_inertia.maths.values import AnyArray, array_dataclass

# Half the time to compile, twice the 20 ms to run, some hundred times.
_WITHOUT_OPTIMIZATION = {"xla_backend_optimization_level": 0}


@array_dataclass
class PlanProblem:
    """Search problem of a plan."""

    goal: Goal  # what the plan is to determine
    forecast: Forecast  # how the telemetry of slews is foreseen
    # (truths, d) parameters that are expected; the goal's number is averaged over them.
    thetas: np.ndarray
    region: FeasibleRegion  # where plans may lie
    end_attitude: np.ndarray | None = None  # (4,) where the campaign must end; None for anywhere

    @property
    def groups(self) -> tuple[tuple[int, int], ...]:
        """Places of the parameters of the goal's effects: (first, behind the last) of each."""
        return tuple(self.forecast.layout.slice_of(name) for name in self.goal.effects)

    def slews(self, x: AnyArray) -> SlewArrays:
        """The slews of a plan (slews, 5), the last one ending in `end_attitude` if there is one."""
        return _slews(self.forecast.arrays, self.region, self.end_attitude, x)

    def variables(self, slews: SlewArrays) -> np.ndarray:
        """The design variables (slews, 5) of slews."""
        fractions = [
            np.asarray(slews.rate) / self.region.rate,
            np.asarray(slews.acceleration) / self.region.acceleration,
        ]
        return np.concatenate([np.asarray(slews.rotation_B), np.stack(fractions, 1)], 1)

    def value(self, x: np.ndarray) -> float:
        """The goal's number for a plan (slews, 5): geometric mean over truths, in its unit."""
        logs = [self.score(x[None], k)[0][0] for k in range(len(self.thetas))]
        return float(np.exp(np.mean(logs)))

    def least_slacks(self, x: np.ndarray) -> dict[str, float]:
        """The least that a plan (slews, 5) leaves of each limit, beyond its reserve."""
        return {
            name: float(values.min(initial=np.inf))
            for name, values in self.score(x[None])[1].items()
        }

    def parameter_sds(self, x: np.ndarray, truths: np.ndarray) -> list[dict[str, float]]:
        """Sds of all parameters to expect of plans (n, slews, 5).

        The root mean square over `truths` (k, 6 + axes), J and K as `thetas` has them.
        """
        at_null = np.tile(self.thetas[0], (len(truths), 1))
        at_null[:, : truths.shape[1]] = truths
        problem = replace(self, thetas=at_null)
        # A batch repeats two plans five times: batches of two would compile one more program.
        found = np.array([problem.score(x, k)[2] for k in range(len(truths))])
        names = self.forecast.layout.names
        sds = np.sqrt(np.mean(found**2, axis=0)).tolist()
        return [dict(zip(names, sd, strict=True)) for sd in sds]

    def sd_before(self) -> dict[str, float]:
        """Sds of all parameters before the plan is flown, in their units."""
        names = self.forecast.layout.names
        covariance = inverse(np.asarray(self.forecast.arrays.prior))
        return dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=False))

    def score(
        self, x: np.ndarray, truth: int = 0
    ) -> tuple[np.ndarray, dict[str, np.ndarray], np.ndarray, np.ndarray]:
        """Goal, limits, sds and information of many plans at one truth.

        `x` (n, slews, 5). Returns `log_value` (n,): logarithm of the goal's number; `slacks`:
        {limit: (n, ...)}, see `constraint_slacks`; `sd` (n, d): expected sds of all parameters;
        `information` (n, slews, d + b, d + b): of each slew, see `information_matrices`.
        """
        static = (self.goal, self.forecast.layout, self.groups)
        given = (self.forecast.arrays, self.thetas[truth], self.region, self.end_attitude)
        batches = [
            np.resize(x[i : i + NUMERICS.plans_per_batch], (NUMERICS.plans_per_batch, *x.shape[1:]))
            for i in range(0, len(x), NUMERICS.plans_per_batch)
        ]
        parts = [_scores(*static, *given, batch) for batch in batches]
        return jax.tree.map(lambda *pieces: np.concatenate(pieces)[: len(x)], *parts)

    def log_value_and_gradient(self, x: np.ndarray, truths: int) -> tuple[float, np.ndarray]:
        """Logarithm of the smooth goal, mean over the first truths, and its exact gradient.

        `x` (slews, 5). Returns `gradient` (slews, 5): its derivative with respect to the design
        variables.
        """
        static = (self.goal, self.forecast.layout, self.groups)
        arrays = self.forecast.arrays
        given = (self.region, self.end_attitude, x)
        thetas = self.thetas[:truths]
        results = [_log_value_and_gradient(*static, arrays, theta, *given) for theta in thetas]
        gradient = np.mean([np.asarray(gradient) for _, gradient in results], axis=0)
        return float(np.mean([value for value, _ in results])), gradient

    def slacks_and_jacobian(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """All constraint slacks at the first truth, and their derivatives.

        `x` (slews, 5). Returns `slacks` (k,): fractions of each limit; infinite where there is
        none; `jacobian` (k, slews, 5): their derivatives with respect to the design variables.
        """
        layout, arrays = self.forecast.layout, self.forecast.arrays
        slacks, jacobian = _slacks_and_jacobian(
            layout, arrays, self.thetas[0], self.region, self.end_attitude, x
        )
        return np.asarray(slacks), np.asarray(jacobian)


def _slews(
    arrays: ForecastArrays,
    region: FeasibleRegion,
    end: AnyArray | None,
    x: AnyArray,
) -> SlewArrays:
    """The slews of design variables (slews, 5), the last one ending in an attitude (4,)."""
    slews = slews_from_variables(x, region)
    if end is None:
        return slews
    attitude = jnp.asarray(arrays.start.attitude)
    for turn in quaternion.exp(slews.rotation_B[:-1]):
        attitude = quaternion.multiply(attitude, turn)
    last = quaternion.error(attitude, jnp.asarray(end))
    return slews._replace(rotation_B=jnp.asarray(slews.rotation_B).at[-1].set(last))


def _slacks(
    layout: ForecastLayout,
    arrays: ForecastArrays,
    theta: Array,
    region: FeasibleRegion,
    slews: SlewArrays,
) -> dict[str, Array]:
    """Constraint slacks of slews flown by the body that theta (d,) describes."""
    body = rigid_body_at(layout.structure, theta, arrays.conditions)
    motion = motion_of_slews(slews, layout.times, body, arrays.start)
    return constraint_slacks(motion, slews, region, layout.times)


@partial(jax.jit, static_argnames=("goal", "layout", "groups"))
def _scores(goal, layout, groups, arrays, theta, region, end, x):
    def one(row: Array) -> tuple[Array, dict[str, Array], Array, Array]:
        slews = _slews(arrays, region, end, row)
        information = information_matrices(layout, arrays, theta, slews)
        expected = covariance_after(arrays, information)
        value = jnp.log(criterion(goal, expected, theta, arrays.prior_sd, groups, layout.n_base))
        slacks = _slacks(layout, arrays, theta, region, slews)
        return value, slacks, jnp.sqrt(jnp.diag(expected)), information

    return jax.lax.map(one, x)


@partial(
    jax.jit, static_argnames=("goal", "layout", "groups"), compiler_options=_WITHOUT_OPTIMIZATION
)
def _log_value_and_gradient(goal, layout, groups, arrays, theta, region, end, x):
    def one(x: Array) -> Array:
        expected = expected_covariance(layout, arrays, theta, _slews(arrays, region, end, x))
        return jnp.log(
            criterion(goal, expected, theta, arrays.prior_sd, groups, layout.n_base, smooth=True)
        )

    return jax.value_and_grad(one)(x)


@partial(jax.jit, static_argnames=("layout",), compiler_options=_WITHOUT_OPTIMIZATION)
def _slacks_and_jacobian(layout, arrays, theta, region, end, x):
    def slacks(x: Array) -> Array:
        found = _slacks(layout, arrays, theta, region, _slews(arrays, region, end, x))
        return jnp.concatenate([jnp.ravel(part) for part in found.values()])

    return slacks(x), jax.jacfwd(slacks)(x)
