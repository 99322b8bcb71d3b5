"""How well a model predicts slews left out of its fit: whether an effect belongs in it."""

from __future__ import annotations

import numpy as np

from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.maths.linear_algebra import solve


def held_out_chi2(estimate: Estimate) -> float | None:
    """Compute the reduced chi^2 of slews that were left out of the fit, one after the other.

    Each slew is predicted with theta and bias from the others; only its own start state is fitted.
    To first order around the estimate.

    Returns: 1 if the predictions are as good as noise allows; None with fewer than two slews.
    """
    info = estimate.information
    slews = len(info.chi2)
    if slews < 2:
        return None
    fit = estimate.linearised()
    total, numbers = 0.0, 0.0
    for s in range(slews):
        chi2, allowed = _prediction_chi2(fit, s)
        total = total + chi2 - allowed
        numbers = numbers + (info.n_data[s].sum() - fit.n_local)
    return float(total / numbers)


def _prediction_chi2(fit: LinearisedFit, s: int) -> tuple[float, float]:
    """chi^2 of one slew predicted from the others, and how much of it is no misfit.

    The prediction is itself uncertain: the others leave theta and bias open to some degree.
    """
    info, shared = fit.information, fit.n_shared
    step, known = fit.shares.without(s)
    A, g = info.matrix[s].sum(0), info.gradient[s].sum(0)
    linear = g[:shared] + A[:shared, :shared] @ step
    local = g[shared:] + A[shared:, :shared] @ step + fit.point.local[s]
    stiffness = A[shared:, shared:] + np.eye(fit.n_local)
    chi2 = info.chi2[s].sum() + step @ (g[:shared] + linear) - local @ solve(stiffness, local)
    following = solve(stiffness, A[shared:, :shared])
    gradient = linear - following.T @ local
    information = A[:shared, :shared] - A[:shared, shared:] @ following
    return chi2, gradient @ solve(information + known, gradient)
