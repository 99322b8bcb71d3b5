"""Sun sensors and magnetometers are held against the integrated rate; wrong ones are named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.marks import LIKE_ANOTHER

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import (
    DirectionSensor,
    InertiaPrior,
    RateSensor,
    StarTracker,
    Wheel,
)
from bayes_inertia.campaign.inputs import InputStream
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.campaign.writer import write_campaign
from bayes_inertia.conventions.check import check_conventions

J = np.diag([0.041, 0.043, 0.0085])
SUN = np.array([0.5, 0.7, 0.51]) / np.linalg.norm([0.5, 0.7, 0.51])
AXES = np.eye(3)
TURNS = (([1, 0, 0], 30), ([0, 1, 0], 45), ([0, 0, 1], 60), ([-1, -1, -1], 40))
NAMES, UNIT = "sensors.{}.direction.names", "sensors.{}.direction.unit"


def slew_of(k, axis, degrees, spin=1.0):
    """A slew from rest to rest and what Sun sensor, magnetometer, gyro and tachometers read."""
    rng = np.random.default_rng(k)
    time = np.linspace(0.0, 60.0, 121)
    share = np.clip((time - 8.0) / 40.0, 0.0, 1.0)
    axis = np.array(axis) / np.linalg.norm(axis)
    angle = spin * np.radians(degrees) * (share - np.sin(2.0 * np.pi * share) / (2.0 * np.pi))
    rate = np.gradient(angle, time)[:, None] * axis
    attitude = Rotation.random(random_state=k) * Rotation.from_rotvec(angle[:, None] * axis)
    phase = (time + 360.0 * k) * 2.0 * np.pi / 2800.0
    field_N = 3e-5 * np.stack([np.cos(phase), np.sin(phase), 0.5 * np.cos(0.5 * phase)], -1)
    seen = {
        "sun": attitude.inv().apply(SUN) + 0.01 * rng.normal(size=(121, 3)),
        "magnetometer": attitude.inv().apply(field_N) + 2e-7 * rng.normal(size=(121, 3)),
    }
    return Slew(
        f"slew {k}",
        360.0 * k,
        time,
        rate=rate + 2e-4 * rng.normal(size=(121, 3)),
        wheel_momentum=-rate @ J + 2e-6 * rng.normal(size=(121, 3)),
        attitude=attitude.as_quat(),
        more=seen,
        inputs={"magnetometer": InputStream(time, field_N, "line")},
    )


def campaign_of(spin=1.0, wheels=True, tracker=False):
    """A cubesat with gyro, Sun sensor and magnetometer, and wheels or star tracker."""
    slews = [slew_of(k, *turn, spin=spin) for k, turn in enumerate(TURNS)]
    slews = [s if tracker else replace(s, attitude=None) for s in slews]
    slews = [s if wheels else replace(s, wheel_momentum=None) for s in slews]
    return Campaign(
        name="cubesat",
        inertia=InertiaPrior(J, 0.1, 5e-4, includes_wheel_spin=True),
        wheels=[Wheel(f"w{i}", AXES[i], 2e-6, momentum_sigma=2e-6) for i in range(3)],
        rate_sensor=RateSensor((2e-4,) * 3, bias_sigma=1e-5),
        star_tracker=StarTracker([0.0, 0.0, 1.0], 1e-3, 1e-3) if tracker else None,
        slews=slews,
        more_sensors=(
            ("sun", DirectionSensor(0.01, SUN)),
            ("magnetometer", DirectionSensor(2e-7, unit="T")),
        ),
    )


def read_by(campaign, sensor, matrix, offset=0.0):
    """The campaign whose sensor reads other numbers: a matrix (3, 3) times them, and an offset."""
    slews = [
        replace(s, more=s.more | {sensor: s.more[sensor] @ np.transpose(matrix) + offset})
        for s in campaign.slews
    ]
    return replace(campaign, slews=slews)


def named(sensor, letters):
    """Columns as `write_campaign` names those of a further sensor, from letters such as "-y"."""
    return [x.replace(x[-1], f"{sensor}_{'xyz'.index(x[-1]) + 1}") for x in letters]


def first_of(check):
    return [(change.key, change.mended) for change in check.changes if change.proposal == 1]


def test_a_right_campaign_agrees_and_its_sensors_are_held_against_a_law():
    check = check_conventions(campaign_of())
    assert check.verdict == "consistent"
    assert check.misfits["direction"] < 0.5
    assert not any("no law" in line or "closure" in line for line in check.cannot_show)


@pytest.mark.parametrize(
    ("sensor", "matrix", "key", "mended"),
    [
        ("sun", -AXES, NAMES, ["-x", "-y", "-z"]),
        pytest.param("sun", np.diag([1.0, -1.0, 1.0]), NAMES, ["x", "-y", "z"], marks=LIKE_ANOTHER),
        pytest.param(
            "sun", np.diag([1.0, -1.0, -1.0]), NAMES, ["x", "-y", "-z"], marks=LIKE_ANOTHER
        ),
        pytest.param("sun", AXES[[1, 0, 2]], NAMES, ["y", "x", "z"], marks=LIKE_ANOTHER),
        ("sun", np.diag([1.0, -1.0, 1.0]) @ AXES[[1, 0, 2]], NAMES, ["-y", "x", "z"]),
        ("magnetometer", np.diag([1.0, 1.0, -1.0]) @ AXES[[1, 2, 0]], NAMES, ["-z", "x", "y"]),
        pytest.param("magnetometer", -AXES, NAMES, ["-x", "-y", "-z"], marks=LIKE_ANOTHER),
        pytest.param("magnetometer", AXES[[1, 2, 0]], NAMES, ["z", "x", "y"], marks=LIKE_ANOTHER),
        pytest.param(
            "magnetometer", np.diag([-1.0, 1.0, 1.0]), NAMES, ["-x", "y", "z"], marks=LIKE_ANOTHER
        ),
        pytest.param("magnetometer", 1e9 * AXES, UNIT, "nT", marks=LIKE_ANOTHER),
        ("magnetometer", 1e4 * AXES, UNIT, "G"),
    ],
)
def test_a_wrong_direction_sensor_is_named_first(sensor, matrix, key, mended):
    check = check_conventions(read_by(campaign_of(), sensor, matrix), quick=True)
    assert check.verdict == "wrong"
    mended = mended if isinstance(mended, str) else named(sensor, mended)
    assert first_of(check) == [(key.format(sensor), mended)]


def test_a_field_that_no_planet_has_is_the_one_in_another_unit():
    campaign = campaign_of()
    fields = [InputStream(s.time, 1e9 * s.inputs["magnetometer"].values) for s in campaign.slews]
    slews = [
        replace(s, inputs={"magnetometer": field})
        for s, field in zip(campaign.slews, fields, strict=True)
    ]
    check = check_conventions(replace(campaign, slews=slews), quick=True)
    assert first_of(check) == [("sensors.magnetometer.reference.unit", "nT")]


def without_gyro(campaign):
    """The same, whose rates are smoothed from wheels and vectors, or fixes."""
    slews = [replace(s, rate=None) for s in campaign.slews]
    return replace(campaign, rate_sensor=None, slews=slews)


@pytest.mark.parametrize("tracker", [False, True])
def test_right_vectors_without_a_gyro_are_left_alone(tracker):
    check = check_conventions(without_gyro(campaign_of(tracker=tracker)), quick=True)
    assert check.verdict == "consistent"
    assert check.misfits["direction"] < 0.5


@pytest.mark.parametrize(
    ("sensor", "matrix", "key", "mended"),
    [
        ("magnetometer", AXES[[1, 0, 2]], NAMES, ["y", "x", "z"]),
        ("sun", np.diag([1.0, -1.0, 1.0]), NAMES, ["x", "-y", "z"]),
        pytest.param(
            "magnetometer",
            np.diag([1.0, 1.0, -1.0]) @ AXES[[1, 2, 0]],
            NAMES,
            ["-z", "x", "y"],
            marks=LIKE_ANOTHER,
        ),
        pytest.param("magnetometer", 1e9 * AXES, UNIT, "nT", marks=LIKE_ANOTHER),
    ],
)
def test_rates_without_a_gyro_follow_the_vectors_as_each_change_reads_them(
    sensor, matrix, key, mended
):
    campaign = read_by(without_gyro(campaign_of()), sensor, matrix)
    check = check_conventions(campaign, quick=True)
    assert check.verdict == "wrong"
    mended = mended if isinstance(mended, str) else named(sensor, mended)
    assert first_of(check) == [(key.format(sensor), mended)]


def test_rates_without_a_gyro_follow_the_fixes_as_each_change_reads_them():
    campaign = without_gyro(campaign_of(tracker=True))
    turned = [-1.0, -1.0, -1.0, 1.0]
    slews = [replace(s, attitude=s.attitude * turned) for s in campaign.slews]
    check = check_conventions(replace(campaign, slews=slews), quick=True)
    assert first_of(check) == [("sensors.star tracker.attitude.maps", "body_to_inertial")]


@pytest.mark.slow
def test_a_reference_that_points_the_other_way_is_among_the_proposals():
    campaign = campaign_of()
    sensors = (("sun", DirectionSensor(0.01, -SUN)), campaign.more_sensors[1])
    check = check_conventions(replace(campaign, more_sensors=sensors), quick=True)
    proposed = {change.key: change.mended for change in check.changes}
    assert proposed["sensors.sun.reference_N"] == pytest.approx(SUN)


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=LIKE_ANOTHER) for k in (1, 2))])
def test_a_badly_calibrated_magnetometer_and_mountings_off_by_degrees_are_left_alone(seed):
    rng = np.random.default_rng(seed)
    offset = rng.normal(size=3)
    offset *= 7.5e-6 / np.linalg.norm(offset)
    bad = read_by(campaign_of(), "magnetometer", AXES + np.diag(0.1 * rng.normal(size=3)), offset)
    turned = Rotation.from_rotvec(np.radians(3.0) * rng.normal(size=3)).as_matrix()
    check = check_conventions(read_by(bad, "sun", turned), quick=True)
    assert check.verdict == "consistent"


def test_slews_with_one_sensor_and_readings_that_are_missing_are_left_alone():
    campaign = campaign_of()
    half = np.where(np.arange(121)[:, None] < 60, np.nan, campaign.slews[0].more["sun"])
    slews = [
        replace(campaign.slews[0], more=campaign.slews[0].more | {"sun": half}),
        *(replace(s, more={"magnetometer": s.more["magnetometer"]}) for s in campaign.slews[1:3]),
        replace(campaign.slews[3], more={"sun": campaign.slews[3].more["sun"]}),
    ]
    check = check_conventions(replace(campaign, slews=slews), quick=True)
    assert check.verdict == "consistent"
    assert "direction" in check.misfits


@pytest.mark.parametrize(
    ("matrix", "key", "mended"),
    [
        (np.diag([1.0, -1.0, 1.0]), "axes", np.diag([1.0, -1.0, 1.0]).tolist()),
        pytest.param(
            AXES[[1, 0, 2]],
            "rate.names",
            ["wy_radps", "wx_radps", "wz_radps"],
            marks=LIKE_ANOTHER,
        ),
        (np.degrees(AXES), "rate.unit", "deg/s"),
    ],
)
def test_wrong_rates_are_named_without_star_tracker_and_wheels(matrix, key, mended):
    campaign = campaign_of(wheels=False)
    slews = [replace(s, rate=s.rate @ matrix.T) for s in campaign.slews]
    check = check_conventions(replace(campaign, slews=slews), quick=True)
    assert set(check.misfits) == {"direction"}
    assert first_of(check) == [(f"sensors.rate sensor.{key}", mended)]


def test_one_direction_tells_its_sign_only_against_a_star_tracker():
    for tracker, verdict in ((True, "wrong"), (False, "consistent")):
        campaign = campaign_of(tracker=tracker)
        slews = [replace(s, more={"sun": -s.more["sun"]}, inputs=None) for s in campaign.slews]
        alone = replace(campaign, more_sensors=campaign.more_sensors[:1], slews=slews)
        check = check_conventions(alone, quick=True)
        assert check.verdict == verdict
        if tracker:
            flipped = named("sun", ["-x", "-y", "-z"])
            assert first_of(check) == [("sensors.sun.direction.names", flipped)]


@pytest.mark.slow
def test_a_further_gyro_is_held_against_the_directions_too():
    campaign = campaign_of(wheels=False)
    slews = [replace(s, more=s.more | {"mems": s.rate * [1.0, 1.0, -1.0]}) for s in campaign.slews]
    sensors = (*campaign.more_sensors, ("mems", RateSensor((2e-4,) * 3, bias_sigma=1e-5)))
    check = check_conventions(replace(campaign, more_sensors=sensors, slews=slews), quick=True)
    assert check.sentence.startswith("With the sensor mems: ")
    assert first_of(check) == [("sensors.mems.axes", np.diag([1.0, 1.0, -1.0]).tolist())]


def test_a_body_that_tumbles_tells_nothing_by_its_directions():
    campaign = campaign_of(spin=200.0)
    part = slice(40, 80)
    slews = [
        replace(
            s,
            time=s.time[part],
            rate=s.rate[part],
            wheel_momentum=s.wheel_momentum[part],
            more={name: values[part] for name, values in s.more.items()},
        )
        for s in campaign.slews
    ]
    check = check_conventions(replace(campaign, slews=slews))
    assert "direction" not in check.misfits
    assert not check.changes
    said = [line for line in check.cannot_show if "sun" in line]
    assert [line.partition(" is held")[0] for line in said] == ["sun: no law"]


@pytest.mark.parametrize(
    ("of", "wrong", "gyro"), [("direction", "uT", True), ("reference", "nT", False)]
)
def test_a_wrong_unit_is_named_by_the_key_of_the_file(tmp_path, of, wrong, gyro):
    campaign = campaign_of() if gyro else without_gyro(campaign_of())
    folder = write_campaign(campaign, tmp_path / "campaign")
    text = (folder / "campaign.toml").read_text()
    at = text.index(f"{of} = ", text.index('name = "magnetometer"'))
    other = text[:at] + text[at:].replace('unit = "T"', f'unit = "{wrong}"', 1)
    assert other != text
    (folder / "campaign.toml").write_text(other)
    check = check_conventions(folder, quick=True)
    assert first_of(check) == [(f"sensors.magnetometer.{of}.unit", "T")]
    assert check.edits


def in_the_environment(campaign):
    """The campaign whose magnetometer looks at the field of the environment."""
    slews = [
        replace(s, magnetic_field_N=s.inputs["magnetometer"].values, inputs=None)
        for s in campaign.slews
    ]
    return replace(campaign, slews=slews)


@pytest.mark.parametrize(
    ("old", "new", "key", "mended"),
    [
        ('"Bz_N_T"], unit = "T"', '"Bz_N_T"], unit = "nT"', "unit", "T"),
        ('"Bx_N_T", "By_N_T"', '"By_N_T", "Bx_N_T"', "names", ["Bx_N_T", "By_N_T", "Bz_N_T"]),
        pytest.param(
            '"Bx_N_T"',
            '"-Bx_N_T"',
            "names",
            ["Bx_N_T", "By_N_T", "Bz_N_T"],
            marks=LIKE_ANOTHER,
        ),
    ],
)
def test_a_wrong_field_of_the_environment_is_named_without_torquers(
    tmp_path, old, new, key, mended
):
    folder = write_campaign(in_the_environment(campaign_of(tracker=True)), tmp_path / "campaign")
    text = (folder / "campaign.toml").read_text()
    assert old in text
    # An entry of the environment needs no name.
    text = text.replace('name = "magnetic field"\n', "").replace(old, new)
    (folder / "campaign.toml").write_text(text)
    check = check_conventions(folder, quick=True)
    assert first_of(check) == [(f"environment.magnetic field.vector.{key}", mended)]
    assert check.edits


def test_a_constant_field_in_another_unit_is_named(tmp_path):
    campaign, field_N = campaign_of(tracker=True), np.array([2e-5, 1e-5, -3e-5])
    rng = np.random.default_rng(1)
    slews = []
    for s in campaign.slews:
        seen = Rotation.from_quat(s.attitude).inv().apply(field_N)
        more = {"magnetometer": seen + 2e-7 * rng.normal(size=seen.shape)}
        slews.append(replace(s, more=more, inputs=None))
    sensors = (("magnetometer", DirectionSensor(2e-7, 1e9 * field_N, unit="T")),)
    folder = write_campaign(replace(campaign, slews=slews, more_sensors=sensors), tmp_path / "c")
    check = check_conventions(folder, quick=True)
    assert [c.key for c in check.changes if c.proposal == 1] == ["sensors.magnetometer.reference_N"]
    assert check.changes[0].mended == pytest.approx(field_N)
    assert check.edits


def test_a_slew_without_magnetometer_needs_no_field():
    campaign = in_the_environment(campaign_of(tracker=True))
    bare = {"sun": campaign.slews[1].more["sun"]}
    slews = list(campaign.slews)
    slews[1] = replace(slews[1], magnetic_field_N=None, more=bare)
    check = check_conventions(replace(campaign, slews=slews), quick=True)
    assert check.verdict == "consistent"
