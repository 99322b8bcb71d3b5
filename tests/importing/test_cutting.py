"""Logs are cut into slews: at rests, by files, as stated; commands are held across the cut."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from support.campaign_files import assert_teaches
from support.raw_logs import NOISE, STEP, edited_mapping, imported, log_columns, write_csv

from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.errors import CampaignError
from bayes_inertia.importing.import_logs import import_logs

# Two good slews; one that the end of the log cuts off; a small turn between the good ones.
TURNS = [(60.0, 30.0, 0.5), (200.0, 6.0, 0.012), (300.0, 40.0, 0.8), (480.0, 40.0, 0.6)]
END = 500.0
EVERY_FIX = ("[inertia]", "[cut]\nbefore_s = 20.0\nafter_s = 20.0\n\n[inertia]")


@pytest.fixture
def columns():
    return log_columns(TURNS, END)


def test_slews_go_from_rest_to_rest_and_the_others_are_named(tmp_path, columns):
    cut = imported(tmp_path, columns, EVERY_FIX).cut
    assert [round(np.degrees(w.turned), 0) for w in cut.windows] == pytest.approx(
        np.degrees([0.5, 0.8]), abs=1.0
    )
    for window, (start, duration, _) in zip(cut.windows, (TURNS[0], TURNS[2]), strict=True):
        assert start - 1.0 < window.motion[0] < start + 0.3 * duration
        assert start + 0.7 * duration < window.motion[1] < start + duration + 6.0
        assert window.motion[0] - window.start == pytest.approx(20.0)
        assert window.end - window.motion[1] == pytest.approx(20.0)
    reasons = {part.reason: part for part in cut.dropped}
    small = next(part for reason, part in reasons.items() if "turns 0." in reason)
    assert small.start < 204.0 < small.end
    late = next(part for reason, part in reasons.items() if "no rest after" in reason)
    assert late.end == END - STEP


def test_nothing_is_lost_between_slews_and_what_is_dropped(tmp_path, columns):
    cut = imported(tmp_path, columns, EVERY_FIX).cut
    spans = sorted(
        [(w.start, w.end) for w in cut.windows] + [(d.start, d.end) for d in cut.dropped]
    )
    assert spans[0][0] == 0.0
    assert spans[-1][1] == END - STEP
    for (_, before), (after, _) in pairwise(spans):
        assert before == after


def test_two_slews_never_share_a_reading(tmp_path):
    columns = log_columns([(40.0, 30.0, 0.5), (90.0, 30.0, 0.6)], 170.0)
    first, second = imported(tmp_path, columns).cut.windows
    assert first.end == pytest.approx(second.start)
    campaign = read_campaign(tmp_path / "c")
    times = [slew.start + slew.time for slew in campaign.slews]
    assert times[0][-1] < times[1][0]


def test_an_outlier_is_no_slew(tmp_path, columns):
    columns["wy"][250:252] = 40.0
    cut = imported(tmp_path, columns, EVERY_FIX).cut
    assert len(cut.windows) == 2


def test_a_log_without_a_slew_says_so(tmp_path):
    with pytest.raises(CampaignError) as caught:
        imported(tmp_path, log_columns([], 100.0))
    assert_teaches(caught.value, ["no slew is to be seen", "rad/s", "state [[slews]]"])


def test_a_body_that_never_rests_is_cut_only_as_stated(tmp_path):
    columns = log_columns([], 100.0)
    columns["wz"] += 20.0 + 5.0 * np.sin(columns["t_ms"] / 3e3)
    with pytest.raises(CampaignError) as caught:
        imported(tmp_path, columns)
    assert_teaches(caught.value, ["the body never rests", "[[slews]]"])
    more = '\n[[slews]]\nname = "tumble"\nstart = 10.0\nend = 60.0\n'
    stated = imported(tmp_path, columns, more=more)
    assert stated.cut.scan is None
    assert stated.noises == ()
    assert not (tmp_path / "c" / "slews.svg").exists()
    assert read_campaign(tmp_path / "c").slews[0].duration == 50.0


def test_sessions_of_a_body_that_never_rests_are_a_slew_each(tmp_path):
    columns = log_columns([], 300.0)
    columns["wz"] += 20.0 + 5.0 * np.sin(columns["t_ms"] / 3e3)
    kept = (columns["t_ms"] < 40e3) | (columns["t_ms"] > 100e3)
    # A session of three readings is no slew.
    kept &= (columns["t_ms"] < 299e3 - 100e3) | (columns["t_ms"] > 299.9e3)
    columns = {name: values[kept] for name, values in columns.items()}
    by_gaps = ("[inertia]", '[cut]\nby = "gaps"\ngap_s = 30.0\nlongest_s = 60.0\n\n[inertia]')
    cut = imported(tmp_path, columns, by_gaps).cut
    assert cut.by == "gaps"
    spans = [(window.start, window.end) for window in cut.windows]
    assert len(spans) == 3
    assert spans[0][0] == 0.0
    assert spans[0][1] < 40.0
    assert spans[1][0] == pytest.approx(100.0, abs=0.5)
    assert spans[2][1] == pytest.approx(199.0, abs=0.5)
    lengths = [end - start for start, end in spans[1:]]
    assert max(lengths) <= 60.0
    assert lengths[0] == pytest.approx(lengths[1], abs=0.5)
    assert len(read_campaign(tmp_path / "c").slews) == 3


def test_the_threshold_may_be_stated(tmp_path, columns):
    rest_rate = ("[inertia]", "[cut]\nrest_rate = 0.036\n\n[inertia]")
    cut = imported(tmp_path, columns, rest_rate).cut
    assert cut.scan.high == 0.036
    assert len(cut.windows) == 1  # 2 * 0.8 / 40 rad/s; the others peak at 0.033 and 0.03


def test_stated_slews_are_taken_as_they_are(tmp_path, columns):
    more = '\n[[slews]]\nname = "big"\nstart = 280.0\nend = 360.0\nangle_deg = 45.0\n'
    cut = imported(tmp_path, columns, more=more).cut
    campaign = read_campaign(tmp_path / "c")
    assert cut.by == "slews"
    assert [slew.name for slew in campaign.slews] == ["big"]
    assert campaign.slews[0].start == 280.0
    assert campaign.slews[0].duration == 80.0


def test_stated_slews_must_not_overlap(tmp_path, columns):
    more = "".join(
        f'\n[[slews]]\nname = "{name}"\nstart = {start}\nend = {start + 80.0}\n'
        for name, start in (("a", 280.0), ("b", 350.0))
    )
    with pytest.raises(CampaignError) as caught:
        imported(tmp_path, columns, more=more)
    assert_teaches(caught.value, ["a and b overlap", "end one before the other"])


def test_the_command_in_force_is_held_into_the_slew(tmp_path, columns):
    sparse = np.full(len(columns["torque"]), np.nan)
    sparse[[0, 100, 620]] = [1.0, 2.0, 3.0]  # at 0, 50 and 310 s, mN m
    columns["torque"] = sparse
    imported(tmp_path, columns, EVERY_FIX)
    first, second = read_campaign(tmp_path / "c").slews
    np.testing.assert_allclose(first.wheel_torque[:3, 0], 1e-3)  # since 0 s, before the slew
    np.testing.assert_allclose(first.wheel_torque[first.start + first.time >= 50.0, 0], 2e-3)
    np.testing.assert_allclose(second.wheel_torque[0, 0], 2e-3)
    np.testing.assert_allclose(second.wheel_torque[-1, 0], 3e-3)


def test_several_files_are_kept_as_slews(tmp_path, columns):
    rows = (np.arange(len(columns["torque"])) < 300, np.arange(len(columns["torque"])) >= 520)
    files = [
        write_csv(tmp_path / f"log_{k}.csv", {n: v[keep] for n, v in columns.items()})
        for k, keep in ((2, rows[0]), (10, rows[1]))
    ]
    result = import_logs(files[::-1], edited_mapping(tmp_path), tmp_path / "c")
    assert result.cut.by == "files"
    assert [w.name for w in result.cut.windows] == ["log_2", "log_10"]
    assert [len(s.time) for s in read_campaign(tmp_path / "c").slews] == [300, len(rows[1]) - 520]


def test_files_with_a_clock_of_their_own_follow_each_other(tmp_path, columns):
    files = []
    for k in (1, 2):
        part = {name: values[:300] for name, values in columns.items()}
        files.append(write_csv(tmp_path / f"log_{k}.csv", part))
    own = ('epoch = "campaign"', 'epoch = "file"')
    with pytest.raises(CampaignError) as caught:
        import_logs(files, edited_mapping(tmp_path, own), tmp_path / "c")
    assert_teaches(caught.value, ["cut.between_files_s", "missing key"])
    pause = ("[inertia]", "[cut]\nbetween_files_s = 600.0\n\n[inertia]")
    import_logs(files, edited_mapping(tmp_path, own, pause), tmp_path / "c")
    first, second = read_campaign(tmp_path / "c").slews
    assert second.start - first.start == pytest.approx(first.duration + 600.0)
    np.testing.assert_array_equal(first.rate, second.rate)


def test_rows_out_of_order_and_repeated_rows_are_mended_and_said(tmp_path, columns):
    order = np.arange(len(columns["torque"]))
    order[[100, 101]] = order[[101, 100]]
    shuffled = {name: values[np.append(order, 7)] for name, values in columns.items()}
    mended = imported(tmp_path, shuffled, EVERY_FIX)
    (tmp_path / "straight").mkdir()
    straight = imported(tmp_path / "straight", columns, EVERY_FIX)
    for key, stream in straight.logs.streams.items():
        np.testing.assert_array_equal(mended.logs.streams[key].time, stream.time)
        np.testing.assert_array_equal(mended.logs.streams[key].values, stream.values)
    notes = " ".join(mended.logs.streams["rate"].notes)
    assert "2 rows out of order were sorted" in notes
    assert "1 row repeated a time" in notes


def test_flagged_rows_hold_no_reading(tmp_path, columns):
    columns["ok"] = np.ones(len(columns["torque"]))
    columns["ok"][50:60] = 0.0
    flag = ('unit = "deg/s"\n', 'unit = "deg/s"\nvalid = { name = "ok", equals = 1 }\n')
    stream = imported(tmp_path, columns, EVERY_FIX, flag).logs.streams["rate"]
    assert len(stream.time) == len(columns["torque"]) - 10
    assert "10 rows are flagged" in " ".join(stream.notes)


def test_counts_become_readings(tmp_path, columns):
    straight = imported(tmp_path, columns, EVERY_FIX).logs.streams["rate"].values
    for name in ("wx", "wy", "wz"):
        columns[name] = (columns[name] + 3.0) / 0.01
    (tmp_path / "counts").mkdir()
    scale = ('unit = "deg/s"\n', 'unit = "deg/s"\nscale = 0.01\noffset = -3.0\n')
    counted = imported(tmp_path / "counts", columns, EVERY_FIX, scale).logs.streams["rate"].values
    np.testing.assert_allclose(counted, straight, atol=1e-12)


def test_the_noise_of_the_rests_is_seen(tmp_path, columns):
    noises = imported(tmp_path, columns, EVERY_FIX).noises
    rates = next(noise for noise in noises if noise.key == "rate_sensor.sigma")
    for fit in rates.fits:
        assert abs(np.log(fit.white / NOISE)) < 4.0 * fit.white_error
    wrong = ("sigma = 1e-4\n", "sigma = 3e-4\n")
    (tmp_path / "w").mkdir()
    stated = imported(tmp_path / "w", columns, EVERY_FIX, wrong).noises
    assert next(noise for noise in stated if noise.key == "rate_sensor.sigma").differs
    assert not rates.differs


@pytest.mark.parametrize(("first_command", "begins"), [(0.0, 0.0), (1.0, 1.0), (15.0, 0.0)])
def test_a_slew_begins_with_its_first_command(tmp_path, columns, first_command, begins):
    columns["torque"][columns["t_ms"] < 1e3 * first_command] = np.nan
    cut = imported(tmp_path, columns, ("[inertia]", "[cut]\nbefore_s = 100\n\n[inertia]")).cut
    assert cut.windows[0].start == begins
    missing = [dirt for dirt in read_campaign(tmp_path / "c").dirt if dirt.channel == "torque"]
    # A long rest is worth more than the commands in it.
    assert bool(missing) == (first_command == 15.0)
