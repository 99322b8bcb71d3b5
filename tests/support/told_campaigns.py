"""Summaries of campaigns whose truth is known, without any telemetry."""

from __future__ import annotations

import numpy as np

from bayes_inertia.inference.likelihood_summary import LikelihoodSummary, summary_of

PRIOR_MEAN = np.array([3.2, 2.2, 1.9, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
PRIOR_SD = np.array([0.128, 0.088, 0.076, *(6 * [0.03])])
# What a campaign of five slews tells, roughly [kg m^2, 1].
TYPICAL_SD = np.array([2e-4, 2e-4, 2e-4, 1e-3, 1e-3, 1e-3, 1e-4, 1e-4, 1e-4])


def campaign_of(
    truth: np.ndarray, rng: np.random.Generator, name: str = "c", narrower: float = 1.0
) -> LikelihoodSummary:
    """What a campaign tells of a spacecraft: correlated, with noise of its own.

    `truth` (n,): J alone where there is no rate sensor (6), else with a K or more of it.

    `narrower`: by what the stated sds are too small; 1 for honest ones.
    """
    n = truth.size
    prior_mean, prior_sd = PRIOR_MEAN[:n], PRIOR_SD[:n]
    sd = TYPICAL_SD[:n] * np.exp(0.3 * rng.standard_normal(n))
    axes = np.linalg.qr(rng.standard_normal((n, n)))[0]
    shape = 0.6 * np.eye(n) + 0.4 * (axes * np.exp(rng.standard_normal(n))) @ axes.T
    covariance = shape * np.outer(sd, sd)
    told = truth + narrower * np.linalg.cholesky(covariance) @ rng.standard_normal(n)
    precision = np.linalg.inv(covariance) + np.diag(prior_sd**-2.0)
    posterior = np.linalg.inv(precision)
    mean = posterior @ (np.linalg.solve(covariance, told) + prior_mean / prior_sd**2)
    return summary_of(name, mean, posterior, prior_mean, prior_sd)
