"""Sister spacecraft: exact integrals, calibrated shrinkage."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.told_campaigns import PRIOR_MEAN, PRIOR_SD, campaign_of

from bayes_inertia.inference.likelihood_summary import LikelihoodSummary, with_prior
from bayes_inertia.series.fleet import FleetSettings, _Told, fleet_of
from bayes_inertia.series.history import history_of, unit_of

SPREAD = np.repeat([2.4 * 3e-3, 3e-3], [6, 3])
SHORT = FleetSettings(walkers=32, least_draws=150, most_draws=150, burn=100.0 / 150.0)


def flown(crafts: int, seed: int, spread: np.ndarray = SPREAD, n: int = 9):
    rng = np.random.default_rng(seed)
    truth = rng.normal(PRIOR_MEAN, 0.5 * PRIOR_SD) + spread * rng.standard_normal((crafts, 9))
    truth = truth[:, :n]
    return truth, [campaign_of(x, rng, f"craft {k}") for k, x in enumerate(truth)]


@pytest.mark.parametrize("correlation", [None, 0.9 * np.ones((9, 9)) + 0.1 * np.eye(9)])
def test_fleet_and_crafts_are_integrated_exactly(correlation):
    """Against the joint Gaussian of the fleet's mean and three crafts, at two spreads."""
    prior = np.eye(9) if correlation is None else correlation
    _, told = flown(3, 0)
    told = [replace(craft, prior_correlation=correlation) for craft in told]
    first, log_spread = told[0], np.log([np.full(9, 3e-3), np.full(9, 1e-2)])
    result = _Told.by(told).conditional(log_spread)
    parts = [craft.whitened(first) for craft in told]
    data = np.concatenate([y for _, y in parts])
    expected = []
    for spread in np.exp(log_spread) * unit_of(first):
        own = np.kron(np.eye(3), np.diag(spread**2))
        roots = np.zeros((27, 27))
        for k, (R, _) in enumerate(parts):
            roots[9 * k : 9 * k + 9, 9 * k : 9 * k + 9] = R
        covariance = roots @ (own + np.kron(np.ones((3, 3)), prior)) @ roots.T + np.eye(27)
        solved = np.linalg.solve(covariance, data)
        expected.append(-0.5 * (data @ solved + np.linalg.slogdet(covariance)[1]))
        across = np.tile(prior, 3) @ roots.T
        k = len(expected) - 1
        np.testing.assert_allclose(result.center[k], across @ solved, atol=1e-5)
    np.testing.assert_allclose(np.diff(result.log_density), np.diff(expected), rtol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(("crafts", "n"), [(5, 9), (20, 6)])
def test_quoted_sds_of_a_fleet_are_calibrated(crafts, n):
    """z of all crafts: rms within 1 +- 3 / sqrt(2 n), n independent numbers."""
    z = []
    for seed in range(20 // crafts):
        truth, told = flown(crafts, seed, n=n)
        fleet = fleet_of(told, SHORT)
        z.append((fleet.craft_mean - truth) / fleet.craft_sd)
    every = np.concatenate(z).ravel()
    assert abs(np.sqrt(np.mean(every**2)) - 1.0) < 3.0 / np.sqrt(2.0 * len(every))


def test_sisters_make_a_craft_known_better_where_its_own_data_are_poor():
    _, told = flown(20, 3, spread=1e-4 * np.ones(9))
    fleet = fleet_of(told, SHORT)
    alone = np.array([np.sqrt(np.diag(with_prior(craft)[1])) for craft in told])
    assert np.median(alone[:, 3:6] / fleet.craft_sd[:, 3:6]) > 2.0
    # An average over the spread may widen single elements, but no craft as a whole.
    assert np.all(np.median(alone / fleet.craft_sd, axis=1) > 1.0)


def test_a_fleet_of_very_many_spacecraft_is_still_sampled_for_long_enough():
    _, told = flown(3, 6)
    costly = replace(SHORT, spacecraft_times_draws=1)
    assert fleet_of(told, costly) == fleet_of(told, SHORT)


@pytest.mark.slow
@pytest.mark.parametrize("crafts", [3, 10])
def test_two_seeds_agree_within_their_monte_carlo_error(crafts):
    """Of three spacecraft the spread has long tails, which two short chains reach or not."""
    _, told = flown(crafts, 4)
    a, b = (fleet_of(told, FleetSettings(seed=seed)) for seed in (1, 2))
    assert np.max(np.abs(a.craft_mean - b.craft_mean) / a.craft_sd) < 0.2
    assert np.max(np.abs(np.log(a.craft_sd / b.craft_sd))) < 0.15
    assert np.max(np.abs(a.mean - b.mean) / a.sd) < 0.2
    assert np.max(np.abs(np.log(a.sd / b.sd))) < 0.3


def test_a_former_posterior_is_no_prior_of_a_fleet_nor_of_its_sisters_alone():
    _, told = flown(3, 5)
    mean, covariance = with_prior(told[0])
    sd = np.sqrt(np.diag(covariance))
    former = {
        "prior_mean": mean,
        "prior_sd": sd,
        "prior_correlation": covariance / np.outer(sd, sd),
    }
    updated = [replace(told[1], **former), told[2], told[0]]
    plain = [replace(told[1], **_prior_of(told[0])), told[2], told[0]]
    a, b = fleet_of(updated, SHORT), fleet_of(plain, SHORT)
    np.testing.assert_array_equal(a.mean, b.mean)
    np.testing.assert_array_equal(a.alone, b.alone)
    np.testing.assert_allclose(history_of(updated).alone, history_of(plain).alone)
    # Not counted as its own, a former posterior makes a spacecraft no better known.
    assert np.all(a.alone_sd[0] > np.sqrt(np.diag(with_prior(updated[0])[1])))


def _prior_of(summary: LikelihoodSummary) -> dict[str, np.ndarray]:
    return {"prior_mean": summary.prior_mean, "prior_sd": summary.prior_sd}
