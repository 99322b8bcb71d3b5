"""Format 2: actuators, sensors, environment and changes, each device with its own stream."""

from __future__ import annotations

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from support.campaign_files import CSV, assert_same, assert_teaches, edited, make, refusal
from support.campaign_files import FORMAT_2 as TOML
from support.campaign_files import TOML as FORMAT_1

from bayes_inertia.app.commands.check import campaign_json
from bayes_inertia.campaign.actuators import (
    Change,
    GimballedRotors,
    KnownTorque,
    Magnetorquer,
    Thruster,
)
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.format_1 import upgrade
from bayes_inertia.campaign.hardware import DirectionSensor, RateSensor, StarTracker
from bayes_inertia.campaign.inputs import InputStream
from bayes_inertia.campaign.reader import campaign_sha256, copy_campaign, read_campaign
from bayes_inertia.campaign.writer import toml_text, write_campaign
from bayes_inertia.physics.actuators import effects_of

TORQUERS = """
[[actuators]]
name = "torquers"
type = "magnetorquer"
axes = [[1, 0, 0]]
gain_sigma = 0.02
dipole = { stream = "mtq", names = ["m1"], unit = "mA m^2" }
"""
MEMS = """
[[sensors]]
name = "mems"
type = "rate"
axes = [[1, 0, 0], [0, 0.6, 0.8]]
sigma = [1e-4, 2e-4]
rate = { stream = "mems", names = ["m1", "m2"], unit = "deg/s", offset_s = 0.1 }
"""
SUN = """
[[sensors]]
name = "sun"
type = "direction"
sigma = 0.01
reference_N = [0, 0, 2]
direction = { stream = "sun", names = ["s1", "s2", "s3"], frame = "body" }

[[sensors]]
name = "magnetometer"
type = "direction"
sigma = 1e-7
offset_sigma = 1e-6
direction = { stream = "mag", names = ["m1", "m2", "m3"], unit = "uT", frame = "body" }
reference = { stream = "model", names = ["b1", "b2", "b3"], unit = "nT", frame = "inertial" }
"""
STREAMS = (
    ('file = "a.csv"', 'files = "a_{stream}.csv"'),
    ('file = "b.csv"', 'files = { all = "b.csv", mems = "b_mems.csv", mtq = "b_mtq.csv" }'),
)


def streams(folder, toml=TOML + TORQUERS + MEMS):
    """A folder with a table for each stream."""
    make(folder, edited(toml, *STREAMS))
    (folder / "a.csv").rename(folder / "a_all.csv")
    for slew in "ab":
        (folder / f"{slew}_mems.csv").write_text("t,m1,m2\n0.2,1,2\n0.4,3,4\n")
        (folder / f"{slew}_mtq.csv").write_text("t,m1\n-1,100\n0.6,200\n")
    return folder


def test_both_formats_are_read_as_one_campaign(tmp_path):
    read = read_campaign(make(tmp_path / "2", TOML))
    assert list(read.sensors) == ["gyro", "tracker"]
    assert_same(replace(read, names=Campaign.names), read_campaign(make(tmp_path / "1")))


def test_every_stream_keeps_its_own_times(tmp_path):
    campaign = read_campaign(streams(tmp_path / "in"))
    for slew in campaign.slews:
        assert slew.time.tolist() == pytest.approx([0.0, 0.25, 0.3, 0.5, 0.75])
        mems = slew.more["mems"]
        assert np.flatnonzero(np.isfinite(mems).all(axis=1)).tolist() == [2, 3]
        np.testing.assert_allclose(mems[2], np.deg2rad([1.0, 2.0]))
        assert np.isnan(slew.rate[2]).all()
        dipole = slew.inputs["torquers"]
        assert dipole.time.tolist() == [-1.0, 0.6]
        assert dipole.values[:, 0].tolist() == [0.1, 0.2]
        assert dipole.between == "hold"
    assert dict(campaign.more_sensors)["mems"].sigma == (1e-4, 2e-4)
    names = [device["name"] for device in campaign_json(campaign)["devices"]]
    assert names == ["gyro", "tracker", "mems", "torquers"]


