"""Evidence for processes that are filtered out is the density of the data, nothing left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayes_inertia.inference import optimizer
from bayes_inertia.inference.filtered_evidence import (
    FilteredEvidence,
    evidence_peak,
    noise_level_used,
)
from bayes_inertia.inference.objective import prior_rows
from bayes_inertia.physics.effects import RateBiasInstability
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.processes import Process

SD, TIME = 6e-5, 15.0
NONE, WALK, BIAS = (), (Process("rate", 4e-6),), (Process("rate", SD, TIME),)


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


def evidence_at(estimate):
    model, point, white = estimate.model, estimate.point, estimate.white
    level = noise_level_used(model, point, white)
    nothing = np.zeros(point.n_local, bool)
    return FilteredEvidence(model, point, white, estimate.free, level, nothing)


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
    channel = fit.channels["rate"]
    rows = channel.valid[0].size
    for s, slew in enumerate(model.campaign.slews):
        for process in noise:
            power = (process.size / np.array(model.campaign.rate_sensor.sigma)) ** 2
            own = np.kron(covariance_of(process, model.campaign, slew, channel.time[s]), np.eye(3))
            covariance[s, :rows, s, :rows] += own * np.tile(power, len(channel.time[s]))
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


def test_the_evidence_is_the_density_of_all_readings(plain):
    """Differences between sets of processes: constants fall out."""
    settings = [NONE, WALK, BIAS]
    dense = np.array([dense_log_density(plain, noise) for noise in settings])
    evidence = evidence_at(plain)
    found = [evidence.log_evidence([noise])[0] for noise in settings]
    np.testing.assert_allclose(np.diff(found), np.diff(dense), rtol=0.0, atol=0.01)
    assert dense[2] > dense[1] + 20.0 > dense[0]


def test_a_set_among_others_has_the_same_evidence(plain):
    sizes = np.geomspace(1e-5, 1e-4, 11)
    evidence = evidence_at(plain)
    settings = [(Process("rate", size, TIME),) for size in sizes]
    alone = [evidence.log_evidence([setting])[0] for setting in settings]
    np.testing.assert_allclose(evidence.log_evidence(settings), alone, rtol=1e-12)


def test_the_peak_is_where_nothing_around_is_higher_and_near_the_truth(plain):
    evidence = evidence_at(plain)

    def processes(x):
        return (Process("rate", SD * np.exp(x[0]), TIME * np.exp(x[1])),)

    flat = np.zeros(2)
    peak = evidence_peak(evidence, processes, np.array([1.0, -1.0]), flat)
    steps = 0.05 * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    around = evidence.log_evidence([processes(peak.at + step) for step in steps])
    assert np.all(around < peak.log_evidence)
    # The truth is at zero: within four sds, as the curvature has them.
    assert peak.at @ peak.curvature @ peak.at < 16.0


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
