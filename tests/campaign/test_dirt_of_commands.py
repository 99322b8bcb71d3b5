"""Rows of torque commands that were lost: a straight line, and how far it may be off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.campaign_files import assert_same
from support.dirty_example import SLEWING, dirty, kinds, without_rows

from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.campaign.writer import write_campaign


def smooth_commands(header, rows):
    """Commands without the noise of a closed loop, and with lost rows."""
    for k, name in enumerate(("u1_Nm", "u2_Nm", "u3_Nm")):
        for row in rows:
            command = 1e-3 * np.sin(2.0 * np.pi * float(row[0]) / 60.0 + k)
            row[header.index(name)] = repr(float(command))


LOST = (60, 100, 102, SLEWING, SLEWING + 1, SLEWING + 2, 300)


def test_rows_lost_among_smooth_commands_lie_near_a_line(tmp_path):
    def lost(header, rows):
        smooth_commands(header, rows)
        return without_rows(*LOST)(header, rows)

    known = read_campaign(dirty(tmp_path / "known", smooth_commands)).slews[0]
    measured = read_campaign(dirty(tmp_path / "measured", lost))
    assert kinds(measured)[0] == ("gap", "torque", "masked")
    campaign = read_campaign(dirty(tmp_path / "c", lost, without="tachometers"))
    assert kinds(campaign)[0] == ("gap", "torque", "modelled")
    assert len(campaign.slews) == 2
    slew = campaign.slews[0]
    np.testing.assert_allclose(slew.time, known.time, atol=1e-9)
    error = np.abs(slew.wheel_torque - known.wheel_torque)
    assert np.flatnonzero(error.max(axis=1)).tolist() == list(LOST)
    # Three rows in a row lie furthest from their line: 2e-6 N m of commands of 1e-3.
    assert (error <= 3.0 * slew.lost_command_sd).all()
    assert 0.0 < slew.lost_command_sd.max() < 3e-6
    assert np.isnan(slew.rate[list(LOST)]).all()
    again = read_campaign(write_campaign(campaign, tmp_path / "again"))
    assert_same(replace(again, dirt=()), replace(campaign, dirt=()))


@pytest.mark.parametrize("hidden", ["step", "corner", "pulses", "noise"])
def test_what_no_line_shows_is_integrated_out(tmp_path, hidden):
    rng = np.random.default_rng(5)

    def lost(header, rows):
        smooth_commands(header, rows)
        at = header.index("u1_Nm")
        for i, row in enumerate(rows):
            more = {
                "step": 1e-4 * (i > SLEWING),
                "corner": 1e-4 * max(0, i - SLEWING),
                "pulses": 1e-4 * (i % 40 == 20),
                "noise": 0.0,
            }
            noise = 1e-5 * rng.normal() * (hidden == "noise")
            row[at] = repr(float(row[at]) + more[hidden] + noise)
        return without_rows(SLEWING)(header, rows)

    campaign = read_campaign(dirty(tmp_path / "c", lost, without="tachometers"))
    assert kinds(campaign)[0] == ("gap", "torque", "modelled")
    assert len(campaign.slews) == 2
    assert np.flatnonzero(campaign.slews[0].lost_command).tolist() == [SLEWING]


def test_a_missing_command_of_one_wheel_is_a_lost_row(tmp_path):
    def one_cell(header, rows):
        rows[SLEWING][header.index("u2_Nm")] = "NaN"

    campaign = read_campaign(dirty(tmp_path / "a", one_cell))
    assert kinds(campaign) == [("gap", "torque", "masked")]
    whole = read_campaign(dirty(tmp_path / "b", one_cell, without="tachometers"))
    assert kinds(whole) == [("gap", "torque", "modelled")]
    assert np.flatnonzero(whole.slews[0].lost_command).tolist() == [SLEWING]
    assert np.isfinite(whole.slews[0].rate[SLEWING]).all()
