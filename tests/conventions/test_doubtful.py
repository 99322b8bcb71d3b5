"""What is wrong by little or beside gaps is named too, and what cannot be shown is said briefly."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bayes_inertia
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.conventions.check import check_conventions
from bayes_inertia.conventions.invisible import invisible_in_brief
from tests.support.wrong_conventions import with_keys

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"


def with_rates(matrix: np.ndarray, **channels: None):
    """The example, whose rates are multiplied by a matrix, without some of the other channels."""
    campaign = read_campaign(EXAMPLE)
    slews = [
        replace(slew, rate=np.asarray(slew.rate) @ matrix.T, **channels) for slew in campaign.slews
    ]
    return replace(campaign, slews=tuple(slews))


NO_WHEELS = {"wheel_torque": None, "wheel_momentum": None}


def test_a_change_that_explains_doubtful_data_far_better_is_proposed():
    turned = Rotation.from_rotvec(np.radians([9.0, -12.0, 10.0])).as_matrix()
    check = check_conventions(with_rates(turned, **NO_WHEELS), quick=True)
    assert 1.0 < max(check.misfits.values()) < 3.0
    assert check.verdict == "wrong"
    assert check.changes[0].key == "rate_sensor.axes"
    assert np.allclose(check.changes[0].mended, turned, atol=0.05)
    assert "hardly agree" in check.sentence


def test_doubtful_data_that_no_change_explains_are_left_alone():
    check = check_conventions(with_rates(np.diag([1.25, 0.75, 1.2]), **NO_WHEELS), quick=True)
    assert 1.0 < max(check.misfits.values()) < 3.0
    assert check.verdict == "consistent"


def with_gaps(folder: Path) -> Path:
    """Leave out a twelfth of the rows of every table, in its middle."""
    for path in folder.glob("*.csv"):
        header, *rows = path.read_text().splitlines()
        first = len(rows) // 2
        kept = rows[:first] + rows[first + len(rows) // 12 :]
        path.write_text("\n".join([header, *kept]) + "\n")
    return folder


@pytest.mark.parametrize("unit", ["mN m", "N m"])
def test_commands_with_gaps_are_held_against_the_tachometers(tmp_path, unit):
    wrong = with_keys(EXAMPLE, tmp_path / "campaign", {"columns.wheel_torque.unit": unit})
    check = check_conventions(with_gaps(wrong))
    assert "drive" in check.misfits
    keys = [change.key for change in check.changes if change.proposal == 1]
    assert keys == (["columns.wheel_torque.unit"] if unit == "mN m" else [])
    # The record says what a fit does with them.
    notes = [dirt["note"] for dirt in check.dirt if dirt["channel"] == "torque"]
    assert all("measured wheel momentum drives the model" in note for note in notes)
    assert notes


def test_what_cannot_be_shown_is_said_in_a_few_lines():
    campaign, rng = read_campaign(EXAMPLE), np.random.default_rng(5)
    slews = [
        replace(
            slew,
            rate=2e-5 * rng.normal(size=slew.rate.shape),
            wheel_torque=0.0 * np.asarray(slew.wheel_torque),
            wheel_momentum=0.0 * np.asarray(slew.wheel_momentum),
            attitude=None,
        )
        for slew in campaign.slews
    ]
    still = replace(campaign, slews=tuple(slews), star_tracker=None)
    said = check_conventions(still).cannot_show
    brief = invisible_in_brief(said)
    assert len(said) > 20
    assert len(brief) <= 4
    assert any("columns.time.unit" in line for line in brief)
    assert brief[-1].startswith("as no campaign can")


def test_a_dead_rate_sensor_is_impossible_and_no_change_is_proposed():
    check = check_conventions(with_rates(np.zeros((3, 3))))
    assert (check.verdict, check.changes) == ("wrong", ())
