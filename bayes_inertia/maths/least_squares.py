"""Powell's dogleg on normal equations, for problems whose parameters live on a manifold.

`scipy.optimize.least_squares` and optimistix want the whole Jacobian as one matrix; here normal
equations come in blocks (slews) that are wanted anyway, and a step is followed along a chart of
the physical inertia tensors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import linalg

# Damping of a correction: stiff directions move, weak ones stay. Corrections of one step at most.
_CORRECTION_DAMPING, _MOST_CORRECTIONS = 1e-2, 5
# A descent ends when so many steps together gained less than so many tolerances.
_STALL_STEPS, _STALL_TOLERANCES = 5, 100.0
# Gauss-Newton converges the more slowly the larger the misfit, which counts up to so many times.
_MOST_MISFIT_COUNTED = 30.0
# Half-width of the trust region, in sizes of the coordinates: at first, and where no step is short
# enough.
_FIRST_RADIUS, _SMALLEST_RADIUS = 1.0, 1e-12
# Share of a step's promise below which it disappoints and is corrected, and below and above which
# the region shrinks and grows, and by what.
_DISAPPOINTING_SHARE, _POOR_SHARE, _GOOD_SHARE = 0.5, 0.25, 0.75
_SHRINK, _GROW = 0.25, 2.0
# Damping that keeps the normal matrix definite in spite of rounding, relative.
_LEAST_DAMPING = 1e-12


@dataclass(frozen=True, eq=False)
class _Problem[X]:
    """What is minimised, and how one moves."""

    objective: Callable[[X], float]
    equations: Callable[[X], tuple[np.ndarray, np.ndarray]]
    move: Callable[[X, np.ndarray], X]

    def at(self, x: X) -> tuple[X, float]:
        """A point and its objective, infinite where there is none."""
        value = self.objective(x)
        return x, value if np.isfinite(value) else np.inf

    def corrected(self, x: X, value: float, target: float) -> tuple[X, float]:
        """A point lower than x beside the valley's bottom; enough once the target is reached."""
        for _ in range(_MOST_CORRECTIONS):
            if not np.isfinite(value) or value <= target:
                break
            step = _damped_step(*self.equations(x), _CORRECTION_DAMPING)
            trial, reached = self.at(self.move(x, step))
            if reached >= value:
                break
            x, value = trial, reached
        return x, value


@dataclass(frozen=True, eq=False)
class _QuadraticModel:
    """The objective near a point, in sizes of the coordinates."""

    hessian: np.ndarray
    gradient: np.ndarray
    newton: np.ndarray
    steepest: np.ndarray

    @classmethod
    def at(cls, hessian: np.ndarray, gradient: np.ndarray, size: np.ndarray) -> _QuadraticModel:
        """The model of normal equations whose coordinates have these sizes (n,)."""
        hessian, gradient = hessian * np.outer(size, size), gradient * size
        curvature = gradient @ hessian @ gradient
        length = gradient @ gradient / curvature if curvature > 0.0 else 0.0
        newton = _damped_step(hessian, gradient, _LEAST_DAMPING)
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
    equations: Callable[[X], tuple[np.ndarray, np.ndarray]],
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
    long, narrow, curved valley, and steps end on its wall: a step that disappoints is followed by
    corrections that move down the wall and not along the valley.

    `objective`: half the sum of squares at a point; infinite or NaN where there is none.
    `equations`: Gauss-Newton Hessian (n, n) and gradient (n,) at a point. `move`: the point reached
    from a point by a step (n,). `size` (n,): A step of each coordinate that is neither large nor
    small. The first step is at most this. `tolerance`: of the objective. The descent ends when the
    Gauss-Newton step promises less than this, or when the last steps that were taken gained less
    than a hundred times this together. `expected`: what noise alone makes of the objective. Where
    the objective is r times larger, misfit blurs the minimum as much more noise would, and steps
    converge slowly: the tolerance counts r^2 times, and no more than 30 r times.

    Examples
    --------
    >>> def identity(x): return np.eye(2), x
    >>> x, _ = dogleg(lambda x: 0.5 * x @ x, identity, np.add, np.ones(2), np.ones(2))
    >>> x.round(3).tolist()
    [0.0, 0.0]
    """
    problem = _Problem(objective, equations, move)
    (x, best), radius = problem.at(x), _FIRST_RADIUS
    reached_before = [np.inf] * _STALL_STEPS
    model = _QuadraticModel.at(*equations(x), size)
    for _ in range(steps):
        step = model.step(radius)
        promised = model.gain(step)
        if not np.isfinite(promised):
            break
        trial, reached = problem.at(move(x, step * size))
        if promised > _STALL_TOLERANCES * _counted(tolerance, best / expected):
            wanted = best - _DISAPPOINTING_SHARE * promised
            trial, reached = problem.corrected(trial, reached, wanted)
        radius = _next_radius(radius, step, (best - reached) / max(promised, 1e-300))
        if np.isfinite(reached) and reached <= best:
            x, best = trial, reached
            reached_before = [*reached_before[1:], best]
            counted = _counted(tolerance, best / expected)
            stalled = reached_before[0] - best < _STALL_TOLERANCES * counted
            if stalled or model.gain(model.newton) < counted:
                break
            model = _QuadraticModel.at(*equations(x), size)
        if promised < 1e-3 * tolerance or radius < _SMALLEST_RADIUS:
            break
    return x, best


def _counted(tolerance: float, misfit: float) -> float:
    """The tolerance of an objective that is so many times what noise alone makes."""
    larger = max(1.0, misfit)
    return tolerance * larger * min(larger, _MOST_MISFIT_COUNTED)


def _next_radius(radius: float, step: np.ndarray, share: float) -> float:
    """The half-width of the region after a step that kept this share of its promise."""
    if share < _POOR_SHARE:
        return _SHRINK * min(radius, _length(step))
    at_the_edge = _length(step) > 0.999 * radius
    return _GROW * radius if share > _GOOD_SHARE and at_the_edge else radius


def _length(step: np.ndarray) -> float:
    """The largest component of a step."""
    return float(np.max(np.abs(step)))


def _damped_step(hessian: np.ndarray, gradient: np.ndarray, damping: float) -> np.ndarray:
    """The step (n,) with this damping, or the least more that keeps the matrix definite, or NaN."""
    if not (np.all(np.isfinite(hessian)) and np.all(np.isfinite(gradient))):
        return np.full_like(gradient, np.nan)
    scale = np.sqrt(np.diag(hessian))
    scaled = hessian / np.outer(scale, scale)
    while True:
        try:
            factor = linalg.cho_factor(scaled + damping * np.eye(len(scale)))
            return -linalg.cho_solve(factor, gradient / scale) / scale
        except linalg.LinAlgError:  # Rounding.
            damping = max(10.0 * damping, 1e-15)
