"""The check of a folder of format 2: what is wrong is named by the file's own keys."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayes_inertia.campaign.hardware import RateSensor
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
