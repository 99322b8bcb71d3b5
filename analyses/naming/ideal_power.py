"""How large a random effect must be for an ideal test to find it: for `kinds.py`.

The ideal test knows the effect, its correlation time and its size, and compares likelihoods with
and without it (Neyman and Pearson). Everything else that a fit finds is projected off. With
eigenvalues l of the signal's information at unit size, twice the log of the ratio is the sum of
z^2 a^2 l / (1 + a^2 l) - log(1 + a^2 l): z^2 is chi^2 with one degree of freedom without the
effect, and 1 + a^2 l times as large with it. Its level and its power are simulated.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from scipy import optimize
from scipy.linalg import block_diag

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.diagnosis.linear_system import projected_signal
from bayes_inertia.diagnosis.torque_response import coefficient_columns, torque_response
from bayes_inertia.inference.laplace import Estimate
from bayes_inertia.inference.marginal_posterior import prior_roots
from bayes_inertia.physics.effects import RateRandomWalk, TachometerNoiseWalk
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.stochastic_effect import StochasticEffect

_DRAWS = 20_000
_SIZES = (1e-4, 1e4)  # where the size is looked for, in medians of its prior


def eigenvalues(
    plain: Estimate, effect: StochasticEffect, time: float, middle: float
) -> np.ndarray:
    """Information of a signal as large as the median of its prior, by its own directions.

    A walk goes on between slews, which the package takes for independent.

    `plain`: a fit without the effect. `effect`: its first parameter is its size. `time`: its
    correlation time, if it has one [s]. `middle`: where a walk is zero [s].
    """
    campaign = plain.model.campaign
    model = Model(campaign, (effect,), plain.model.structure.drive)
    theta, part = model.space.mean, model.space.slice_of(effect.name)
    theta[part.start + 1 : part.stop] = time
    columns = coefficient_columns(torque_response(plain), effect)
    signal, _ = projected_signal(plain.linearised(), columns)
    slews, k = signal.gradient.shape
    if isinstance(effect, RateRandomWalk | TachometerNoiseWalk):
        axes = k // effect.knots
        of_axis = theta[part.start] ** 2 * walk_covariance(campaign, effect.knots, middle)
        by_slew = of_axis.reshape(slews, effect.knots, slews, effect.knots)
        covariance = np.einsum("sitj,ab->saitbj", by_slew, np.eye(axes))
    else:
        roots = prior_roots(model.structure, jnp.asarray(theta), model.data.arrays.slews.context)
        blocks = [block_diag(*own @ np.swapaxes(own, 1, 2)) for own in np.asarray(roots[0])]
        covariance = block_diag(*blocks)
    values, vectors = np.linalg.eigh(covariance.reshape(slews * k, -1))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.maximum(np.linalg.eigvalsh(root.T @ signal.matrix.reshape(slews * k, -1) @ root), 0.0)


def walk_covariance(campaign: Campaign, knots: int, middle: float) -> np.ndarray:
    """Covariance of a walk at the knots of all slews, for a density of one.

    `campaign`: says when its slews are. `knots`: of each slew. `middle`: where the walk is zero
    [s]. Returns (n, n): of all knots of the first slew, of the second, ... [s].
    """
    share = np.linspace(0.0, 1.0, knots)
    away = np.concatenate([s.start + share * s.time[-1] - middle for s in campaign.slews])
    one_side = np.multiply.outer(away, away) > 0.0
    return np.where(one_side, np.minimum.outer(np.abs(away), np.abs(away)), 0.0)


def ideal_power(powers: np.ndarray, size: float, level: float) -> float:
    """Power of the ideal test of a signal.

    `powers` (n,): its eigenvalues at unit size. `size`: its size. `level`: of the test.

    Examples
    --------
    >>> [round(ideal_power(np.full(9, 1.0), size, 0.01), 1) for size in (0.01, 10.0)]
    [0.0, 1.0]
    """
    gain = size**2 * powers
    chi2 = np.random.default_rng(1).normal(size=(_DRAWS, len(powers))) ** 2
    shrunk = gain / (1.0 + gain)
    limit = np.quantile(chi2 @ shrunk, 1.0 - level)
    return float(np.mean(chi2 @ (shrunk * (1.0 + gain)) > limit))


def ideal_size(powers: np.ndarray, power: float, level: float) -> float:
    """Size at which the ideal test has a power; arguments as in `ideal_power`.

    >>> size = ideal_size(np.full(9, 1.0), 0.9, 0.01)
    >>> round(ideal_power(np.full(9, 1.0), size, 0.01), 2)
    0.9
    """
    seen = powers[powers > 1e-9 * powers.max()]

    def lacking(log_size: float) -> float:
        return ideal_power(seen, float(np.exp(log_size)), level) - power

    return float(np.exp(optimize.brentq(lacking, *np.log(_SIZES), xtol=1e-3)))
