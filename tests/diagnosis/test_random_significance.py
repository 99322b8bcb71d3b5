"""p-values of the largest Bayes factor: those of brute force, and uniform where nothing is random.

Tolerances are four Monte Carlo errors of brute force.
"""

from types import MethodType, SimpleNamespace

import numpy as np
import pytest
from scipy.special import logsumexp

from bayes_inertia.diagnosis.hypothesis_table import (
    RandomMember,
    log_evidence_of_random,
    signal_of,
)
from bayes_inertia.diagnosis.linear_system import projected_signal
from bayes_inertia.diagnosis.score_test import p_values_of_largest
from bayes_inertia.inference.linearised_fit import LinearisedFit
from bayes_inertia.maths.linear_algebra import inverse_root

SLEWS, NUMBERS, SHARED, LOCAL, K = 3, 30, 2, 1, 4
CAMPAIGNS = 800
LOG_B = np.array([-1.0, 0.0, 1.0, 2.0])


def linear_fit(width=1.0):
    """A fit of a linear model whose priors are so wide; two of its columns are alike then."""
    columns = width * np.random.default_rng(1).normal(size=(SLEWS, NUMBERS, SHARED + LOCAL))
    columns[..., 1] = columns[..., 0] + columns[..., 1] / np.sqrt(width)
    index = lambda s: np.r_[:SHARED, SHARED + LOCAL * s : SHARED + LOCAL * (s + 1)]  # noqa: E731
    hessian = np.eye(SHARED + SLEWS * LOCAL)
    for s in range(SLEWS):
        hessian[np.ix_(index(s), index(s))] += columns[s].T @ columns[s]
    made = SimpleNamespace(
        columns=columns,
        index=index,
        n_shared=SHARED,
        n_local=LOCAL,
        prior_precision=np.eye(SHARED),
        model=SimpleNamespace(space=SimpleNamespace(whitening=None)),
        covariance=np.linalg.inv(hessian),
        inverse_root=inverse_root(hessian),
        whitened_gradient=np.zeros(len(hessian)),
        residual=np.zeros((SLEWS, NUMBERS)),
        valid=np.ones((SLEWS, NUMBERS)),
    )
    made.replicates = MethodType(LinearisedFit.replicates, made)
    made.simulated_gradient = MethodType(LinearisedFit.simulated_gradient, made)
    made._pulled = MethodType(LinearisedFit._pulled, made)
    made._fitted_again = MethodType(LinearisedFit._fitted_again, made)
    return made


@pytest.fixture(scope="module")
def fit():
    """A fit of a linear model with standard normal priors."""
    return linear_fit()


@pytest.fixture(scope="module")
def signals(fit):
    """Two signals that are alike, one that goes on between slews, and that the fit imitates."""
    rng = np.random.default_rng(2)
    first = rng.normal(size=(SLEWS, NUMBERS, K))
    second = first + 0.5 * rng.normal(size=first.shape)
    first[..., 0] = fit.columns[..., 0]
    each = [scale * np.eye(SLEWS * K) for scale in (1.0, 2.0)]
    shared = np.linalg.cholesky(0.7 + 0.3 * np.eye(SLEWS))
    return (first, each, (1.0, 0.5)), (second, [np.kron(shared, np.eye(K))], (1.0,))


def family(fit, signals):
    """Members of the table, of signals."""
    members = []
    for columns, roots, odds in signals:
        (projected, _), n = projected_signal(fit, columns), SLEWS * K
        matrix, gradient = projected.matrix.reshape(n, n), projected.gradient.ravel()
        forms = [signal_of(matrix, gradient, np.zeros((n, 0)), root, 3.0) for root in roots]
        members.append(RandomMember("", forms, np.log(odds), matrix=matrix))
    return members


def brute_force(fit, signals, added, seed):
    """Largest log Bayes factor (n,) of campaigns with a signal added or with none."""
    rng = np.random.default_rng(seed)
    noise = np.full((SLEWS, NUMBERS), np.hypot(1.0, added))
    residual = fit.replicates(rng, CAMPAIGNS, noise)
    largest = np.full(CAMPAIGNS, -np.inf)
    for (columns, *_), member in zip(signals, family(fit, signals), strict=True):
        gradient = np.einsum("snk,snd->skd", columns, residual).reshape(SLEWS * K, -1)
        values = logsumexp(log_evidence_of_random(member, gradient), axis=0)
        largest = np.maximum(largest, values)
    return largest


def told_of(members, asked=LOG_B, seed=4):
    """P-values by the simulation."""
    return p_values_of_largest(members, asked, np.random.default_rng(seed), 4000)


def test_p_values_are_those_of_many_campaigns_without_a_signal(fit, signals):
    for one in signals:
        largest = brute_force(fit, [one], 0.0, 3)
        shares = (largest[:, None] >= LOG_B).mean(0)
        told = told_of(family(fit, [one]))
        error = np.sqrt(told * (1.0 - told) / CAMPAIGNS)
        assert np.all(shares[:3] > 0.0)
        assert np.all(np.abs(shares - told) < 4.0 * error + 0.02 * told)
        # The bound by Markov's inequality is far above.
        assert np.all(np.exp(-LOG_B[2:]) > shares[2:] + 4.0 * error[2:])


def test_the_largest_of_several_is_as_large_at_most_as_often_as_said(fit, signals):
    largest = brute_force(fit, signals, 0.0, 3)
    shares = (largest[:, None] >= LOG_B).mean(0)
    told = told_of(family(fit, signals))
    assert np.all(shares < told + 4.0 * np.sqrt(told * (1.0 - told) / CAMPAIGNS))
    assert np.all(told < len(signals) * shares + 0.02)


def test_p_values_of_campaigns_without_a_signal_are_uniform_and_with_one_small(fit, signals):
    levels = np.array([0.02, 0.1])
    limit = 4.0 * np.sqrt(levels * (1.0 - levels) / CAMPAIGNS)
    for added, holds in ((0.0, True), (1.0, False)):
        p = told_of(family(fit, signals[:1]), brute_force(fit, signals[:1], added, 5), 6)
        shares = (p[:, None] < levels).mean(0)
        assert np.all(np.abs(shares - levels) < limit + 0.05 * levels) is np.bool_(holds)


def test_wide_priors_lose_nothing_in_rounding(signals):
    """Where the fit imitates a signal but for a trace, and truths are far apart."""
    few, many = (
        np.array(
            [
                told_of(family(linear_fit(width), signals), seed=seed)
                for seed in range(first, first + 6)
            ]
        )
        for width, first in ((1e3, 30), (1e7, 40))
    )
    error = np.hypot(few.std(0), many.std(0)) / np.sqrt(len(few))
    assert np.all(np.abs(few.mean(0) - many.mean(0)) < 4.0 * error)
    assert np.all(error < 0.1 * few.mean(0))
    left = [
        linear_fit(width).replicates(np.random.default_rng(1), 500, np.ones((SLEWS, NUMBERS)))
        for width in (1e3, 1e7)
    ]
    np.testing.assert_allclose(left[1], left[0], rtol=0.0, atol=1e-2)
