"""Uniform ranks stay inside their band as often as it says; others leave it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from bayes_inertia.studies.calibration import QUANTITIES, Calibration, calibration_of, cases_named
from bayes_inertia.studies.limits import LIMITS as STUDIES_LIMITS
from bayes_inertia.studies.rank_statistics import (
    Ranks,
    ecdf_band,
    probability_inside,
)
from bayes_inertia.studies.work import WorkResult


def normal_ranks(n: int, seed: int, sd: float = 1.0, shift: float = 0.0) -> np.ndarray:
    """Ranks of n standard normal truths among draws of a normal posterior of this sd."""
    rng = np.random.default_rng(seed)
    truth = rng.standard_normal((n, 1))
    draws = shift + sd * rng.standard_normal((n, STUDIES_LIMITS.ranked_draws))
    # Truth and draws come from one posterior: both around the same mean.
    return (draws < truth).sum(1)


@pytest.mark.parametrize(("n", "ranked", "width"), [(40, 19, 2.0), (40, 99, 2.5), (300, 9, 1.5)])
def test_the_probability_of_the_band_is_exact(n, ranked, width):
    trials = 3000
    ranks = np.random.default_rng(3).integers(0, ranked + 1, (trials, n))
    inside = np.mean([np.abs(Ranks(r, ranked).departure).max() <= width + 1e-9 for r in ranks])
    exact = probability_inside(n, ranked, width)
    assert abs(inside - exact) < 4.0 * np.sqrt(exact * (1.0 - exact) / trials)
    assert abs(inside - probability_inside(n, ranked, 0.8 * width)) > 0.05


def test_the_band_holds_what_it_says():
    # Counts are whole numbers: the probability jumps.
    for level in (0.9, 0.99):
        width = ecdf_band(100, STUDIES_LIMITS.ranked_draws, level)
        assert probability_inside(100, STUDIES_LIMITS.ranked_draws, width + 0.01) >= level
        assert probability_inside(100, STUDIES_LIMITS.ranked_draws, width - 0.01) <= level


@pytest.mark.slow
def test_uniform_ranks_are_rejected_as_rarely_as_the_p_value_says():
    trials = 200
    p = np.array(
        [
            Ranks(normal_ranks(60, seed), STUDIES_LIMITS.ranked_draws).p_value
            for seed in range(trials)
        ]
    )
    for level in (0.05, 0.3):
        assert np.sum(p < level) <= stats.binom.ppf(0.999, trials, level)
    assert np.median(p) < 0.7


@pytest.mark.slow
def test_wrong_sds_and_shifts_are_rejected():
    for seed in range(5):
        assert Ranks(normal_ranks(1000, seed, sd=0.75), STUDIES_LIMITS.ranked_draws).p_value < 1e-6
        assert Ranks(normal_ranks(400, seed, shift=0.5), STUDIES_LIMITS.ranked_draws).p_value < 1e-6
    # Uniform ranks of as many fits, five times.
    assert (
        min(
            Ranks(normal_ranks(1000, seed), STUDIES_LIMITS.ranked_draws).p_value
            for seed in range(5)
        )
        > 1e-4
    )


def test_coverage_counts_ranks():
    ranks = normal_ranks(2000, 5)
    for level in (0.5, 0.9, 0.95):
        coverage = Ranks(ranks, STUDIES_LIMITS.ranked_draws).coverage(level)
        assert coverage.low < coverage.share < coverage.high
        error = np.sqrt(level * (1.0 - level) / 2000)
        assert abs(coverage.share - level) < 4.0 * error
    small = Ranks(normal_ranks(2000, 5, sd=0.75), STUDIES_LIMITS.ranked_draws).coverage(0.9)
    assert small.high < 0.9


def made(n: int, seed: int, sd: float = 1.0) -> Calibration:
    """A calibration whose posteriors are normal, of sds that are right or not."""
    ranks = np.stack([normal_ranks(n, 100 * seed + k, sd) for k in range(len(QUANTITIES))], 1)
    rows = [
        {
            "task": f"five-slews/{i}",
            "rank": r.tolist(),
            "truth": [0.0] * len(QUANTITIES),
            "mean": [0.1] * len(QUANTITIES),
            "sd": [1.0] * len(QUANTITIES),
            "explained": True,
            "nested_rhat": 1.0,
        }
        for i, r in enumerate(ranks)
    ]
    return calibration_of(cases_named(["five-slews"]), WorkResult(tuple(rows)))


@pytest.mark.slow
def test_a_right_pipeline_is_rarely_rejected_and_a_wrong_one_always():
    trials = 40
    alarms = sum(bool(made(100, seed).rejected) for seed in range(trials))
    assert alarms <= stats.binom.ppf(0.999, trials, 0.01)
    assert all(made(300, seed, sd=0.75).rejected for seed in range(3))
