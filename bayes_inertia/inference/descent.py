"""A descent of the negative log posterior; sizes of stochastic effects are learnt on the way."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayes_inertia.inference.filtered_sizes import filtered_parameters, with_filtered_sizes
from bayes_inertia.inference.hyperparameters import (
    evidence_at,
    most_probable,
    without_hyperparameters,
)
from bayes_inertia.inference.likelihood import information_blocks
from bayes_inertia.inference.noise_model import Whitenings, n_data
from bayes_inertia.inference.objective import (
    in_chart,
    moved,
    negative_log_posterior,
    normal_equations,
    step_sizes,
)
from bayes_inertia.inference.point import Point
from bayes_inertia.maths.least_squares import dogleg
from bayes_inertia.physics.forward_model import Model

# Rounds of learning sizes, at most, and the change [prior sd] after which they have settled.
_ROUNDS, _SETTLED = 8, 0.02
# Tolerance of the objective while sizes or noise are learnt; a descent as asked for follows.
_TOLERANCE_OF_ROUNDS = 1e-3


def descend(
    model: Model, point: Point, white: Whitenings, free: np.ndarray, **stop: Any
) -> tuple[Point, float]:
    """The minimum that a descent from a point reaches, and its objective.

    `free` (f,): indices of the parameters that may move. Those of stochastic effects among them go
    where the evidence is largest, the others to the minimum that belongs to them. Returns
    `objective`: half the sum of all whitened squares, priors included.
    """
    shaped = without_hyperparameters(model, free)
    if len(shaped) < len(free):
        rough = roughly(stop)
        point, _ = _to_minimum(model, point, white, shaped, **rough)
        for _ in range(_ROUNDS):
            point, change = _sizes_learnt(model, point, white, free)
            if change < _SETTLED:
                break
            point, _ = _to_minimum(model, point, white, shaped, **rough)
    return _to_minimum(model, point, white, shaped, **stop)


def roughly(stop: Mapping[str, Any]) -> dict[str, Any]:
    """When to stop where a descent as asked for follows.

    Examples
    --------
    >>> roughly({"steps": 60, "tolerance": 1e-7})
    {'steps': 60, 'tolerance': 0.001}
    """
    return {**stop, "tolerance": max(stop.get("tolerance", 0.0), _TOLERANCE_OF_ROUNDS)}


def _sizes_learnt(
    model: Model, point: Point, white: Whitenings, free: np.ndarray
) -> tuple[Point, float]:
    """The point with the sizes that the evidence favours, and how far they moved [prior sd]."""
    by_knots = np.setdiff1d(free, filtered_parameters(model, point.theta))
    change = 0.0
    if len(without_hyperparameters(model, by_knots)) < len(by_knots):
        point, change = most_probable(evidence_at(model, point, white, by_knots))
    point, further = with_filtered_sizes(model, point, white, free)
    return point, max(change, further)


def _to_minimum(
    model: Model, point: Point, white: Whitenings, free: np.ndarray, **stop: Any
) -> tuple[Point, float]:
    """The minimum with the sizes of stochastic effects as they are."""
    return dogleg(
        lambda x: negative_log_posterior(model, x, white),
        lambda x: in_chart(
            x, *normal_equations(model, x, information_blocks(model, x, white, free))
        ),
        lambda x, step: moved(model, x, step, free),
        point,
        step_sizes(model, point, free),
        expected=_expected(model, white),
        **stop,
    )


def _expected(model: Model, white: Whitenings) -> float:
    """What noise alone makes of the objective; of other densities it has no such meaning."""
    if any(each.density is not None for each in white):
        return np.inf
    return 0.5 * max(float(n_data(model, white).sum()), 1.0)
