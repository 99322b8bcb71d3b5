"""Rounded and uneven stamps, and clocks that are neither."""

from __future__ import annotations

import numpy as np
import pytest
from support.dirty_example import dirty, kinds

from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.faults.stamps import regular_stamps

ROWS = np.arange(500)


def single(time):
    return time.astype(np.float32).astype(float)


ROUNDED = {
    "32 bits": (single(1e6 + 0.48 * ROWS), 0.48),
    "32 bits, across a power of two": (single(1048476 + 0.48 * ROWS), 0.48),
    "two decimals of 30 Hz": (np.round(ROWS / 30.0, 2), 1.0 / 30.0),
    "truncated, 7 Hz": (np.floor(100.0 * (ROWS / 7.0 + 1e-6)) / 100.0, 1.0 / 7.0),
    "milliseconds of 60 Hz": (np.round(1e3 * ROWS / 60.0), 1e3 / 60.0),
    "days with six decimals": (86400.0 * np.round(61100.0 + 0.25 * ROWS / 86400.0, 6), 0.25),
    "Julian days from their first": (
        86400.0 * (np.round(2461100.5 + 0.25 * ROWS / 86400.0, 6) - 2461100.5),
        0.25,
    ),
    "ticks of 20 Hz": (np.round(20.0 * 0.48 * ROWS) / 20.0, 0.48),
}


@pytest.mark.parametrize("name", ROUNDED)
def test_rounded_stamps_become_those_of_the_clock(name):
    stamps, step = ROUNDED[name]
    for rows in (ROWS, np.delete(ROWS, [7, 8, 90, 300])):
        time, record = regular_stamps(stamps[rows])
        assert (record.kind, record.treated) == ("clock", "modelled")
        np.testing.assert_allclose(np.diff(time), np.diff(rows) * step, rtol=1e-3)
        assert np.abs(time - stamps[rows]).max() < 0.4 * step


def jittered(share, rng):
    return 0.48 * (ROWS + share * rng.uniform(-1.0, 1.0, len(ROWS)))


def test_other_clocks_are_left_alone():
    rng = np.random.default_rng(8)
    fixes = np.arange(0.03, 120.0, 5.0)
    clocks = {
        "even": 0.25 * ROWS,
        "even, with the rounding of a large epoch": 1.7e9 + 0.1 * ROWS,
        "rounded finely": np.round(2.476e-4 * ROWS, 6),
        "even, rows lost": np.delete(0.25 * ROWS, rng.choice(ROWS[1:-1], 40, replace=False)),
        "in turns": np.cumsum(np.tile([1.0, 1.1], 250)),
        "two clocks": np.union1d(0.1 * ROWS, fixes),
        "changes": np.cumsum(rng.exponential(size=500)),
        "nearly even": jittered(0.002, rng),
        "few rows": single(1e6 + 0.48 * np.arange(12)),
        "jump": 0.25 * ROWS + 1.3 * (ROWS > 200),
    }
    accused = [name for name, time in clocks.items() if regular_stamps(time)[1] is not None]
    assert accused == []


@pytest.mark.parametrize("rounded", [False, True])
def test_jitter_is_recorded_and_kept(rounded):
    stamps = jittered(0.05, np.random.default_rng(3))
    stamps = single(stamps + 1e6) if rounded else stamps
    time, record = regular_stamps(stamps)
    np.testing.assert_array_equal(time, stamps)
    assert (record.kind, record.treated) == ("clock", "ignored")
    assert "uneven" in record.note


def test_rounded_stamps_of_a_campaign(tmp_path):
    def rounded(header, rows):
        for i, row in enumerate(rows):
            row[0] = f"{i / 7.0:.2f}"

    campaign = read_campaign(dirty(tmp_path / "c", rounded))
    assert kinds(campaign) == [("clock", "time", "modelled")]
    assert campaign.dirt[0].rows == ()
    assert campaign.dirt[0].slew == campaign.slews[0].name
    np.testing.assert_allclose(np.diff(campaign.slews[0].time), 1.0 / 7.0, rtol=1e-3)


def test_a_wild_stamp_overflows_nothing():
    """Beyond what 32 bits hold; warnings are errors here."""
    regular_stamps(np.append(0.48 * ROWS + 0.1 * (ROWS % 3 == 0), 1e40))
