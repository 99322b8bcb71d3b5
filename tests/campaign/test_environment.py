"""Position and field from two-line elements: against astropy's axes and the Earth's dipole."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.campaign_files import FORMAT_2 as TOML
from support.campaign_files import assert_teaches, edited, make, refusal

from bayes_inertia import Campaign, CampaignError, InertiaPrior, RateSensor, Slew, with_orbit
from bayes_inertia.campaign.reader import campaign_sha256, copy_campaign, read_campaign

# Of a CubeSat in low orbit, public catalogue.
ELEMENTS = """\
1 52191U 22033AL  23247.77431173  .00022171  00000+0  61178-3 0  9997
2 52191  97.3601 329.3497 0007739 208.8387 151.2430 15.37072592 79491
"""
EPOCH = "2023-09-04T14:48:23"


@pytest.fixture
def orbiting(tmp_path: Path) -> Campaign:
    tle = tmp_path / "orbit.tle"
    tle.write_text(ELEMENTS)
    return with_orbit(tumbling(), tle, EPOCH)


def tumbling() -> Campaign:
    time = np.arange(0.0, 5600.0, 20.0)
    slew = Slew("orbit", 100.0, time, rate=np.zeros((len(time), 3)))
    return Campaign("c", InertiaPrior(np.eye(3), 0.1, 0.1), (), RateSensor(1e-3), None, (slew,))


def test_position_is_that_of_the_orbit(orbiting):
    position = orbiting.slews[0].position_N
    radius = np.linalg.norm(position, axis=1)
    # Kepler's third law: 15.37 turns a day.
    a = (3.986004e14 * (86400.0 / 15.37072592 / (2.0 * np.pi)) ** 2) ** (1.0 / 3.0)
    assert np.all(np.abs(radius / a - 1.0) < 3e-3)
    normal = np.cross(position[:-1], position[1:])
    inclination = np.degrees(np.arccos(normal[:, 2] / np.linalg.norm(normal, axis=1)))
    assert np.all(np.abs(inclination - 97.36) < 0.05)


def test_field_is_nearly_that_of_a_dipole_that_turns_with_the_earth(orbiting):
    """IGRF is turned from its own dipole by some ten degrees."""
    from astropy import units
    from astropy.coordinates import ITRS, TEME, CartesianRepresentation
    from astropy.time import Time
    from astropy.utils import iers

    slew = orbiting.slews[0]
    with iers.conf.set_temp("auto_download", False):
        at = Time(EPOCH) + (slew.start + slew.time) * units.s
        teme = TEME(CartesianRepresentation(slew.position_N.T * units.m), obstime=at)
        fixed = teme.transform_to(ITRS(obstime=at)).cartesian.xyz.to_value(units.m).T
    # Gauss coefficients of the dipole [nT], IGRF-13, epoch 2020.
    dipole = np.array([-1450.9, 4652.5, -29404.8])
    up = fixed / np.linalg.norm(fixed, axis=1, keepdims=True)

    def agreement(moment: np.ndarray) -> float:
        """Mean cosine between the field and that of a dipole."""
        right = 3.0 * (up @ moment)[:, None] * up - moment
        size = np.linalg.norm(right, axis=1) * np.linalg.norm(field, axis=1)
        return float(np.mean(np.sum(right * field, axis=1) / size))

    # Both axes share the pole: they differ by a turn about it.
    turn = np.angle((fixed[:, :2] @ [1, 1j]) / (slew.position_N[:, :2] @ [1, 1j]))
    field = np.array(slew.magnetic_field_N)
    flat = (field[:, :2] @ [1, 1j]) * np.exp(1j * turn)
    field[:, 0], field[:, 1] = flat.real, flat.imag
    assert agreement(dipole) > 0.95
    # Negative controls: the dipole at another longitude, and the field turned about.
    assert agreement(dipole * [-3.0, -3.0, 1.0]) < agreement(dipole) - 0.03
    assert agreement(-dipole) < -0.95


def test_the_first_row_is_at_the_start_whatever_its_own_clock_says(orbiting, tmp_path):
    late = replace(orbiting.slews[0], time=orbiting.slews[0].time + 50.0)
    again = with_orbit(replace(orbiting, slews=(late,)), tmp_path / "orbit.tle", EPOCH)
    np.testing.assert_array_equal(again.slews[0].position_N, orbiting.slews[0].position_N)


@pytest.mark.parametrize(
    ("text", "epoch", "says"),
    [
        ("nothing\n", EPOCH, "holds no two-line elements"),
        (ELEMENTS, "2021-01-01", "days away from the slews"),
        (ELEMENTS, "yesterday", "is no date"),
        (ELEMENTS, 5.0, "5.0 is no date"),
        (ELEMENTS, np.datetime64("2021-01-01"), "days away from the slews"),
    ],
)
def test_what_gives_no_orbit_is_said(tmp_path, text, epoch, says):
    tle = tmp_path / "orbit.tle"
    tle.write_text(text)
    with pytest.raises(CampaignError, match=says):
        with_orbit(tumbling(), tle, epoch)


def test_an_orbit_is_a_key_of_the_campaign_folder(tmp_path):
    folder = tmp_path / "in"
    field = 'type = "magnetic_field"\nvector = { stream = "all", names = ["bx", "by", "bz"], '
    orbit = f'type = "orbit"\ntle = "orbit.tle"\nepoch = "{EPOCH}"'
    make(folder, edited(TOML, (f'{field}unit = "T", frame = "inertial" }}', orbit)))
    assert "orbit.tle" in str(refusal(folder))
    (folder / "orbit.tle").write_text(ELEMENTS)
    campaign = read_campaign(folder)
    expected = with_orbit(campaign, folder / "orbit.tle", EPOCH)
    for slew, other in zip(campaign.slews, expected.slews, strict=True):
        np.testing.assert_array_equal(slew.magnetic_field_N, other.magnetic_field_N)
        np.testing.assert_array_equal(slew.position_N, other.position_N)
    before = campaign_sha256(folder)
    assert (copy_campaign(folder, tmp_path / "copy") / "orbit.tle").read_text() == ELEMENTS
    other = make(
        tmp_path / "other", edited((folder / "campaign.toml").read_text(), (EPOCH, "soon"))
    )
    (other / "orbit.tle").write_text(ELEMENTS)
    assert_teaches(refusal(other), ["other/campaign.toml, key environment.orbit.epoch", "no date"])
    (folder / "orbit.tle").write_text(ELEMENTS + "\n")
    assert campaign_sha256(folder) != before
