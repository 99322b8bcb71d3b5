"""Log evidence for an effect whose size is not known to a factor: averaged over the scale of its prior.

An effect's prior states how large it may plausibly be. Evidence at that one scale punishes an effect of which little
is needed for all that might have been there, and so prefers a wrong effect with a narrow prior to the right one with a
wide prior (Lindley's paradox). The scale of the amplitudes is therefore itself unknown: log-uniform over four decades
up to the stated one, a mixture of g-priors (Liang et al. 2008). Parameters that give an effect its shape (a mode's
frequency) keep their own priors.
"""

from __future__ import annotations

import numpy as np
from scipy.special import logsumexp

from bayes_inertia.estimate import Estimate, prior_rows
from bayes_inertia.levenberg import inverse

# Prior sd of the amplitudes over the stated one.
SCALES = np.logspace(-4.0, 0.0, 17)


def first_order_log_bayes_factor(along: np.ndarray, powers: np.ndarray) -> float:
    """Log evidence for amplitudes against none, from a linear model of unit noise.

    Parameters
    ----------
    along, powers : (n,) gradient and information along independent directions, in units of the stated prior sd.

    >>> strong, weak = first_order_log_bayes_factor([60.0], [100.0]), first_order_log_bayes_factor([3.0], [100.0])
    >>> strong > 10.0, weak < 0.0
    (True, True)
    """
    along, powers = np.asarray(along, float), np.maximum(np.asarray(powers, float), 0.0)
    variance = SCALES[:, None] ** 2
    values = 0.5 * np.sum(variance * along**2 / (1.0 + variance * powers) - np.log1p(variance * powers), axis=1)
    return float(logsumexp(values) - np.log(len(SCALES)))


def log_bayes_factor(before: Estimate, after: Estimate, effect: str) -> float:
    """Log evidence for the fit with `effect` against the fit without it, by Laplace's approximation.

    Parameters
    ----------
    before, after : fits of the same data and noise; the effect's parameters are free in `after` only.
    """
    space = after.model.space
    part = np.arange(space.size)[space.slice_of(effect)]
    slope, distance = (rows[part] for rows in prior_rows(after.model, after.theta))
    posterior = inverse(after.covariance[np.ix_(part, part)])
    data = posterior - np.diag(slope**2)
    pull = posterior @ (distance / slope)
    amplitude = np.array([not space.priors[i].logarithmic for i in part])
    stated = _gaussian(data, pull, slope)
    scaled = [_gaussian(data, pull, np.where(amplitude, slope / s, slope)) for s in SCALES]
    at_stated_scale = before.objective - after.objective + stated[1]
    return float(at_stated_scale + logsumexp([sum(g) - sum(stated) for g in scaled]) - np.log(len(SCALES)))


def _gaussian(data: np.ndarray, pull: np.ndarray, slope: np.ndarray) -> tuple[float, float]:
    """Fit and Occam's factor of amplitudes with prior sd 1/slope: b^T (L + P)^-1 b / 2 and (log |P| - log |L + P|) / 2."""
    values, vectors = np.linalg.eigh(np.eye(len(slope)) + data / np.outer(slope, slope))
    along = vectors.T @ (pull / slope)
    values = np.maximum(values, 1.0)
    return 0.5 * float(np.sum(along**2 / values)), -0.5 * float(np.sum(np.log(values)))
