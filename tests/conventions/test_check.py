"""Wrong conventions are named, one by one; right ones are left alone, whatever physics hides."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support.commands import run

import bayes_inertia
from bayes_inertia.app.commands.check import show_check
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import InertiaPrior, RateSensor, Wheel
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.campaign.writer import write_campaign
from bayes_inertia.conventions.check import check_conventions
from bayes_inertia.conventions.wording import invisible_in_brief
from bayes_inertia.physics.small_campaign import small_campaign
from tests.support.wrong_conventions import value_of, with_keys

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"
DATA = Path(__file__).parent.parent / "data"
RIGHT = {"example": EXAMPLE, "lag": DATA / "hidden_lag", "dipole": DATA / "hidden_dipole"}
X, Y = "wheels.wheel_x.axis", "wheels.wheel_y.axis"
WRONG = {
    "quaternion order": {"columns.attitude.scalar": "first"},
    "quaternion direction": {"columns.attitude.maps": "body_to_inertial"},
    "rate unit": {"columns.rate.unit": "deg/s"},
    "quaternion element": {"columns.attitude.names": ["q1", "-q2", "q3", "q4"]},
    "torque sign": {"columns.wheel_torque.acts_on": "body"},
    "wheel axis": {Y: [0.0, -1.0, 0.0]},
    "gyro axes": {"columns.rate.names": ["wy_radps", "wx_radps", "wz_radps"]},
    "wheel axes": {X: [0.0, 1.0, 0.0], Y: [1.0, 0.0, 0.0]},
    "wheel columns": {"columns.wheel_torque.names": ["u1_Nm", "u3_Nm", "u2_Nm"]},
    "time unit": {"columns.time.unit": "ms"},
    "torque unit": {"columns.wheel_torque.unit": "mN m"},
    "momentum unit": {"columns.wheel_momentum.unit": "mN m s"},
    "both units": {
        "columns.wheel_torque.unit": "mN m",
        "columns.wheel_momentum.unit": "mN m s",
    },
    "rate frame": {"rate_sensor.axes": [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]},
    "inertia unit": {
        "inertia.tensor": [[32357.0, -122.0, 26.0], [-122.0, 21613.0, 158.0], [26.0, 158.0, 18705]]
    },
}


@pytest.mark.parametrize("name", WRONG)
def test_the_wrong_convention_is_named_first(name, tmp_path):
    wrong = WRONG[name]
    check = check_conventions(with_keys(EXAMPLE, tmp_path / "campaign", wrong), quick=True)
    assert check.verdict == "wrong"
    proposed = [change for change in check.changes if change.proposal == 1]
    assert {change.key: change.stated for change in proposed} == wrong
    for change in proposed:
        right = value_of(EXAMPLE, change.key)
        assert change.mended == right or change.key == "inertia.tensor"
        assert change.sigma_before > 4.0 > 4.0 * change.sigma_after
    assert check.edits
    assert all(edit in check.sentence for edit in check.edits)


@pytest.mark.parametrize("name", RIGHT)
def test_a_right_campaign_is_left_alone_whatever_physics_hides(name):
    check = check_conventions(RIGHT[name])
    assert check.verdict == "consistent"
    assert max(check.misfits.values()) < 1.0
    assert set(check.misfits) == {"closure", "conservation", "drive"}
    assert any("common sign" in words for words in check.cannot_show)
    brief = invisible_in_brief(check.cannot_show)[-1]
    assert "boresight, but by the noise of its fixes" in brief
    assert "the products of the stated tensor are written" in brief


@pytest.mark.slow
def test_a_pair_is_named_where_no_single_change_mends(tmp_path):
    wrong = {"columns.attitude.maps": "body_to_inertial", "columns.wheel_torque.acts_on": "body"}
    check = check_conventions(with_keys(EXAMPLE, tmp_path / "campaign", wrong), quick=True)
    assert {c.key: c.stated for c in check.changes if c.proposal == 1} == wrong


def in_another_unit(folder: Path, prefix: str, factor: float) -> Path:
    """Multiply the columns whose names begin with a prefix, in every table of a campaign."""
    for path in folder.glob("*.csv"):
        header, *rows = path.read_text().split()
        hit = [name.startswith(prefix) for name in header.split(",")]
        lines = [
            ",".join(
                repr(float(cell) * factor) if changed else cell
                for cell, changed in zip(row.split(","), hit, strict=True)
            )
            for row in rows
        ]
        path.write_text("\n".join([header, *lines]) + "\n")
    return folder


def test_degrees_with_their_noise_are_mended_together(tmp_path):
    sigma = {"rate_sensor.sigma": 2e-5 * 57.29577951}
    folder = with_keys(EXAMPLE, tmp_path / "campaign", sigma)
    check = check_conventions(in_another_unit(folder, "w", 57.29577951308232), quick=True)
    first, second = check.changes
    assert (first.key, first.stated, first.mended) == ("columns.rate.unit", "rad/s", "deg/s")
    assert second.key == "rate_sensor.sigma"
    assert second.mended == pytest.approx(2e-5, rel=1e-3)
    alone = check_conventions(with_keys(folder, tmp_path / "alone", {"rate_sensor.sigma": 2e-5}))
    assert [change.key for change in alone.changes] == ["columns.rate.unit"]


@pytest.mark.parametrize(("wrong", "factor"), [(0.002, 2), (0.0001, 10)])
def test_a_spin_inertia_that_is_wrong_by_a_factor_is_mended(tmp_path, wrong, factor):
    speed = {"names": ["h1_Nms", "h2_Nms", "h3_Nms"], "unit": "rad/s", "relative_to": "body"}
    keys = {"columns.wheel_momentum": None, "columns.wheel_speed": speed}
    spin = {f"wheels.wheel_{axis}.spin_inertia": wrong for axis in "xyz"}
    folder = with_keys(EXAMPLE, tmp_path / "campaign", keys | spin)
    check = check_conventions(in_another_unit(folder, "h", 1e3), quick=True)
    assert check.verdict == "wrong"
    assert {change.key for change in check.changes} == set(spin)
    assert all(change.mended == pytest.approx(0.001) for change in check.changes)
    assert f"is wrong by a factor of {factor}" in check.sentence
    assert f"wheel_z differ by a factor of {factor}" in check.doubts[0]


def test_a_factor_of_ten_is_listed_beside_the_unit_that_lies_near(tmp_path):
    speed = {"names": ["h1_Nms", "h2_Nms", "h3_Nms"], "unit": "rad/s", "relative_to": "body"}
    keys = {"columns.wheel_momentum": None, "columns.wheel_speed": speed}
    spin = {f"wheels.wheel_{axis}.spin_inertia": 0.01 for axis in "xyz"}
    # What else is unknown leaves more than the two differ by.
    keys["inertia.tensor"] = (1.15 * np.array(value_of(EXAMPLE, "inertia.tensor"))).tolist()
    folder = with_keys(EXAMPLE, tmp_path / "campaign", keys | spin)
    check = check_conventions(in_another_unit(folder, "h", 1e3), quick=True)
    named = {change.key: change.mended for change in check.changes}
    assert named == {"columns.wheel_speed.unit": "rpm"} | dict.fromkeys(spin, 0.001)


def test_turns_a_minute_that_are_stated_as_turns_a_second_are_no_degrees(tmp_path):
    speed = {"names": ["h1_Nms", "h2_Nms", "h3_Nms"], "unit": "Hz", "relative_to": "body"}
    keys = {"columns.wheel_momentum": None, "columns.wheel_speed": speed}
    folder = with_keys(EXAMPLE, tmp_path / "campaign", keys)
    rpm = 1e3 * 60.0 / (2.0 * math.pi)  # spin inertia 0.001 kg m^2
    (change,) = check_conventions(in_another_unit(folder, "h", rpm), quick=True).changes
    assert (change.key, change.stated, change.mended) == ("columns.wheel_speed.unit", "Hz", "rpm")


@pytest.mark.parametrize(
    ("prefix", "factor", "key", "unit"),
    [
        ("w", 206264.806, "columns.rate.unit", "deg/h"),
        ("w", 57295.7795, "columns.rate.unit", "mdeg/s"),
        ("h", 1e3, "columns.wheel_momentum.unit", "mN m s"),
    ],
)
def test_a_unit_that_makes_nearly_all_readings_unbelievable_is_named(
    tmp_path, prefix, factor, key, unit
):
    folder = with_keys(EXAMPLE, tmp_path / "campaign", {"rate_sensor.range": 0.1})
    change = check_conventions(in_another_unit(folder, prefix, factor)).changes[0]
    assert (change.key, change.mended) == (key, unit)


def test_a_unit_of_rates_beyond_the_range_is_named_of_a_body_that_tumbles_alone(tmp_path):
    """Rates that do not count tell no motion, and what wheels that rest account for is none."""
    time, J, rng = np.arange(0.0, 40.0, 0.1), np.array([3.0, 2.2, 1.6]), np.random.default_rng(1)
    slews = []
    for k, start in enumerate(0.6 * rng.normal(size=(4, 3))):
        turning = lambda t, w: -np.cross(w, J * w) / J  # noqa: E731
        rate = solve_ivp(turning, (0.0, 40.0), start, t_eval=time, rtol=1e-9).y.T
        rate += 1e-3 * rng.normal(size=rate.shape)
        momentum = 1e-5 * rng.normal(size=(len(time), 1))
        slews.append(Slew(f"{k}", 1e3 * k, time, np.degrees(rate), wheel_momentum=momentum))
    wheel = Wheel("w", [0.0, 0.0, 1.0], 1e-3, momentum_sigma=1e-5)
    sensor = RateSensor(sigma=1e-3, range=4.0)
    inertia = InertiaPrior(np.diag(1.05 * J), 0.1, 0.05)
    misread = Campaign("tumble", inertia, (wheel,), sensor, None, slews)
    change = check_conventions(write_campaign(misread, tmp_path / "campaign")).changes[0]
    assert (change.key, change.mended) == ("columns.rate.unit", "deg/s")


def test_lines_to_be_pasted_are_printed_as_they_are(capsys):
    edit = "line 3: axes = [[1.0, 0.0, 0.0]]  ->  axes = [[ -1.0, 0.0, 0.0]]  # kg m^2, or so: wide"
    check = replace(check_conventions(EXAMPLE), sentence=f"By -1 kg m^2.\n  {edit}", edits=(edit,))
    show_check(check, EXAMPLE)
    printed = capsys.readouterr().out
    assert "By −1 kg m²." in printed
    assert f"  {edit}\n" in printed


def test_the_command_prints_one_document_and_ends_with_2(tmp_path, capsys):
    folder = with_keys(EXAMPLE, tmp_path / "campaign", WRONG["torque sign"])
    assert run("doctor", folder, "--json") == 2
    document = json.loads(capsys.readouterr().out)
    assert document["format"] == "bayes-inertia-doctor/1"
    assert document["verdict"] == "wrong"
    first = document["changes"][0]
    assert (first["key"], first["from"], first["to"]) == (
        "columns.wheel_torque.acts_on",
        "body",
        "wheel",
    )
    assert first["sigma_before"] > 10.0 > 1.0 > first["sigma_after"]
    assert run("doctor", EXAMPLE, "--json") == 0
    assert json.loads(capsys.readouterr().out)["changes"] == []


@pytest.mark.parametrize("command", ["check", "fit", "diagnose"])
def test_impossible_data_end_with_2_before_minutes_are_spent(command, tmp_path, capsys):
    folder = with_keys(EXAMPLE, tmp_path / "campaign", WRONG["quaternion direction"])
    out = tmp_path / "run"
    assert run(command, folder, *(() if command == "check" else ("-o", out))) == 2
    message = capsys.readouterr().err
    assert message.startswith("error: ")
    assert 'maps = "inertial_to_body"' in message
    assert "--anyway" in message
    assert not out.exists()


def test_check_goes_on_if_told_to(tmp_path):
    folder = with_keys(EXAMPLE, tmp_path / "campaign", WRONG["torque sign"])
    assert run("check", folder, "--anyway") == 0


@pytest.mark.slow
def test_numbers_whose_squares_overflow_are_held_against_the_laws_without_a_warning():
    campaign = small_campaign()
    slews = tuple(replace(s, wheel_momentum=1e200 * s.wheel_momentum) for s in campaign.slews)
    assert check_conventions(replace(campaign, slews=slews)).verdict in ("consistent", "wrong")
