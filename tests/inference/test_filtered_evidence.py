"""Evidence for processes that are filtered out is the density of the data, nothing left out."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_inertia.errors import EstimateError
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.hyperparameters import Evidence, curvature_of, most_probable
from bayes_inertia.inference.noise_model import estimated_noise, whitening
from bayes_inertia.inference.objective import prior_rows
from bayes_inertia.inference.proposal import explored_sizes
from bayes_inertia.physics.effects import (
    RateBiasInstability,
    RateRandomWalk,
    TachometerNoiseWalk,
)
from bayes_inertia.physics.forward_model import Model

SD, TIME = 6e-5, 15.0


def wandering(campaign, seed):
    """The campaign with a Gauss-Markov bias of three sigmas in each slew."""
    rng, slews = np.random.default_rng(seed), []
    for slew in campaign.slews:
        kept = np.exp(-np.diff(slew.time)[:, None] / TIME)
        bias = SD * rng.normal(size=slew.rate.shape)
        for row in range(1, len(bias)):
            fresh = np.sqrt(1.0 - kept[row - 1] ** 2) * bias[row]
            bias[row] = kept[row - 1] * bias[row - 1] + fresh
        slews.append(replace(slew, rate=slew.rate + bias))
    return replace(campaign, slews=tuple(slews))


@pytest.fixture(scope="module")
def plain(flown):
    """A fit that knows nothing of the bias that wanders."""
    return optimizer.estimate(Model(wandering(flown.campaign, 3)), discount=False)


def evidence_at(estimate, *effects):
    """Of effects at the point of a fit without them; some of their coefficients are not zero."""
    widened = optimizer.move_to(estimate, Model(estimate.model.campaign, effects))
    local = np.array(widened.point.local)
    local[:, estimate.point.n_local :: 7] = 0.3
    every, point = np.arange(len(widened.theta)), replace(widened.point, local=local)
    evidence = Evidence(widened.model, point, widened.white, every, whole=True)
    theta = evidence.theta(np.zeros(len(evidence.hyperparameters)))
    return replace(evidence, point=replace(point, theta=theta))


def dense_log_density(estimate, noise):
    """Of all readings at once, J, K, bias and starts integrated out as the covariance they make."""
    model, fit = estimate.model, estimate.linearised()
    slope, distance = prior_rows(model, estimate.theta)
    off = np.concatenate([distance / slope, estimate.point.bias])
    sds = np.concatenate([1.0 / slope, np.ones(3)])
    slews, numbers = fit.residual.shape
    residual = np.empty((slews, numbers))
    covariance = np.zeros((slews, numbers, slews, numbers))
    shared = fit.shared * sds
    for s in range(slews):
        residual[s] = fit.residual[s] - fit.shared[s] @ off - fit.local[s] @ estimate.point.local[s]
        covariance[s, :, s] = np.eye(numbers) + fit.local[s] @ fit.local[s].T
        for t in range(slews):
            covariance[s, :, t] += shared[s] @ shared[t].T
    sigma = {
        "rate": model.campaign.rate_sensor.sigma,
        "momentum": [wheel.momentum_sigma for wheel in model.campaign.wheels],
    }
    for process in noise:
        channel = fit.channels[process.channel]
        power = (process.size / np.array(sigma[process.channel])) ** 2
        for s, slew in enumerate(model.campaign.slews):
            own = np.kron(covariance_of(process, model.campaign, slew, channel.time[s]), np.eye(3))
            covariance[s, channel.part, s, channel.part] += own * np.tile(
                power, len(channel.time[s])
            )
    valid = fit.valid.ravel()
    covariance = covariance.reshape(len(valid), -1)[np.ix_(valid, valid)]
    x = residual.ravel()[valid]
    return -0.5 * (x @ np.linalg.solve(covariance, x) + np.linalg.slogdet(covariance)[1])


def covariance_of(process, campaign, slew, at):
    """Of a process of unit size at times of one slew."""
    if np.isfinite(process.time):
        return np.exp(-np.abs(np.subtract.outer(at, at)) / process.time)
    ends = [(s.start + s.time[0], s.start + s.time[-1]) for s in campaign.slews]
    middle = 0.5 * (min(ends)[0] + max(e for _, e in ends))
    begin, length = slew.time[0], slew.time[-1] - slew.time[0]
    return abs(slew.start + begin - middle) + length + np.minimum.outer(at, at) - begin


@pytest.mark.long
@pytest.mark.slow
def test_the_evidence_is_the_density_of_all_readings(plain):
    """Differences between sizes and times: constants fall out. Tachometers may walk as well."""
    evidence = evidence_at(plain, RateRandomWalk(), RateBiasInstability(), TachometerNoiseWalk())
    found, dense = [], []
    for x in np.array([[-1.0, 0.0, 0.0, -1.0], [0.0, 1.0, -1.0, -1.0], [1.0, -1.0, 0.5, 0.0]]):
        processes = [each.process for each in estimated_noise(evidence.model, evidence.theta(x))]
        dense.append(dense_log_density(plain, processes))
        found.append(0.5 * x @ x - evidence.negative_log(x)[0])
    np.testing.assert_allclose(np.diff(found), np.diff(dense), rtol=0.0, atol=0.01)
    assert np.abs(np.diff(dense)).min() > 20.0


@pytest.mark.slow
def test_the_slope_of_the_evidence_is_that_of_its_values(plain):
    evidence, x, step = evidence_at(plain, RateBiasInstability()), np.array([0.3, -0.2]), 1e-4
    slope = evidence.negative_log(x)[1]
    for i, unit in enumerate(step * np.eye(2)):
        up, down = (evidence.negative_log(x + side * unit)[0] for side in (1.0, -1.0))
        assert slope[i] == pytest.approx((up - down) / (2.0 * step), rel=1e-5)


@pytest.mark.slow
def test_the_peak_is_where_nothing_around_is_higher_and_near_the_truth(plain):
    evidence = evidence_at(plain, RateBiasInstability())
    point, _ = most_probable(evidence)
    x = evidence.standardised(point.theta)
    lowest, slope = evidence.negative_log(x)
    assert np.abs(slope).max() < 0.05
    for step in 0.05 * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]):
        assert evidence.negative_log(x + step)[0] > lowest
    assert point.theta[-2:] == pytest.approx([SD, TIME], rel=0.35)


@pytest.mark.long
@pytest.mark.slow
def test_tachometers_that_walk_are_filtered_as_rates_are(plain):
    """Their size is learnt from all of the walk, and what it does between knots is filtered."""
    evidence = evidence_at(plain, TachometerNoiseWalk(knots=5))
    assert list(evidence.frozen.filtered) == ["momentum"]
    memories = [each.memory for each in whitening(evidence.model, evidence.point.theta)]
    assert [memory is None for memory in memories] == [True, True, False]


@pytest.mark.long
@pytest.mark.slow
def test_a_fit_learns_the_size_from_the_whole_process(plain):
    """With few knots most of the process is between them."""
    few, many = (
        optimizer.estimate(Model(plain.model.campaign, (RateBiasInstability(knots=k),)))
        for k in (9, 17)
    )
    for estimate in (few, many):
        assert not estimate.tests["rate"].rejected
        assert estimate.theta[-2:] == pytest.approx([SD, TIME], rel=0.35)
    np.testing.assert_allclose(few.theta[-2:], many.theta[-2:], rtol=0.02)
    # J and K, too, do not depend on how many knots there are.
    assert np.abs((few.theta[:9] - many.theta[:9]) / many.sd[:9]).max() < 0.3


@pytest.mark.parametrize("wrong", [np.nan, -np.inf])
def test_sizes_whose_evidence_is_not_finite_are_refused_in_words(wrong):
    def given(sizes):
        return SimpleNamespace(log_evidence=np.where(sizes[:, 0] > 0.0, wrong, 0.0))

    space = SimpleNamespace(names=("torque_remainder.sd", "torque_remainder.time"))
    evidence = SimpleNamespace(
        model=SimpleNamespace(space=space),
        point=SimpleNamespace(theta=np.zeros(2)),
        hyperparameters=np.arange(2),
        free=np.arange(2),
        standardised=lambda theta: theta,
        given=given,
    )
    with pytest.raises(EstimateError, match=r"torque_remainder\.sd.*more than a disturbance"):
        curvature_of(evidence)


def test_sizes_are_explored_as_wide_as_their_evidence_is():
    """However narrow it is beside the prior: 64 walkers tell each spread to 9 %."""
    sds = np.array([0.02, 0.02, 0.1, 0.1])

    def given(sizes):
        return SimpleNamespace(log_evidence=-0.5 * np.sum((np.asarray(sizes) / sds) ** 2, 1))

    evidence = SimpleNamespace(
        point=SimpleNamespace(theta=np.zeros(4)),
        hyperparameters=np.arange(4),
        free=np.arange(4),
        standardised=lambda theta: theta,
        given=given,
    )
    explored = explored_sizes(evidence, np.random.RandomState(4)).explored.dataset
    assert explored.std(1) / sds == pytest.approx(1.0, abs=4.0 * 0.09)
