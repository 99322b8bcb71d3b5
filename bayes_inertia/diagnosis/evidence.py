"""Log evidence for an effect whose size is not known to a factor: averaged over the scale of its prior.

An effect's prior states how large it may plausibly be. Evidence at that one scale punishes an effect of which little
is needed for all that might have been there, and so prefers a wrong effect with a narrow prior to the right one with a
wide prior (Lindley's paradox). The scale of the amplitudes is therefore itself unknown: log-uniform from the size that
the campaign can just not see up to the stated one, a mixture of g-priors (Liang et al. 2008). It may be one scale for all
of an effect's directions, or one for each (one bad wheel of three): both are given the same weight. Parameters that
give an effect its shape (a mode's frequency) keep their own priors.
"""

from __future__ import annotations

import numpy as np
from scipy.special import logsumexp

from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.objective import prior_rows
from bayes_inertia.maths.linear_algebra import inverse

_POINTS = 24
# Smallest scale: signal-to-noise amplitude of an effect of that size in its clearest direction.
_UNSEEN = 0.3


def log_bayes_factor_of(along: np.ndarray, powers: np.ndarray) -> float:
    """Log evidence for amplitudes against none, from a linear model of unit noise.

    Parameters
    ----------
    along, powers : (n,) gradient and information along independent directions, in units of the stated prior sd.

    >>> strong, weak = log_bayes_factor_of([60.0], [100.0]), log_bayes_factor_of([3.0], [100.0])
    >>> strong > 10.0, weak < 0.0
    (True, True)
    """
    along, powers = np.asarray(along, float), np.maximum(np.asarray(powers, float), 0.0)
    lowest = min(_UNSEEN / np.sqrt(max(float(powers.max(initial=0.0)), 1e-300)), 0.1)
    variance = np.geomspace(lowest, 1.0, _POINTS)[:, None] ** 2
    values = 0.5 * (variance * along**2 / (1.0 + variance * powers) - np.log1p(variance * powers))
    together = logsumexp(values.sum(1)) - np.log(_POINTS)
    apart = float(np.sum(logsumexp(values, axis=0) - np.log(_POINTS)))
    return float(np.logaddexp(together, apart) - np.log(2.0))


def log_bayes_factor_around(gain: float, information: np.ndarray, amplitude: np.ndarray) -> float:
    """Log evidence for amplitudes against none, from the model linearised around the best ones.

    Parameters
    ----------
    gain : log posterior gained by the best amplitudes. information : (n, n) of the data there, in units of the stated prior sd.
    amplitude : (n,) the best ones.

    >>> exact = log_bayes_factor_of([60.0], [100.0])
    >>> abs(log_bayes_factor_around(0.5 * 60.0**2 / 101.0, np.array([[100.0]]), np.array([60.0 / 101.0])) - exact) < 1e-9
    True
    """
    powers, directions = np.linalg.eigh(information)
    along = (1.0 + powers) * (directions.T @ amplitude)
    powers = np.maximum(powers, 0.0)
    return (
        gain - 0.5 * float(np.sum(along**2 / (1.0 + powers))) + log_bayes_factor_of(along, powers)
    )


def log_bayes_factor(before: Estimate, after: Estimate, effect: str) -> float:
    """Log evidence for the fit with `effect` against the fit without it, by Laplace's approximation.

    Parameters
    ----------
    before, after : fits of the same data and noise; the effect's parameters are free in `after` only.
    """
    space = after.model.space
    part = np.arange(space.size)[space.slice_of(effect)]
    shape = np.array([space.priors[i].logarithmic for i in part], bool)
    slope, distance = (rows[part] for rows in prior_rows(after.model, after.theta))
    covariance = after.covariance[np.ix_(part, part)] * np.outer(slope, slope)
    # In units of the stated prior sd, shapes integrated out: information of the data, and the gradient at zero amplitude.
    posterior = inverse(covariance[np.ix_(~shape, ~shape)])
    occam_of_shape = (
        -0.5 * np.linalg.slogdet(inverse(covariance)[np.ix_(shape, shape)])[1]
        if shape.any()
        else 0.0
    )
    gain = before.objective - after.objective
    return float(
        log_bayes_factor_around(gain, posterior - np.eye(len(posterior)), distance[~shape])
        + occam_of_shape
    )
