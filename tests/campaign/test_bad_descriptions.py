"""A description that is wrong is refused, by key."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.campaign_files import (
    TOML,
    assert_teaches,
    edited,
    make,
    refusal,
)

from bayes_inertia.campaign.reader import campaign_sha256, read_campaign
from bayes_inertia.errors import CampaignError

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
    ("other format", [("campaign/1", "campaign/3")], ["key format", "bayes-inertia-campaign/1"]),
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
        ["key slews.second.zzzzzz", "known here: name, file, files, start, axis, angle_deg"],
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
        [('unit = "rad/s"', 'unit = "rps"')],
        ["key columns.rate.unit", "'rps' is not one of", '"deg/s"'],
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
        ["key rate_sensor.sigma", "3 axes"],
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
        ["key columns.attitude", "[star_tracker]", "leave the columns out"],
    ),
    (
        "speed and momentum",
        [
            (
                "[[slews]]",
                'wheel_speed = { names = ["a", "b"], unit = "rpm", relative_to = "body" }\n'
                "[[slews]]",
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
        ["key columns.wheel_momentum.names", "'h1'", "used by columns.rate"],
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
        "axis whose square overflows",
        [("axis = [0.0, 1.0, 0.0]", "axis = [0.0, 1e200, 0.0]")],
        ["campaign.toml, key wheels.y.axis", "length 1e+200"],
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


@pytest.mark.parametrize(
    ("changes", "named"), [row[1:] for row in BAD_TOML], ids=[row[0] for row in BAD_TOML]
)
def test_bad_description(tmp_path, changes, named):
    folder = make(tmp_path, edited(TOML, *changes))
    with pytest.raises(CampaignError) as caught:
        read_campaign(folder)
    assert_teaches(caught.value, named)


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


@pytest.mark.slow
@given(position=st.integers(0, len(TOML) - 1), junk=st.text(max_size=3))
@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_damaged_descriptions_never_end_in_a_traceback(tmp_path, position, junk):
    folder = make(tmp_path, TOML[:position] + junk + TOML[position + 1 :])
    error = refusal(folder)
    assert error is None or (error.where and error.advice)


@pytest.mark.parametrize(
    ("key", "wrong_advice"),
    [("body_torque", "wheel_torque"), ("magnetometer", "magnetic_field")],
)
def test_no_advice_leads_to_another_physical_quantity(tmp_path, key, wrong_advice):
    entry = f'[columns]\n{key} = {{ names = ["a"], unit = "N m" }}\n'
    error = refusal(make(tmp_path, edited(TOML, ("[columns]\n", entry))))
    assert f"key columns.{key}: unknown key; known here" in str(error)
    assert f'did you mean "{wrong_advice}"' not in str(error)
