"""Levenberg-Marquardt on normal equations, for problems whose parameters live on a manifold.

`scipy.optimize.least_squares` wants the whole Jacobian as one matrix and factors it at every step;
here normal equations come in blocks (slews) that are wanted anyway, and a step is followed along a
chart of the physical inertia tensors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import linalg

# Damping of a correction: stiff directions move, weak ones stay. Corrections of one step at most.
_CORRECTION_DAMPING, _MOST_CORRECTIONS = 1e-2, 3
# A descent ends when so many steps together gained less than so many tolerances.
_STALL_STEPS, _STALL_TOLERANCES = 5, 100.0
# Damping of the first step; of a step that counts as undamped; above which no step is short enough.
_FIRST_DAMPING, _LEAST_DAMPING, _LARGEST_DAMPING = 1e-4, 1e-12, 1e12
# Damping at which a step meets a wall of the support, where the undamped one promises without end.
_WALL_DAMPING = 1e3
# Share of a step's promise below which it disappoints, and of the undamped step's below which
# parts of that are tried.
_DISAPPOINTING_SHARE, _LITTLE_SHARE = 0.5, 0.02
_UNDAMPED_PARTS = (0.3, 0.1, 0.03)
# The undamped step may promise so many tolerances more than the damped one when a descent ends.
_UNDAMPED_TOLERANCES = 1e3


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
        """A point lower than x beside the valley's bottom; enough once `wanted` is reached."""
        for _ in range(_MOST_CORRECTIONS):
            if not np.isfinite(value) or value < target:
                break
            step = _damped_step(*self.equations(x), _CORRECTION_DAMPING)
            trial, reached = self.at(self.move(x, step))
            if reached >= value:
                break
            x, value = trial, reached
        return x, value


@dataclass(frozen=True, eq=False)
class _PredictedGain:
    """Steps with damping and without, and by how much they would lower the quadratic."""

    step: np.ndarray
    undamped: np.ndarray
    damped_gain: float
    undamped_gain: float

    def has_converged(self, tolerance: float, damping: float) -> bool:
        """Whether little is left to gain.

        A damped step may promise little while the end of the valley is far; at a wall of the
        support the promise never ends.
        """
        near = self.undamped_gain < _UNDAMPED_TOLERANCES * tolerance
        return self.damped_gain < tolerance and (near or damping > _WALL_DAMPING)


def levenberg_marquardt[X](
    objective: Callable[[X], float],
    equations: Callable[[X], tuple[np.ndarray, np.ndarray]],
    move: Callable[[X, np.ndarray], X],
    x: X,
    *,
    steps: int = 100,
    tolerance: float = 1e-7,
) -> tuple[X, float]:
    """Minimise half a sum of squares.

    Nielsen's damping (Madsen, Nielsen, Tingleff 2004, algorithm 3.16), with steps searched along
    and corrected. Where the data hardly show a direction the minimum lies at the end of a long,
    narrow, curved valley: steps end on its wall, and damping alone would creep. A step that
    disappoints is followed by corrections that move down the wall and not along the valley. One
    that gains little of what the undamped step promises is tried against parts of that step.

    Parameters
    ----------
    objective : callable
        Half the sum of squares at a point; infinite or NaN where there is none.
    equations : callable
        Gauss-Newton Hessian (n, n) and gradient (n,) at a point.
    move : callable
        The point reached from a point by a step (n,).
    x : object
        Where to begin.
    steps : int
        At most.
    tolerance : float
        Of the objective. The descent ends when a step promises less than this and the undamped
        one less than a thousand times this, or when the last steps that were taken gained less
        than a hundred times this together.

    Returns
    -------
    x : object
        The best point.
    objective : float
        There.

    Examples
    --------
    >>> def identity(x): return np.eye(2), x
    >>> x, _ = levenberg_marquardt(lambda x: 0.5 * x @ x, identity, np.add, np.ones(2))
    >>> x.round(3).tolist()
    [0.0, 0.0]
    """
    problem = _Problem(objective, equations, move)
    best, damping, growth = objective(x), _FIRST_DAMPING, 2.0
    reached_before = [np.inf] * _STALL_STEPS
    hessian, gradient = equations(x)
    for _ in range(steps):
        predicted = _predicted_gain(hessian, gradient, damping)
        trial, reached = _trial(problem, x, best, predicted, tolerance)
        if np.isfinite(reached) and reached <= best:
            gain = (best - reached) / max(predicted.damped_gain, 1e-300)
            x, best = trial, reached
            factor = max(0.1, 1.0 - (2.0 * min(gain, 1.0) - 1.0) ** 3)
            damping, growth = max(damping * factor, _LEAST_DAMPING), 2.0
            if predicted.has_converged(tolerance, damping):
                break
            reached_before = [*reached_before[1:], best]
            if reached_before[0] - best < _STALL_TOLERANCES * tolerance:
                break
            hessian, gradient = equations(x)
        else:
            damping, growth = damping * growth, growth * 2.0
        hopeless = predicted.damped_gain < 1e-3 * tolerance or damping > _LARGEST_DAMPING
        if hopeless or not np.all(np.isfinite(gradient)):
            break
    return x, best


def _predicted_gain(hessian: np.ndarray, gradient: np.ndarray, damping: float) -> _PredictedGain:
    """The step with this damping, the undamped one, and what both promise."""
    step, undamped = (_damped_step(hessian, gradient, d) for d in (damping, _LEAST_DAMPING))
    gains = (float(-(gradient @ s + 0.5 * s @ hessian @ s)) for s in (step, undamped))
    return _PredictedGain(step, undamped, *gains)


def _trial[X](
    problem: _Problem[X], x: X, best: float, predicted: _PredictedGain, tolerance: float
) -> tuple[X, float]:
    """Where a step leads, with corrections where it disappoints, and its objective."""
    gain, all_gain = predicted.damped_gain, predicted.undamped_gain
    trial, reached = problem.at(problem.move(x, predicted.step))
    if best - reached < _DISAPPOINTING_SHARE * gain:
        trial, reached = problem.corrected(trial, reached, best - _DISAPPOINTING_SHARE * gain)
    far = all_gain > _UNDAMPED_TOLERANCES * tolerance
    if best - reached < _LITTLE_SHARE * all_gain and far:
        parts = (problem.at(problem.move(x, k * predicted.undamped)) for k in _UNDAMPED_PARTS)
        part, value = min(parts, key=lambda candidate: candidate[1])
        if value < best:
            corrected = problem.corrected(part, value, -np.inf)
            trial, reached = min((trial, reached), corrected, key=lambda candidate: candidate[1])
    return trial, reached


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
