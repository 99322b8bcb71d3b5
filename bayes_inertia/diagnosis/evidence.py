"""Log evidence for an effect whose size is not known to a factor: averaged over its prior's scale.

An effect's prior states how large it may plausibly be. Evidence at that one scale punishes an
effect of which little is needed for all that might have been there, and so prefers a wrong effect
with a narrow prior to the right one with a wide prior (Lindley's paradox). The scale of the
amplitudes is therefore itself unknown: log-uniform from the size that the campaign can just not see
up to the stated one, a mixture of g-priors (Liang et al. 2008). It may be one scale for all of an
effect's directions, or one for each (one bad wheel of three): both are given the same weight. A
stated scale may also be wrong altogether: with a small probability the scale is log-uniform beyond
it, so that a strong effect pays once for its unlikely size, and not with the square of it.
Parameters that give an effect its shape (a mode's frequency) keep their own priors.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import logsumexp

from bayes_inertia.diagnosis.prior_sizes import sizes_with_weights, smallest_size
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.noise_model import log_normalisation
from bayes_inertia.inference.objective import prior_rows
from bayes_inertia.maths.linear_algebra import inverse

# Tolerance of the objective for refits that are only compared. What is left of it is a hundredth at
# most, while evidence is weighed in units.
COMPARISON_TOLERANCE = 1e-5
_N_PRIOR_SCALES = 24


def log_bayes_factor_of(gradient: ArrayLike, powers: ArrayLike) -> float:
    """Compute the log evidence for amplitudes against none, from a linear model of unit noise.

    `powers` (n,). `gradient` (n,): along independent directions, in units of the stated prior sd.

    Examples
    --------
    >>> log_bayes_factor_of([60.0], [100.0]) > 10.0, log_bayes_factor_of([3.0], [100.0]) < 0.0
    (True, True)
    """
    u, power = np.asarray(gradient, float), np.maximum(np.asarray(powers, float), 0.0)
    scales, weights = sizes_with_weights(smallest_size(power, 1.0), 1.0, _N_PRIOR_SCALES)
    variance = scales[:, None] ** 2
    values = 0.5 * (variance * u**2 / (1.0 + variance * power) - np.log1p(variance * power))
    one_scale = logsumexp(values.sum(1), b=weights)
    scale_each = float(np.sum(logsumexp(values, axis=0, b=weights[:, None])))
    return float(np.logaddexp(one_scale, scale_each) - np.log(2.0))


def log_bayes_factor_around(
    gain: float, information: np.ndarray, amplitude: np.ndarray, prior_scale: float = 1.0
) -> float:
    """Compute the log evidence for amplitudes against none, linearised around the best ones.

    `amplitude` (n,). `information` (n, n): of the data there, in units of the prior sd that they
    were fitted with. `prior_scale`: how many times the stated prior sd that unit is.

    Examples
    --------
    >>> exact = log_bayes_factor_of([60.0], [100.0])
    >>> gain, best = 0.5 * 60.0**2 / 101.0, np.array([60.0 / 101.0])
    >>> abs(log_bayes_factor_around(gain, np.array([[100.0]]), best) - exact) < 1e-9
    True
    """
    powers, directions = np.linalg.eigh(information)
    gradient = (1.0 + powers) * (directions.T @ amplitude)
    powers = np.maximum(powers, 0.0)
    at_fitted_scale = 0.5 * float(np.sum(gradient**2 / (1.0 + powers)))
    stated = log_bayes_factor_of(gradient / prior_scale, powers / prior_scale**2)
    return gain - at_fitted_scale + stated


def log_bayes_factor(before: Estimate, after: Estimate, effect: str) -> float:
    """Compute the log evidence for a fit with an effect against the fit without it.

    By Laplace's approximation.
    """
    space = after.model.space
    part = np.arange(space.size)[space.slice_of(effect)]
    shape = np.array([space.priors[i].logarithmic for i in part], bool)
    slope, distance = (rows[part] for rows in prior_rows(after.model, after.theta))
    covariance = after.covariance[np.ix_(part, part)] * np.outer(slope, slope)
    # In units of the stated prior sd, shapes integrated out: information of the data, and the
    # gradient at zero amplitude.
    posterior = inverse(covariance[np.ix_(~shape, ~shape)])
    occam_of_shape = (
        -0.5 * np.linalg.slogdet(inverse(covariance)[np.ix_(shape, shape)])[1]
        if shape.any()
        else 0.0
    )
    gain = before.objective - after.objective
    information = posterior - np.eye(len(posterior))
    (scale,) = (e.prior_scale for e in after.model.effects if e.name == effect)
    evidence = log_bayes_factor_around(gain, information, distance[~shape], scale)
    return float(evidence + occam_of_shape)


def log_evidence_of_fit(estimate: Estimate) -> float:
    """Compute the log density of the data under a fit's model, everything integrated out.

    By Laplace's approximation around the fit itself. Fits whose noise differs can be compared.

    Returns: up to a constant that all models of the same readings share; -inf where the fit has no
    end.
    """
    if not np.isfinite(estimate.objective):
        return -np.inf
    slope, _ = prior_rows(estimate.model, estimate.theta)
    priors = float(np.log(np.abs(slope[estimate.free])).sum())
    half_log_det = 0.5 * float(np.linalg.slogdet(estimate.hessian)[1])
    return log_normalisation(estimate.white) - estimate.objective + priors - half_log_det