def test_every_table_counts_in_the_digest_and_is_copied(tmp_path):
    folder = streams(tmp_path / "in")
    before = campaign_sha256(folder)
    copy = copy_campaign(folder, tmp_path / "copy")
    assert campaign_sha256(copy) == before
    (folder / "b_mtq.csv").write_text("t,m1\n-1,100\n0.6,201\n")
    assert campaign_sha256(folder) != before


def test_wheels_may_have_tachometers_of_several_kinds_and_tables(tmp_path):
    momentum = ('"all", names = ["h2"], unit = "N m s"', '"speed", names = ["n"], unit = "rpm"')
    toml = edited(
        TOML, momentum, ('\nmomentum = { stream = "speed"', '\nspeed = { stream = "speed"')
    )
    files = [
        (f'file = "{s}.csv"', f'files = {{ all = "{s}.csv", speed = "{s}_n.csv" }}') for s in "ab"
    ]
    folder = make(tmp_path / "in", edited(toml, *files))
    for slew in "ab":
        (folder / f"{slew}_n.csv").write_text("t,n\n0.25,600\n0.6,1200\n")
    slew = read_campaign(folder).slews[0]
    assert slew.wheel_momentum[:, 0][np.isfinite(slew.wheel_momentum[:, 0])].tolist() == [
        0.11, 0.12, 0.13, 0.14]  # fmt: skip
    speeds = slew.wheel_momentum[:, 1][np.isfinite(slew.wheel_momentum[:, 1])]
    np.testing.assert_allclose(speeds, 0.002 * 2.0 * np.pi * np.array([10.0, 20.0]))


def suns(folder, toml=TOML + SUN):
    """A folder with a Sun sensor and a magnetometer."""
    files = [(f'file = "{s}.csv"', f'files = "{s}_{{stream}}.csv"') for s in "ab"]
    make(folder, edited(toml, *files))
    for slew in "ab":
        (folder / f"{slew}.csv").rename(folder / f"{slew}_all.csv")
        (folder / f"{slew}_sun.csv").write_text("t,s1,s2,s3\n0.1,0,0.6,0.8\n0.2,,,\n")
        (folder / f"{slew}_mag.csv").write_text("t,m1,m2,m3\n0.1,1,2,3\n0.6,4,5,6\n")
        (folder / f"{slew}_model.csv").write_text("t,b1,b2,b3\n-50,1,2,3\n50,1,2,4\n")
    return folder


def test_directions_and_fields_are_read_with_their_references(tmp_path):
    campaign = read_campaign(suns(tmp_path / "in"))
    sensors = dict(campaign.more_sensors)
    assert sensors["sun"] == DirectionSensor(0.01, (0.0, 0.0, 1.0))
    assert sensors["magnetometer"] == DirectionSensor(1e-7, unit="T", offset_sigma=1e-6)
    slew = campaign.slews[0]
    seen = slew.more["magnetometer"]
    np.testing.assert_allclose(
        seen[np.isfinite(seen).all(axis=1)], [[1e-6, 2e-6, 3e-6], [4e-6, 5e-6, 6e-6]]
    )
    assert slew.more["sun"][slew.time == 0.1].tolist() == [[0.0, 0.6, 0.8]]
    np.testing.assert_allclose(slew.inputs["magnetometer"].values[1], [1e-9, 2e-9, 4e-9])
    again = read_campaign(write_campaign(campaign, tmp_path / "out"))
    assert again.more_sensors == campaign.more_sensors
    for one, other in zip(campaign.slews, again.slews, strict=True):
        np.testing.assert_array_equal(one.more["magnetometer"], other.more["magnetometer"])
        np.testing.assert_array_equal(one.more["sun"], other.more["sun"])
        reference, same = (s.inputs["magnetometer"] for s in (one, other))
        np.testing.assert_array_equal(reference.values, same.values)


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("reference_N = [0, 0, 2]\n", "", ["sensors.sun.reference_N", "missing"]),
        ('"uT", frame', '"rad", frame', ["sensors.magnetometer.direction.unit", '"uT"']),
        (', unit = "nT"', "", ["sensors.magnetometer.reference.unit"]),
        ("offset_sigma = 1e-6", "ofset_sigma = 1e-6", ["ofset_sigma", '"offset_sigma"']),
        ("sigma = 0.01", "sigma = [0.01, 0.02]", ["sensors.sun.sigma"]),
        ("sigma = 0.01", "sigma = 0.01\nscale_sigma = 0.1", ["sensors.sun.scale_sigma"]),
        (
            'frame = "body"',
            'frame = "inertial"',
            ["sensors.sun.direction.frame", "into the body frame"],
        ),
        ('"s1", "s2", "s3"', '"s1", "s2"', ["sensors.sun.direction.names"]),
    ],
)
def test_bad_directions_name_file_and_key(tmp_path, old, new, named):
    error = refusal(suns(tmp_path / "in", TOML + edited(SUN, (old, new))))
    assert error is not None
    assert_teaches(error, ["campaign.toml", *named])


