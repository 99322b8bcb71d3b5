"""The check of a folder of format 2: what is wrong is named by the file's own keys."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayes_inertia.campaign.hardware import RateSensor, Wheel
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.campaign.writer import write_campaign
from bayes_inertia.conventions.check import check_conventions

AXES = np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The example campaign with its rates read by a second gyro too, turned and without bias."""
    import bayes_inertia

    campaign = read_campaign(f"{next(iter(bayes_inertia.__path__))}/example")
    slews = [replace(slew, more={"mems": slew.rate @ AXES.T}) for slew in campaign.slews]
    sigma = campaign.rate_sensor.sigma
    sensor = RateSensor(sigma, AXES, bias_sigma=1e-5)
    two = replace(campaign, slews=slews, more_sensors=(("mems", sensor),))
    return write_campaign(two, tmp_path_factory.mktemp("two") / "campaign")


def checked(folder, old="", new=""):
    """The check of the folder with other text in its description."""
    text = (folder / "campaign.toml").read_text()
    assert old in text
    (folder / "other.toml").write_text(text.replace(old, new))
    return check_conventions(folder / "other.toml")


def test_a_right_campaign_is_not_accused(folder):
    check = checked(folder)
    assert check.verdict == "consistent"
    assert check.changes == ()
    assert not any("columns." in line or "rate_sensor." in line for line in check.cannot_show)


@pytest.mark.parametrize(
    ("old", "new", "keys", "mended"),
    [
        ('acts_on = "wheel"', 'acts_on = "body"', ["actuators.{}.torque.acts_on"], "wheel"),
        ('"inertial_to_body"', '"body_to_inertial"', ["sensors.star tracker.attitude.maps"],
         "inertial_to_body"),
        ('"wz_radps"], unit = "rad/s"', '"wz_radps"], unit = "deg/s"',
         ["sensors.rate sensor.rate.unit"], "rad/s"),
        ("[-0.6, 0.8, 0.0]", "[0.6, -0.8, 0.0]", ["sensors.mems.axes"], AXES.tolist()),
    ],
)  # fmt: skip
def test_a_wrong_key_is_named_as_the_file_writes_it(folder, old, new, keys, mended):
    check = checked(folder, old, new)
    assert check.verdict == "wrong"
    wheels = [wheel.name for wheel in read_campaign(folder).wheels]
    expected = [key.format(w) for key in keys for w in wheels] if "{}" in keys[0] else keys
    first = [change for change in check.changes if change.proposal == 1]
    assert [change.key for change in first] == expected
    assert first[0].mended == mended
    assert check.edits


def test_the_unit_of_one_wheel_alone_is_named(folder):
    """Wheels whose columns say different things were left out."""
    text = (folder / "campaign.toml").read_text()
    (folder / "one.toml").write_text(text.replace('unit = "N m s"', 'unit = "mN m s"', 1))
    check = check_conventions(folder / "one.toml", quick=True)
    first = [(c.key, c.mended) for c in check.changes if c.proposal == 1]
    name = read_campaign(folder).wheels[0].name
    assert first == [(f"actuators.{name}.momentum.unit", "N m s")]


def two_trackers(folder, **changes):
    """The example with a second star tracker, which reads what the first does."""
    campaign = read_campaign(folder)
    slews = [replace(s, more={"second": s.attitude}) for s in campaign.slews]
    sensors = (("second", replace(campaign.star_tracker, mounting_sigma=1e-3)),)
    return replace(campaign, slews=slews, more_sensors=sensors, **changes)


def test_a_further_tracker_may_be_mounted_roughly_or_be_the_reference(folder):
    for campaign in (two_trackers(folder), two_trackers(folder, reference="second")):
        assert check_conventions(campaign, quick=True).verdict == "consistent"
    slews = [replace(s, more={"second": s.attitude * [-1, -1, -1, 1]}) for s in campaign.slews]
    check = check_conventions(replace(campaign, slews=slews), quick=True)
    assert check.sentence.startswith("With the sensor second: ")
    assert check.changes[0].key == "sensors.second.attitude.maps"


