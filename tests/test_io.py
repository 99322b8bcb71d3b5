"""Campaign folders: every wrong input is one clear error, and what is written reads back as the same numbers."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pyarrow
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pyarrow import parquet

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import RateSensor, StarTracker, Wheel
from bayes_inertia.campaign.inertia_prior import InertiaPrior
from bayes_inertia.campaign.reader import campaign_sha256, read_campaign
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.campaign.writer import write_campaign
from bayes_inertia.errors import BayesInertiaError, CampaignError, OutputError
from bayes_inertia.files import write_atomically

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"

TOML = """\
format = "bayes-inertia-campaign/1"
name = "two slews"

[inertia]
tensor = [[3.0, 0.01, 0.0], [0.01, 2.0, 0.0], [0.0, 0.0, 2.0]]
relative_sigma = 0.04
product_sigma = 0.03
includes_wheel_spin = false

[[wheels]]
name = "x"
axis = [1.0, 0.0, 0.0]
spin_inertia = 0.001
momentum_sigma = 5e-6

[[wheels]]
name = "y"
axis = [0.0, 1.0, 0.0]
spin_inertia = 0.002

[rate_sensor]
sigma = 2e-5

[star_tracker]
boresight = [0.0, 0.0, 1.0]
sigma_cross = 2e-5
sigma_roll = 1e-4

[columns]
time = { names = ["t"], unit = "s" }
wheel_torque = { names = ["u1", "u2"], unit = "N m", acts_on = "wheel" }
wheel_momentum = { names = ["h1", "h2"], unit = "N m s", relative_to = "body" }
rate = { names = ["wx", "wy", "wz"], unit = "rad/s" }
attitude = { names = ["q1", "q2", "q3", "q4"], scalar = "last", maps = "inertial_to_body" }
magnetic_field = { names = ["bx", "by", "bz"], unit = "T", frame = "inertial" }

[[slews]]
name = "first"
file = "a.csv"
start = 0.0
axis = [1.0, 0.0, 0.0]
angle_deg = 30.0

