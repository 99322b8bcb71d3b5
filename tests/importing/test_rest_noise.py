"""The noise at rest is that of the sensor, whatever single readings say."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_inertia.faults.motion_scan import MotionScan
from bayes_inertia.faults.outliers import outliers_at_rest
from bayes_inertia.importing.rest_noise import _fit

ROWS = 2000
TIME = 0.25 * np.arange(ROWS)


def at_rest() -> MotionScan:
    still = np.zeros(ROWS)
    return MotionScan(TIME, still, still.astype(int), 1.0, 1.0, np.zeros((0, 2)), np.zeros(3))


def test_outliers_are_not_taken_for_noise():
    rng = np.random.default_rng(11)
    clean = rng.normal(0.0, 2e-5, ROWS)
    dirty = clean.copy()
    dirty[rng.choice(ROWS, 10, replace=False)] += 20 * 2e-5
    plain, robust = (_fit(TIME, values, at_rest()) for values in (clean, dirty))
    assert plain is not None
    assert robust is not None
    assert robust.white == pytest.approx(plain.white, abs=3.0 * plain.white * plain.white_error)
    # What the outliers would have added.
    assert np.std(dirty) > 1.3 * robust.white


def test_rounded_readings_are_kept():
    rng = np.random.default_rng(12)
    rounded = np.round(rng.normal(0.0, 0.2, ROWS))
    assert not outliers_at_rest(rounded).any()