@pytest.mark.slow
def test_without_gyro_a_further_tracker_of_one_fix_is_left_alone(folder):
    campaign = two_trackers(folder)
    slews = [replace(s, rate=None, more=None) for s in campaign.slews]
    without = replace(campaign, rate_sensor=None, more_sensors=(), slews=slews)
    one = []
    for slew in slews:
        first = np.arange(len(slew.time)) == np.argmax(slew.fixes)
        one.append(replace(slew, more={"second": np.where(first[:, None], slew.attitude, np.nan)}))
    alone = replace(without, more_sensors=campaign.more_sensors, slews=one)
    checks = [check_conventions(c, quick=True) for c in (alone, without)]
    assert checks[0] == checks[1]


def test_names_may_have_dots(folder, tmp_path):
    campaign = read_campaign(folder)
    wheels = [replace(wheel, name=f"RW.{k}") for k, wheel in enumerate(campaign.wheels)]
    named = write_campaign(replace(campaign, wheels=wheels), tmp_path / "dots")
    check = checked(named, 'acts_on = "wheel"', 'acts_on = "body"')
    assert check.changes[0].key == "actuators.RW.0.torque.acts_on"
    assert len(check.edits) == len(wheels)


@pytest.mark.slow
def test_what_a_locked_wheel_reads_does_not_count(folder, tmp_path):
    campaign = read_campaign(folder)
    spare = Wheel("spare", (0.6, 0.0, 0.8), 1e-3, momentum_sigma=1e-6, state="locked")
    rng = np.random.default_rng(1)
    slews = [
        replace(
            s,
            wheel_torque=np.insert(s.wheel_torque, 3, 1e-3, axis=1),
            wheel_momentum=np.insert(s.wheel_momentum, 3, rng.normal(size=len(s.time)), axis=1),
        )
        for s in campaign.slews
    ]
    locked = replace(campaign, wheels=(*campaign.wheels, spare), slews=slews)
    plain = check_conventions(campaign, quick=True)
    assert check_conventions(locked, quick=True) == plain
    wrong = checked(write_campaign(locked, tmp_path / "locked"), '"N m s"', '"mN m s"')
    assert [change.key for change in wrong.changes if change.proposal == 1][:3] == [
        f"actuators.{wheel.name}.momentum.unit" for wheel in campaign.wheels
    ]
    running = (*campaign.wheels, replace(spare, state="running"))
    alone = [replace(slew, more=None) for slew in slews]
    one = replace(locked, wheels=running, more_sensors=(), slews=alone)
    of_format_1 = write_campaign(one, tmp_path / "one")
    name = 'name = "spare"'
    assert checked(of_format_1, name, f'{name}\nstate = "locked"').verdict == "consistent"


def test_a_noise_that_shares_a_wrong_unit_is_mended_where_it_stands(folder, tmp_path):
    """Beside the columns of the tachometers, or among the wheel's own keys."""
    campaign = read_campaign(folder)
    text = (folder / "campaign.toml").read_text()
    for wheel in campaign.wheels:
        text = text.replace(f", sigma = {wheel.momentum_sigma!r}}}", "}")
        said = f'name = "{wheel.name}"\n'
        text = text.replace(said, f"{said}momentum_sigma = {1e-3 * wheel.momentum_sigma!r}\n")
    (folder / "own.toml").write_text(text.replace('unit = "N m s"', 'unit = "mN m s"'))
    changes = check_conventions(folder / "own.toml", quick=True).changes
    sigmas = {change.key: change.mended for change in changes if "sigma" in change.key}
    assert sigmas == {
        f"actuators.{wheel.name}.momentum_sigma": pytest.approx(wheel.momentum_sigma)
        for wheel in campaign.wheels
    }