def test_one_sensor_is_the_reference_of_frames(tmp_path):
    campaign = read_campaign(streams(tmp_path / "in"))
    assert campaign.frame_reference == "tracker"
    stated = edited(TOML + TORQUERS + MEMS, ("sigma = [1e-4", "reference = true\nsigma = [1e-4"))
    campaign = read_campaign(streams(tmp_path / "stated", stated))
    again = read_campaign(write_campaign(campaign, tmp_path / "out"))
    assert campaign.frame_reference == again.frame_reference == "mems"
    assert again.names == ("gyro", "tracker")
    said = {row["name"]: row["is"] for row in campaign_json(campaign)["devices"]}
    assert said["mems"] == "rate sensor, 2 axes, reference of frames"
    assert said["tracker"] == "star tracker"
    twice = edited(stated, ("sigma_cross", "reference = true\nsigma_cross"))
    error = refusal(streams(tmp_path / "twice", twice))
    assert_teaches(error, ["sensors.mems.reference", "tracker is the reference"])


THIRD_WHEEL = """
[[actuators]]
name = "z"
type = "wheel"
axis = [0, 0, 1]
spin_inertia = 0.003
state = "locked"

[[sensors]]
name = "gyro\""""
WITH_THIRD_WHEEL = edited(TOML, ('\n[[sensors]]\nname = "gyro"', THIRD_WHEEL))


def test_a_wheel_without_motor_torque_needs_no_commands(tmp_path):
    """A free rotor has no momentum by itself; nor has a locked one where none was read."""
    for state, momentum in (("free", np.nan), ("locked", 0.0)):
        toml = edited(WITH_THIRD_WHEEL + TORQUERS + MEMS, ("locked", state))
        campaign = read_campaign(streams(tmp_path / state, toml))
        slew = campaign.slews[0]
        assert not slew.wheel_torque[:, 2].any()
        read = np.isfinite(slew.wheel_momentum[:, 0])
        expected = np.where(read, momentum, np.nan)
        np.testing.assert_array_equal(slew.wheel_momentum[:, 2], expected)
        again = read_campaign(write_campaign(campaign, tmp_path / f"{state} again"))
        assert again.wheels == campaign.wheels
        np.testing.assert_array_equal(again.slews[0].wheel_momentum, slew.wheel_momentum)


def test_a_locked_wheel_needs_no_telemetry(tmp_path):
    toml = WITH_THIRD_WHEEL
    campaign = read_campaign(make(tmp_path / "in", toml))
    assert [wheel.state for wheel in campaign.wheels] == ["running", "running", "locked"]
    assert campaign.has_commands
    assert not campaign.slews[0].wheel_torque[:, 2].any()
    assert read_campaign(write_campaign(campaign, tmp_path / "out")).wheels == campaign.wheels
    wrong = edited(toml, ('state = "locked"', 'state = "off"'))
    assert_teaches(refusal(make(tmp_path / "wrong", wrong)), ["actuators.z.state", '"locked"'])


