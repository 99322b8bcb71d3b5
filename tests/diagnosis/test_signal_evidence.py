"""A random signal in a linear model: its Bayes factor is one, and found where it is there."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import logsumexp

from bayes_inertia.diagnosis.hypothesis_table import (
    RandomMember,
    log_evidence_of_random,
    signal_of,
)
from bayes_inertia.diagnosis.linear_system import projected_signal
from bayes_inertia.maths.linear_algebra import inverse_root

SLEWS, NUMBERS, SHARED, LOCAL, K = 3, 40, 2, 2, 4
LARGEST = 20.0


@pytest.fixture(scope="module")
def design():
    """Columns of what is fitted and of the signal; the first fitted one imitates part of it."""
    rng = np.random.default_rng(5)
    fitted = rng.normal(size=(SLEWS, NUMBERS, SHARED + LOCAL))
    columns = rng.normal(size=(SLEWS, NUMBERS, K))
    fitted[..., 0] = columns[..., 0] + 0.3 * fitted[..., 0]
    return fitted, columns


def indices(slew):
    own = SHARED + LOCAL * slew
    return np.r_[:SHARED, own : own + LOCAL]


def fit_of(fitted, data):
    """A fit of a linear model with standard normal priors, at zero."""
    size = SHARED + SLEWS * LOCAL
    hessian, gradient = np.eye(size), np.zeros(size)
    for s in range(SLEWS):
        hessian[np.ix_(indices(s), indices(s))] += fitted[s].T @ fitted[s]
        gradient[indices(s)] += fitted[s].T @ data[s]
    root = inverse_root(hessian)
    return SimpleNamespace(
        inverse_root=root,
        whitened_gradient=root @ gradient,
        columns=fitted,
        residual=data,
        index=indices,
    )


def projected(fit, columns):
    """The signal, beside no effect of a fixed shape."""
    return projected_signal(fit, columns)[0]


def drawn(rng, fitted, columns, size):
    truth = rng.normal(size=SHARED + SLEWS * LOCAL)
    signal = size * np.einsum("snk,sk->sn", columns, rng.normal(size=(SLEWS, K)))
    known = np.stack([fitted[s] @ truth[indices(s)] for s in range(SLEWS)])
    return known + signal + rng.normal(size=(SLEWS, NUMBERS))


def evidence(fitted, columns, data, unit=1.0, largest=LARGEST):
    roots = [unit * scale * np.eye(SLEWS * K) for scale in (1.0, 2.0)]
    signal = projected(fit_of(fitted, data), columns)
    return weighed(signal, roots, np.array([1.0, 0.5]), largest)


def weighed(signal, roots, odds=(1.0,), largest=LARGEST):
    """Log Bayes factor of a random signal."""
    return float(logsumexp(log_evidence_of_random(member_of(signal, roots, odds, largest))))


def member_of(signal, roots, odds=(1.0,), largest=LARGEST):
    n = signal.gradient.size
    matrix, gradient, none = signal.matrix.reshape(n, n), signal.gradient.ravel(), np.zeros((n, 0))
    forms = [signal_of(matrix, gradient, none, root, largest) for root in roots]
    return RandomMember("", forms, np.log(odds))


@pytest.mark.slow
def test_without_a_signal_the_bayes_factor_is_one_on_average(design):
    """What bounds false alarms: one campaign of b exceeds b at most."""
    fitted, columns = design
    rng = np.random.default_rng(6)
    # A weak signal of a few shapes: the average over campaigns converges.
    factors = np.exp(
        [evidence(fitted, columns, drawn(rng, fitted, columns, 0.0), 1e-2) for _ in range(3000)]
    )
    error = factors.std() / np.sqrt(len(factors))
    assert factors.mean() == pytest.approx(1.0, abs=4.0 * error)
    assert error < 0.1
    assert np.mean(factors > 20.0) < 1.0 / 20.0
    # Without projecting off what is fitted it is not one.
    free = np.zeros_like(fitted)
    data = [drawn(rng, fitted, columns, 0.0) for _ in range(200)]
    wrong = np.exp([evidence(free, columns, x, 1e-2) for x in data])
    assert wrong.mean() > 10.0


def test_a_signal_is_found(design):
    fitted, columns = design
    rng = np.random.default_rng(7)
    found = [evidence(fitted, columns, drawn(rng, fitted, columns, 1.0)) for _ in range(20)]
    assert min(found) > 10.0


def test_a_signal_that_repeats_is_told_from_one_that_does_not(design):
    fitted, columns = design
    rng = np.random.default_rng(8)
    leads = []
    for same in (True, False):
        coefficients = rng.normal(size=(1 if same else SLEWS, K)) * np.ones((SLEWS, 1))
        data = drawn(rng, fitted, columns, 0.0) + np.einsum("snk,sk->sn", columns, coefficients)
        signal = projected(fit_of(fitted, data), columns)
        once = weighed(signal.repeated(), [np.eye(K)])
        each = weighed(signal, [np.eye(SLEWS * K)])
        leads.append(once - each)
    assert leads[0] > 3.0
    assert leads[1] < -3.0


def test_a_process_that_goes_on_between_slews_is_told_from_one_that_does_not(design):
    """The mean gain is the distance of two normal laws: of either sign, by which is the truth."""
    fitted, columns = design
    rng = np.random.default_rng(10)
    shared = np.full((SLEWS, SLEWS), 0.8) + 0.2 * np.eye(SLEWS)
    joint = np.kron(np.linalg.cholesky(shared), np.eye(K))
    gains = {True: [], False: []}
    for goes_on, found in gains.items():
        for _ in range(60):
            z = rng.normal(size=SLEWS * K)
            coefficients = ((joint @ z) if goes_on else z).reshape(SLEWS, K)
            data = drawn(rng, fitted, columns, 0.0) + np.einsum("snk,sk->sn", columns, coefficients)
            signal = projected(fit_of(fitted, data), columns)
            together, apart = (
                weighed(signal, [root], largest=1.0) for root in (joint, np.eye(SLEWS * K))
            )
            found.append(together - apart)
    for goes_on, found in gains.items():
        error = np.std(found) / np.sqrt(len(found))
        mean = np.mean(found) if goes_on else -np.mean(found)
        assert mean > 5.0 * error


def test_a_size_beyond_its_prior_costs_what_it_was_unlikely(design):
    """And not with the square of it: a strong signal keeps nearly all its evidence."""
    fitted, columns = design
    data = drawn(np.random.default_rng(9), fitted, columns, 25.0 * LARGEST)
    beyond = evidence(fitted, columns, data)
    within = evidence(fitted, columns, data, largest=100.0 * LARGEST)
    assert 0.0 < within - beyond < np.log(100.0) + 1.0
