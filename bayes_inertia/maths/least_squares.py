"""Levenberg-Marquardt on normal equations, for problems whose parameters live on a manifold.

`scipy.optimize.least_squares` wants the whole Jacobian as one matrix and factors it at every step;
here normal equations come in blocks (slews) that are wanted anyway, and a step is followed along a
chart of the physical inertia tensors.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import linalg

# Damping of a correction: stiff directions move, weak ones stay. Corrections of one step at most.
_STIFF, _CORRECTIONS = 1e-2, 3
# So many steps are the last ones, and so many tolerances are little for them to gain.
_LATELY, _CREEP = 5, 100.0
# Damping of a step that counts as undamped.
_LEAST = 1e-12
# Parts of the undamped step that are tried where the damped one disappoints.
_PARTS = (0.3, 0.1, 0.03)


def descend[X](
    objective: Callable[[X], float],
    equations: Callable[[X], tuple[np.ndarray, np.ndarray]],
    move: Callable[[X, np.ndarray], X],
    x: X,
    *,
    steps: int = 100,
    tolerance: float = 1e-7,
) -> tuple[X, float]:
    """Minimise half a sum of squares with Nielsen's damping (Madsen, Nielsen, Tingleff 2004, algorithm 3.16), searched along and corrected.

    Where the data hardly show a direction the minimum lies at the end of a long, narrow, curved valley: steps end on its
    wall, and damping alone would creep. A step that disappoints is followed by corrections that move down the wall and not
    along the valley, and one that gains little of what the undamped step promises is tried against parts of that step.

    Parameters
    ----------
    objective : half the sum of squares at a point; infinite or NaN where there is none.
    equations : Gauss-Newton Hessian (n, n) and gradient (n,) at a point.
    move : the point reached by a step (n,).
    steps : at most. tolerance : stop when a step promises less than this, and the undamped one less than a thousand times this, or
        when the last steps that were taken gained less than a hundred times this together.

    Returns
    -------
    The best point and its objective.

    >>> descend(lambda x: 0.5 * x @ x, lambda x: (np.eye(2), x), lambda x, s: x + s, np.ones(2))[0].round(3).tolist()
    [0.0, 0.0]
    """
    best, damping, growth = objective(x), 1e-4, 2.0
    reached_before = [np.inf] * _LATELY
    hessian, gradient = equations(x)
    for _ in range(steps):
        step, whole = (_damped_step(hessian, gradient, d) for d in (damping, _LEAST))
        promised, all_promised = (_promised(hessian, gradient, s) for s in (step, whole))
        trial, reached = _at(objective, move(x, step))
        if best - reached < 0.5 * promised:
            trial, reached = _corrected(
                objective, equations, move, trial, reached, best - 0.5 * promised
            )
        if best - reached < 0.02 * all_promised and all_promised > 1e3 * tolerance:
            part, value = min(
                (_at(objective, move(x, k * whole)) for k in _PARTS), key=lambda tried: tried[1]
            )
            if value < best:
                trial, reached = min(
                    (trial, reached),
                    _corrected(objective, equations, move, part, value, -np.inf),
                    key=lambda tried: tried[1],
                )
        if np.isfinite(reached) and reached <= best:
            gain = (best - reached) / max(promised, 1e-300)
            x, best = trial, reached
            damping, growth = (
                max(damping * max(0.1, 1.0 - (2.0 * min(gain, 1.0) - 1.0) ** 3), _LEAST),
                2.0,
            )
            # A damped step may promise little while the end of the valley is far; at a wall of the support the promise never ends.
            if promised < tolerance and (all_promised < 1e3 * tolerance or damping > 1e3):
                break
            reached_before = [*reached_before[1:], best]
            if reached_before[0] - best < _CREEP * tolerance:
                break
            hessian, gradient = equations(x)
        else:
            damping, growth = damping * growth, growth * 2.0
        if promised < 1e-3 * tolerance or damping > 1e12 or not np.all(np.isfinite(gradient)):
            break
    return x, best


def _at[X](objective: Callable[[X], float], x: X) -> tuple[X, float]:
    """A point and its objective, infinite where there is none."""
    value = objective(x)
    return x, value if np.isfinite(value) else np.inf


def _promised(hessian: np.ndarray, gradient: np.ndarray, step: np.ndarray) -> float:
    """By how much a step would lower the objective if it were the quadratic of the normal equations."""
    return float(-(gradient @ step + 0.5 * step @ hessian @ step))


def _corrected[X](objective, equations, move, x: X, value: float, wanted: float) -> tuple[X, float]:
    """A point lower than x beside the valley's bottom, in at most a few corrections, fewer once `wanted` is reached."""
    for _ in range(_CORRECTIONS):
        if not np.isfinite(value) or value < wanted:
            break
        trial, reached = _at(objective, move(x, _damped_step(*equations(x), _STIFF)))
        if reached >= value:
            break
        x, value = trial, reached
    return x, value


def _damped_step(hessian: np.ndarray, gradient: np.ndarray, damping: float) -> np.ndarray:
    """The step (n,) with this damping, or with the least more that keeps the matrix definite; NaN where there is none."""
    if not (np.all(np.isfinite(hessian)) and np.all(np.isfinite(gradient))):
        return np.full_like(gradient, np.nan)
    scale = np.sqrt(np.diag(hessian))
    scaled = hessian / np.outer(scale, scale)
    while True:
        try:
            return (
                -linalg.cho_solve(
                    linalg.cho_factor(scaled + damping * np.eye(len(scale))), gradient / scale
                )
                / scale
            )
        except linalg.LinAlgError:  # Rounding.
            damping = max(10.0 * damping, 1e-15)
