"""The table's log evidence of sets against brute force: a Gaussian density of all the data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from bayes_inertia.diagnosis.hypothesis_table import (
    FixedMember,
    RandomMember,
    Signal,
    System,
    evidence_of_sets,
    given_fixed,
    given_random,
    log_evidence_with,
    nothing,
)
from bayes_inertia.diagnosis.limits import LIMITS

NUMBERS, SIZES = 30, np.array([0.2, 0.6, 1.5])
WEIGHTS = np.array([0.3, 0.5, 0.2])


@pytest.fixture
def columns():
    """Columns (n, 5): two effects of two and one amplitudes, a random signal of two directions."""
    return np.random.default_rng(1).normal(size=(NUMBERS, 5))


@pytest.fixture
def data(columns):
    """Data (n,) with the first effect in them."""
    rng = np.random.default_rng(2)
    return columns[:, :2] @ [0.9, -0.4] + rng.normal(size=NUMBERS)


def density(data, columns, sd):
    """Log density of the data where amplitudes of columns have these sds."""
    covariance = np.eye(NUMBERS) + (columns * sd**2) @ columns.T
    return multivariate_normal(np.zeros(NUMBERS), covariance).logpdf(data)


def averaged(data, columns, groups):
    """Log evidence against nothing, averaged over one size of each group of columns."""
    values = []
    for picked in np.ndindex(*[len(SIZES)] * len(groups)):
        sd = np.zeros(columns.shape[1])
        for k, group in zip(picked, groups, strict=True):
            sd[group] = SIZES[k]
        values.append(density(data, columns, sd) + np.log(WEIGHTS[list(picked)]).sum())
    return logsumexp(values) - density(data, columns, np.zeros(columns.shape[1]))


@pytest.fixture
def system(columns, data):
    """S and u of the two effects."""
    X = columns[:, :3]
    return System(X.T @ X, X.T @ data)


@pytest.fixture
def members():
    """The two effects."""
    none = np.array([], int)
    return [
        FixedMember("two", np.array([0, 1]), none, SIZES, WEIGHTS),
        FixedMember("one", np.array([2]), none, SIZES, WEIGHTS),
    ]


@pytest.fixture
def signal(columns, data):
    """The random signal, along its own directions."""
    X, Z = columns[:, :3], columns[:, 3:]
    powers, turn = np.linalg.eigh(Z.T @ Z)
    own = Signal(powers, turn, turn.T @ Z.T @ X, turn.T @ Z.T @ data, SIZES, WEIGHTS)
    return RandomMember("random", [own], np.zeros(1))


def test_one_effect(columns, data, system, members):
    found = log_evidence_with(nothing(system), members[1])
    assert found == pytest.approx(averaged(data, columns, [[2]]), abs=1e-9)


def test_directions_share_a_size_or_each_has_its_own(columns, data, system, members):
    X = columns[:, :2] @ np.linalg.eigh(system.matrix[:2, :2])[1]
    of_both = [averaged(data, X, [[0, 1]]), averaged(data, X, [[0], [1]])]
    found = log_evidence_with(nothing(system), members[0])
    assert found == pytest.approx(logsumexp(of_both) - np.log(2.0), abs=1e-9)


def test_pair_beside_random_signal(columns, data, system, members, signal):
    given = given_fixed(given_random(system, signal), members[0])
    found = log_evidence_with(given, members[1])
    assert found == pytest.approx(averaged(data, columns, [[0, 1], [2], [3, 4]]), abs=1e-9)


def test_combinations_of_sizes_that_hardly_count_are_left_out(system, members):
    system = System(40.0 * system.matrix, 40.0 * system.gradient)
    many = np.geomspace(1e-3, 1e3, 200)
    member = replace(members[0], sizes=many, weights=np.full(len(many), 1.0 / len(many)))
    every = given_fixed(nothing(system), member)
    likely = given_fixed(nothing(system), member, likely=True)
    probability = np.exp(every.log_weight - logsumexp(every.log_weight))
    counts = probability > np.exp(-LIMITS.negligible_sizes)
    assert 0 < counts.sum() < len(many)
    for a, b in zip(likely, every, strict=True):
        np.testing.assert_array_equal(a, b[counts])
    few = given_fixed(nothing(system), members[0], likely=True)
    assert len(few.log_weight) == len(SIZES)


def test_gradient_must_be_that_of_the_data(columns, data, system, members):
    """Negative control: another gradient is noticed."""
    wrong = System(system.matrix, -0.5 * system.gradient)
    found = log_evidence_with(nothing(wrong), members[1])
    assert abs(found - averaged(data, columns, [[2]])) > 1e-3


def test_one_sided_effect_is_half_of_a_two_sided_one_on_either_side(columns, data, system, members):
    upward = replace(members[1], one_sided=True)
    downward = System(system.matrix, system.gradient * np.array([1.0, 1.0, -1.0]))
    both = [log_evidence_with(nothing(s), upward) for s in (system, downward)]
    whole = log_evidence_with(nothing(system), members[1])
    assert logsumexp(both) - np.log(2.0) == pytest.approx(whole, abs=1e-9)


def test_an_effect_that_may_act_where_nothing_is_seen(columns, data, system, members):
    """It is as probable there as beforehand, alone and beside what is seen."""
    cost, elsewhere = np.log(1000.0), np.log(0.7)
    hidden = replace(members[1], log_cost=cost, log_elsewhere=elsewhere)
    alone = averaged(data, columns, [[2]]) - cost
    found = log_evidence_with(nothing(system), hidden)
    assert found == pytest.approx(np.logaddexp(alone, elsewhere), abs=1e-9)
    assert log_evidence_with(nothing(system), replace(hidden, log_elsewhere=-np.inf)) < -5.0
    seen = members[0]
    beside = log_evidence_with(given_fixed(nothing(system), seen), hidden)
    assert log_evidence_with(given_fixed(nothing(system), hidden), seen) > beside - 0.5
    assert beside > elsewhere + averaged(data, columns, [[0, 1]]) - 1e-9


def test_true_set_is_the_most_probable_row(system, members, signal):
    found = evidence_of_sets(system, members, [signal])
    assert max(found, key=found.__getitem__) == {"two"}
    assert frozenset(["two", "one"]) in found
    assert frozenset(["two", "random"]) in found


def test_the_fitted_set_is_weighed_however_little_its_parts_explain():
    """Its parts are the worst of all pairs, of which only the best are extended."""
    pull = np.array([9.0, 8.0, 7.0, 6.0, 5.0, 0.0, 0.0, 0.0])
    none = np.array([], int)
    singles = [FixedMember(str(k), np.array([k]), none, SIZES, WEIGHTS) for k in range(len(pull))]
    system, weak = System(np.eye(len(pull)), pull), frozenset(["5", "6", "7"])
    assert weak not in evidence_of_sets(system, singles)
    assert weak in evidence_of_sets(system, singles, fitted=weak)