FIELD = """[[environment]]
name = "other"
type = "magnetic_field"
vector = { names = ["b1", "b2", "b3"], unit = "T", frame = "inertial" }

"""
FIXES = TOML[TOML.index("[sensors.attitude]") : TOML.index("[[environment]]")]
BAD = [
    ("two", [("[[environment]]\n", FIELD + "[[environment]]\n")], ["environment.field", "other"]),
    ("unknown key", [("sigma = 2e-5", "sigmas = 2e-5")], ["sensors.gyro.sigmas", '"sigma"']),
    ("other physics", [("sigma = 2e-5", "mass = 2e-5")], ["sensors.gyro.mass", "known here"]),
    ("no torque of a wheel", [("torque = {", "max_torque = 1.0 #")], ["actuators.x.torque", "y"]),
    ("unknown type", [('"wheel"', '"weel"')], ["actuators.x.type", '"wheel"', '"thruster"']),
    ("no type", [('type = "rate"\n', "")], ["sensors.gyro.type", '"rate"']),
    ("unit", [('"rad/s"', '"rps"')], ["sensors.gyro.rate.unit", '"deg/s"']),
    ("no unit", [(', unit = "rad/s"', "")], ["sensors.gyro.rate.unit", "never guessed"]),
    ("two columns", [('"wx", "wy", "wz"', '"wx", "wy"')], ["sensors.gyro.rate.names", "3 axes"]),
    ("two sigmas", [("sigma = 2e-5", "sigma = [1e-5, 2e-5]")], ["sensors.gyro.sigma", "3 axes"]),
    ("two columns of a wheel", [('["u1"]', '["u1", "u2"]')], ["actuators.x.torque.names"]),
    ("column twice", [('["u2"]', '["u1"]')], ["actuators.y.torque.names", "actuators.x.torque"]),
    ("long axis", [("[1, 0, 0]", "[2, 0, 0]")], ["actuators.x.axis", "length 2"]),
    ("no sigma", [("sigma_roll = 1e-4\n", "")], ["sensors.tracker.sigma_roll", "[rad]"]),
    ("negative", [("sigma_roll = 1e-4", "sigma_roll = -1.0")], ["sensors.tracker.sigma_roll"]),
    ("name twice", [('name = "y"', 'name = "x"')], ["actuators.x", "twice"]),
    ("no file", [('file = "a.csv"\n', "")], ["slews.first.file", "{stream}"]),
    ("both", [('"a.csv"', '"a.csv"\nfiles = "a_{stream}.csv"')], ["slews.first.files"]),
    ("no place", [('file = "a.csv"', 'files = "a.csv"')], ["slews.first.files", "stream"]),
    ("no table", [('file = "a.csv"', 'files = "c_{stream}.csv"')], ["slews.first", "c_all.csv"]),
    ("no stream", [('file = "a.csv"', 'files = { al = "a.csv" }')], ["files.al", 'mean "all"']),
    ("other stream", [('file = "a.csv"', 'files = { x = "a.csv" }')], ["files.x", "here: all"]),
    ("old keys", [("[[environment]]", "[[wheels]]")], ["key wheels", "[[actuators]]"]),
    ("no fixes", [(FIXES, "")], ["sensors.tracker.attitude: missing"]),
    ("moved", [("sigma_r", "reference = true\nmounting_sigma = 0.01\nsigma_r")], ["sits as"]),
    ("frames", [("sigma = 2e-5", "sigma = 2e-5\nreference = 1")], ["sensors.gyro.reference"]),
    ("no sensor", [("[[sensors]]", "[[sensor]]")], ["key sensor", '"sensors"']),
]  # fmt: skip
BAD_DEVICES = [
    ("columns", [('["m1"], unit = "mA', '["m1", "m2"], unit = "mA')], ["torquers.dipole"]),
    ("between", [('unit = "mA m^2"', 'unit = "mA m^2", between = "on"')], ["between", '"hold"']),
    ("gain", [("gain_sigma = 0.02", "gain_sigma = -0.02")], ["actuators.torquers.gain_sigma"]),
    ("stream", [('stream = "mtq", ', "")], ["actuators.torquers.dipole.stream", "missing"]),
    ("no field", [("[[environment]]\n", "")], ["magnetic_field"]),
]  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "named"), [row[1:] for row in BAD], ids=[row[0] for row in BAD]
)
def test_bad_descriptions_name_file_and_key(tmp_path, changes, named):
    error = refusal(make(tmp_path / "in", edited(TOML, *changes)))
    assert error is not None
    assert_teaches(error, ["campaign.toml", *named])


