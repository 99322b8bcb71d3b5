"""Every detector finds its own fault, and nothing in readings without one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from bayes_inertia.campaign.inspection import DETECTORS
from bayes_inertia.faults import gaps, impossible, quantisation, saturated, stuck
from bayes_inertia.faults.fault import Series
from bayes_inertia.faults.outliers import outliers_at_rest, without_outliers

Change = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def series(change: Change | None = None) -> Series:
    """A quiet sensor of three axes, 200 readings at 4 Hz, with a range of 1 rad/s."""
    time = 0.25 * np.arange(200.0)
    values = np.random.default_rng(3).normal(scale=1e-5, size=(200, 3))
    if change is not None:
        time, values = change(time, values)
    valid = np.isfinite(values) & (np.abs(np.nan_to_num(values)) < 1.0)
    return Series(time, values, valid, (1e-5, 1e-5, 1e-5), 1e3, "rad/s", "1 rad/s")


def lost(time: np.ndarray, values: np.ndarray):
    kept = np.delete(np.arange(200), slice(60, 80))
    return time[kept], values[kept]


def marked(time: np.ndarray, values: np.ndarray):
    values[50, 1] = -1e31
    return time, values


def marked_as_in_degrees(time: np.ndarray, values: np.ndarray):
    values[[50, 90]] = np.deg2rad(-9999.0)
    return time, values


def at_range(time: np.ndarray, values: np.ndarray):
    values[70:75, 0] = 1.0
    return time, values


def standing(time: np.ndarray, values: np.ndarray):
    values[100:130] = values[100]
    return time, values


def rounded(time: np.ndarray, values: np.ndarray):
    return time, np.round(values / 3e-5) * 3e-5


CASES = (
    (gaps.detect, lost, "gap", 1),
    (impossible.detect, marked, "outliers", 1),
    (impossible.detect, marked_as_in_degrees, "outliers", 2),
    (saturated.detect, at_range, "saturated", 5),
    (stuck.detect, standing, "stuck", 30),
    (quantisation.detect, rounded, "quantised", 0),
)
EVERY = [case[0] for case in CASES]


@pytest.mark.parametrize(("detect", "change", "kind", "rows"), CASES)
def test_a_fault_is_told_by_its_detector(detect, change, kind, rows):
    (fault,) = detect(series(change))
    record = fault.record("rate", "a")
    assert (record.kind, record.channel, record.slew, len(record.rows)) == (kind, "rate", "a", rows)


@pytest.mark.parametrize("detect", EVERY)
def test_readings_without_a_fault_show_none(detect):
    assert detect(series()) == []


def test_only_what_cannot_be_real_is_masked():
    masks = {c[2]: fault.masks for c in CASES for fault in c[0](series(c[1]))}
    assert {kind for kind, goes in masks.items() if goes} == {"outliers", "stuck"}
    assert set(DETECTORS) < set(EVERY)


def test_two_outliers_in_a_row_are_both_replaced():
    motion = np.sin(np.linspace(0.0, 3.0, 300))
    spiked = motion.copy()
    spiked[120:122] = 6.5
    assert np.abs(without_outliers(spiked) - motion).max() < 0.05


def test_one_limit_tells_outliers_at_rest_and_in_motion():
    quiet = np.random.default_rng(1).normal(size=300)
    for size, is_one in ((4.0, False), (40.0, True)):
        spiked = quiet.copy()
        spiked[120] += size
        assert bool(outliers_at_rest(spiked)[120]) is is_one
        assert (without_outliers(spiked)[120] != spiked[120]) is np.bool_(is_one)
