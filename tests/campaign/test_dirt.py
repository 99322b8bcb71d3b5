"""Dirt in telemetry as it is read: masked, modelled, ignored or refused, and recorded."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.campaign_files import assert_same, assert_teaches, edited, refusal
from support.dirty_example import SLEWING, dirty, kinds, without_rows

import bayes_inertia as bi
from bayes_inertia.campaign.commands import without_impossible_torques
from bayes_inertia.campaign.hardware import Wheel
from bayes_inertia.campaign.inspection import with_dirt_masked
from bayes_inertia.campaign.reader import read_campaign, read_unmasked
from bayes_inertia.campaign.writer import write_campaign
from bayes_inertia.conventions.check import check_conventions
from bayes_inertia.errors import CampaignError
from bayes_inertia.faults.stuck import stuck_readings


@pytest.fixture(scope="module")
def clean(tmp_path_factory):
    return read_campaign(dirty(tmp_path_factory.mktemp("clean") / "c", lambda h, rows: None))


def test_clean_telemetry_is_not_accused(clean):
    assert clean.dirt == ()
    assert with_dirt_masked(clean) == clean


def test_a_row_sent_twice_counts_once(tmp_path, clean):
    campaign = read_campaign(dirty(tmp_path / "c", lambda h, rows: rows[:50] + rows[48:]))
    assert kinds(campaign) == [("duplicate", "time", "masked")]
    assert campaign.dirt[0].rows == (48, 49)
    assert_same(replace(campaign, dirt=()), clean)


def test_a_row_sent_in_two_parts_is_one(tmp_path, clean):
    def split(header, rows):
        k = header.index("q1")
        halves = []
        for row in rows:
            if row[k]:
                halves.append([*row[:k], *[""] * 4, *row[k + 4 :]])
                halves.append([row[0], *[""] * (k - 1), *row[k:]])
            else:
                halves.append(row)
        return halves

    campaign = read_campaign(dirty(tmp_path / "c", split))
    assert_same(replace(campaign, dirt=()), clean)


def test_late_rows_are_put_in_place(tmp_path, clean):
    def late(header, rows):
        return rows[:60] + rows[63:70] + rows[60:63] + rows[70:]

    campaign = read_campaign(dirty(tmp_path / "c", late))
    assert kinds(campaign) == [("clock", "time", "ignored")]
    assert campaign.dirt[0].rows == (60, 61, 62)
    assert_same(replace(campaign, dirt=()), clean)


def test_a_single_wrong_stamp_is_mended(tmp_path, clean):
    def glitch(header, rows):
        rows[100][0] = "1e6"

    campaign = read_campaign(dirty(tmp_path / "c", glitch))
    assert kinds(campaign) == [("clock", "time", "modelled")]
    assert campaign.dirt[0].rows == (100,)
    np.testing.assert_allclose(campaign.slews[0].time, clean.slews[0].time, atol=1e-9)
    np.testing.assert_array_equal(campaign.slews[0].rate, clean.slews[0].rate)


def test_a_wrong_stamp_beside_a_gap_is_left_out(tmp_path):
    def glitch(header, rows):
        rows[100][0] = "1e6"
        del rows[101]

    campaign = read_campaign(dirty(tmp_path / "c", glitch, without="commands"))
    assert ("clock", "time", "masked") in kinds(campaign)
    assert campaign.slews[0].time.max() < 1e6


def jump(by: float):
    def change(header, rows):
        for row in rows[200:]:
            row[0] = repr(float(row[0]) - by)

    return change


@pytest.mark.parametrize("by", [10.1, 1e4])
def test_a_clock_that_jumps_back_is_refused(tmp_path, by):
    error = refusal(dirty(tmp_path / "c", jump(by)))
    assert_teaches(error, ["slew_01.csv, line 202, column t_s", "goes back"])


def test_a_clock_that_jumps_back_by_whole_steps_is_refused(tmp_path):
    error = refusal(dirty(tmp_path / "c", jump(10.0)))
    assert_teaches(error, ["slew_01.csv, line", "goes back", "set back by"])


def test_slews_that_overlap_in_time_are_told(tmp_path, clean):
    folder = dirty(tmp_path / "c", lambda header, rows: None)
    toml = folder / "campaign.toml"
    later = [line for line in toml.read_text().splitlines() if line.startswith("start")][1]
    toml.write_text(toml.read_text().replace(later, "start = 10.0"))
    (record,) = read_campaign(folder).dirt
    assert (record.kind, record.channel, record.treated) == ("clock", "time", "ignored")
    assert f"{clean.slews[1].name} begins" in record.note
    assert "mend start" in record.note


def test_a_lost_row_leaves_its_commands_unknown(tmp_path):
    campaign = read_campaign(dirty(tmp_path / "c", without_rows(SLEWING)))
    assert ("gap", "torque", "masked") in kinds(campaign)
    assert ("gap", "rate", "ignored") in kinds(campaign)
    assert campaign.slews[0].wheel_torque is None
    assert campaign.slews[1].wheel_torque is not None
    assert campaign.has_tachometers
    assert not campaign.has_commands
    again = read_campaign(write_campaign(campaign, tmp_path / "again"))
    assert_same(replace(again, dirt=()), replace(campaign, dirt=()))


def test_commands_drive_a_slew_that_lost_tachometers_would_cut(tmp_path, clean):
    """A message that holds torques and speeds takes both along where it is lost."""

    def lost(header, rows):
        for name in ("u1_Nm", "u2_Nm", "u3_Nm", "h1_Nms", "h2_Nms", "h3_Nms"):
            for k in (120, 121, 122, 200, 201, 202, 300, 301, 302):
                rows[k][header.index(name)] = ""

    folder = dirty(tmp_path / "c", lost)
    campaign = read_campaign(folder)
    assert [slew.name for slew in campaign.slews] == [slew.name for slew in clean.slews]
    assert campaign.has_commands
    assert campaign.slews[0].lost_command is not None
    assert ("gap", "torque", "modelled") in kinds(campaign)
    told = [(row["channel"], row["treated"]) for row in check_conventions(folder).dirt]
    assert ("torque", "modelled") in told
    assert ("torque", "masked") not in told


def test_without_tachometers_the_slew_is_cut_at_too_many_lost_rows(tmp_path, clean):
    many = without_rows(*range(30, 450, 7))
    campaign = read_campaign(dirty(tmp_path / "c", many, without="tachometers"))
    # Parts of six rows are of no use.
    assert [len(slew.time) for slew in campaign.slews[:2]] == [30, 17]
    assert campaign.slews[-1].name == clean.slews[1].name
    assert all(slew.lost_command is None for slew in campaign.slews)
    assert ("gap", "torque", "masked") in kinds(campaign)


def test_constant_commands_are_held_across_a_gap(tmp_path):
    def idle(header, rows):
        for name in ("u1_Nm", "u2_Nm", "u3_Nm"):
            for row in rows:
                row[header.index(name)] = "1e-5"
        del rows[SLEWING : SLEWING + 12]

    campaign = read_campaign(dirty(tmp_path / "c", idle, without="tachometers"))
    assert len(campaign.slews) == 2
    assert kinds(campaign) == [("gap", "rate", "ignored")]


def test_commands_not_recorded_for_a_while(tmp_path):
    def silent(header, rows):
        for row in rows[SLEWING : SLEWING + 12]:
            row[header.index("u1_Nm") : header.index("u3_Nm") + 1] = [""] * 3

    campaign = read_campaign(dirty(tmp_path / "a", silent))
    assert kinds(campaign) == [("gap", "torque", "masked")]
    assert campaign.slews[0].wheel_torque is None
    whole = read_campaign(dirty(tmp_path / "b", silent, without="tachometers")).slews[0]
    assert len(whole.time) == len(campaign.slews[0].time)
    assert np.flatnonzero(whole.lost_command).tolist() == list(range(SLEWING, SLEWING + 12))


def test_momentum_unknown_while_the_torque_turns_cuts_the_slew(tmp_path):
    gap = without_rows(*range(SLEWING, SLEWING + 60))
    campaign = read_campaign(dirty(tmp_path / "c", gap, without="commands"))
    assert ("gap", "momentum", "masked") in kinds(campaign)
    assert len(campaign.slews) == 3


def test_a_locked_wheel_without_tachometer_hides_no_gap_of_the_others(tmp_path):
    gap = without_rows(*range(SLEWING, SLEWING + 60))
    campaign = read_unmasked(dirty(tmp_path / "c", gap, without="commands"))
    off = Wheel("off", (0.0, 0.0, 1.0), 1e-3, state="locked")
    slews = [
        replace(s, wheel_momentum=np.insert(s.wheel_momentum, 3, np.nan, axis=1))
        for s in campaign.slews
    ]
    locked = replace(campaign, wheels=(*campaign.wheels, off), slews=slews)
    folder = write_campaign(locked, tmp_path / "locked")
    assert "h4" not in (folder / "campaign.toml").read_text()
    assert len(read_campaign(folder).slews) == 3


def stick(columns: tuple[str, ...], rows_stuck: slice):
    def change(header, rows):
        for name in columns:
            k = header.index(name)
            given = [row for row in rows if row[k]]
            for row in given[rows_stuck]:
                row[k] = given[rows_stuck][0][k]

    return change


STUCK = [
    ("rate", ("wx_radps", "wy_radps", "wz_radps"), slice(100, 112), range(100, 112)),
    ("rate", ("wy_radps",), slice(100, 106), range(100, 106)),
    ("momentum", ("h2_Nms",), slice(200, 212), range(200, 212)),
    ("attitude", ("q1", "q2", "q3", "q4"), slice(3, 8), None),
]


def test_a_stuck_tachometer_that_drives_the_model_is_a_gap(tmp_path):
    wheels = ("h1_Nms", "h2_Nms", "h3_Nms")
    stuck = stick(wheels, slice(SLEWING, SLEWING + 60))
    campaign = read_campaign(dirty(tmp_path / "a", stuck, without="commands"))
    assert kinds(campaign)[-1] == ("gap", "momentum", "masked")
    assert len(campaign.slews) == 3
    assert {d.slew for d in campaign.dirt if d.kind == "stuck"} <= {s.name for s in campaign.slews}
    commanded = read_campaign(dirty(tmp_path / "b", stuck))
    assert len(commanded.slews) == 2


def test_impossible_commands_are_unknown(tmp_path):
    def absurd(header, rows):
        rows[SLEWING][header.index("u1_Nm")] = "1e300"

    campaign = read_campaign(dirty(tmp_path / "c", absurd))
    assert kinds(campaign) == [("outliers", "torque", "masked"), ("gap", "torque", "masked")]
    assert campaign.slews[0].wheel_torque is None


@pytest.mark.parametrize(("channel", "columns", "where", "rows"), STUCK)
def test_stuck_readings_are_masked(tmp_path, clean, channel, columns, where, rows):
    campaign = read_campaign(dirty(tmp_path / "c", stick(columns, where)))
    assert kinds(campaign) == [("stuck", channel, "masked")]
    expected = rows if rows is not None else np.flatnonzero(clean.slews[0].fixes)[where].tolist()
    assert campaign.dirt[0].rows == tuple(expected)
    field = {"momentum": "wheel_momentum"}.get(channel, channel)
    lost = np.isnan(getattr(campaign.slews[0], field)) & ~np.isnan(getattr(clean.slews[0], field))
    assert np.flatnonzero(lost.any(axis=1)).tolist() == list(expected)


def test_repetition_by_right_is_not_stuck():
    rng = np.random.default_rng(4)
    motion = np.concatenate([np.zeros(200), np.sin(np.arange(300) / 50.0), np.zeros(200)])
    noise = rng.normal(scale=1e-3, size=700)
    cases = {
        "nothing": (np.zeros(700), 1e-3),
        "no noise": (motion, 1e-3),
        "coarse steps": (np.round(motion / 0.01) * 0.01, 1e-3),
        "coarse steps, noise stated too large": (np.round(motion / 0.01) * 0.01, 0.1),
        "steps as large as the noise": (np.round((motion + noise) / 1e-3) * 1e-3, 1e-3),
        "read four times as often as measured": (np.repeat((motion + noise)[::4], 4), 1e-3),
        "read ten times as often as measured": (np.repeat((motion + noise)[::10], 10), 1e-3),
        "noise": (motion + noise, 1e-3),
    }
    accused = [
        name
        for name, (values, sigma) in cases.items()
        if stuck_readings(np.repeat(values[:, None], 3, axis=1), [sigma] * 3).any()
    ]
    assert accused == []
    values = np.round((motion + noise) / 1e-3) * 1e-3
    values[300:360] = values[300]
    assert stuck_readings(values[:, None], [1e-3])[300:360].all()


def test_noise_is_rarely_called_stuck():
    rng = np.random.default_rng(9)
    for step in (0.2, 1.0, 1.9):
        values = np.round(rng.normal(size=(100, 3000)) / step) * step
        accused = sum(stuck_readings(v[:, None], [1.0]).any() for v in values)
        assert accused == 0, step


def test_impossible_readings_are_masked_and_never_end_in_a_traceback(tmp_path, clean):
    def absurd(header, rows):
        rows[20][header.index("wx_radps")] = "-1e31"
        rows[21][header.index("wz_radps")] = "1e300"
        rows[40][header.index("h1_Nms")] = "1e300"

    campaign = read_campaign(dirty(tmp_path / "c", absurd))
    assert [(d.kind, d.channel, d.rows) for d in campaign.dirt] == [
        ("outliers", "rate", (20, 21)),
        ("outliers", "momentum", (40,)),
    ]
    assert np.isnan(campaign.slews[0].rate).sum() == 2
    assert campaign.scale_of_motion()[0] == pytest.approx(clean.scale_of_motion()[0], rel=1e-2)


def test_impossible_readings_of_a_campaign_in_memory_do_not_count(clean):
    rate = clean.slews[0].rate.copy()
    rate[3, 1] = 1e300
    campaign = replace(clean, slews=(replace(clean.slews[0], rate=rate), clean.slews[1]))
    assert not campaign.valid_readings(campaign.slews[0])[3, 1]
    assert campaign.valid_readings(campaign.slews[0]).sum() == rate.size - 1


def with_range(folder: Path, change) -> Path:
    dirty(folder, change)
    path = folder / "campaign.toml"
    path.write_text(edited(path.read_text(), ("[rate_sensor]", "[rate_sensor]\nrange = 0.5")))
    return folder


def test_saturated_readings_are_recorded(tmp_path):
    def saturate(header, rows):
        for row in rows[100:110]:
            row[header.index("wx_radps")] = "0.5"

    campaign = read_campaign(with_range(tmp_path / "c", saturate))
    assert kinds(campaign) == [("saturated", "rate", "masked")]
    assert campaign.dirt[0].rows == tuple(range(100, 110))
    assert not campaign.valid_readings(campaign.slews[0])[100:110, 0].any()


@pytest.mark.parametrize(("step", "treated"), [(5e-5, "modelled"), (2e-4, "ignored")])
def test_quantised_readings_are_recorded(clean, step, treated):
    slews = [replace(s, rate=np.round(s.rate / step) * step) for s in clean.slews]
    campaign = with_dirt_masked(replace(clean, slews=tuple(slews)))
    assert kinds(campaign) == [("quantised", "rate", treated)]
    assert f"{step:.3g}" in campaign.dirt[0].note
    fine = [replace(s, rate=np.round(s.rate / 1e-6) * 1e-6) for s in clean.slews]
    assert with_dirt_masked(replace(clean, slews=tuple(fine))).dirt == ()


def test_a_gap_in_the_rates_is_only_recorded(tmp_path, clean):
    def silent(header, rows):
        for row in rows[100:140]:
            row[header.index("wx_radps") : header.index("wz_radps") + 1] = [""] * 3

    campaign = read_campaign(dirty(tmp_path / "c", silent))
    assert kinds(campaign) == [("gap", "rate", "ignored")]
    assert campaign.dirt[0].rows == (99,)
    assert campaign.has_commands


def test_infinity_and_an_axis_without_any_reading_stay_errors(tmp_path):
    def infinite(header, rows):
        rows[7][header.index("wx_radps")] = "inf"

    def empty(header, rows):
        for row in rows:
            row[header.index("wy_radps")] = "nan"

    for change, named in ((infinite, "line 9, column wx_radps"), (empty, "column wy_radps")):
        with pytest.raises(CampaignError) as caught:
            read_campaign(dirty(tmp_path / change.__name__, change))
        assert_teaches(caught.value, ["slew_01.csv", named])


def test_a_subset_keeps_its_own_faults(tmp_path):
    campaign = read_campaign(dirty(tmp_path / "c", stick(("wx_radps",), slice(100, 112))))
    assert campaign.subset([1]).dirt == ()
    assert campaign.subset([0]).dirt == campaign.dirt


@pytest.mark.long
@pytest.mark.slow
def test_lost_rows_move_the_estimate_by_less_than_one_sd(tmp_path):
    rng = np.random.default_rng(3)

    def drop(header, rows):
        lost = set(rng.choice(np.arange(1, len(rows) - 1), 4, replace=False).tolist())
        return without_rows(*lost)(header, rows)

    clean = read_campaign(dirty(tmp_path / "a", lambda h, rows: None))
    campaign = read_campaign(dirty(tmp_path / "b", drop))
    reference = bi.estimate(bi.Model(clean), starts=1)
    treated = bi.estimate(bi.Model(campaign), starts=1)
    assert np.abs((treated.theta - reference.theta) / reference.sd).max() < 1.0
    # The control: holding the last command across the lost rows.
    rows = np.searchsorted(clean.slews[0].time, campaign.slews[0].time)
    held = replace(campaign.slews[0], wheel_torque=clean.slews[0].wheel_torque[rows])
    wrong = bi.estimate(bi.Model(replace(campaign, slews=(held, *campaign.slews[1:]))), starts=1)
    assert np.abs((wrong.theta - reference.theta) / reference.sd).max() > 1.0


def test_the_largest_commands_of_a_wrong_unit_are_no_faults():
    wheel = Wheel("x", (1.0, 0.0, 0.0), 1e-3, max_torque=0.02)
    # A ramp in mN m read as N m: 1 % of it lies beyond a hundred times the limit of the wheel.
    ramp = np.linspace(0.0, 2.02, 200)[:, None]
    channels = {"time": np.arange(200.0), "wheel_torque": ramp}
    assert without_impossible_torques(channels, [wheel]) == (channels, [])
    ramp[7] = 1e31
    _, dirt = without_impossible_torques(channels, [wheel])
    assert [record.kind for record, _ in dirt] == ["outliers"]


def test_one_number_that_marks_no_command_is_a_fault_however_often():
    wheel = Wheel("x", (1.0, 0.0, 0.0), 1e-3, max_torque=0.02)
    torque = np.full((200, 1), 0.01)
    torque[::10] = -9999.0
    channels = {"time": np.arange(200.0), "wheel_torque": torque}
    kept, dirt = without_impossible_torques(channels, [wheel])
    assert np.isnan(kept["wheel_torque"]).sum() == 20
    assert [record.kind for record, _ in dirt] == ["outliers"]


def test_one_number_in_all_wheels_far_beyond_the_other_commands_is_a_mark():
    wheels = [Wheel("xyz"[k], tuple(np.eye(3)[k]), 1e-3) for k in range(3)]
    torque = np.random.default_rng(1).normal(0.0, 1e-3, (200, 3))
    torque[[7, 90]] = -0.0328  # -32768 counts
    channels = {"time": np.arange(200.0), "wheel_torque": torque}
    kept, dirt = without_impossible_torques(channels, wheels)
    assert np.isnan(kept["wheel_torque"]).all(axis=1).nonzero()[0].tolist() == [7, 90]
    assert [record.kind for record, _ in dirt] == ["outliers"]
    # With the other sign, in a row, beside no other command, or in one wheel alone it may be one.
    for rows, number in (([90], 0.0328), ([8, 91], -0.0328)):
        slew = torque.copy()
        slew[rows] = number
        assert without_impossible_torques(channels | {"wheel_torque": slew}, wheels)[1] == []
    torque[:] = 0.0
    torque[[7, 90]] = 0.0328
    assert without_impossible_torques(channels, wheels)[1] == []
    one = {"time": np.arange(200.0), "wheel_torque": np.r_[np.full(199, 1e-3), 0.0328][:, None]}
    assert without_impossible_torques(one, wheels[:1])[1] == []


@pytest.mark.parametrize("row", [0, 1, 37, -1])
@pytest.mark.parametrize("stamp", ["-3.7e283", "0.0", "1e12", "4e5"])
def test_a_stamp_far_from_all_others_never_counts(tmp_path, row, stamp):
    def change(header, rows):
        for other in rows:
            other[0] = repr(float(other[0]) + 1e5)
        rows[row][0] = stamp

    campaign = read_campaign(dirty(tmp_path / "c", change))
    notes = [d.note for d in campaign.dirt if d.kind == "clock"]
    assert any("1 row with a wrong stamp" in note for note in notes)
    assert campaign.slews[0].duration < 1e3


def test_many_stamps_far_from_the_others_are_refused(tmp_path):
    def change(header, rows):
        for row in rows[300:]:
            row[0] = repr(float(row[0]) + 1e9)

    error = refusal(dirty(tmp_path / "c", change))
    assert_teaches(error, ["slew_01.csv, line 302, column t_s", "far from most others"])
