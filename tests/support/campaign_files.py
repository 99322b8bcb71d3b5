"""What several of the tests in `campaign` use."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.errors import BayesInertiaError, CampaignError

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


# The same in format 2.
FORMAT_2 = """\
format = "bayes-inertia-campaign/2"
name = "two slews"

[inertia]
tensor = [[3.0, 0.01, 0.0], [0.01, 2.0, 0.0], [0.0, 0.0, 2.0]]
relative_sigma = 0.04
product_sigma = 0.03
includes_wheel_spin = false

[time]
names = ["t"]
unit = "s"

[[actuators]]
name = "x"
type = "wheel"
axis = [1, 0, 0]
spin_inertia = 0.001
torque = { stream = "all", names = ["u1"], unit = "N m", acts_on = "wheel" }
momentum = { stream = "all", names = ["h1"], unit = "N m s", relative_to = "body", sigma = 5e-6 }

[[actuators]]
name = "y"
type = "wheel"
axis = [0, 1, 0]
spin_inertia = 0.002
torque = { stream = "all", names = ["u2"], unit = "N m", acts_on = "wheel" }
momentum = { stream = "all", names = ["h2"], unit = "N m s", relative_to = "body" }

[[sensors]]
name = "gyro"
type = "rate"
sigma = 2e-5
rate = { stream = "all", names = ["wx", "wy", "wz"], unit = "rad/s" }

[[sensors]]
name = "tracker"
type = "attitude"
boresight = [0, 0, 1]
sigma_cross = 2e-5
sigma_roll = 1e-4

[sensors.attitude]
stream = "all"
names = ["q1", "q2", "q3", "q4"]
scalar = "last"
maps = "inertial_to_body"

[[environment]]
name = "field"
type = "magnetic_field"
vector = { stream = "all", names = ["bx", "by", "bz"], unit = "T", frame = "inertial" }

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


def assert_teaches(error: BayesInertiaError, named: list[str]) -> None:
    text = str(error)
    for part in named:
        assert part in text, f"{part!r} not in {text!r}"
    assert error.where, text
    assert error.advice, text
    assert len(text) < 1200, text
    assert "\n" not in text
    assert "pydantic" not in text


BAD_BINARY = [
    ("missing column", {"wx": None}, ["no column 'wx'", "The table has"]),
    ("text", {"wx": ["a", "b", "c", "d"]}, ["column wx", "'a' is not a number"]),
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


def unit(draw, size: int):
    vector = np.array(
        draw(
            st.lists(st.floats(-1, 1), min_size=size, max_size=size).filter(
                lambda v: np.linalg.norm(v) > 0.1
            )
        )
    )
    return tuple((vector / np.linalg.norm(vector)).tolist())
