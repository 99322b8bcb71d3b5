"""A posterior less its prior: summaries of campaigns multiply."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import stats
from support.told_campaigns import PRIOR_MEAN, PRIOR_SD, TYPICAL_SD, campaign_of

from bayes_inertia.inference.likelihood_summary import (
    p_value_of_same,
    product,
    summary_from_json,
    summary_of,
    with_prior,
)


def test_the_prior_comes_back():
    rng = np.random.default_rng(0)
    told = campaign_of(PRIOR_MEAN, rng)
    mean, covariance = with_prior(told)
    again = summary_of("c", mean, covariance, PRIOR_MEAN, PRIOR_SD)
    np.testing.assert_allclose(again.precision, told.precision, rtol=1e-4, atol=1.0)
    np.testing.assert_allclose(again.mean, told.mean, atol=1e-3 * TYPICAL_SD.min())


def test_a_direction_that_data_leave_open_has_no_precision():
    covariance = np.diag(TYPICAL_SD**2)
    covariance[4, 4] = PRIOR_SD[4] ** 2
    told = summary_of("c", PRIOR_MEAN, covariance, PRIOR_MEAN, PRIOR_SD)
    assert told.precision[4, 4] == 0.0
    assert np.linalg.eigvalsh(told.precision).min() >= -1e-6


def test_campaigns_multiply_as_one_posterior_of_all_data():
    rng = np.random.default_rng(1)
    truth = rng.normal(PRIOR_MEAN, PRIOR_SD)
    told = [campaign_of(truth, rng) for _ in range(3)]
    precision = np.sum([one.precision for one in told], axis=0) + np.diag(PRIOR_SD**-2.0)
    pull = np.sum([one.precision @ one.mean for one in told], axis=0) + PRIOR_MEAN / PRIOR_SD**2
    mean, covariance = with_prior(product(told))
    np.testing.assert_allclose(covariance, np.linalg.inv(precision), rtol=1e-6, atol=1e-14)
    np.testing.assert_allclose(mean, np.linalg.solve(precision, pull), atol=1e-4 * TYPICAL_SD.min())


def test_a_file_holds_a_summary_to_the_bit():
    told = campaign_of(PRIOR_MEAN, np.random.default_rng(2), "third")
    assert summary_from_json(told.json()) == told


def test_p_values_of_one_body_are_uniform_and_of_two_bodies_small():
    """Of campaigns that tell of other directions too: those told once only are no disagreement."""
    rng = np.random.default_rng(9)
    p_values, of_two = [], []
    for _ in range(400):
        told = [campaign_of(PRIOR_MEAN, rng) for _ in range(3)]
        # One campaign is blind to Jzz.
        seen, blind = np.delete(np.arange(9), 2), np.zeros((9, 9))
        covariance = np.linalg.inv(told[0].precision)
        blind[np.ix_(seen, seen)] = np.linalg.inv(covariance[np.ix_(seen, seen)])
        told[0] = replace(told[0], precision=blind)
        p_values.append(p_value_of_same(told))
        told[1] = replace(told[1], mean=told[1].mean + 8.0 * PRIOR_SD * np.eye(9)[0])
        of_two.append(p_value_of_same(told))
    assert stats.kstest(p_values, "uniform").pvalue > 1e-3
    assert stats.kstest(np.sqrt(p_values), "uniform").pvalue < 1e-3
    assert max(of_two) < 1e-6