[[slews]]
name = "second"
file = "b.csv"
start = 100
"""

CSV = """\
t,u1,u2,h1,h2,wx,wy,wz,q1,q2,q3,q4,bx,by,bz,mode
0,0.001,0.002,0.11,0.21,0.01,0.02,0.03,,,,,1e-5,2e-5,3e-5,idle
0.25,0.003,0.004,0.12,0.22,0.04,,0.06,0.6,0.0,0.0,0.8,1e-5,2e-5,3e-5,slew
0.5,0.005,0.006,0.13,0.23,0.07,0.08,0.09,0.0,0.0,0.0,1.0,1e-5,2e-5,3e-5,slew
0.75,0.007,0.008,0.14,0.24,0.10,0.11,0.12,,,,,1e-5,2e-5,3e-5,idle
"""


def make(folder: Path, toml: str = TOML, csv: str = CSV) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "campaign.toml").write_text(toml, encoding="utf-8")
    for name in ("a.csv", "b.csv"):
        (folder / name).write_text(csv, encoding="utf-8")
    return folder


def edited(text: str, *changes: tuple[str, str]) -> str:
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    return text


def cell(line: int, column: str, value: str) -> str:
    """CSV with one cell replaced; `line` as in a text editor."""
    lines = CSV.splitlines()
    cells = lines[line - 1].split(",")
    cells[lines[0].split(",").index(column)] = value
    lines[line - 1] = ",".join(cells)
    return "\n".join(lines) + "\n"


def assert_same(a: Campaign, b: Campaign, rtol: float = 0.0) -> None:
    """Same campaign; a star tracker or environment without a single value counts as absent."""

    def same(x, y, key: str):
        if key == "attitude" or key.endswith("_N"):
            x, y = (None if v is None or np.isnan(v).all() else v for v in (x, y))
        if x is None or y is None or isinstance(x, str | bool):
            assert x == y, key
        elif isinstance(x, tuple) and x and not isinstance(x[0], float):
            assert len(x) == len(y), key
            for one, other in zip(x, y, strict=True):
                same(one, other, key)
        elif hasattr(x, "__dataclass_fields__"):
            for name in x.__dataclass_fields__:
                same(getattr(x, name), getattr(y, name), name)
        else:
            np.testing.assert_allclose(
                x, y, rtol=1e-14 if key == "angle" else rtol, atol=0.0, err_msg=key
            )

    same(a, b, "campaign")


def refusal(folder: Path) -> CampaignError | None:
    """Why a folder cannot be read; any other exception passes through and fails the test."""
    try:
        read_campaign(folder)
    except CampaignError as error:
        return error
    return None


# ------------------------------------------------------------------------------- good input


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
            "sigma = [1e-5, 2e-5, 3e-5]\nbias_sigma = 1e-6\nscale_factor_sigma = [0.1, 0.2, 0.3]\nrange = 1",
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
    values = ["0.1234567890123456", "1.7976931348623157e+308", "5e-324", "8.9884656743115785e+307"]
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


# ------------------------------------------------------------------------------- bad descriptions, by key


BAD_TOML = [
    # what is wrong, change, and what the message must name
    ("syntax", [('name = "two slews"', "name = two slews")], ["campaign.toml, line 2", "TOML"]),
    (
        "syntax at the end",
        [("start = 100\n", "start = [100\n")],
        ["campaign.toml, line 47", "TOML"],
    ),
    (
        "a key twice",
        [("relative_sigma = 0.04", "relative_sigma = 0.04\nrelative_sigma = 0.05")],
        ["campaign.toml, line 7", "TOML"],
    ),
    ("huge integer", [("start = 100\n", f"start = {'9' * 5000}\n")], ["campaign.toml", "TOML"]),
    ("other format", [("campaign/1", "campaign/2")], ["key format", "bayes-inertia-campaign/1"]),
    ("no format", [('format = "bayes-inertia-campaign/1"\n', "")], ["key format", "missing"]),
    (
        "unknown key",
        [("product_sigma", "product_sgima")],
        ["key inertia.product_sgima", 'did you mean "product_sigma"'],
    ),
    (
        "unknown section",
        [("[star_tracker]", "[startracker]")],
        ["key startracker", 'did you mean "star_tracker"'],
    ),
    (
        "unknown column",
        [("magnetic_field =", "magfield =")],
        ["key columns.magfield", 'did you mean "magnetic_field"'],
    ),
    (
        "unknown key in a column",
        [('scalar = "last"', 'scalars = "last"')],
        ["key columns.attitude.scalars", '"scalar"'],
    ),
    (
        "unknown key of a wheel",
        [("momentum_sigma", "sigma_momentum")],
        ["key wheels.x.sigma_momentum", '"momentum_sigma"'],
    ),
    (
        "key of another section",
        [("sigma = 2e-5", "sigma = 2e-5\nboresight = 1")],
        ["key rate_sensor.boresight", "[star_tracker]"],
    ),
    (
        "key like no other",
        [("start = 100", "start = 100\nzzzzzz = 1")],
        ["key slews.second.zzzzzz", "known here: name, file, start, axis, angle_deg"],
    ),
    ("no time unit", [(', unit = "s"', "")], ["key columns.time.unit", '"ms"', "never guessed"]),
    (
        "no rate unit",
        [(', unit = "rad/s"', "")],
        ["key columns.rate.unit", '"deg/s"', "never guessed"],
    ),
    (
        "no torque unit",
        [(', unit = "N m", acts', ", acts")],
        ["key columns.wheel_torque.unit", "never guessed"],
    ),
    (
        "no torque sense",
        [(', acts_on = "wheel"', "")],
        ["key columns.wheel_torque.acts_on", '"wheel" or "body"', "never guessed"],
    ),
    (
        "no momentum unit",
        [(', unit = "N m s", rel', ", rel")],
        ["key columns.wheel_momentum.unit", "never guessed"],
    ),
    (
        "no momentum sense",
        [(', relative_to = "body"', "")],
        ["key columns.wheel_momentum.relative_to", "never guessed"],
    ),
    (
        "no scalar place",
        [(', scalar = "last"', "")],
        ["key columns.attitude.scalar", '"first" or "last"', "never guessed"],
    ),
    (
        "no attitude sense",
        [(', maps = "inertial_to_body"', "")],
        ["key columns.attitude.maps", "never guessed"],
    ),
    ("no field unit", [(', unit = "T"', "")], ["key columns.magnetic_field.unit", "never guessed"]),
    (
        "no field frame",
        [(', frame = "inertial"', "")],
        ["key columns.magnetic_field.frame", "never guessed"],
    ),
    (
        "field in body axes",
        [('frame = "inertial"', 'frame = "body"')],
        ["key columns.magnetic_field.frame", "rotate"],
    ),
    (
        "momentum relative to stars",
        [('relative_to = "body"', 'relative_to = "inertial"')],
        ["key columns.wheel_momentum.relative_to", "subtract"],
    ),
    (
        "unknown unit",
        [('unit = "rad/s"', 'unit = "rpm"')],
        ["key columns.rate.unit", "'rpm' is not one of", '"deg/s"'],
    ),
    ("no time", [('time = { names = ["t"], unit = "s" }\n', "")], ["key columns.time", "missing"]),
    (
        "no rate",
        [('rate = { names = ["wx", "wy", "wz"], unit = "rad/s" }\n', "")],
        ["key columns.rate", "missing"],
    ),
    ("no noise", [("sigma = 2e-5\n", "")], ["key rate_sensor.sigma", "[rad/s]"]),
    (
        "no sense of J",
        [("includes_wheel_spin = false\n", "")],
        ["key inertia.includes_wheel_spin", "missing"],
    ),
    ("no file", [('file = "b.csv"\n', "")], ["key slews.second.file", "missing"]),
    ("unnamed slew", [('name = "second"\n', "")], ["key slews[2 of 2].name", "missing"]),
    ("no slews", [(TOML[TOML.index("[[slews]]") :], "")], ["key slews", "missing"]),
    (
        "number in quotes",
        [("spin_inertia = 0.002", 'spin_inertia = "0.002"')],
        ["key wheels.y.spin_inertia", "'0.002' is not a number"],
    ),
    (
        "truth for a number",
        [("relative_sigma = 0.04", "relative_sigma = true")],
        ["key inertia.relative_sigma", "True is not a number"],
    ),
    (
        "number for truth",
        [("includes_wheel_spin = false", "includes_wheel_spin = 0")],
        ["key inertia.includes_wheel_spin", "true"],
    ),
    ("number for text", [('name = "two slews"', "name = 2")], ["key name", "2 is not text"]),
    (
        "nan",
        [("product_sigma = 0.03", "product_sigma = nan")],
        ["key inertia.product_sigma", "finite"],
    ),
    ("inf", [("start = 100", "start = inf")], ["key slews.second.start", "finite"]),
    (
        "inf in a triple",
        [("sigma = 2e-5", "sigma = [1e-5, inf, 1e-5]")],
        ["key rate_sensor.sigma", "finite"],
    ),
    (
        "two sigmas",
        [("sigma = 2e-5", "sigma = [1e-5, 1e-5]")],
        ["key rate_sensor.sigma", "3 items"],
    ),
    ("text sigma", [("sigma = 2e-5", 'sigma = "2e-5"')], ["key rate_sensor.sigma", "'2e-5'"]),
    ("tensor of two rows", [(", [0.0, 0.0, 2.0]]", "]")], ["key inertia.tensor", "3 items"]),
    (
        "short row of tensor",
        [("[0.01, 2.0, 0.0]", "[0.01, 2.0]")],
        ["key inertia.tensor[2 of 3]", "3 items"],
    ),
    (
        "name for names",
        [('names = ["t"]', 'names = "t"')],
        ["key columns.time.names", "not a list"],
    ),
    (
        "two time columns",
        [('names = ["t"]', 'names = ["t", "mode"]')],
        ["key columns.time.names", "1 item"],
    ),
    (
        "three quaternion columns",
        [('"q3", "q4"', '"q3"')],
        ["key columns.attitude.names", "4 items"],
    ),
    (
        "single brackets",
        [(TOML[TOML.index('[[slews]]\nname = "second"') :], ""), ("[[slews]]", "[slews]")],
        ["key slews", "[[slews]]"],
    ),
    (
        "number for a section",
        [
            (TOML[TOML.index("[star_tracker]") : TOML.index("[columns]")], ""),
            ("[inertia]", "star_tracker = 3\n[inertia]"),
        ],
        ["key star_tracker", "not a table"],
    ),
    (
        "too few torques",
        [('names = ["u1", "u2"]', 'names = ["u1"]')],
        ["key columns.wheel_torque.names", "1 column(s) for 2 [[wheels]]"],
    ),
    (
        "torques without wheels",
        [(TOML[TOML.index("[[wheels]]") : TOML.index("[rate_sensor]")], "")],
        ["key columns.wheel_torque.names", "0 [[wheels]]"],
    ),
    (
        "attitude without tracker",
        [(TOML[TOML.index("[star_tracker]") : TOML.index("[columns]")], "")],
        ["key columns.attitude", "[star_tracker]"],
    ),
    (
        "speed and momentum",
        [
            (
                "[[slews]]",
                'wheel_speed = { names = ["a", "b"], unit = "rpm", relative_to = "body" }\n[[slews]]',
            )
        ],
        ["key columns.wheel_speed", "keep one"],
    ),
    (
        "column used twice",
        [('"wx", "wy"', '"wx", "wx"')],
        ["key columns.rate.names", "'wx'", "once"],
    ),
    (
        "column in two roles",
        [('"wx", "wy"', '"h1", "wy"')],
        ["key columns.wheel_momentum.names", "'h1'", "used by rate"],
    ),
    (
        "negative sigma",
        [("sigma = 2e-5", "sigma = -2e-5")],
        ["campaign.toml, key rate_sensor.sigma", "positive"],
    ),
    (
        "axis not unit",
        [("axis = [0.0, 1.0, 0.0]", "axis = [0.0, 2.0, 0.0]")],
        ["campaign.toml, key wheels.y.axis", "unit"],
    ),
    (
        "slew axis zero",
        [("start = 0.0\naxis = [1.0", "start = 0.0\naxis = [0.0")],
        ["campaign.toml, key slews.first.axis", "unit"],
    ),
    (
        "impossible body",
        [("[[3.0,", "[[9.0,")],
        ["campaign.toml, key inertia.tensor", "sum of the other two"],
    ),
    (
        "asymmetric tensor",
        [("[[3.0, 0.01", "[[3.0, 0.02")],
        ["campaign.toml, key inertia.tensor", "symmetric"],
    ),
    (
        "two wheels of one name",
        [('name = "y"', 'name = "x"')],
        ["campaign.toml, key wheels", "twice"],
    ),
    (
        "two slews of one name",
        [('name = "second"', 'name = "first"')],
        ["campaign.toml, key slews", "twice"],
    ),
    (
        "one table for two slews",
        [('file = "b.csv"', 'file = "a.csv"')],
        ["key slews.second.file", "two slews"],
    ),
    (
        "parent folder",
        [('file = "b.csv"', 'file = "../b.csv"')],
        ["key slews.second.file", "outside the campaign folder"],
    ),
    (
        "parent folder, inside",
        [('file = "b.csv"', 'file = "x/../../b.csv"')],
        ["key slews.second.file", "outside the campaign folder"],
    ),
    (
        "absolute path",
        [('file = "b.csv"', 'file = "/etc/passwd"')],
        ["key slews.second.file", "outside the campaign folder"],
    ),
    (
        "Windows path",
        [('file = "b.csv"', "file = 'C:\\b.csv'")],
        ["key slews.second.file", "outside the campaign folder"],
    ),
    (
        "Windows parent",
        [('file = "b.csv"', "file = '..\\b.csv'")],
        ["key slews.second.file", "outside the campaign folder"],
    ),
    (
        "missing table",
        [('file = "b.csv"', 'file = "c.csv"')],
        ["key slews.second.file", "'c.csv' does not exist"],
    ),
    (
        "a folder for a table",
        [('file = "b.csv"', 'file = "."')],
        ["key slews.second.file", "not a file"],
    ),
    (
        "a name too long",
        [('file = "b.csv"', f'file = "{"b" * 5000}.csv"')],
        ["key slews.second.file"],
    ),
    (
        "unknown table format",
        [('file = "b.csv"', 'file = "campaign.toml"')],
        ["campaign.toml", ".parquet"],
    ),
    (
        "missing column",
        [('"wx", "wy"', '"wx", "w_y"')],
        ["a.csv, line 1", "'w_y'", "did you mean 'wy'", "The table has: t, u1"],
    ),
]


def assert_teaches(error: BayesInertiaError, named: list[str]) -> None:
    text = str(error)
    for part in named:
        assert part in text, f"{part!r} not in {text!r}"
    assert error.where, text
    assert error.advice, text
    assert len(text) < 1200, text
    assert "\n" not in text
    assert "pydantic" not in text


@pytest.mark.parametrize(
    ("changes", "named"), [row[1:] for row in BAD_TOML], ids=[row[0] for row in BAD_TOML]
)
def test_bad_description(tmp_path, changes, named):
    folder = make(tmp_path, edited(TOML, *changes))
    with pytest.raises(CampaignError) as caught:
        read_campaign(folder)
    assert_teaches(caught.value, named)


# ------------------------------------------------------------------------------- bad telemetry, by line


BAD_CSV = [
    ("empty file", "", ["a.csv, line 1", "empty"]),
    ("only a header", CSV.splitlines()[0], ["a.csv", "0 row(s)"]),
    ("one row", "\n".join(CSV.splitlines()[:2]), ["a.csv", "1 row(s)"]),
    ("short line", CSV.replace("0.06,0.6,", "0.06,"), ["a.csv, line 3", "15 cells", "16"]),
    ("long line", CSV.replace("0.06,0.6,", "0.06,0.6,0.6,"), ["a.csv, line 3", "17 cells", "16"]),
    ("long first line", CSV.replace("\n0,", "\n0,0,"), ["a.csv, line 2", "17 cells"]),
    (
        "all lines long",
        CSV.replace(",idle", ",idle,").replace(",slew", ",slew,"),
        ["a.csv, line 2", "17 cells"],
    ),
    ("decimal comma", CSV.replace("0.25,", "0,25,"), ["a.csv, line 3", "decimal points"]),
    (
        "quoted decimal comma",
        CSV.replace("0.25,", '"0,25",'),
        ["a.csv, line 3, column t", "decimal point, not a comma"],
    ),
    ("semicolons", CSV.replace(",", ";"), ["a.csv, line 1", "semicolons"]),
    ("tabs", CSV.replace(",", "\t"), ["a.csv, line 1", "tabs"]),
    ("column twice", CSV.replace("mode", "wx"), ["a.csv, line 1", "two columns are named 'wx'"]),
    (
        "column missing",
        CSV.replace("wx", "w_x"),
        ["a.csv, line 1", "no column 'wx'", "did you mean 'w_x'"],
    ),
    ("text", cell(4, "wx", "high"), ["a.csv, line 4, column wx", "'high' is not a number"]),
    ("long text", cell(4, "wx", "x" * 9000), ["a.csv, line 4, column wx", "..."]),
    (
        "quaternion beyond all numbers",
        cell(4, "q4", "1e300"),
        ["a.csv, line 4, columns q1, q2, q3, q4", "length inf"],
    ),
    ("underscore", cell(4, "wx", "1_000"), ["a.csv, line 4, column wx", "'1_000'"]),
    ("date", cell(4, "t", "2024-01-01T00:00:00"), ["a.csv, line 4, column t", "seconds"]),
    ("infinity", cell(5, "wz", "inf"), ["a.csv, line 5, column wz", "infinite"]),
    (
        "infinity in the quaternion",
        cell(4, "q4", "-Infinity"),
        ["a.csv, line 4, column q4", "infinite"],
    ),
    ("overflow", cell(5, "wz", "1e999"), ["a.csv, line 5, column wz", "infinite"]),
    ("empty time", cell(4, "t", ""), ["a.csv, line 4, column t", "empty"]),
    ("nan time", cell(4, "t", "nan"), ["a.csv, line 4, column t", "empty"]),
    (
        "repeated time",
        cell(4, "t", "0.25"),
        ["a.csv, line 4, column t", "0.25 is repeated", "line 3"],
    ),
    (
        "time goes back",
        cell(5, "t", "0.1"),
        ["a.csv, line 5, column t", "goes back from 0.5 to 0.1"],
    ),
    (
        "lines counted over empty ones",
        cell(5, "t", "0.1").replace("\n0.5", "\n\n\n0.5"),
        ["a.csv, line 7, column t", "line 6"],
    ),
    ("zero quaternion", cell(4, "q4", "0"), ["a.csv, line 4, columns q1, q2, q3, q4", "length 0"]),
    (
        "quaternion not unit",
        cell(4, "q4", "0.9"),
        ["a.csv, line 4, columns q1, q2, q3, q4", "length 0.9"],
    ),
    (
        "quaternion incomplete",
        cell(4, "q2", ""),
        ["a.csv, line 4, columns q1, q2, q3, q4", "incomplete"],
    ),
    (
        "quaternion almost empty",
        cell(5, "q2", "0.0"),
        ["a.csv, line 5, columns q1, q2, q3, q4", "incomplete"],
    ),
    ("empty command", cell(3, "u2", ""), ["a.csv, line 3, column u2", "empty"]),
    ("empty momentum", cell(5, "h1", "  "), ["a.csv, line 5, column h1", "empty"]),
    ("gap in the field", cell(5, "by", ""), ["a.csv, line 5, column by", "empty"]),
    ("open quote", CSV.replace(",slew", ',"slew', 1), ["a.csv, line 3", "quote"]),
    ("huge cell", cell(3, "mode", "x" * 200_000), ["a.csv, line 3", "CSV"]),
]


@pytest.mark.parametrize(
    ("csv", "named"), [row[1:] for row in BAD_CSV], ids=[row[0] for row in BAD_CSV]
)
def test_bad_telemetry(tmp_path, csv, named):
    folder = make(tmp_path, csv=csv)
    with pytest.raises(CampaignError) as caught:
        read_campaign(folder)
    assert_teaches(caught.value, named)


@pytest.mark.parametrize("column", ["t", "wy", "u1", "h2", "bx"])
def test_a_column_that_is_empty_everywhere(tmp_path, column):
    lines = CSV.splitlines()
    at = lines[0].split(",").index(column)
    rows = [row.split(",") for row in lines[1:]]
    csv = "\n".join([lines[0], *(",".join([*row[:at], "", *row[at + 1 :]]) for row in rows)])
    with pytest.raises(CampaignError) as caught:
        read_campaign(make(tmp_path, csv=csv))
    assert_teaches(caught.value, [f"a.csv, column {column}", "every cell is empty"])


def test_a_slew_without_any_fix_or_field(tmp_path):
    folder = make(tmp_path)
    csv = (
        CSV.replace("1e-5,2e-5,3e-5", ",,")
        .replace("0.6,0.0,0.0,0.8", ",,,")
        .replace("0.0,0.0,0.0,1.0", ",,,")
    )
    (folder / "b.csv").write_text(csv)
    first, second = read_campaign(folder).slews
    assert first.attitude is not None
    assert second.attitude is second.magnetic_field_N is None


@pytest.mark.parametrize("name", ["campaign.toml", "b.csv"])
def test_not_utf8(tmp_path, name):
    path = make(tmp_path) / name
    path.write_bytes(path.read_bytes().replace(b"slew", b"sl\xe9w", 1))
    line = {"campaign.toml": 2, "b.csv": 3}[name]
    with pytest.raises(CampaignError) as caught:
        read_campaign(tmp_path)
    assert_teaches(caught.value, [f"{name}, line {line}", "UTF-8"])


def test_not_a_campaign(tmp_path):
    for path, named in [(tmp_path, "no campaign.toml"), (tmp_path / "nowhere", "does not exist")]:
        for function in (read_campaign, campaign_sha256):
            with pytest.raises(CampaignError) as caught:
                function(path)
            assert_teaches(caught.value, [str(path), named])


def test_symlinks_may_not_leave_the_folder(tmp_path):
    folder = make(tmp_path / "campaign")
    outside = tmp_path / "outside.csv"
    outside.write_text(CSV)
    (folder / "b.csv").unlink()
    (folder / "b.csv").symlink_to(outside)
    with pytest.raises(CampaignError) as caught:
        read_campaign(folder)
    assert_teaches(caught.value, ["key slews.second.file", "links to a place outside"])
    (folder / "b.csv").unlink()
    (folder / "inner.csv").write_text(CSV)
    (folder / "b.csv").symlink_to("inner.csv")
    (tmp_path / "alias").symlink_to(folder)
    assert len(read_campaign(tmp_path / "alias").slews) == 2


@given(position=st.integers(0, len(TOML) - 1), junk=st.text(max_size=3))
@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_damaged_descriptions_never_end_in_a_traceback(tmp_path, position, junk):
    folder = make(tmp_path, TOML[:position] + junk + TOML[position + 1 :])
    error = refusal(folder)
    assert error is None or (error.where and error.advice)


@given(position=st.integers(0, len(CSV) - 1), junk=st.text(max_size=3))
@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_damaged_tables_never_end_in_a_traceback(tmp_path, position, junk):
    folder = make(tmp_path, csv=CSV[:position] + junk + CSV[position + 1 :])
    error = refusal(folder)
    assert error is None or (error.where and error.advice)


# ------------------------------------------------------------------------------- Parquet, HDF5, MAT


def table_columns() -> dict[str, np.ndarray]:
    header, *rows = CSV.splitlines()
    cells = np.array([[float(c or "nan") for c in row.split(",")[:-1]] for row in rows])
    return dict(zip(header.split(","), cells.T, strict=False))


def save_parquet(path: Path, columns: dict) -> None:
    parquet.write_table(
        pyarrow.table(
            {name: pyarrow.array(values, from_pandas=True) for name, values in columns.items()}
        ),
        path,
    )


def save_hdf5(path: Path, columns: dict, group: str = "/") -> None:
    with h5py.File(path, "a") as file:
        for name, values in columns.items():
            file.require_group(group)[name] = values


def save_mat(path: Path, columns: dict) -> None:
    scipy.io.savemat(path, columns)


def with_table(folder: Path, suffix: str) -> Path:
    return make(folder, TOML.replace(".csv", suffix))


SAVERS = {".parquet": save_parquet, ".h5": save_hdf5, ".hdf5": save_hdf5, ".mat": save_mat}


@pytest.mark.parametrize("suffix", SAVERS)
def test_other_formats_give_the_same_campaign(tmp_path, suffix):
    folder = with_table(tmp_path / "other", suffix)
    for name in "ab":
        SAVERS[suffix](folder / f"{name}{suffix}", table_columns())
    assert_same(read_campaign(make(tmp_path / "csv")), read_campaign(folder))


def test_parquet_null_and_integer(tmp_path):
    folder = with_table(tmp_path, ".parquet")
    for name in "ab":
        columns = table_columns() | {"t": np.arange(4), "wx": [None, 1, 2, 3], "mode": list("abcd")}
        save_parquet(folder / f"{name}.parquet", columns)
    slew = read_campaign(folder).slews[0]
    assert slew.time.tolist() == [0.0, 1.0, 2.0, 3.0]
    assert np.isnan(slew.rate[:, 0]).tolist() == [True, False, False, False]


def test_groups_and_structs(tmp_path):
    """One HDF5 or MAT file may hold all slews, each in the group (struct) of its name; a lone group needs no name."""
    expected = read_campaign(make(tmp_path / "csv"))
    folder = make(tmp_path / "h5", TOML.replace("a.csv", "all.h5").replace("b.csv", "all.h5"))
    for group in ("first", "second"):
        save_hdf5(folder / "all.h5", table_columns(), f"logs/{group}")
    assert_same(expected, read_campaign(folder))
    folder = make(tmp_path / "mat", TOML.replace("a.csv", "all.mat").replace("b.csv", "all.mat"))
    save_mat(folder / "all.mat", {"first": table_columns(), "second": table_columns()})
    assert_same(expected, read_campaign(folder))
    folder = with_table(tmp_path / "v73", ".mat")
    for name in "ab":
        save_hdf5(
            folder / f"{name}.mat", {k: v[None, :] for k, v in table_columns().items()}, "anything"
        )
    assert_same(expected, read_campaign(folder))


def test_groups_that_cannot_be_told_apart(tmp_path):
    folder = with_table(tmp_path, ".h5")
    for group in ("x", "y"):
        save_hdf5(folder / "a.h5", table_columns(), group)
    shutil.copy(folder / "a.h5", folder / "b.h5")
    with pytest.raises(CampaignError) as caught:
        read_campaign(folder)
    assert_teaches(caught.value, ["a.h5", "/x, /y"])


COLUMN = table_columns()
BAD_BINARY = [
    ("missing column", {"wx": None}, ["no column 'wx'", "The table has"]),
    ("text", {"wx": ["a", "b", "c", "d"]}, ["column wx", "not", "numbers"]),
    ("truth", {"wx": np.array([True, False, True, False])}, ["column wx", "numbers"]),
    ("infinite", {"wx": np.array([0.0, np.inf, 0.0, 0.0])}, ["row 2, column wx", "infinite"]),
    ("repeated time", {"t": np.array([0.0, 1.0, 1.0, 2.0])}, ["row 3, column t", "repeated"]),
    (
        "32-bit time",
        {"t": (1.7e9 + 0.25 * np.arange(4)).astype(np.float32)},
        ["column t", "32 bits"],
    ),
]


# MATLAB stores truth values as small integers, so they cannot be told from numbers there.
BINARY_CASES = [
    (suffix, row)
    for suffix in (".parquet", ".h5", ".mat")
    for row in BAD_BINARY
    if (suffix, row[0]) != (".mat", "truth")
]


@pytest.mark.parametrize(
    ("suffix", "changes", "named"),
    [(suffix, *row[1:]) for suffix, row in BINARY_CASES],
    ids=[f"{s} {r[0]}" for s, r in BINARY_CASES],
)
def test_bad_binary_tables(tmp_path, suffix, changes, named):
    folder = with_table(tmp_path, suffix)
    for name in "ab":
        SAVERS[suffix](
            folder / f"{name}{suffix}",
            {k: v for k, v in (COLUMN | changes).items() if v is not None},
        )
    with pytest.raises(CampaignError) as caught:
        read_campaign(folder)
    assert_teaches(caught.value, [f"a{suffix}", *named])


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"wx": np.zeros(3)}, ["column wx", "3 rows"]),
        ({"wx": np.zeros((4, 2))}, ["column wx", "(4, 2)"]),
    ],
    ids=["rows", "matrix"],
)
@pytest.mark.parametrize("suffix", [".h5", ".mat"])
def test_datasets_that_are_no_columns(tmp_path, suffix, changes, named):
    folder = with_table(tmp_path, suffix)
    for name in "ab":
        SAVERS[suffix](folder / f"{name}{suffix}", COLUMN | changes)
    with pytest.raises(CampaignError) as caught:
        read_campaign(folder)
    assert_teaches(caught.value, [f"a{suffix}", *named])


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"not a table\n" * 100,
        b"MATLAB 5.0 MAT-file" + bytes(200),
        b"\x89HDF\r\n\x1a\n" + bytes(99),
        b"PAR1" + bytes(50) + b"PAR1",
    ],
)
@pytest.mark.parametrize("suffix", [".parquet", ".h5", ".mat"])
def test_damaged_binary_tables(tmp_path, suffix, content):
    folder = with_table(tmp_path, suffix)
    for name in "ab":
        (folder / f"{name}{suffix}").write_bytes(content)
    with pytest.raises(CampaignError) as caught:
        read_campaign(folder)
    assert caught.value.where.startswith(str(folder / f"a{suffix}"))
    assert caught.value.advice


@pytest.mark.parametrize("soft", [False, True], ids=["external", "through a soft link"])
def test_hdf5_links_may_not_leave_the_file(tmp_path, soft):
    save_hdf5(tmp_path / "outside.h5", COLUMN)
    folder = with_table(tmp_path / "campaign", ".h5")
    for name in "ab":
        save_hdf5(folder / f"{name}.h5", {k: v for k, v in COLUMN.items() if k != "wx"})
        with h5py.File(folder / f"{name}.h5", "a") as file:
            file["elsewhere" if soft else "wx"] = h5py.ExternalLink(
                str(tmp_path / "outside.h5"), "/wx"
            )
            if soft:
                file["wx"] = h5py.SoftLink("/elsewhere")
    with pytest.raises(CampaignError) as caught:
        read_campaign(folder)
    assert_teaches(caught.value, ["a.h5, column wx", "links to another file"])


# ------------------------------------------------------------------------------- writing


def test_write_then_read(tmp_path):
    campaign = read_campaign(make(tmp_path / "in"))
    folder = write_campaign(campaign, tmp_path / "out" / "deeper")
    assert sorted(p.name for p in folder.iterdir()) == [
        "campaign.toml",
        "slew_01.csv",
        "slew_02.csv",
    ]
    again = read_campaign(folder)
    assert_same(campaign, again)
    digest = campaign_sha256(folder)
    assert write_campaign(again, folder) == folder
    assert campaign_sha256(folder) == digest


def test_never_overwrites_another_campaign(tmp_path):
    campaign = read_campaign(make(tmp_path / "in"))
    folder = write_campaign(campaign, tmp_path / "out")
    before = {p.name: p.read_bytes() for p in folder.iterdir()}
    other = replace(
        campaign,
        slews=(replace(campaign.slews[0], rate=campaign.slews[0].rate * 2), campaign.slews[1]),
    )
    for another in (other, replace(campaign, name="other")):
        with pytest.raises(OutputError) as caught:
            write_campaign(another, folder)
        assert_teaches(caught.value, [str(folder), "overwrite"])
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == before
    (folder / "campaign.toml").unlink()
    (folder / "slew_02.csv").unlink()
    write_campaign(campaign, folder)
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == before


def test_refuses_what_could_not_be_read_back(tmp_path):
    campaign = read_campaign(make(tmp_path / "in"))
    first, second = campaign.slews
    gap = first.wheel_momentum.copy()
    gap[2, 1] = np.nan
    for slew, named in [
        (replace(first, wheel_torque=None), "no wheel_torque"),
        (replace(first, wheel_momentum=gap), "gap in row 3"),
    ]:
        with pytest.raises(OutputError) as caught:
            write_campaign(replace(campaign, slews=(slew, second)), tmp_path / "out")
        assert_teaches(caught.value, ["slew first", named])
    assert not (tmp_path / "out").exists()
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError):
        write_campaign(campaign, tmp_path / "file")


NUMBER = st.floats(-1e6, 1e6, allow_subnormal=True)
POSITIVE = st.floats(1e-9, 1e3)


def arrays(draw, rows: int, columns: int, gaps: bool):
    element = st.one_of(NUMBER, st.just(float("nan"))) if gaps else NUMBER
    return np.array(
        draw(
            st.lists(
                st.lists(element, min_size=columns, max_size=columns), min_size=rows, max_size=rows
            )
        )
    )


def unit(draw, size: int):
    vector = np.array(
        draw(
            st.lists(st.floats(-1, 1), min_size=size, max_size=size).filter(
                lambda v: np.linalg.norm(v) > 0.1
            )
        )
    )
    return tuple((vector / np.linalg.norm(vector)).tolist())


@st.composite
def campaigns(draw) -> Campaign:
    wheels = tuple(
        Wheel(
            name,
            unit(draw, 3),
            draw(POSITIVE),
            momentum_sigma=draw(st.none() | POSITIVE),
            max_torque=draw(st.none() | POSITIVE),
        )
        for name in draw(st.lists(st.text(max_size=5), max_size=3, unique=True))
    )
    tracker = draw(st.none() | st.builds(StarTracker, st.just(unit(draw, 3)), POSITIVE, POSITIVE))
    torque, momentum, field = (draw(st.booleans()) for _ in range(3))
    slews = []
    for name in draw(st.lists(st.text(max_size=5), min_size=1, max_size=3, unique=True)):
        time = np.array(sorted(draw(st.lists(NUMBER, min_size=2, max_size=5, unique=True))))
        rows = len(time)
        rate = arrays(draw, rows, 3, gaps=True)
        rate[0] = draw(NUMBER)
        fixes = np.array(
            [unit(draw, 4) if draw(st.booleans()) else (np.nan,) * 4 for _ in range(rows)]
        )
        slews.append(
            Slew(
                name,
                draw(NUMBER),
                time,
                rate=rate,
                attitude=fixes if tracker and draw(st.booleans()) else None,
                wheel_torque=arrays(draw, rows, len(wheels), gaps=False)
                if torque and wheels
                else None,
                wheel_momentum=arrays(draw, rows, len(wheels), gaps=False)
                if momentum and wheels
                else None,
                magnetic_field_N=arrays(draw, rows, 3, gaps=False)
                if field and draw(st.booleans())
                else None,
                axis_B=draw(st.none() | st.just(unit(draw, 3))),
                angle=draw(st.none() | NUMBER),
            )
        )
    prior = InertiaPrior(
        np.diag([3.0, 2.0, 2.0]) * draw(POSITIVE),
        draw(POSITIVE),
        draw(POSITIVE),
        draw(st.booleans()),
    )
    sensor = RateSensor(
        sigma=draw(POSITIVE),
        range=draw(st.none() | POSITIVE),
        bias=tuple(draw(st.tuples(NUMBER, NUMBER, NUMBER))),
    )
    return Campaign(draw(st.text(max_size=20)), prior, wheels, sensor, tracker, tuple(slews))


@given(campaign=campaigns())
@settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
def test_any_campaign_survives_writing(tmp_path, campaign):
    folder = tmp_path / "round_trip"
    shutil.rmtree(folder, ignore_errors=True)
    again = read_campaign(write_campaign(campaign, folder))
    assert_same(campaign, again)
    write_campaign(again, folder)  # identical to the last byte, or it would refuse


# ------------------------------------------------------------------------------- digest and atomic writes


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


@pytest.mark.parametrize(
    "content",
    [b"new", "new", lambda path: path.write_bytes(b"new")],
    ids=["bytes", "text", "function"],
)
def test_atomic_write(tmp_path, content):
    path = tmp_path / "result.nc"
    path.write_bytes(b"old")
    assert write_atomically(path, content) == path
    assert path.read_bytes() == b"new"
    assert [p.name for p in tmp_path.iterdir()] == ["result.nc"]


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "result.nc"
    path.write_bytes(b"old")

    def fails(temporary: Path):
        assert (temporary.parent, temporary.suffix) == (tmp_path, ".nc")
        temporary.write_bytes(b"half")
        raise ValueError("interrupted")

    with pytest.raises(ValueError, match="interrupted"):
        write_atomically(path, fails)
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("result.nc", b"old")]
    for bad in (tmp_path / "no" / "folder.txt", path / "below.txt"):
        with pytest.raises(OutputError) as caught:
            write_atomically(bad, b"")
        assert_teaches(caught.value, [str(bad), "cannot be written"])


def test_written_files_have_ordinary_permissions(tmp_path):
    plain = tmp_path / "plain"
    plain.write_bytes(b"")
    assert os.stat(write_atomically(tmp_path / "atomic", b"")).st_mode == plain.stat().st_mode


# ------------------------------------------------------------------------------- telemetry at hand


def shared(kind: str) -> list:
    folders = sorted(p.parent for p in SHARED.glob(f"{kind}/*/campaign.toml"))
    return folders or [
        pytest.param(None, marks=pytest.mark.skip(reason=f"../shared/data/{kind} is not there"))
    ]


@pytest.mark.parametrize("folder", shared("basilisk"), ids=lambda p: getattr(p, "name", "absent"))
def test_basilisk_telemetry(folder, tmp_path):
    campaign = read_campaign(folder)
    assert campaign.has_commands
    assert campaign.has_tachometers
    assert (len(campaign.wheels), len(campaign.slews), campaign.star_tracker.boresight_B) == (
        3,
        5,
        (0.0, 0.0, 1.0),
    )
    for slew in campaign.slews:
        assert np.isfinite(slew.attitude).all(axis=1).sum() > 0
        assert slew.position_N.shape == slew.magnetic_field_N.shape == (len(slew.time), 3)
        assert not np.isnan(slew.rate).any()
    assert_same(campaign, read_campaign(write_campaign(campaign, tmp_path / "copy")))


@pytest.mark.parametrize("folder", shared("delft"), ids=lambda p: getattr(p, "name", "absent"))
def test_delft_telemetry(folder):
    campaign = read_campaign(folder)
    assert not campaign.has_commands
    assert campaign.has_tachometers
    assert campaign.star_tracker is None
    assert campaign.inertia.includes_wheel_spin
    momentum = np.concatenate([slew.wheel_momentum for slew in campaign.slews])
    assert 1e-5 < np.abs(momentum).max() < 1e-2
