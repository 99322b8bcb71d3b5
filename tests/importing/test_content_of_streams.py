"""What a stream holds: nothing, rounded numbers, marks of no reading, counts, a column twice."""

from __future__ import annotations

import json

import numpy as np
import pytest
from support.campaign_files import assert_teaches
from support.raw_logs import MAPPING, imported, log_columns

from bayes_inertia.errors import CampaignError
from bayes_inertia.importing.mapping import parse_mapping
from bayes_inertia.importing.stream_readings import with_signs

FIXES = ("q1", "q2", "q3", "q4")
RATES = ("wx", "wy", "wz")
SPEEDS = """
[[streams]]
holds = "wheel_speed"
files = ["log.csv"]
time = { names = ["t_ms"], kind = "ms", epoch = "campaign" }
names = ["speed"]
unit = "rpm"
relative_to = "body"
"""
OF_FIXES = 'form = "quaternion"\n'


@pytest.fixture
def columns():
    columns = log_columns([(40.0, 30.0, 0.5), (140.0, 30.0, -0.5)], 210.0)
    return columns | {"speed": 400.0 + np.cumsum(columns["torque"])}


def refused(tmp_path, columns, *changes, more="") -> CampaignError:
    with pytest.raises(CampaignError) as caught:
        imported(tmp_path, columns, *changes, more=more)
    assert "slew_0" not in str(caught.value)
    assert not (tmp_path / "campaign").exists()
    return caught.value


def noises(campaign) -> dict[str, tuple[float, ...]]:
    return {noise.key: noise.seen for noise in campaign.noises}


@pytest.mark.parametrize(
    ("emptied", "named"),
    [
        (["torque"], ["log.csv, column torque", "no reading at all", "[[wheels]]"]),
        (["speed"], ["log.csv, column speed", "no reading at all", "wheel_speed out"]),
        (["wy"], ["log.csv, column wy", "no reading at all", "streams.rate.names"]),
        (["wx", "wz"], ["log.csv, columns wx, wz", "no reading at all"]),
        (FIXES, ["log.csv, columns q1, q2, q3, q4", "no reading at all", "attitude out"]),
        (["t_ms"], ["log.csv, column t_ms", "every cell is empty"]),
    ],
)
def test_a_column_without_a_reading_is_named_as_the_log_names_it(tmp_path, columns, emptied, named):
    for name in emptied:
        columns[name] = np.full(len(columns[name]), np.nan)
    assert_teaches(refused(tmp_path, columns, more=SPEEDS), named)


@pytest.mark.parametrize("rows", [1, 2, 9])
def test_rates_of_a_few_rows_are_refused_at_once(tmp_path, columns, rows):
    few = {name: values[:rows] for name, values in columns.items()}
    assert_teaches(refused(tmp_path, few), ["log.csv, columns wx, wy, wz", f"{rows} reading"])


def test_one_axis_with_a_few_readings_is_refused(tmp_path, columns):
    columns["wz"][3:] = np.nan
    assert_teaches(refused(tmp_path, columns), ["log.csv, column wz", "3 readings only"])


def test_what_is_missing_in_one_slew_is_named_as_the_log_names_it(tmp_path, columns):
    columns["wy"][columns["t_ms"] > 100e3] = np.nan
    error = refused(tmp_path, columns)
    assert_teaches(error, ["log.csv, column wy, in slew 2", "every cell is empty"])


def test_a_column_with_fewer_readings_than_its_neighbours_is_said(tmp_path, columns):
    columns["wz"][1::2] = np.nan
    notes = imported(tmp_path, columns).logs.streams["rate"].notes
    assert [note.rpartition("/")[2] for note in notes] == [
        "log.csv: wz has 210 readings, others 420"
    ]


