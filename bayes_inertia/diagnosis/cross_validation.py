"""How well a model predicts slews that were left out of its fit: the judge of whether an effect belongs in it."""

from __future__ import annotations

import numpy as np

from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.objective import N_BIAS
from bayes_inertia.maths.linear_algebra import inverse, solve


def held_out(at: Estimate) -> float | None:
    """Reduced chi^2 of slews that were left out of the fit, one after the other; None with fewer than two slews.

    Each slew is predicted with theta and bias from the others; only its own start state is fitted. To first order
    around the estimate.
    """
    info, m = at.information, at.point.local.shape[1]
    n = len(info.chi2)
    if n < 2:
        return None
    fit, shared = at.linearised(), len(at.free) + N_BIAS
    total, numbers = 0.0, 0.0
    for s in range(n):
        step, hessian = fit.without_slew(s)
        step = step[:shared]
        A, g = info.matrix[s].sum(0), info.gradient[s].sum(0)
        linear = g[:shared] + A[:shared, :shared] @ step
        own = g[shared:] + A[shared:, :shared] @ step + at.point.local[s]
        stiff = A[shared:, shared:] + np.eye(m)
        chi2 = info.chi2[s].sum() + step @ (g[:shared] + linear) - own @ solve(stiff, own)
        # The prediction is itself uncertain: what the others' uncertainty of theta and bias allows is no misfit.
        apart = solve(stiff, A[shared:, :shared])
        pull, information_ = (
            linear - apart.T @ own,
            A[:shared, :shared] - A[:shared, shared:] @ apart,
        )
        known = inverse(inverse(hessian)[:shared, :shared])
        total, numbers = (
            total + chi2 - pull @ solve(information_ + known, pull),
            numbers + info.n_data[s].sum() - m,
        )
    return float(total / numbers)
