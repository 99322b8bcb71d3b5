"""Powell's dogleg on normal equations, for problems whose parameters live on a manifold.

`scipy.optimize.least_squares` and optimistix want the whole Jacobian as one matrix; here normal
equations come in blocks (slews) that are wanted anyway, and a step is followed along a chart of
the physical inertia tensors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import linalg

from bayes_inertia.maths.numerics import NUMERICS


class Equations[X](NamedTuple):
    """Normal equations of half a sum of squares, priors among them, at a point.

    Parameters
    ----------
    hessian : (n, n) array
        J^T J, J the derivatives of the residuals there.
    gradient : (n,) array
        J^T r, r the residuals there.
    pull : callable
        From another point y to J^T r (n,), r the residuals at y and J as above: it asks for no
        further derivatives.
    """

    hessian: np.ndarray
    gradient: np.ndarray
    pull: Callable[[X], np.ndarray]


@dataclass(frozen=True, eq=False)
class _Problem[X]:
    """What is minimised, and how one moves."""

    objective: Callable[[X], float]
    move: Callable[[X, np.ndarray], X]

    def at(self, x: X) -> tuple[X, float]:
        """A point and its objective, infinite where there is none."""
        value = self.objective(x)
        return x, value if np.isfinite(value) else np.inf

    def corrected(
        self, x: X, value: float, target: float, before: Equations[X], step: np.ndarray
    ) -> tuple[X, float]:
        """A point lower than x, where a step (n,) from `before` ended on the wall of a valley.

        What the residuals are there beyond what was linear in the step is taken off with the
        derivatives from before the step; enough once the target is reached.
        """
        linear = before.gradient + before.hessian @ step
        solve = _damped(before.hessian, NUMERICS.correction_damping)
        for _ in range(NUMERICS.most_corrections):
            if not np.isfinite(value) or value <= target:
                break
            trial, reached = self.at(self.move(x, solve(before.pull(x) - linear)))
            left = (reached - target) / (value - target)
            if reached < value:
                x, value = trial, reached
            if left > NUMERICS.most_left:
                break
        return x, value


@dataclass(frozen=True, eq=False)
class _QuadraticModel:
    """The objective near a point, in sizes of the coordinates."""

    hessian: np.ndarray
    gradient: np.ndarray
    newton: np.ndarray
    steepest: np.ndarray

    @classmethod
    def at(cls, equations: Equations, size: np.ndarray) -> _QuadraticModel:
        """The model of normal equations whose coordinates have these sizes (n,)."""
        hessian, gradient = equations.hessian * np.outer(size, size), equations.gradient * size
        curvature = gradient @ hessian @ gradient
        length = gradient @ gradient / curvature if curvature > 0.0 else 0.0
        newton = _damped(hessian, NUMERICS.least_damping)(gradient)
        return cls(hessian, gradient, newton, -length * gradient)

    def gain(self, step: np.ndarray) -> float:
        """By how much a step lowers the quadratic."""
        return float(-(self.gradient @ step + 0.5 * step @ self.hessian @ step))

    def step(self, radius: float) -> np.ndarray:
        """The step (n,) to where the dogleg path ends or leaves a box of this half-width."""
        if _length(self.newton) <= radius:
            return self.newton
        if _length(self.steepest) >= radius:
            return self.steepest * (radius / _length(self.steepest))
        leg = self.newton - self.steepest
        room = np.where(leg > 0.0, radius - self.steepest, radius + self.steepest)
        share = np.min(room[leg != 0.0] / np.abs(leg[leg != 0.0]))
        return self.steepest + share * leg


def dogleg[X](
    objective: Callable[[X], float],
    equations: Callable[[X], Equations[X]],
    move: Callable[[X, np.ndarray], X],
    x: X,
    size: np.ndarray,
    *,
    steps: int = 100,
    tolerance: float = 1e-7,
    expected: float = np.inf,
) -> tuple[X, float]:
    """Minimise half a sum of squares within a trust region.

    A step follows the dogleg path, steepest descent first and then towards the Gauss-Newton step,
    to where it leaves the box in which the quadratic is trusted (Powell 1970; Nocedal and Wright
    2006, section 4.1). Where the data hardly show a direction the minimum lies at the end of a
    long, narrow, curved valley, and steps end on its wall: a step that keeps less than its promise
    is followed by corrections that bend it (geodesic acceleration, Transtrum and Sethna 2012, by
    the residuals at its end). They ask for residuals, not for derivatives.

    `objective`: half the sum of squares at a point; infinite or NaN where there is none.
    `equations`: normal equations at a point. `move`: the point reached from a point by a step (n,).
    `size` (n,): A step of each coordinate that is neither large nor small. The first step is at
    most this. `tolerance`: of the objective. The descent ends when the
    Gauss-Newton step promises less than this, or when the last steps that were taken gained less
    than a hundred times this together. `expected`: what noise alone makes of the objective. Where
    the objective is r times larger, misfit blurs the minimum as much more noise would, and steps
    converge slowly: the tolerance counts r^2 times, and no more than 30 r times.

    Examples
    --------
    >>> def identity(x): return Equations(np.eye(2), x, lambda y: y)
    >>> x, _ = dogleg(lambda x: 0.5 * x @ x, identity, np.add, np.ones(2), np.ones(2))
    >>> x.round(3).tolist()
    [0.0, 0.0]
    """
    problem = _Problem(objective, move)
    (x, best), radius = problem.at(x), NUMERICS.first_radius
    reached_before = [np.inf] * NUMERICS.stall_steps
    now = equations(x)
    model = _QuadraticModel.at(now, size)
    for _ in range(steps):
        step = model.step(radius)
        promised = model.gain(step)
        if not np.isfinite(promised):
            break
        trial, reached = problem.at(move(x, step * size))
        if promised > NUMERICS.stall_tolerances * _counted(tolerance, best / expected):
            wanted = best - NUMERICS.disappointing_share * promised
            trial, reached = problem.corrected(trial, reached, wanted, now, step * size)
        radius = _next_radius(radius, step, (best - reached) / max(promised, 1e-300))
        if np.isfinite(reached) and reached <= best:
            x, best = trial, reached
            reached_before = [*reached_before[1:], best]
            counted = _counted(tolerance, best / expected)
            stalled = reached_before[0] - best < NUMERICS.stall_tolerances * counted
            if stalled or model.gain(model.newton) < counted:
                break
            now = equations(x)
            model = _QuadraticModel.at(now, size)
        if promised < 1e-3 * tolerance or radius < NUMERICS.smallest_radius:
            break
    return x, best


def _counted(tolerance: float, misfit: float) -> float:
    """The tolerance of an objective that is so many times what noise alone makes."""
    larger = max(1.0, misfit)
    return tolerance * larger * min(larger, NUMERICS.most_misfit_counted)


def _next_radius(radius: float, step: np.ndarray, share: float) -> float:
    """The half-width of the region after a step that kept this share of its promise."""
    if share < NUMERICS.poor_share:
        return NUMERICS.shrink * min(radius, _length(step))
    at_the_edge = _length(step) > 0.999 * radius
    return NUMERICS.grow * radius if share > NUMERICS.good_share and at_the_edge else radius


def _length(step: np.ndarray) -> float:
    """The largest component of a step."""
    return float(np.max(np.abs(step)))


def _damped(hessian: np.ndarray, damping: float) -> Callable[[np.ndarray], np.ndarray]:
    """From a gradient (n,) to the step with this damping, or the least more that keeps the matrix
    definite; NaN where derivatives are not finite.
    """
    if not np.all(np.isfinite(hessian)):
        return lambda gradient: np.full_like(gradient, np.nan)
    scale = np.sqrt(np.diag(hessian))
    scaled = hessian / np.outer(scale, scale)
    while True:
        try:
            factor = linalg.cho_factor(scaled + damping * np.eye(len(scale)))
            break
        except linalg.LinAlgError:  # Rounding.
            damping = max(10.0 * damping, 1e-15)

    def step(gradient: np.ndarray) -> np.ndarray:
        if not np.all(np.isfinite(gradient)):
            return np.full_like(gradient, np.nan)
        return -linalg.cho_solve(factor, gradient / scale) / scale

    return step
