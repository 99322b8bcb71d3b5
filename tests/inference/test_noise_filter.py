"""Correlated noise is filtered out exactly: the likelihood is that of its full covariance."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np
import pytest

from bayes_inertia.campaign.hardware import CorrelatedNoise
from bayes_inertia.inference import optimizer
from bayes_inertia.inference.laplace import plain_series
from bayes_inertia.inference.linearised_fit import channel_rows
from bayes_inertia.inference.noise_model import (
    correlated_noise,
    innovations,
    noise_memory,
    wandering_noise,
)
from bayes_inertia.physics.effects import RateBiasInstability, RateRandomWalk
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.random_basis import hat_functions, slew_fraction

SIGMA = 2e-5
WALK, BIAS, TIME = 3e-6, 1.6e-5, 20.0
MEASURED = CorrelatedNoise((0.4, 0.7, 1.0), (2.0, 60.0, 2.0))
STATED = {"rate_random_walk": WALK, "bias_instability": BIAS, "bias_instability_time": TIME}
WALK_ONLY = {"rate_random_walk": WALK}
BIAS_ONLY = {"bias_instability": BIAS, "bias_instability_time": TIME}


def with_noise(campaign, colour=None, **stated):
    sensor = replace(campaign.rate_sensor, correlated_noise=colour, **stated)
    return replace(campaign, rate_sensor=sensor)


def with_gaps(campaign):
    """Some readings are missing."""
    slews = []
    for slew in campaign.slews:
        rate = np.array(slew.rate)
        rate[[20, 21, 50]] = np.nan
        slews.append(replace(slew, rate=rate))
    return replace(campaign, slews=tuple(slews))


def test_what_a_slews_own_clock_says_does_not_count(flown):
    campaign = with_noise(flown.campaign, **WALK_ONLY)
    slews = tuple(replace(slew, time=slew.time + 5e5) for slew in campaign.slews)
    one, other = (rate_memory(Model(x)) for x in (campaign, replace(campaign, slews=slews)))
    np.testing.assert_allclose(other.gain, one.gain, atol=1e-9)
    np.testing.assert_allclose(other.scale, one.scale, rtol=1e-9)


def rate_memory(model, theta=None, **asked):
    """The filter for the noise of the rates."""
    theta = model.space.mean if theta is None else theta
    return noise_memory(model, model.channels[0], theta, **asked)


def covariance(campaign, slew, at, axis):
    """Of one axis' noise at these times, in units of one reading's variance."""
    sensor = campaign.rate_sensor
    variance = sensor.sigma[axis] ** 2
    apart = np.abs(at[:, None] - at)
    total = np.eye(len(at))
    if sensor.correlated_noise is not None:
        share, time = sensor.correlated_noise.share[axis], sensor.correlated_noise.time[axis]
        total = (1.0 - share) * total + share * np.exp(-apart / time)
    if sensor.bias_instability is not None:
        wander = np.exp(-apart / sensor.bias_instability_time)
        total += sensor.bias_instability**2 / variance * wander
    if sensor.rate_random_walk is not None:
        start, length = slew.time[0], slew.time[-1] - slew.time[0]
        ends = [(s.start + s.time[0], s.start + s.time[-1]) for s in campaign.slews]
        middle = 0.5 * (min(ends)[0] + max(e for _, e in ends))
        before = abs(slew.start + start - middle) + length
        walked = np.minimum(at[:, None], at) - start
        total += sensor.rate_random_walk**2 / variance * (before + walked)
    return total


@pytest.mark.parametrize(
    ("colour", "stated"),
    [
        (CorrelatedNoise(1.0, 2.0), {}),
        (MEASURED, {}),
        (None, WALK_ONLY),
        (None, BIAS_ONLY),
        (None, STATED),
        (MEASURED, STATED),
    ],
)
def test_innovations_give_the_likelihood_of_the_full_covariance(flown, colour, stated):
    """r^T C^-1 r and log |C|, missing readings included."""
    campaign = with_noise(with_gaps(flown.campaign), colour, **stated)
    model = Model(campaign)
    memory = rate_memory(model)
    valid = channel_rows(model)["rate"].valid
    z = np.random.default_rng(7).normal(size=valid.shape) * valid
    new = np.asarray(innovations(z, memory))
    for s, slew in enumerate(campaign.slews):
        for axis in range(3):
            rows = np.flatnonzero(valid[s, :, axis])
            C = covariance(campaign, slew, campaign.slews[s].time[rows], axis)
            x = z[s, rows, axis]
            chi2 = x @ np.linalg.solve(C, x)
            assert np.sum(new[s, :, axis] ** 2) == pytest.approx(chi2, rel=1e-8)
            norm = -2.0 * np.log(memory.scale[s, :, axis]).sum()
            assert norm == pytest.approx(np.linalg.slogdet(C)[1], rel=1e-8, abs=1e-8)
    noise = correlated_noise(new, memory)
    assert np.allclose(noise[valid], z[valid], atol=1e-9)


def test_white_noise_needs_no_filter(flown):
    assert rate_memory(Model(flown.campaign)) is None


@pytest.mark.parametrize("effect", [RateRandomWalk(knots=4), RateBiasInstability(knots=5)])
def test_what_an_effect_estimates_is_not_filtered_out_as_well(flown, effect):
    campaign = with_noise(flown.campaign, **STATED)
    model = Model(campaign, (effect,))
    for asked, sources in ((Model(campaign), ["stated"] * 2), (model, ["stated", effect.name])):
        noise = wandering_noise(asked, asked.channels[0], asked.space.mean)
        assert [each.source for each in noise.processes] == sources
        assert rate_memory(asked).gain.shape[-1] == 2


def noise_covariance(memory, slew, axis):
    """Of one axis' noise in one slew, as the filter has it."""
    shape = np.asarray(memory.scale).shape
    units = np.zeros((shape[1], *shape))
    units[np.arange(shape[1]), slew, np.arange(shape[1]), axis] = 1.0
    columns = correlated_noise(units, memory)[:, slew, :, axis]
    return columns.T @ columns