@pytest.mark.parametrize(
    ("changes", "named"),
    [row[1:] for row in BAD_DEVICES[:4]],
    ids=[row[0] for row in BAD_DEVICES[:4]],
)
def test_bad_devices_name_file_and_key(tmp_path, changes, named):
    error = refusal(streams(tmp_path / "in", edited(TOML + TORQUERS + MEMS, *changes)))
    assert error is not None
    assert_teaches(error, ["campaign.toml", *named])


def test_a_table_of_format_1_has_no_columns_of_its_own(tmp_path):
    """The keys that the upgrade gives it would be overwritten."""
    wheel = "spin_inertia = 0.002"
    for key in ("torque = { names = ['u9'] }", "type = 'torque'"):
        error = refusal(make(tmp_path / key[:4], edited(FORMAT_1, (wheel, f"{wheel}\n{key}"))))
        assert_teaches(error, [f"key wheels.y.{key.split()[0]}", "format 2"])


def test_format_1_takes_a_gyro_of_two_axes(tmp_path):
    text = edited(FORMAT_1, ('"wx", "wy", "wz"', '"wx", "wy"'))
    text = edited(text, ("sigma = 2e-5", "axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]\nsigma = 2e-5"))
    campaign = read_campaign(make(tmp_path, text))
    assert campaign.gyro.sigma == (2e-5, 2e-5)
    assert campaign.slews[0].rate.shape == (4, 2)


def test_an_upgrade_keeps_the_document_and_says_the_same(tmp_path):
    content = tomllib.loads(FORMAT_1)
    upgraded = upgrade(content)
    assert content == tomllib.loads(FORMAT_1)
    folder = make(tmp_path / "one", FORMAT_1)
    other = make(tmp_path / "two", toml_text(upgraded))
    assert_same(read_campaign(folder), read_campaign(other))


def test_keys_of_format_2_in_format_1_are_told(tmp_path):
    text = edited(TOML, ("campaign/2", "campaign/1"))
    error = refusal(make(tmp_path / "in", text))
    assert_teaches(error, ["campaign.toml", "format 2"])


CHANGE = '\n[[changes]]\nname = "fuel"\npart = "inertia"\nslew = "second"\n'


def test_a_change_is_in_every_model_from_its_slew_on(tmp_path):
    campaign = read_campaign(make(tmp_path / "in", TOML + CHANGE))
    assert campaign.changes == (Change("fuel", 100.0),)
    (effect,) = effects_of(campaign)
    assert effect.after == (False, True)
    assert effect.parameters(campaign)[0].priors[0].sd == pytest.approx(0.03 * 7.0 / 3.0)
    assert effects_of(campaign.subset([1]))[0].after == (True,)


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ('slew = "second"', 'slew = "third"', ["changes.fuel.slew", "first, second"]),
        ('slew = "second"', 'slew = "first"', ["changes.fuel.slew", "one side"]),
        ('slew = "second"', "time = 200.0", ["changes.fuel.time", "one side"]),
        ('slew = "second"', "", ["changes.fuel.slew", "one of"]),
        ('"inertia"', '"mass"', ["changes.fuel.part"]),
    ],
)
def test_a_change_that_cannot_be_is_refused(tmp_path, old, new, named):
    error = refusal(make(tmp_path / "in", TOML + edited(CHANGE, (old, new))))
    assert_teaches(error, ["campaign.toml", *named])


