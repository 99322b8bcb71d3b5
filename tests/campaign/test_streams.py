"""Telemetry at several rates, in several tables and on several clocks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.campaign_files import (
    CSV,
    FORMAT_2,
    TOML,
    assert_same,
    assert_teaches,
    edited,
    make,
    refusal,
)

from bayes_inertia.campaign.reader import campaign_sha256, copy_campaign, read_campaign
from bayes_inertia.campaign.sensors import reading_step
from bayes_inertia.campaign.writer import write_campaign
from bayes_inertia.errors import CampaignError
from bayes_inertia.physics.effects import FlexibleMode
from bayes_inertia.physics.small_campaign import small_campaign

FILES = """files = { rate = "rate.csv", attitude = "tracker.csv", wheel_torque = "wheels.csv", \
wheel_momentum = "wheels.csv", magnetic_field = "field.csv" }"""
TABLES = {
    "rate.csv": "t,wx,wy,wz\n0.0,1,2,3\n0.1,4,5,6\n0.2,7,8,9\n0.3,1,1,1\n",
    "tracker.csv": "t,q1,q2,q3,q4\n0.0,,,,\n0.05,0.6,0,0,0.8\n0.3,0,0,0,1\n",
    "wheels.csv": "t,u1,u2,h1,h2\n0.0,1e-3,0,0.1,0.2\n0.2,2e-3,0,0.11,0.2\n",
    "field.csv": "t,bx,by,bz\n0,1e-5,2e-5,3e-5\n0.3,1e-5,2e-5,3e-5\n",
}


def make_streams(folder, *changes, toml=TOML, **tables):
    """A campaign whose first slew has a table a stream."""
    text = edited(toml, ('file = "a.csv"', FILES), *changes)
    make(folder, text)
    for name, content in {**TABLES, **{f"{k}.csv": v for k, v in tables.items()}}.items():
        (folder / name).write_text(content)
    return folder


def test_each_reading_keeps_its_own_time(tmp_path):
    slew = read_campaign(make_streams(tmp_path)).slews[0]
    assert slew.time.tolist() == [0.0, 0.05, 0.1, 0.2, 0.3]
    assert np.isnan(slew.rate).all(axis=1).tolist() == [False, True, False, False, False]
    assert slew.fixes.tolist() == [False, True, False, False, True]
    assert slew.wheel_momentum[:, 0].tolist()[::3] == [0.1, 0.11]
    assert np.isnan(slew.wheel_momentum[[1, 2, 4]]).all()
    assert slew.wheel_torque[:, 0].tolist() == [1e-3, 1e-3, 1e-3, 2e-3, 2e-3]
    assert np.isfinite(slew.magnetic_field_N).all(axis=1).tolist() == [True] + [False] * 3 + [True]


def test_the_step_of_readings_is_that_of_the_sensor_whatever_other_clocks_there_are(tmp_path):
    slew = read_campaign(make_streams(tmp_path)).slews[0]
    campaign = replace(read_campaign(tmp_path), slews=(slew,))
    assert reading_step(campaign) == pytest.approx(0.1)
    gyroless = replace(campaign, slews=(replace(slew, rate=None),), rate_sensor=None)
    assert reading_step(gyroless) == pytest.approx(0.25)
    # A flexible mode is looked for up to what the readings resolve.
    slews = tuple(shifted_commands(slew) for slew in small_campaign().slews)
    merged, one_clock = replace(small_campaign(), slews=slews), small_campaign()
    assert len(merged.slews[0].time) > 1.9 * len(one_clock.slews[0].time)
    median = FlexibleMode().parameters(merged)[1].null
    assert median == pytest.approx(FlexibleMode().parameters(one_clock)[1].null)
    assert FlexibleMode().max_step(merged) == pytest.approx(FlexibleMode().max_step(one_clock))


def shifted_commands(slew):
    """The slew with a row of its own for each torque command, a hundredth of a step later."""
    late = slew.time[:-1] + 0.01 * np.diff(slew.time)
    time = np.concatenate([slew.time, late])
    order = np.argsort(time)
    columns = {}
    for field in ("rate", "attitude", "wheel_momentum", "magnetic_field_N", "position_N"):
        if (values := getattr(slew, field)) is not None:
            empty = np.full((len(late), values.shape[1]), np.nan)
            columns[field] = np.concatenate([values, empty])[order]
    torque = np.concatenate([slew.wheel_torque, slew.wheel_torque[:-1]])[order]
    return replace(slew, time=time[order], wheel_torque=torque, **columns)


def test_offsets_move_one_stream(tmp_path):
    late = ('maps = "inertial_to_body" }', 'maps = "inertial_to_body", offset_s = -0.03 }')
    slew = read_campaign(make_streams(tmp_path, late)).slews[0]
    np.testing.assert_allclose(slew.time[slew.fixes], [0.02, 0.27], atol=1e-12)
    one_table = read_campaign(make(tmp_path / "one", edited(TOML, late))).slews[0]
    np.testing.assert_allclose(one_table.time[one_table.fixes], [0.22, 0.47], atol=1e-12)
    assert np.isfinite(one_table.rate).any(axis=1).sum() == 4


def test_an_offset_of_all_streams_changes_no_reading(tmp_path):
    plain = read_campaign(make(tmp_path / "a")).slews[0]
    all_late = edited(TOML, ('["t"], unit = "s"', '["t"], unit = "s", offset_s = 2.0'))
    late = read_campaign(make(tmp_path / "b", all_late)).slews[0]
    np.testing.assert_array_equal(late.time, plain.time + 2.0)
    np.testing.assert_array_equal(late.rate, plain.rate)


def test_a_stream_may_have_its_own_clock(tmp_path):
    own = ('unit = "rad/s" }', 'unit = "rad/s", time = { names = ["ms"], unit = "ms" } }')
    rate = TABLES["rate.csv"].replace("t,", "ms,").replace("0.1,", "100,").replace("0.2,", "200,")
    rate = rate.replace("0.3,", "300,")
    text = edited(TOML, own)
    folder = make_streams(tmp_path, rate=rate, toml=text)
    csv = CSV.replace("mode", "ms").replace("idle", "1").replace("slew", "3")
    lines = csv.splitlines()
    stamped = [f"{line.rsplit(',', 1)[0]},{250 * i}" for i, line in enumerate(lines[1:])]
    (folder / "b.csv").write_text("\n".join([lines[0], *stamped]))
    first, second = read_campaign(folder).slews
    assert first.time.tolist() == [0.0, 0.05, 0.1, 0.2, 0.3]
    assert second.time.tolist() == [0.0, 0.25, 0.5, 0.75]


def test_a_table_of_one_slew_on_another_clock_is_refused_by_its_file(tmp_path):
    """Fits of such a slew did not end; where all slews are so, the clock has an offset."""
    later = TABLES["tracker.csv"].replace("\n0.", "\n5000.")
    with pytest.raises(CampaignError, match=r"tracker.csv: its times are 5000 to 5000.3 s, those"):
        read_campaign(make_streams(tmp_path / "one", tracker=later))
    alone = edited(TOML, (TOML[TOML.rindex("[[slews]]") :], ""))
    slew = read_campaign(make_streams(tmp_path / "all", toml=alone, tracker=later)).slews[0]
    assert slew.duration > 5000.0


def test_a_slew_begins_at_its_first_command(tmp_path):
    wheels = TABLES["wheels.csv"].replace("0.0,1e-3", "0.1,1e-3")
    slew = read_campaign(make_streams(tmp_path, wheels=wheels)).slews[0]
    assert slew.time.tolist() == [0.1, 0.2, 0.3]
    assert slew.start == pytest.approx(0.1)


def test_large_stamps_of_two_streams_meet(tmp_path):
    epoch = 1.7e9
    tables = {}
    for name in ("rate", "tracker", "wheels", "field"):
        header, *rows = TABLES[f"{name}.csv"].splitlines()
        cells = [row.split(",", 1) for row in rows]
        tables[name] = "\n".join([header, *(f"{float(t) + epoch!r},{x}" for t, x in cells)])
    # One rounding unit of such a time.
    tables["rate"] = tables["rate"].replace(
        "1700000000.1", repr(float(np.nextafter(epoch + 0.1, 0.0)))
    )
    slew = read_campaign(make_streams(tmp_path, **tables)).slews[0]
    assert len(slew.time) == 5


def test_written_and_copied_streams_are_the_same(tmp_path):
    folder = make_streams(tmp_path / "in")
    campaign = read_campaign(folder)
    assert_same(campaign, read_campaign(write_campaign(campaign, tmp_path / "out")))
    copy = copy_campaign(folder, tmp_path / "copy")
    assert_same(campaign, read_campaign(copy))
    assert campaign_sha256(copy) == campaign_sha256(folder)
    (copy / "tracker.csv").write_text(TABLES["tracker.csv"] + "0.4,0,0,0,1\n")
    assert campaign_sha256(copy) != campaign_sha256(folder)


def test_a_slew_without_commands_or_fixes_is_written(tmp_path):
    less = (', attitude = "tracker.csv", wheel_torque = "wheels.csv"', "")
    campaign = read_campaign(make_streams(tmp_path / "in", less))
    assert campaign.slews[0].wheel_torque is campaign.slews[0].attitude is None
    assert not campaign.has_commands
    assert_same(campaign, read_campaign(write_campaign(campaign, tmp_path / "out")))


BAD = [
    (("files = {", 'file = "a.csv"\nfiles = {'), ["key slews.first.files", "file is given too"]),
    ((FILES, ""), ["key slews.first.file", "missing"]),
    (('rate = "rate.csv", ', ""), ["key slews.first.files.rate", "missing"]),
    (('attitude = "tr', 'atitude = "tr'), ["slews.first.files.atitude", 'mean "attitude"']),
    (('magnetic_field = "f', 'position = "f'), ["slews.first.files.position", "nothing is read"]),
    (('"rate.csv"', '"none.csv"'), ["key slews.first.files", "none.csv"]),
    (('"rate.csv"', '"b.csv"'), ["key slews.second.file", "two slews"]),
    (('"rate.csv"', '"../rate.csv"'), ["key slews.first.files"]),
    (('"rad/s" }', '"rad/s", offset_s = "1" }'), ["key columns.rate.offset_s", "not a number"]),
    (('"rad/s" }', '"rad/s", offset = 1.0 }'), ["key columns.rate.offset", '"offset_s"']),
    (
        ('"rad/s" }', '"rad/s", time = { names = ["wx"], unit = "s" } }'),
        ["key columns.rate.names", "'wx' is already used by columns.rate.time"],
    ),
    (
        ('"rad/s" }', '"rad/s", time = { names = ["tt"], unit = "s" } }'),
        ["rate.csv, line 1", "no column 'tt'"],
    ),
    (('"rad/s" }', '"rad/s", time = { names = ["t"] } }'), ["columns.rate.time.unit", "missing"]),
]


@pytest.mark.parametrize(("change", "named"), BAD, ids=range(len(BAD)))
def test_bad_streams(tmp_path, change, named):
    error = refusal(make_streams(tmp_path, change))
    assert error is not None
    assert_teaches(error, named)


def test_a_star_tracker_may_have_a_single_fix_or_none(tmp_path):
    one = read_campaign(make_streams(tmp_path / "one", tracker="t,q1,q2,q3,q4\n0.1,0,0,0,1\n"))
    assert one.slews[0].fixes.tolist() == [False, True, False, False]
    none = read_campaign(make_streams(tmp_path / "none", tracker="t,q1,q2,q3,q4\n"))
    assert none.slews[0].attitude is None


def test_a_slew_in_which_no_tracker_sees_a_star_is_refused(tmp_path):
    wheels, begin, end = (
        FORMAT_2.index(text)
        for text in ("[[actuators]]", '[[sensors]]\nname = "tracker"', "[[environment]]")
    )
    tracker = FORMAT_2[begin:end]
    other = edited(tracker, ('"tracker"', '"other"'), ('"all"', '"other"'))
    first = edited(tracker, ('"all"', '"first"'))
    slews = '[[slews]]\nname = "first"\nfiles = "a_{stream}.csv"\nstart = 0.0\n'
    folder = make(tmp_path / "in", FORMAT_2[:wheels] + first + other + slews)
    for name in ("first", "other"):
        (folder / f"a_{name}.csv").write_text("t,q1,q2,q3,q4\n0,,,,\n1,,,,\n")
    assert_teaches(refusal(folder), ["slews.first", "no sensor has a reading"])


def test_rows_of_a_stream_that_cannot_be_told_apart(tmp_path):
    late = ('unit = "rad/s" }', 'unit = "rad/s", offset_s = 1e16 }')
    with pytest.raises(CampaignError) as caught:
        read_campaign(make_streams(tmp_path, late))
    assert_teaches(caught.value, ["slews.first", "closer than"])
