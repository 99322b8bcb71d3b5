"""Clocks that people bring: set back, wrapped, split in columns, an hour off, or none at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.campaign_files import assert_teaches
from support.raw_logs import NOISE, STEP, imported, log_columns, write_csv

from bayes_inertia.app.commands.check import refuse_or_warn
from bayes_inertia.errors import CampaignError
from bayes_inertia.faults.known_offsets import known_offset
from bayes_inertia.faults.row_order import set_back_row
from bayes_inertia.importing.mapped_lines import streams_beside
from bayes_inertia.tables.number_table import read_table

GRID = np.arange(0.0, 100.0, 0.25)
CAMPAIGN = 'kind = "ms", epoch = "campaign"'


@pytest.fixture(scope="module")
def columns():
    return log_columns([(40.0, 30.0, 0.5)], 110.0)


def refusal(tmp_path, columns, *changes, files=None) -> CampaignError:
    with pytest.raises(CampaignError) as caught:
        imported(tmp_path, columns, *changes, files=files)
    return caught.value


def noise(count: int) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(count, 3))


BACK = {
    "again from zero": (np.r_[GRID, GRID[:80] + 0.1], 400),
    "the very same stamps": (np.r_[GRID, GRID], 400),
    "a longer second session": (np.r_[GRID[:100], GRID + 0.1], 100),
    "into a pause of the first": (np.r_[0:20:0.25, 60:100:0.25, 25:45:0.25], 240),
    "by some seconds": (np.r_[GRID[:200], GRID[180:] + 0.1], 200),
}


@pytest.mark.parametrize("name", BACK)
def test_a_clock_that_was_set_back_is_reported(name):
    stamps, row = BACK[name]
    assert set_back_row(stamps, noise(len(stamps))) == row


LATE = {
    "two rows swapped": np.r_[GRID[:50], GRID[51], GRID[50], GRID[52:]],
    "a packet that came late": np.r_[GRID[:100], GRID[150:200], GRID[100:150], GRID[200:]],
    "downloads in reverse order": np.r_[GRID[200:], GRID[:200]],
    "packets of a network": GRID[np.argsort(np.arange(400) + 6 * noise(400)[:, 0] ** 2 % 6)],
    "one stamp far ahead": np.r_[GRID[:50], 1e6, GRID[51:]],
    "one stamp at zero": np.r_[GRID[40:90], 0.0, GRID[91:]],
}


@pytest.mark.parametrize("name", LATE)
def test_rows_that_only_came_late_are_no_clock_set_back(name):
    assert set_back_row(LATE[name], noise(len(LATE[name]))) is None


def test_rows_sent_again_are_no_clock_set_back():
    stamps = np.r_[GRID[:200], GRID[100:]]
    assert set_back_row(stamps, np.sin(stamps)[:, None]) is None
    assert set_back_row(stamps, noise(len(stamps))) == 200


def test_a_second_session_is_an_error_with_its_line_and_by_how_much(tmp_path, columns):
    twice = {name: np.concatenate([cells, cells]) for name, cells in columns.items()}
    twice["t_ms"][220:] += 100.0
    # The second session's first reading came half a second after the last of the first.
    words = ["log.csv, line 222", "goes back by 109.4 s", "add 109.9 s"]
    assert_teaches(refusal(tmp_path, twice), words)


def test_a_second_session_in_a_file_of_its_own_is_never_shuffled_in(tmp_path, columns):
    later = {**columns, "t_ms": columns["t_ms"] + 100.0, "wx": columns["wx"] + 0.01}
    files = [write_csv(tmp_path / "log_1.csv", columns), write_csv(tmp_path / "log_2.csv", later)]
    by_rest = ("[rate_sensor]", '[cut]\nby = "rest"\n\n[rate_sensor]')
    error = refusal(tmp_path, {}, by_rest, files=files)
    assert_teaches(error, ["log_2.csv", "overlap", 'epoch = "file"'])


PERIODS = [
    ("ms", 2**32, 1, "2^32 ms"),
    ("ms", 2**31, 1, "2^31 ms"),
    ("ms", 2**24, 1, "2^24 ms"),
    ("us", 2**32, 1000, "2^32 us"),
    ("ms", 86400000, 1, "86400 s"),
    ("s", 4294967.296, 1e-3, "2^32 ms"),
    ("ms", 2**16, 1, "2^16 ms"),
]


def wrapped(columns, kind, period, size, start=50_000.0):
    """A log whose counter begins anew 50 s after its start."""
    counts = (columns["t_ms"] * size + period - start * size) % period
    exact = counts if kind == "s" else np.round(counts).astype(np.int64)
    return {**columns, "t_ms": exact}, (CAMPAIGN, f'kind = "{kind}", epoch = "campaign"')


@pytest.mark.parametrize(("kind", "period", "size", "name"), PERIODS, ids=[p[3] for p in PERIODS])
def test_a_counter_that_wraps_is_counted_on_and_said(tmp_path, columns, kind, period, size, name):
    log, change = wrapped(columns, kind, period, size)
    straight = imported(tmp_path, columns).logs.streams
    (tmp_path / "wrapped").mkdir()
    streams = imported(tmp_path / "wrapped", log, change).logs.streams
    assert list(streams) == list(straight)
    for key, stream in streams.items():
        np.testing.assert_allclose(stream.time, straight[key].time, atol=1e-6)
        # All streams have the stamps of one file.
        assert f"wrapped at {name} (" in " ".join(stream.notes)
        assert "line 102" in " ".join(stream.notes)


def test_streams_that_begin_after_the_wrap_are_counted_on_too(tmp_path, columns):
    log, _ = wrapped(columns, "ms", 2**32, 1)
    late = {name: cells[150:] for name, cells in log.items()}
    files = [write_csv(tmp_path / "log_a.csv", log), write_csv(tmp_path / "st.csv", late)]
    of_tracker = (
        'holds = "attitude"\nfiles = ["log*.csv"]',
        'holds = "attitude"\nfiles = ["st.csv"]',
    )
    streams = imported(tmp_path, {}, of_tracker, files=files).logs.streams
    assert streams["attitude"].time[0] - streams["rate"].time[0] == 75.0
    assert "the counter had wrapped" in " ".join(streams["attitude"].notes)


def test_a_pause_that_may_hide_a_wrap_is_refused(tmp_path, columns):
    log, _ = wrapped(columns, "ms", 2**16, 1)
    paused = {name: np.delete(cells, np.s_[10:40]) for name, cells in log.items()}
    assert_teaches(refusal(tmp_path, paused), ["log.csv, line 12", "every 2^16 ms (65.536 s)"])


def test_stamps_coarser_than_rows_stop_the_import(tmp_path, columns):
    coarse = {**columns, "t_ms": np.floor(columns["t_ms"] / 2000.0) * 2000.0}
    error = refusal(tmp_path, coarse)
    assert_teaches(error, ["log.csv, line 3", "165 of 220 rows repeat the time", "nanosec"])


def test_rows_without_a_time_are_few_or_an_error(tmp_path, columns):
    holes = {**columns, "t_ms": columns["t_ms"].copy()}
    holes["t_ms"][5] = np.nan
    notes = imported(tmp_path, holes).logs.streams["rate"].notes
    assert "1 of 220 rows hold readings without a time and are left out" in notes
    holes["t_ms"][20:40] = np.nan
    (tmp_path / "many").mkdir()
    assert_teaches(refusal(tmp_path / "many", holes), ["log.csv, line 7", "21 of 220 rows"])


@pytest.mark.parametrize("offset", [3600.0, -7200.0, 19800.0])
def test_a_stream_outside_every_slew_is_reported_with_the_offset_that_explains_it(
    tmp_path, columns, offset
):
    off = {**columns, "t_ms": columns["t_ms"] + 1e3 * offset}
    files = [write_csv(tmp_path / "log_a.csv", columns), write_csv(tmp_path / "st.csv", off)]
    of_tracker = (
        'holds = "attitude"\nfiles = ["log*.csv"]',
        'holds = "attitude"\nfiles = ["st.csv"]',
    )
    error = refusal(tmp_path, {}, of_tracker, files=files)
    said = f"all 220 readings of st.csv lie outside every slew, by {abs(offset):g} s"
    assert_teaches(error, ["streams.attitude.offset_s", said, f"offset_s = {-offset:g} ("])


@pytest.mark.parametrize("stated", ["unix_s", "tai_s", "unix_ms"])
@pytest.mark.parametrize("wrong", ["attitude", "rate"])
def test_a_count_of_gps_time_that_is_stated_as_another_is_named(tmp_path, columns, wrong, stated):
    """Of a stream, or of the rates themselves: ten years, or twenty-two, away."""
    size = 1e3 if stated.endswith("ms") else 1.0
    gps = size * (columns["t_ms"] / 1e3 + 1456401618.0)
    utc = columns["t_ms"] + 1772366400e3
    tracker, rest = (gps, utc) if wrong == "attitude" else (utc, gps)
    kinds = (stated, "unix_ms") if wrong == "attitude" else ("unix_ms", stated)
    files = [
        write_csv(tmp_path / "st.csv", {**columns, "t_ms": tracker}),
        write_csv(tmp_path / "log_a.csv", {**columns, "t_ms": rest}),
    ]
    clock = 'time = {{ names = ["t_ms"], {} }}\n'.format
    changes = (
        ('"attitude"\nfiles = ["log*.csv"]', '"attitude"\nfiles = ["st.csv"]'),
        (clock(CAMPAIGN) + "form", clock(f'kind = "{kinds[0]}"') + "form"),
        (clock(CAMPAIGN), clock(f'kind = "{kinds[1]}"')),
    )
    error = refusal(tmp_path, {}, *changes, files=files)
    meant = stated.replace("unix", "gps").replace("tai", "gps")
    said = f'streams.{wrong}.time.kind = "{meant}", not "{stated}" may be meant: it puts 220 in'
    assert_teaches(error, ["outside every slew", said])


def spin_with_one_reading(
    folder: Path, holds: str, seconds: float
) -> tuple[list[Path], tuple[str, str]]:
    """Logs of a body that spins at one rate, one stream with one reading, and their mapping."""
    time = np.arange(0.0, 110.0, STEP)
    rate = np.degrees([0.02, 0.0, 0.0] + NOISE * noise(len(time)))
    log = {"t_ms": 1e3 * time} | dict(zip(("wx", "wy", "wz"), rate.T, strict=True))
    log |= {"torque": 0.0 * time, "q1": np.sin(0.01 * time), "q2": 0.0 * time, "q3": 0.0 * time}
    log |= {"q4": np.cos(0.01 * time)}
    one = {name: cells[:1] for name, cells in log.items()} | {"t_ms": [1e3 * seconds]}
    files = [write_csv(folder / "log.csv", log), write_csv(folder / "one.csv", one)]
    return files, (f'"{holds}"\nfiles = ["log*.csv"]', f'"{holds}"\nfiles = ["one.csv"]')


FROM_20_S_TO_90_S = '\n[[slews]]\nname = "spin"\nstart = 20.0\nend = 90.0\n'


def test_one_command_before_the_first_slew_is_in_force_and_no_doubt(tmp_path, capsys):
    """It was said to lie outside every slew."""
    files, change = spin_with_one_reading(tmp_path, "wheel_torque", 5.0)
    folder = imported(tmp_path, {}, change, more=FROM_20_S_TO_90_S, files=files).folder
    refuse_or_warn(folder)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("holds", "seconds"), [("attitude", 5.0), ("attitude", 105.0), ("wheel_torque", 105.0)]
)
def test_a_single_reading_outside_every_slew_is_refused_too(tmp_path, holds, seconds):
    files, change = spin_with_one_reading(tmp_path, holds, seconds)
    with pytest.raises(CampaignError) as caught:
        imported(tmp_path, {}, change, more=FROM_20_S_TO_90_S, files=files)
    said = "the only reading of one.csv lies outside every slew, by 18 s"
    assert_teaches(caught.value, [f"streams.{holds}.offset_s", said, "GPS time"])


@pytest.mark.parametrize("kind", ["us", "s", "min"])
@pytest.mark.parametrize("holds", ["rate", "attitude"])
def test_a_stream_in_another_unit_of_time_is_refused(tmp_path, columns, kind, holds):
    files = [write_csv(tmp_path / name, columns) for name in ("log_a.csv", "other.csv")]
    stamps = 'time = { names = ["t_ms"], kind = '
    change = (
        f'"{holds}"\nfiles = ["log*.csv"]\n{stamps}"ms"',
        f'"{holds}"\nfiles = ["other.csv"]\n{stamps}"{kind}"',
    )
    error = refusal(tmp_path, {}, change, files=files)
    assert_teaches(error, [f"streams.{holds}.time.kind", "other.csv span", "times as much"])


@pytest.mark.parametrize("offset", [37.0, -32.184])
def test_readings_beside_all_rates_are_counted_and_the_offset_is_named(tmp_path, columns, offset):
    commands = {**columns, "t_ms": columns["t_ms"] + 1e3 * offset}
    files = [write_csv(tmp_path / "log_a.csv", columns), write_csv(tmp_path / "u.csv", commands)]
    of_commands = ('_torque"\nfiles = ["log*.csv"]', '_torque"\nfiles = ["u.csv"]')
    notes = imported(tmp_path, {}, of_commands, files=files).logs.streams["wheel_torque"].notes
    assert "readings lie where no rate was logged and are left out" in notes[-1]
    assert f"220 lie in a slew with {-offset:+g} s in streams.wheel_torque.offset_s" in notes[-1]


def test_commands_that_end_early_are_in_force_in_no_later_slew(tmp_path):
    columns = log_columns([(40.0, 30.0, 0.5), (160.0, 30.0, 0.7)], 230.0)
    commands = {name: cells[:150] for name, cells in columns.items()}
    files = [write_csv(tmp_path / "log_a.csv", columns), write_csv(tmp_path / "u.csv", commands)]
    of_commands = ('_torque"\nfiles = ["log*.csv"]', '_torque"\nfiles = ["u.csv"]')
    sparse = "[cut]\nbefore_s = 30.0\nafter_s = 30.0\n\n[rate_sensor]"
    result = imported(tmp_path, {}, of_commands, ("[rate_sensor]", sparse), files=files)
    assert result.logs.streams["wheel_torque"].notes == ("no reading in slew 2",)
    assert not (result.folder / "slew_02_torque.csv").exists()


def test_rates_that_end_early_are_said_of_the_other_streams(tmp_path, columns):
    rates = {name: cells[:195] for name, cells in columns.items()}
    files = [write_csv(tmp_path / "log_a.csv", columns), write_csv(tmp_path / "w.csv", rates)]
    of_rates = ('"rate"\nfiles = ["log*.csv"]', '"rate"\nfiles = ["w.csv"]')
    streams = imported(tmp_path, {}, of_rates, files=files).logs.streams
    for holds in ("wheel_torque", "attitude"):
        assert streams[holds].notes == (
            "23 of 220 readings lie where no rate was logged and are left out",
        )


def test_offsets_of_time_scales_are_tried_by_name():
    for size, why in ((18.0, "GPS"), (69.184, "TT is ahead of UTC"), (3618.0, "GPS")):
        known = known_offset([(np.array([0.1, 5.0, 9.9]) + size, [(0.0, 10.0)])])
        assert known is not None
        assert known[0] == pytest.approx(-size)
        assert why in known[1]
    assert known_offset([(np.array([0.0, 9.0]) + 1234.5, [(0.0, 10.0)])]) is None


def test_a_log_without_stamps_is_read_at_its_rate(tmp_path, columns):
    rate = ('time = { names = ["t_ms"], kind = "ms", epoch', "time = { rate_hz = 2.0, epoch")
    bare = {name: cells for name, cells in columns.items() if name != "t_ms"}
    streams = imported(tmp_path, bare, rate).logs.streams
    assert np.allclose(streams["rate"].time, columns["t_ms"] / 1e3)
    (tmp_path / "both").mkdir()
    both = ("time = { names", "time = { rate_hz = 2.0, names")
    assert_teaches(refusal(tmp_path / "both", columns, both), ["time.rate_hz", "both given"])


@pytest.mark.parametrize(("offset", "count"), [(37.0, 1), (30.0, 0), (0.0, 0)])
def test_what_a_known_offset_mends_reaches_doctor(tmp_path, columns, offset, count):
    fixes = {**columns, "t_ms": columns["t_ms"] + 1e3 * offset}
    files = [write_csv(tmp_path / "log_a.csv", columns), write_csv(tmp_path / "st.csv", fixes)]
    of_fixes = ('"attitude"\nfiles = ["log*.csv"]', '"attitude"\nfiles = ["st.csv"]')
    said = streams_beside(imported(tmp_path, {}, of_fixes, files=files).folder)
    assert len(said) == count
    assert all("220 lie in a slew with -37 s in streams.attitude.offset_s" in x for x in said)


def test_commands_said_to_be_regular_are_so_but_for_the_one_in_force(tmp_path):
    """The command in force at the start of a slew stands on no clock."""
    log = log_columns([(40.0, 20.0, 0.5), (140.0, 20.0, -0.4)], 240.0)
    rng, step = np.random.default_rng(1), 0.25
    time = np.arange(0.1, 240.0, step)
    jitter = 0.02 * rng.uniform(-1.0, 1.0, len(time))
    torque = np.interp(1e3 * time, log["t_ms"], log["torque"])
    files = [
        write_csv(tmp_path / "log.csv", {k: v for k, v in log.items() if k != "torque"}),
        write_csv(tmp_path / "cmd.csv", {"t_ms": 1e3 * (time + jitter), "torque": torque}),
    ]
    stated = 'holds = "wheel_torque"\nfiles = ["{}.csv"]\ntime = {{ names = ["t_ms"], kind = "ms"{}'
    change = (stated.format("log*", ""), stated.format("cmd", ", regular = true"))
    done = imported(tmp_path, {}, change, files=files)
    second = read_table(done.folder / "slew_02_torque.csv", ["t_s"]).numbers("t_s")
    assert second[0] == 0.0
    np.testing.assert_allclose(np.diff(second[1:]), step, atol=2e-4)
    assert done.campaign.slews[1].wheel_torque is not None
