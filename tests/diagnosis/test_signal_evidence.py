"""A random signal in a linear model: its Bayes factor is one, and found where it is there."""

from types import SimpleNamespace

import numpy as np
import pytest

from bayes_inertia.diagnosis.signal_evidence import (
    SignalPrior,
    gain_of_one_process,
    projected_signal,
    signal_evidence,
)
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


def drawn(rng, fitted, columns, size):
    truth = rng.normal(size=SHARED + SLEWS * LOCAL)
    signal = size * np.einsum("snk,sk->sn", columns, rng.normal(size=(SLEWS, K)))
    known = np.stack([fitted[s] @ truth[indices(s)] for s in range(SLEWS)])
    return known + signal + rng.normal(size=(SLEWS, NUMBERS))


def evidence(fitted, columns, data, unit=1.0, largest=LARGEST):
    roots = [np.broadcast_to(unit * scale * np.eye(K), (SLEWS, K, K)) for scale in (1.0, 2.0)]
    signal = projected_signal(fit_of(fitted, data), columns)
    return signal_evidence(signal, SignalPrior(roots, np.array([1.0, 0.5]), largest))


def test_without_a_signal_the_bayes_factor_is_one_on_average(design):
    """What bounds false alarms: one campaign of b exceeds b at most."""
    fitted, columns = design
    rng = np.random.default_rng(6)
    # A weak signal of a few shapes: the average over campaigns converges.
    factors = np.exp(
        [
            evidence(fitted, columns, drawn(rng, fitted, columns, 0.0), 1e-2).log_bayes_factor
            for _ in range(3000)
        ]
    )
    error = factors.std() / np.sqrt(len(factors))
    assert factors.mean() == pytest.approx(1.0, abs=4.0 * error)
    assert error < 0.1
    assert np.mean(factors > 20.0) < 1.0 / 20.0
    # Without projecting off what is fitted it is not one.
    free = np.zeros_like(fitted)
    data = [drawn(rng, fitted, columns, 0.0) for _ in range(200)]
    wrong = np.exp([evidence(free, columns, x, 1e-2).log_bayes_factor for x in data])
    assert wrong.mean() > 10.0


def test_a_signal_is_found_and_its_size_told(design):
    fitted, columns = design
    rng = np.random.default_rng(7)
    found = [evidence(fitted, columns, drawn(rng, fitted, columns, 1.0)) for _ in range(20)]
    assert min(x.log_bayes_factor for x in found) > 10.0
    sizes = [x.size * (1.0, 2.0)[x.shape] for x in found]
    assert 0.6 < np.exp(np.mean(np.log(sizes))) < 1.6


def test_a_signal_that_repeats_is_told_from_one_that_does_not(design):
    fitted, columns = design
    rng = np.random.default_rng(8)
    unit = np.broadcast_to(np.eye(K), (SLEWS, K, K))
    leads = []
    for same in (True, False):
        coefficients = rng.normal(size=(1 if same else SLEWS, K)) * np.ones((SLEWS, 1))
        data = drawn(rng, fitted, columns, 0.0) + np.einsum("snk,sk->sn", columns, coefficients)
        signal = projected_signal(fit_of(fitted, data), columns)
        once = signal_evidence(signal.repeated(), SignalPrior([unit[:1]], np.ones(1), LARGEST))
        each = signal_evidence(signal, SignalPrior([unit], np.ones(1), LARGEST))
        leads.append(once.log_bayes_factor - each.log_bayes_factor)
    assert leads[0] > 3.0
    assert leads[1] < -3.0


def test_a_process_that_goes_on_between_slews_is_told_from_one_that_does_not(design):
    """The mean gain is the distance of two normal laws: of either sign, by which is the truth."""
    fitted, columns = design
    rng = np.random.default_rng(10)
    shared = np.full((SLEWS, SLEWS), 0.8) + 0.2 * np.eye(SLEWS)
    joint = np.kron(np.linalg.cholesky(shared), np.eye(K))
    each = np.broadcast_to(np.eye(K), (SLEWS, K, K))
    gains = {True: [], False: []}
    for goes_on, found in gains.items():
        for _ in range(60):
            z = rng.normal(size=SLEWS * K)
            coefficients = ((joint @ z) if goes_on else z).reshape(SLEWS, K)
            data = drawn(rng, fitted, columns, 0.0) + np.einsum("snk,sk->sn", columns, coefficients)
            signal = projected_signal(fit_of(fitted, data), columns)
            found.extend(gain_of_one_process(signal, joint, each)(np.ones(1)))
    for goes_on, found in gains.items():
        error = np.std(found) / np.sqrt(len(found))
        mean = np.mean(found) if goes_on else -np.mean(found)
        assert mean > 5.0 * error
    # A root that is no other than that of each slew gains nothing.
    none = gain_of_one_process(signal, np.eye(SLEWS * K), each)(np.array([0.1, 1.0]))
    np.testing.assert_allclose(none, 0.0, atol=1e-9)


def test_a_size_beyond_its_prior_costs_what_it_was_unlikely(design):
    """And not with the square of it: a strong signal keeps nearly all its evidence."""
    fitted, columns = design
    data = drawn(np.random.default_rng(9), fitted, columns, 25.0 * LARGEST)
    beyond = evidence(fitted, columns, data)
    within = evidence(fitted, columns, data, largest=100.0 * LARGEST)
    assert beyond.size > LARGEST
    assert 0.0 < within.log_bayes_factor - beyond.log_bayes_factor < np.log(100.0) + 1.0
    # The densities of both, over the logarithm of the size, add up to one.
    smallest, largest = beyond.sizes
    at = np.linspace(np.log(smallest), np.log(100.0 * largest), 20_001)
    density = np.exp([beyond.log_density(size) for size in np.exp(at)])
    assert np.trapezoid(density, at) == pytest.approx(1.0, abs=1e-3)
