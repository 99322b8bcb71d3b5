"""The Allan-type fit finds the noise that is there, and none that is not."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_inertia.faults.noise import fit_noise, rounding_sigmas

RUNS = 40
SAMPLES = 1500


def fits(make) -> list:
    generators = [np.random.default_rng(child) for child in np.random.SeedSequence(5).spawn(RUNS)]
    return [fit_noise([make(rng)]) for rng in generators]


def test_white_noise_is_seen_with_its_error_and_nothing_else():
    found = fits(lambda rng: rng.normal(0.0, 3.0, SAMPLES))
    errors = np.array([np.log(fit.white / 3.0) / fit.white_error for fit in found])
    # Mean 0, and a spread that the stated error does not understate; 4 standard errors.
    assert abs(errors.mean()) < 4.0 / np.sqrt(RUNS)
    assert errors.std() < 1.0 + 4.0 / np.sqrt(2.0 * RUNS)
    assert sum(fit.random_walk > 0.0 for fit in found) <= 3
    assert sum(fit.flicker > 0.0 for fit in found) <= 3
    assert not any(fit.quantisation for fit in found)


def test_a_random_walk_is_distinguished_from_white_noise():
    def walk(rng):
        return rng.normal(0.0, 1.0, SAMPLES) + np.cumsum(rng.normal(0.0, 0.2, SAMPLES))

    found = fits(walk)
    white = np.array([fit.white for fit in found])
    steps = np.array([fit.random_walk for fit in found])
    assert white.mean() == pytest.approx(1.0, abs=4.0 * white.std() / np.sqrt(RUNS) + 0.01)
    assert steps.mean() == pytest.approx(0.2, abs=4.0 * steps.std() / np.sqrt(RUNS) + 0.01)
    assert (steps > 0.0).all()


def test_a_steady_drift_is_no_noise():
    drift = 0.01 * np.arange(SAMPLES)
    found = fits(lambda rng: drift + rng.normal(0.0, 1.0, SAMPLES))
    still = fits(lambda rng: rng.normal(0.0, 1.0, SAMPLES))
    for fit, other in zip(found, still, strict=True):
        assert fit.white == pytest.approx(other.white, rel=1e-6)


def test_the_step_of_a_converter_is_seen():
    found = fits(lambda rng: 0.5 * np.round(rng.normal(0.0, 2.0, SAMPLES) / 0.5))
    assert [fit.quantisation for fit in found] == pytest.approx([0.5] * RUNS)
    # Rounding adds the variance of a uniform step.
    white = np.array([fit.white for fit in found])
    expected = np.sqrt(4.0 + 0.5**2 / 12.0)
    assert white.mean() == pytest.approx(expected, abs=4.0 * white.std() / np.sqrt(RUNS))


def test_several_series_are_one_measurement():
    rng = np.random.default_rng(3)
    series = [rng.normal(k, 2.0, 300) for k in range(8)]
    fit = fit_noise(series)
    assert abs(np.log(fit.white / 2.0)) < 4.0 * fit.white_error
    assert fit.samples == 2400


def test_too_few_readings_give_no_noise():
    assert fit_noise([np.arange(5.0)]) is None
    assert fit_noise([]) is None
    assert fit_noise([np.ones(100)]) is None


def test_no_white_noise_is_stated_as_none_and_not_as_zero():
    rng = np.random.default_rng(4)
    assert fit_noise([np.cumsum(np.cumsum(rng.normal(size=300)))]) is None


def test_the_noise_is_never_below_the_rounding():
    rng = np.random.default_rng(5)
    hidden = np.round(rng.normal(0.0, 0.02, 300))
    fit = fit_noise([hidden], rounding=0.3)
    assert fit is not None
    assert fit.white == 0.3


def test_an_axis_that_stays_at_one_value_beside_noisy_ones_has_no_rounding():
    rates = np.random.default_rng(2).normal(0.0, 2e-5, (200, 3)).round(12)
    rates[:, 0] = 0.0
    assert rounding_sigmas(rates)[0] == 0.0
