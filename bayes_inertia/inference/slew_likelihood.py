"""How likely each slew's telemetry is at every draw: what ArviZ leaves out one slew at a time.

A slew's own nuisances are integrated out, the rate bias, which slews share, is drawn given J, K and
effects: given a draw, slews are then independent, as rows of one slew are not. How the whole
density divides among the slews is taken to first order around the optimum, so that no slew is
simulated again; their sum is the density that was sampled.
"""

from __future__ import annotations

import numpy as np

from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.noise_model import log_norms
from bayes_inertia.inference.slew_shares import eliminated


def slew_log_likelihood(
    estimate: Estimate, thetas: np.ndarray, likelihood: np.ndarray, rng: np.random.Generator
) -> np.ndarray | None:
    """Log densities (n, slews) of each slew's readings at draws (n, d) of the posterior.

    Over the density that residuals as large as the stated noise have: a constant of the campaign.
    `likelihood` (n,): log density of all readings at each, up to a constant. None where the noise
    is not as stated or the size of a stochastic effect is sampled: slews are not apart there.
    """
    if not estimate.model.noise.is_stated or estimate.model.structure.hyperparameters:
        return None
    constant, gradient, matrix = _equations(estimate)
    f, b = len(estimate.free), len(estimate.point.bias)
    shift = np.zeros((len(thetas), f + b))
    shift[:, :f] = thetas[:, estimate.free] - estimate.theta[estimate.free]
    # The bias given each draw, its prior included.
    precision = np.eye(b) + matrix[:, f:, f:].sum(0)
    slope = estimate.point.bias + gradient[:, f:].sum(0) + shift[:, :f] @ matrix[:, :f, f:].sum(0)
    shift[:, f:] = -np.linalg.solve(precision, slope.T).T
    at_best = _log_densities(constant, gradient, matrix, shift).sum(1)
    bias = estimate.point.bias + shift[:, f:]
    beyond = likelihood - (at_best - 0.5 * np.sum(bias**2, 1))
    # To first order nothing is beyond at the optimum.
    nearest = np.argmin(np.einsum("ni,ij,nj->n", shift, matrix.sum(0), shift))
    root = np.linalg.cholesky(precision)
    shift[:, f:] += np.linalg.solve(root.T, rng.standard_normal(bias.shape).T).T
    logs = _log_densities(constant, gradient, matrix, shift)
    return logs + (beyond - beyond[nearest])[:, None] / logs.shape[1]


def _log_densities(
    constant: np.ndarray, gradient: np.ndarray, matrix: np.ndarray, shift: np.ndarray
) -> np.ndarray:
    """Log densities (n, slews) to second order at shifts (n, n_shared) from the optimum."""
    squares = np.einsum("ni,sij,nj->ns", shift, matrix, shift, optimize=True)
    return constant - shift @ gradient.T - 0.5 * squares


def _equations(estimate: Estimate) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Log density (slews,) at the optimum, its slope (slews, n_shared) and curvature, negated.

    Each slew's own nuisances are integrated out.
    """
    information, local = estimate.information, estimate.point.local
    parts = eliminated(information, local, len(estimate.free) + len(estimate.point.bias))
    squares = information.chi2.sum(1) + np.sum(local**2, 1) - np.sum(parts.pull**2, 1)
    determinants = np.log(np.abs(np.diagonal(parts.root, axis1=1, axis2=2))).sum(1)
    # Numbers of 10^5 would drown differences between models, and overflow in `az.compare`: counted
    # from the log density of what the noise as stated makes.
    used, stated = (log_norms(estimate.model, x) for x in (estimate.white, estimate.stated))
    norms = sum(a.sum(1) - b.sum(1) for a, b in zip(used, stated, strict=True))
    constant = determinants - 0.5 * (squares - information.n_data.sum(1)) + norms
    return constant, parts.gradient, parts.matrix
