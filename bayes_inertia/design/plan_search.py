"""The search for a plan: random plans scored in batches, then descents with exact derivatives.

The descents are sequential quadratic programming. A plan is design variables (slews, 5) as in
`feasible_region`.
"""

from __future__ import annotations

import numpy as np
from scipy import optimize

from bayes_inertia.design.feasible_region import (
    SMALLEST_FRACTIONS,
    draw_variables,
)
from bayes_inertia.design.plan_problem import PlanProblem
from bayes_inertia.progress import Progress, silent

# Limits are kept this far away [fraction] in the search, so that rounding does not cross them.
_LIMIT_CLEARANCE = 1e-3
# Slack [fraction] that stands for a limit which does not exist: SLSQP cannot hold infinity.
_UNLIMITED_SLACK = 1e3
# Most steps of each descent.
_DESCENT_STEPS = 50


def random_plans(
    problem: PlanProblem, slews: int, n: int, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random plans with their scores.

    Returns `x` (n, slews, 5); `log_values` (n,): logarithm of the goal's number of each; infinite
    where it is no number; `least_slacks` (n,): the least that each leaves of any limit.
    """
    rng = np.random.default_rng([seed, 7])
    body = problem.forecast.body(problem.thetas[0])
    x = draw_variables(rng, n, slews, problem.region, problem.forecast.layout.times, body)
    values, slacks, _ = problem.score(x)
    return x, np.where(np.isfinite(values), values, np.inf), _least(slacks, n)


def improved_plan(
    problem: PlanProblem, x: np.ndarray, steps: int, truths: int
) -> tuple[np.ndarray, tuple[float, ...]]:
    """A plan improved by sequential quadratic programming (Kraft 1988).

    `x` (slews, 5). `truths`: over how many of the first truths the goal is averaged. Returns `x`
    (slews, 5): design variables of the improved plan; `history`: the smooth goal's number at every
    evaluation.
    """
    shape, history = x.shape, []

    def value(flat: np.ndarray) -> tuple[float, np.ndarray]:
        log_value, gradient = problem.log_value_and_gradient(flat.reshape(shape), truths)
        history.append(float(np.exp(log_value)))
        return log_value, gradient.ravel()

    def slacks(flat: np.ndarray) -> np.ndarray:
        values = problem.slacks_and_jacobian(flat.reshape(shape))[0]
        return np.minimum(values, _UNLIMITED_SLACK) - _LIMIT_CLEARANCE

    def jacobian(flat: np.ndarray) -> np.ndarray:
        slopes = problem.slacks_and_jacobian(flat.reshape(shape))[1]
        return np.nan_to_num(slopes).reshape(-1, flat.size)

    fractions = [(smallest, 1.0) for smallest in SMALLEST_FRACTIONS]
    optimum = optimize.minimize(
        value,
        x.ravel(),
        jac=True,
        method="SLSQP",
        bounds=([(-np.pi, np.pi)] * 3 + fractions) * len(x),
        constraints={"type": "ineq", "fun": slacks, "jac": jacobian},
        options={"maxiter": steps, "ftol": 1e-5},
    )
    return optimum.x.reshape(shape), tuple(history)


def improved_plans(
    problem: PlanProblem,
    x: np.ndarray,
    log_values: np.ndarray,
    least_slacks: np.ndarray,
    starts: int,
    say: Progress = silent,
) -> tuple[list[np.ndarray], tuple[tuple[float, ...], ...]]:
    """Plans improved from the best of random ones.

    `x` (n, slews, 5); `log_values` (n,); `least_slacks` (n,). Returns `plans` (slews, 5): best
    first. The first is the best one, improved once more over all truths; `histories`: the smooth
    goal's number during each descent.
    """
    order = np.lexsort((log_values, -np.minimum(least_slacks, 0.0)))[:starts]  # feasible ones first
    descents: list[tuple[np.ndarray, tuple[float, ...]]] = []
    for k in order:
        say("improving the best, plans", len(descents), len(order) + 1)
        descents.append(improved_plan(problem, x[k], _DESCENT_STEPS, 1))
    say("improving the best, plans", len(order), len(order) + 1)
    best = [descents[k][0] for k in _ranked(problem, [plan for plan, _ in descents])]
    final = improved_plan(problem, best[0], _DESCENT_STEPS, len(problem.thetas))
    return [final[0], *best], (*(history for _, history in descents), final[1])


def _ranked(problem: PlanProblem, plans: list[np.ndarray]) -> np.ndarray:
    """Order of plans, best first: feasible ones by the goal's number, then the nearest misses."""
    log_values, slacks, _ = problem.score(np.array(plans))
    return np.lexsort((log_values, -np.minimum(_least(slacks, len(plans)), 0.0)))


def _least(slacks: dict[str, np.ndarray], n: int) -> np.ndarray:
    """The least (n,) that each of n plans leaves of any limit."""
    return np.min(
        [values.reshape(n, -1).min(axis=1, initial=np.inf) for values in slacks.values()], axis=0
    )