def everything(tmp_path):
    """A campaign with a device of each kind."""
    campaign = read_campaign(make(tmp_path / "in"))
    eye, time = np.eye(3), np.array([-0.3, 0.1, 1.0 / 3.0])
    actuators = (
        KnownTorque("known", 0.01, "inertial"),
        Magnetorquer("torquers, all", eye[:2]),
        Thruster("jets", 0.1 * eye, 0.02, 0.01, direction_sigma=0.03),
        Thruster("levels", 0.1 * eye),
        GimballedRotors("cmg", [1.0, 2.0], eye[:2], eye[1:], 1e-5, 0.03),
    )
    forms = ("line", "hold", "on_time", "mean", "line")
    slews = []
    for k, slew in enumerate(campaign.slews):
        rng = np.random.default_rng(k)
        inputs = {
            device.name: InputStream(time, 0.1 * rng.random((3, device.columns)), form)
            for device, form in zip(actuators, forms, strict=True)
        }
        more = {"mems": rng.normal(size=(4, 2)), "second": np.roll(slew.attitude, 1, axis=0)}
        more["mems"][1] = np.nan
        if k:
            del more["second"]
        slews.append(replace(slew, inputs=inputs, more=more))
    sensors = (
        ("mems", RateSensor([1e-4, 2e-4], eye[:2])),
        ("second", StarTracker(eye[0], 1e-5, 1e-4)),
    )
    changes = (Change("fuel", 50.0, 0.01),)
    return replace(
        campaign, slews=slews, actuators=actuators, more_sensors=sensors, changes=changes
    )


@pytest.mark.parametrize("gyroless", [False, True])
def test_what_is_written_reads_back_to_the_bit(tmp_path, gyroless):
    campaign = everything(tmp_path)
    if gyroless:
        # The first rate sensor of a folder is the campaign's own: no other may be there.
        slews = [replace(s, rate=None, more={"second": s.attitude}) for s in campaign.slews]
        more = campaign.more_sensors[1:]
        campaign = replace(campaign, slews=slews, rate_sensor=None, more_sensors=more)
    folder = write_campaign(campaign, tmp_path / "out")
    again = read_campaign(folder)
    assert again.actuators[0] == campaign.actuators[0]
    for device, other in zip(campaign.actuators, again.actuators, strict=True):
        for key, value in vars(device).items():
            np.testing.assert_array_equal(value, getattr(other, key))
    assert again.changes == campaign.changes
    for slew, other in zip(campaign.slews, again.slews, strict=True):
        assert (slew.rate is None) == (other.rate is None)
        for key in ("time", "rate", "wheel_torque", "wheel_momentum", "magnetic_field_N"):
            if getattr(slew, key) is not None:
                np.testing.assert_array_equal(getattr(slew, key), getattr(other, key))
        assert set(slew.more) == set(other.more)
        for name, values in slew.more.items():
            np.testing.assert_array_equal(values, other.more[name])
        for name, stream in slew.inputs.items():
            assert stream.between == other.inputs[name].between
            np.testing.assert_array_equal(stream.time, other.inputs[name].time)
            np.testing.assert_array_equal(stream.values, other.inputs[name].values)
    assert write_campaign(again, folder) == folder


def test_a_campaign_of_format_1_is_written_as_before(tmp_path):
    campaign = read_campaign(make(tmp_path / "in", TOML))
    folder = write_campaign(campaign, tmp_path / "out")
    assert read_campaign(folder).names == campaign.names == ("gyro", "tracker")
    assert (folder / "campaign.toml").read_text().startswith('format = "bayes-inertia-campaign/1"')
    assert (folder / "slew_01.csv").read_text().count("\n") == CSV.count("\n")