def test_commands_before_the_first_of_every_wheel_are_said(tmp_path, columns):
    columns["torque"][:7] = np.nan
    columns["other"] = np.zeros(len(columns["torque"]))
    second = '[[wheels]]\nname = "y"\naxis = [0.0, 1.0, 0.0]\nspin_inertia = 0.002\n\n'
    two = ('names = ["torque"]', 'names = ["torque", "other"]')
    changes = [("[rate_sensor]", second + "[rate_sensor]"), two]
    notes = imported(tmp_path, columns, *changes).logs.streams["wheel_torque"].notes
    assert notes == ("7 rows before every wheel had a command were left out",)


def test_a_wheel_that_no_stream_holds_is_named(tmp_path, columns):
    second = '[[wheels]]\nname = "y"\naxis = [0.0, 1.0, 0.0]\nspin_inertia = 0.002\n\n'
    only_x = ('acts_on = "wheel"', 'acts_on = "wheel"\nwheels = ["x"]')
    error = refused(tmp_path, columns, ("[rate_sensor]", second + "[rate_sensor]"), only_x)
    assert_teaches(error, ["mapping.toml, key streams.wheel_torque.wheels", "wheel y", "is off"])


TWICE = [
    ('"wx", "wy", "wz"', '"wx", "wx", "wz"', ["streams.rate.names", "'wx' is named twice"]),
    ('"q1", "q2"', '"q1", "q1"', ["streams.attitude.names", "'q1' is named twice"]),
    ('"wx", "wy", "wz"', '"t_ms", "wy", "wz"', ["streams.rate.names", "as time and as reading"]),
]


@pytest.mark.parametrize(("old", "new", "named"), TWICE)
def test_one_column_for_two_axes_is_refused_with_its_line(old, new, named):
    text = MAPPING.replace(old, new)
    line = next(n for n, row in enumerate(text.splitlines(), 1) if new in row)
    with pytest.raises(CampaignError) as caught:
        parse_mapping(text, "m.toml")
    assert_teaches(caught.value, [f"m.toml, line {line}, key ", *named])


def test_one_column_in_two_streams_is_refused(tmp_path, columns):
    error = refused(tmp_path, columns, ('names = ["torque"]', 'names = ["wy"]'))
    assert_teaches(error, ["streams.wheel_torque.names", "'wy' of log.csv", "rate already"])


@pytest.mark.parametrize("names", ['["wz"]', '["wx", "wy"]'])
def test_rates_about_fewer_than_three_axes_are_refused_with_the_reason(names):
    with pytest.raises(CampaignError) as caught:
        parse_mapping(MAPPING.replace('["wx", "wy", "wz"]', names), "m.toml")
    assert_teaches(caught.value, ["m.toml, key streams.rate.names", "three axes", "rig"])


@pytest.mark.parametrize("step", [100.0, 60.0])
def test_no_noise_below_the_rounding_of_tachometers_is_proposed(tmp_path, columns, step):
    columns["speed"] = step * np.round(5.0 * columns["speed"] / step)
    unstated = ("momentum_sigma = 5e-6\n", "")
    campaign = imported(tmp_path, columns, unstated, more=SPEEDS)
    least = 0.001 * step * 2.0 * np.pi / 60.0 / np.sqrt(12.0)
    assert least <= noises(campaign)["wheels.x.momentum_sigma"][0] < 1.1 * least


def test_tachometers_that_never_change_propose_no_noise(tmp_path, columns):
    columns["speed"] = np.full(len(columns["speed"]), 500.0)
    campaign = imported(tmp_path, columns, ("momentum_sigma = 5e-6\n", ""), more=SPEEDS)
    assert "wheels.x.momentum_sigma" not in noises(campaign)


def test_one_reading_of_a_tachometer_is_said(tmp_path, columns):
    columns["speed"][31:] = np.nan
    columns["speed"][:30] = np.nan
    (*_, stream) = imported(tmp_path, columns, more=SPEEDS).logs.streams.values()
    assert stream.notes == ("no reading in slew 2",)


