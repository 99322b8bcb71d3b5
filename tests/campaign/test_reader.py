"""Good campaign folders, read in SI units."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from support.campaign_files import (
    CSV,
    TOML,
    assert_same,
    edited,
    make,
)

import bayes_inertia
from bayes_inertia.campaign.reader import campaign_sha256, read_campaign
from bayes_inertia.campaign.writer import write_campaign


def test_reads_everything_in_si(tmp_path):
    campaign = read_campaign(make(tmp_path))
    assert (campaign.name, len(campaign.wheels), campaign.wheels[1].max_torque) == (
        "two slews",
        2,
        None,
    )
    assert campaign.rate_sensor.sigma == (2e-5, 2e-5, 2e-5)
    first, second = campaign.slews
    assert (first.name, first.axis_B, second.axis_B, second.start) == (
        "first",
        (1.0, 0.0, 0.0),
        None,
        100.0,
    )
    assert first.angle == pytest.approx(np.pi / 6)
    assert first.time.tolist() == [0.0, 0.25, 0.5, 0.75]
    assert first.wheel_torque[1].tolist() == [0.003, 0.004]
    assert np.isnan(first.rate[1]).tolist() == [False, True, False]
    assert np.isnan(first.attitude).all(axis=1).tolist() == [True, False, False, True]
    assert first.attitude[1].tolist() == [0.6, 0.0, 0.0, 0.8]
    assert first.magnetic_field_N[0].tolist() == [1e-5, 2e-5, 3e-5]


@pytest.mark.parametrize("mark", ["nan", "N/A", "null", "-"])
def test_marks_of_an_empty_cell_hold_no_reading(tmp_path, mark):
    marked = make(tmp_path / "marked", csv=CSV.replace("0.04,,0.06", f"0.04,{mark},0.06"))
    assert_same(read_campaign(marked), read_campaign(make(tmp_path / "empty")))


UNITS = [
    ('["t"], unit = "s"', '["t"], unit = "min"', lambda s: s.time[1], 15.0),
    ('["t"], unit = "s"', '["t"], unit = "ms"', lambda s: s.time[1], 2.5e-4),
    ('"rad/s" }', '"deg/s" }', lambda s: s.rate[0, 0], np.deg2rad(0.01)),
    ('acts_on = "wheel"', 'acts_on = "body"', lambda s: s.wheel_torque[1, 0], -0.003),
    ('unit = "N m", ', 'unit = "mN m", ', lambda s: s.wheel_torque[1, 0], 3e-6),
    (
        'wheel_momentum = { names = ["h1", "h2"], unit = "N m s"',
        'wheel_speed = { names = ["h1", "h2"], unit = "rad/s"',
        lambda s: s.wheel_momentum[0, 1],
        0.00042,
    ),
    (
        'wheel_momentum = { names = ["h1", "h2"], unit = "N m s"',
        'wheel_speed = { names = ["h1", "h2"], unit = "rpm"',
        lambda s: s.wheel_momentum[0, 1],
        0.00042 * np.pi / 30,
    ),
    (
        'maps = "inertial_to_body"',
        'maps = "body_to_inertial"',
        lambda s: s.attitude[1],
        [-0.6, 0.0, 0.0, 0.8],
    ),
    ('scalar = "last"', 'scalar = "first"', lambda s: s.attitude[1], [0.0, 0.0, 0.8, 0.6]),
    ('unit = "T"', 'unit = "nT"', lambda s: s.magnetic_field_N[0, 1], 2e-14),
    (
        'magnetic_field = { names = ["bx", "by", "bz"], unit = "T"',
        'position = { names = ["bx", "by", "bz"], unit = "km"',
        lambda s: s.position_N[0, 1],
        0.02,
    ),
]


@pytest.mark.parametrize(("old", "new", "value", "expected"), UNITS, ids=[row[1] for row in UNITS])
def test_units_and_senses(tmp_path, old, new, value, expected):
    toml = edited(TOML, (old, new))
    np.testing.assert_allclose(
        value(read_campaign(make(tmp_path, toml)).slews[0]), expected, rtol=1e-14
    )


def test_optional_parts_may_be_absent(tmp_path):
    wheels = TOML[TOML.index("[[wheels]]") : TOML.index("[rate_sensor]")]
    tracker = TOML[TOML.index("[star_tracker]") : TOML.index("[columns]")]
    columns = [
        line
        for line in TOML.splitlines(True)
        if line.startswith(("wheel_", "attitude", "magnetic"))
    ]
    campaign = read_campaign(
        make(tmp_path, edited(TOML, (wheels, ""), (tracker, ""), *((line, "") for line in columns)))
        / "campaign.toml"
    )
    assert campaign.wheels == ()
    assert campaign.star_tracker is None
    assert (
        campaign.slews[0].wheel_torque
        is campaign.slews[0].wheel_momentum
        is campaign.slews[0].attitude
        is campaign.slews[0].magnetic_field_N
        is None
    )


def test_numbers_or_triples_and_defaults(tmp_path):
    toml = edited(
        TOML,
        (
            "sigma = 2e-5",
            "sigma = [1e-5, 2e-5, 3e-5]\nbias_sigma = 1e-6\nscale_factor_sigma = [0.1, 0.2, "
            "0.3]\nrange = 1",
        ),
    )
    sensor = read_campaign(make(tmp_path, toml)).rate_sensor
    assert (sensor.sigma, sensor.bias_sigma, sensor.scale_factor_sigma, sensor.range) == (
        (1e-5, 2e-5, 3e-5),
        (1e-6,) * 3,
        (0.1, 0.2, 0.3),
        1.0,
    )
    assert sensor.scale_factor == (1.0, 1.0, 1.0)


def test_csv_survives_what_programs_add(tmp_path):
    plain = read_campaign(make(tmp_path / "plain"))
    header, *rows = CSV.splitlines()
    quoted = ",".join(f'"{name}"' for name in header.split(","))
    odd = "\ufeff" + "\r\n".join([quoted, *rows, "", ""]).replace(",idle", ',"idle, or\r\nnot"')
    folder = make(tmp_path / "odd")
    for name in ("a.csv", "b.csv"):
        (folder / name).write_bytes(odd.encode())
    assert_same(plain, read_campaign(folder))
    assert_same(
        plain, read_campaign(make(tmp_path / "nan", csv=CSV.replace(",,,,,", ",nan,NaN,nan, ,")))
    )


def test_no_digit_is_lost(tmp_path):
    values = ["0.1234567890123456", "999.7976931348623", "5e-324", "8.9884656743115785e-307"]
    campaign = read_campaign(
        make(
            tmp_path,
            csv=edited(
                CSV,
                (",0.01,", f",{values[0]},"),
                (",0.04,", f",{values[1]},"),
                (",0.07,", f",{values[2]},"),
                (",0.10,", f",{values[3]},"),
            ),
        )
    )
    assert campaign.slews[0].rate[:, 0].tolist() == [float(v) for v in values]


def test_digest_follows_content_only(tmp_path):
    folder = make(tmp_path / "one")
    digest = campaign_sha256(folder)
    assert len(digest) == 64
    assert digest == campaign_sha256(folder / "campaign.toml")
    (folder / "notes.txt").write_text("of no concern")
    shutil.copytree(folder, tmp_path / "moved")
    assert campaign_sha256(tmp_path / "moved") == digest
    (folder / "b.csv").write_text(CSV.replace("0.25", "0.26"))
    changed = campaign_sha256(folder)
    assert changed != digest
    (folder / "b.csv").write_text(CSV)
    (folder / "campaign.toml").write_text(TOML + "# a comment\n")
    assert campaign_sha256(folder) not in (digest, changed)


CAMPAIGNS = (
    Path(bayes_inertia.__file__).parent / "example",
    *sorted(path.parent for path in (Path(__file__).parents[1] / "data").glob("*/campaign.toml")),
)


@pytest.mark.parametrize("folder", CAMPAIGNS, ids=lambda path: path.name)
def test_telemetry_of_an_independent_simulator(folder, tmp_path):
    campaign = read_campaign(folder)
    assert campaign.has_commands
    assert campaign.has_tachometers
    assert len(campaign.wheels) == 3
    assert campaign.star_tracker.boresight_B == (0.0, 0.0, 1.0)
    for slew in campaign.slews:
        assert np.isfinite(slew.attitude).all(axis=1).sum() > 0
        assert not np.isnan(slew.rate).any()
    assert_same(campaign, read_campaign(write_campaign(campaign, tmp_path / "copy")))
