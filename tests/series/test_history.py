"""J and K over campaigns: exact evidence, jumps dated and sized, none invented."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from bayes_inertia.errors import CampaignError
from bayes_inertia.inference.likelihood_summary import LikelihoodSummary, product, with_prior
from bayes_inertia.series.history import (
    ChangeHypothesis,
    Changes,
    History,
    Jump,
    history_of,
    log_evidence,
    log_prior,
    smoothed,
    unit_of,
    weigh_changes,
)

TOLD = 0.95


def certain(history: History) -> list[tuple[int, str]]:
    return [(jump.after, jump.part) for jump in history.jumps if jump.probability > TOLD]


def dense_log_evidence(series, hypothesis: ChangeHypothesis) -> float:
    """The evidence from the joint Gaussian of all data, in place of a filter."""
    first, m = series[0], len(series)
    n, unit = first.mean.size, unit_of(first)
    grown = np.cumsum(
        [np.ones(n), *(hypothesis.step_variance(k, n) * unit**2 for k in range(m - 1))], axis=0
    )
    before = first.prior_matrix - np.eye(n)
    prior = np.block([[np.diag(grown[min(k, j)]) + before for j in range(m)] for k in range(m)])
    parts = [campaign.whitened(first) for campaign in series]
    root = block_diag(*(R for R, _ in parts))
    data = np.concatenate([y for _, y in parts])
    covariance = root @ prior @ root.T + np.eye(n * m)
    return -0.5 * (np.linalg.slogdet(covariance)[1] + data @ np.linalg.solve(covariance, data))


HYPOTHESES = (
    ChangeHypothesis(),
    ChangeHypothesis(walk_J=1e-3),
    ChangeHypothesis(walk_K=1e-4, jumps=(Jump(1, "J", 3e-3), Jump(3, "K", 1e-3))),
)


@pytest.mark.parametrize("n", [9, 6, 7])
@pytest.mark.parametrize("hypothesis", HYPOTHESES)
def test_evidence_of_the_filter_is_that_of_the_joint_gaussian(series, hypothesis, n):
    told = series(1, jump=(1, 0, 0.01), campaigns=5, n=n)
    exact = dense_log_evidence(told, hypothesis)
    assert log_evidence(told, [*HYPOTHESES, hypothesis])[-1] == pytest.approx(exact, rel=1e-7)


def after_a_former_run(told: list[LikelihoodSummary]) -> list[LikelihoodSummary]:
    """Campaigns of which each had what was known before as its prior."""
    correlation = 0.9 * np.ones((9, 9)) + 0.1 * np.eye(9)
    known = [replace(told[0], prior_correlation=correlation)]
    for campaign in told[1:]:
        mean, covariance = with_prior(known[-1])
        sd = np.sqrt(np.diag(covariance))
        prior = replace(known[-1], prior_mean=mean, prior_sd=sd)
        prior = replace(prior, prior_correlation=covariance / np.outer(sd, sd))
        known.append(campaign.with_prior_of(prior))
    return known


def test_correlations_of_the_first_prior_count_and_those_of_later_ones_do_not(series):
    told = after_a_former_run(series(4, campaigns=4))
    for hypothesis in HYPOTHESES[:2]:
        exact = dense_log_evidence(told, hypothesis)
        assert log_evidence(told, [hypothesis])[0] == pytest.approx(exact, rel=1e-7)
    history = history_of(told)
    mean, covariance = with_prior(replace(told[0], mean=told[3].mean, precision=told[3].precision))
    np.testing.assert_allclose(history.alone[3], mean)
    np.testing.assert_allclose(history.alone_sd[3], np.sqrt(np.diag(covariance)))


@pytest.mark.parametrize("known", [list, after_a_former_run])
def test_a_constant_series_is_known_as_all_campaigns_together(series, known):
    told = known(series(2))
    mean, covariance = with_prior(product(told))
    at, joint = smoothed(told, ChangeHypothesis())
    np.testing.assert_allclose(
        at, np.tile(mean, (len(told), 1)), atol=1e-6 * np.sqrt(covariance.max())
    )
    np.testing.assert_allclose(joint[:9, :9], covariance, rtol=1e-4, atol=1e-12)


def test_log_prior_of_all_hypotheses_of_two_campaigns_sums_to_one():
    changes = Changes(walks=(1e-3, 1e-2), jumps=(1e-2,), most_jumps=2)
    jumps = [
        (),
        (Jump(0, "J", 1e-2),),
        (Jump(0, "K", 1e-2),),
        (Jump(0, "J", 1e-2), Jump(0, "K", 1e-2)),
    ]
    every = [
        ChangeHypothesis(J, K, some)
        for J in (0.0, 1e-3, 1e-2)
        for K in (0.0, 1e-3, 1e-2)
        for some in jumps
    ]
    total = sum(np.exp(log_prior(hypothesis, 2, changes)) for hypothesis in every)
    assert total == pytest.approx(1.0)


def test_best_first_search_finds_what_enumeration_finds(series):
    told = series(3, jump=(1, 2, 0.002), campaigns=3)
    changes = Changes(walks=(1e-4, 1e-3), jumps=(1e-3, 1e-2), most_jumps=1)
    found = weigh_changes(told, changes)
    options = [(), *((Jump(k, part, sd),) for k in (0, 1) for part in "JK" for sd in (1e-3, 1e-2))]
    every = [
        ChangeHypothesis(J, K, some)
        for J in (0.0, 1e-4, 1e-3)
        for K in (0.0, 1e-4, 1e-3)
        for some in options
    ]
    weights = log_evidence(told, every) + [log_prior(h, 3, changes) for h in every]
    probability = np.exp(weights - np.logaddexp.reduce(weights))
    assert found.hypotheses[0] == every[int(np.argmax(probability))]
    assert found.probability[0] == pytest.approx(probability.max(), abs=0.01)


@pytest.mark.slow
def test_a_jump_of_one_per_cent_is_dated_and_sized(series):
    """Of fifteen series, with three K, none or two, none is missed; `analyses` has a hundred."""
    dated, off = 0, []
    for seed in range(15):
        after, element = seed % 5, seed // 5
        history = history_of(series(seed, jump=(after, element, 0.01), n=(9, 6, 8)[seed % 3]))
        dated += certain(history) == [(after, "J")]
        jump = history.jumps[0]
        truth = 0.01 * history.mean[0, element]
        off.append((jump.size[element] - truth) / jump.sd[element])
    assert dated == 15
    # Fifteen z-scores: rms within 3 of its own sds, 1 / sqrt(30).
    assert np.sqrt(np.mean(np.square(off))) < 1.0 + 3.0 / np.sqrt(30.0)


def test_without_a_rate_sensor_only_J_may_change(series):
    told = series(1, n=6)
    history = history_of(told)
    assert set(history.wanders) == {jump.part for jump in history.jumps} == {"J"}
    assert np.exp(log_prior(ChangeHypothesis(), 2, Changes(), ("J",))) == pytest.approx(0.5 * 0.98)


def test_campaigns_with_other_parameters_are_refused(series):
    told = [*series(1, campaigns=2), *series(2, campaigns=2, n=6)]
    with pytest.raises(CampaignError, match="campaign 1: Jxx to K3; campaign 1: Jxx to Jyz"):
        history_of(told)


def test_no_jump_is_invented_in_constant_series(series):
    assert [certain(history_of(series(seed))) for seed in range(15)] == [[]] * 15


@pytest.mark.slow
def test_sds_that_are_four_times_too_small_invent_changes(series):
    """The negative control: the test above can fail."""
    histories = [history_of(series(seed, narrower=4.0)) for seed in range(10)]
    assert any(certain(h) or max(h.wanders.values()) > TOLD for h in histories)


def test_a_random_walk_is_one_and_no_row_of_jumps(series):
    history = history_of(series(5, walk=2e-3, campaigns=8))
    assert history.wanders["J"] > TOLD
    assert len(certain(history)) <= 1


@pytest.mark.slow
def test_coverage_of_J_and_K_over_series_that_may_change(series):
    """z of the last campaign's J and K: rms of 9 x 12 correlated numbers."""
    z = []
    for seed in range(12):
        told = series(seed, jump=(2, 1, 0.003) if seed % 2 else None)
        rng = np.random.default_rng(seed)
        truth = rng.normal([3.2, 2.2, 1.9, 0, 0, 0, 1, 1, 1], 0.5 * told[0].prior_sd)
        if seed % 2:
            truth[1] *= 1.003
        history = history_of(told)
        z.append((history.mean[-1] - truth) / history.sd[-1])
    rms = np.sqrt(np.mean(np.square(z)))
    # As if a third of them were independent: three sds of an rms are 3 / sqrt(2 n).
    assert abs(rms - 1.0) < 3.0 / np.sqrt(2.0 * 36)