@pytest.mark.parametrize("step", [0.02, 0.1])  # [deg/s]; the first hides its noise, 0.006 deg/s
def test_no_noise_below_the_rounding_of_rates_is_proposed(tmp_path, columns, step):
    for name in RATES:
        columns[name] = step * np.round(columns[name] / step)
    error = refused(tmp_path, columns, ("sigma = 1e-4\n\n[star", "\n[star"))
    proposed = json.loads(str(error).split("sigma = ")[1].split(", [")[0].partition(":")[0])
    least = np.radians(step) / np.sqrt(12.0)
    assert least <= np.min(proposed)
    assert np.max(proposed) < 1.5 * least


@pytest.mark.parametrize("decimals", [3, 4])
def test_no_noise_below_the_rounding_of_fixes_is_proposed(tmp_path, columns, decimals):
    for name in FIXES:
        columns[name] = np.round(columns[name], decimals)
    campaign = imported(tmp_path, columns)
    # An angle is twice the change of a quaternion.
    least = 2.0 * 10.0**-decimals / np.sqrt(12.0)
    for key in ("star_tracker.sigma_cross", "star_tracker.sigma_roll"):
        assert noises(campaign)[key][0] == pytest.approx(least, rel=0.1)


@pytest.mark.parametrize("mark", [0.0, -1.0, -9999.0, 999.99])
def test_one_number_in_all_columns_of_a_fix_is_no_fix_and_said(tmp_path, columns, mark):
    rows = np.arange(len(columns["q1"])) % 3 > 0
    for name in FIXES:
        columns[name] = np.where(rows, mark, columns[name])
    stream = imported(tmp_path, columns).logs.streams["attitude"]
    assert len(stream.time) == 140
    assert f"280 rows hold {mark:.6g} in all of q1, q2, q3, q4: no fix" in stream.notes[0]


def test_a_mark_of_no_fix_that_could_be_one_is_stated_in_the_mapping(tmp_path, columns):
    rows = np.arange(len(columns["q1"])) % 2 == 1
    for name, mark in zip(FIXES, (0.0, 0.0, 0.0, 1.0), strict=True):
        columns[name] = np.where(rows, mark, columns[name] + 1e-9)
    stated = (OF_FIXES, OF_FIXES + "missing = [0, 1]\n")
    assert len(imported(tmp_path, columns, stated).logs.streams["attitude"].time) == 210


@pytest.mark.parametrize("mark", [(0.0, 0.0, 0.0, 1.0), (1.0, 0.0, 0.0, 0.0), (0.5,) * 4])
def test_one_attitude_to_which_others_jump_and_back_is_no_fix(tmp_path, columns, mark):
    angle = 2.0 * np.arctan2(columns["q1"], columns["q4"]) + 0.4
    columns |= {"q1": np.sin(0.5 * angle), "q4": np.cos(0.5 * angle)}
    blind = (columns["t_ms"] % 5000 > 4000) | (np.abs(columns["t_ms"] - 70e3) < 6e3)
    for name, cell in zip(FIXES, mark, strict=True):
        columns[name] = np.where(blind, cell, columns[name] + 1e-9)
    stream = imported(tmp_path, columns).logs.streams["attitude"]
    assert len(stream.time) == 420 - blind.sum()
    assert f"{blind.sum()} rows" in stream.notes[0]
    assert "jump and back: no fix" in stream.notes[0]


def test_an_attitude_that_comes_again_after_a_pause_or_by_motion_stays(tmp_path, columns):
    at_rest = (columns["t_ms"] < 50e3) | (columns["t_ms"] > 185e3)
    for name, cell in zip(FIXES, (0.0, 0.0, 0.0, 1.0), strict=True):
        columns[name] = np.where(at_rest, cell, columns[name])
    assert not imported(tmp_path, columns).logs.streams["attitude"].notes


def test_a_mark_that_is_no_attitude_is_quoted_for_the_mapping(tmp_path, columns):
    rows = np.arange(len(columns["q1"])) % 2 == 1
    for name, mark in zip(FIXES, (-999.0, 0.0, 0.0, 0.0), strict=True):
        columns[name] = np.where(rows, mark, columns[name])
    error = refused(tmp_path, columns)
    assert_teaches(error, ["log.csv, line 3", "length 999", "missing = [-999, 0]"])
    stated = (OF_FIXES, OF_FIXES + "missing = [-999, 0]\n")
    assert len(imported(tmp_path, columns, stated).logs.streams["attitude"].time) == 210