@pytest.mark.parametrize(
    ("effect", "values", "tolerance"),
    [
        (RateRandomWalk(knots=9), {"density": WALK}, 1e-9),
        # A bridge of a Gauss-Markov process is not quite Brownian.
        (RateBiasInstability(knots=9), {"sd": BIAS, "time": 40.0}, 0.03),
        (RateBiasInstability(knots=33), {"sd": BIAS, "time": 10.0}, 0.03),
    ],
)
def test_knots_and_what_is_left_between_them_are_the_whole_process(
    flown, effect, values, tolerance
):
    """Covariances of straight lines between knots, of the bridges, and of the whole add up."""
    model = Model(flown.campaign, (effect,))
    theta = np.concatenate([model.space.mean[: model.n_base], list(values.values())])
    whole, between = (rate_memory(model, theta, whole=whole) for whole in (True, False))
    slew, axis = 1, 0
    rows = len(flown.campaign.slews[slew].time)
    context = jax.tree.map(lambda x: x[slew], model.data.arrays.slews.context)
    root = np.asarray(effect.coefficient_root(values, context, 3 * effect.knots))[axis]
    fraction = slew_fraction(context, np.asarray(flown.campaign.slews[slew].time))
    lines = np.asarray(hat_functions(fraction, effect.knots)) @ root / SIGMA
    total, left = (noise_covariance(m, slew, axis)[:rows, :rows] for m in (whole, between))
    process = total - np.eye(rows)
    # Without the bridges a good part of the variance is missing.
    without = lines @ lines.T
    missing = np.abs(np.diag(process - without)).max()
    assert missing > 2.0 * tolerance * process.max()
    added = without + left - np.eye(rows)
    np.testing.assert_allclose(np.diag(added), np.diag(process), rtol=1e-9)
    np.testing.assert_allclose(added, process, atol=tolerance * process.max())


def wandering(campaign, seed):
    """The campaign with the noise of STATED in its readings."""
    rng, slews = np.random.default_rng(seed), []
    for slew in campaign.slews:
        step = float(slew.time[1] - slew.time[0])
        walk = WALK * np.sqrt(step) * rng.normal(size=slew.rate.shape).cumsum(0)
        bias, kept = np.empty_like(walk), np.exp(-step / TIME)
        bias[0] = BIAS * rng.normal(size=3)
        for row in range(1, len(bias)):
            bias[row] = kept * bias[row - 1] + BIAS * np.sqrt(1 - kept**2) * rng.normal(size=3)
        slews.append(replace(slew, rate=slew.rate + walk + bias))
    return replace(campaign, slews=tuple(slews))


@pytest.fixture(scope="module")
def walked(flown):
    return wandering(flown.campaign, 11)


def test_noise_that_wanders_as_stated_leaves_white_residuals(walked):
    estimate = optimizer.estimate(Model(with_noise(walked, **STATED)), discount=False)
    tests = estimate.tests
    assert not any(test.rejected for test in tests.values())
    believed = optimizer.estimate(Model(walked), discount=False)
    assert believed.tests["rate"].p_white < 1e-12


def test_stated_wandering_is_not_measured_a_second_time(walked):
    """What looks for correlated noise sees residuals without what is stated."""
    stated = optimizer.estimate(Model(with_noise(walked, **STATED)), discount=False)
    seen = np.concatenate(plain_series(stated)["rate"])
    as_white = optimizer.estimate(Model(walked), discount=False)
    unseen = np.concatenate(plain_series(as_white)["rate"])
    neighbours = [np.nanmean(x[1:] * x[:-1]) / np.nanmean(x**2) for x in (seen, unseen)]
    assert abs(neighbours[0]) < 4.0 / np.sqrt(seen.size)
    assert neighbours[1] > 0.2
