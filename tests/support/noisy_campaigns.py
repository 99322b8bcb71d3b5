"""Campaigns with heavy-tailed noise, and moments of posteriors without a chain."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayes_inertia.inference.density_marginal import log_density_with_densities
from bayes_inertia.inference.proposal import IndependenceMove

RATE_SIGMA = 2e-5


def spiked(campaign, share, seed=3, sizes=(10.0, 100.0)):
    """The campaign with outliers of the rate sensor, and their rows by slew."""
    rng, rows, slews = np.random.default_rng(seed), {}, []
    for slew in campaign.slews:
        hit = rng.random(slew.rate.shape) < share
        size = rng.choice([-1.0, 1.0], hit.shape) * rng.uniform(*sizes, hit.shape) * RATE_SIGMA
        rows[slew.name] = set(np.flatnonzero(hit.any(axis=1)).tolist())
        slews.append(replace(slew, rate=np.where(hit, slew.rate + size, slew.rate)))
    return replace(campaign, slews=tuple(slews)), {k: v for k, v in rows.items() if v}


def with_student_t_rates(flying, seed, degrees, scale):
    """A flown campaign whose rate noise is Student-t of the stated sigma times a scale."""
    flown, silent = flying(seed), flying(seed, noise=0.0)
    rng, slews = np.random.default_rng([seed, 1]), []
    for slew, calm in zip(flown.campaign.slews, silent.campaign.slews, strict=True):
        stretch = scale * np.sqrt(degrees / rng.chisquare(degrees, slew.rate.shape))
        slews.append(replace(slew, rate=calm.rate + stretch * (slew.rate - calm.rate)))
    return replace(flown.campaign, slews=tuple(slews)), flown.truth


@dataclass(frozen=True)
class Moments:
    """Means and standard deviations (d,), and the effective number of draws behind them."""

    mean: np.ndarray
    sd: np.ndarray
    effective: float


def importance_moments(estimate, rng, n, logarithm_of=()):
    """Moments of the marginal posterior, from weighted draws of a wide t distribution."""
    logarithmic = np.array([p.logarithmic for p in estimate.model.space.priors])
    wide = IndependenceMove(estimate.theta, 1.3 * estimate.covariance, 8.0, logarithmic)
    draws = wide.draw(np.random.RandomState(np.random.MT19937(int(rng.integers(1 << 31)))), n)
    log_weight = log_density_with_densities(estimate, batch=32)(draws) - wide.log_density(draws)
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    draws[:, list(logarithm_of)] = np.log(draws[:, list(logarithm_of)])
    mean = weight @ draws
    return Moments(mean, np.sqrt(weight @ (draws - mean) ** 2), 1.0 / float(np.sum(weight**2)))