def test_marks_of_other_streams_are_stated_in_the_mapping(tmp_path, columns):
    columns["wy"][::10] = -9999.0
    columns["speed"][::7] = 65535.0
    stated = ('unit = "deg/s"', 'unit = "deg/s"\nmissing = -9999')
    speeds = SPEEDS.replace('unit = "rpm"', 'unit = "rpm"\nmissing = [65535, -1]')
    streams = imported(tmp_path, columns, stated, more=speeds).logs.streams
    assert int(np.isnan(streams["rate"].values[:, 1]).sum()) == 42
    assert "42 cells hold -9999.0, a mark of no reading" in streams["rate"].notes[0]
    assert len(streams["wheel_speed"].time) == 360


@pytest.mark.parametrize(("rows", "mark"), [((100, 101, 102), -99999.0), ((100, 140), -9999.0)])
def test_marks_among_the_rates_hide_no_slew(tmp_path, columns, rows, mark):
    for folder in ("clean", "marked"):
        (tmp_path / folder).mkdir()
    clean = imported(tmp_path / "clean", columns).cut.windows
    for name in RATES:
        columns[name][list(rows)] = mark
    marked = imported(tmp_path / "marked", columns)
    assert [w.name for w in marked.cut.windows] == [w.name for w in clean]
    turned = [w.turned for w in clean]
    assert [w.turned for w in marked.cut.windows] == pytest.approx(turned, rel=0.01)
    assert "outliers" in {record.kind for record in marked.campaign.dirt}


def test_flagged_rows_need_be_no_attitude(tmp_path, columns):
    columns["flag"] = np.arange(len(columns["q1"])) % 2
    columns["q1"] = np.where(columns["flag"] == 0, 7.0, columns["q1"])
    flag = (OF_FIXES, OF_FIXES + 'valid = { name = "flag", equals = 1 }\n')
    assert len(imported(tmp_path, columns, flag).logs.streams["attitude"].time) == 210


@pytest.mark.parametrize("bits", [16, 24])
def test_counts_without_their_sign_are_told_and_mended(tmp_path, columns, bits):
    step = 4e-4  # [deg/s]
    counts = {name: np.round(columns[name] / step).astype(int) for name in RATES}
    assert min(counts[name].min() for name in RATES) < -3
    stated = ('unit = "deg/s"', f'unit = "deg/s"\nscale = {step}')
    streams = []
    for folder, unsigned in (("signed", 0), ("unsigned", 2**bits)):
        (tmp_path / folder).mkdir()
        columns |= {name: np.where(c < 0, c + unsigned, c) for name, c in counts.items()}
        streams.append(imported(tmp_path / folder, columns, stated).logs.streams["rate"])
    np.testing.assert_array_equal(streams[0].values, streams[1].values)
    assert f"{2**bits - 1} is read as -1 ({bits} bits)" in streams[1].notes[0]
    assert not streams[0].notes


@pytest.mark.parametrize(
    "counts", [[3, 65535, 65535, 2], [1, 30000, 65533, 65534, 65535], [0.5, 65533, 65534, 65535]]
)
def test_other_numbers_are_no_counts_without_sign(counts):
    """A mark, readings in the middle, and numbers that are no counts."""
    column = np.array(counts, float)[:, None]
    assert with_signs(column)[0] is column


def test_attitudes_in_counts_have_a_scale(tmp_path, columns):
    exact = np.stack([columns[name] for name in FIXES], axis=1)
    columns |= {name: np.round(columns[name] * 2**31).astype(int) for name in FIXES}
    assert_teaches(refused(tmp_path, columns), ["length 2.14748e+09", "scale = 4.656612873e-10"])
    stated = (OF_FIXES, OF_FIXES + "scale = 4.656612873077393e-10\n")
    stream = imported(tmp_path, columns, stated).logs.streams["attitude"]
    np.testing.assert_allclose(stream.values, exact, atol=1e-9)
