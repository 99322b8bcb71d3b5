"""Logs that are odd but honest: packed, with footers, marks, zones, and several units."""

from __future__ import annotations

import bz2
import gzip
import lzma
from pathlib import Path

import numpy as np
import pytest
from support.raw_logs import edited_mapping, log_columns, write_csv

from bayes_inertia.errors import CampaignError
from bayes_inertia.importing.log_reader import read_logs
from bayes_inertia.importing.mapping import parse_mapping
from bayes_inertia.importing.starting_mapping import starting_mapping
from bayes_inertia.tables import text_cells
from bayes_inertia.tables.limits import Limits
from bayes_inertia.tables.number_table import parse_csv
from bayes_inertia.tables.raw_files import read_raw
from bayes_inertia.tables.table import Column, Table
from bayes_inertia.tables.time_stamps import times_to_seconds

ROWS = [f"{0.5 * k},{0.01 * k:.3f},{k % 7}" for k in range(40)]
TEXT = "\n".join(["t_s,wx,n", *ROWS]) + "\n"
TURNS = [(60.0, 40.0, 1.0)]


def read(folder: Path, content: str | bytes, name: str = "log.csv") -> Table:
    file = folder / name
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_raw(file)


@pytest.mark.parametrize("packing", [gzip, bz2, lzma])
def test_packed_logs_are_read_as_those_that_they_hold(tmp_path, packing):
    plain = read(tmp_path, TEXT)
    packed = read(tmp_path, packing.compress(TEXT.encode()), "log.csv.packed")
    np.testing.assert_array_equal(packed.stack(["t_s", "wx"]), plain.stack(["t_s", "wx"]))
    lines = "\n".join(f'{{"t": {k}, "w": {0.1 * k}}}' for k in range(5))
    assert read(tmp_path, packing.compress(lines.encode()), "a.jsonl.xz").rows == 5


def test_a_packed_log_is_refused_if_damaged_too_large_or_binary(tmp_path, monkeypatch):
    whole = gzip.compress(TEXT.encode())
    with pytest.raises(CampaignError, match=r"log.csv.gz: cannot be read .*damaged.*whole"):
        read(tmp_path, whole[:-20], "log.csv.gz")
    with pytest.raises(CampaignError, match=r"is packed by gzip.*unpack it"):
        read(tmp_path, gzip.compress(b"\x89HDF\r\n\x1a\n" + bytes(99)), "log.h5.gz")
    monkeypatch.setattr(text_cells, "LIMITS", Limits(most_content=100))
    with pytest.raises(CampaignError, match="unpacked it has more than"):
        read(tmp_path, whole, "log.csv.gz")


@pytest.mark.parametrize(
    "footer",
    ["End of file: 40 rows", "EOF", "Total,40", "End of data,,", "\n-- done --,x,y\nby me"],
)
def test_a_footer_is_left_out_and_said(tmp_path, footer):
    table = read(tmp_path, f"{TEXT}{footer}\n")
    assert table.rows == 40
    assert "footer in line" in table.notes[0]
    np.testing.assert_array_equal(table.numbers("wx"), read(tmp_path, TEXT).numbers("wx"))


@pytest.mark.parametrize("damaged", ["20.0,0.4", "20.0,0.4,1,9", "x20.0,0.4,1"])
def test_a_damaged_last_row_is_no_footer(tmp_path, damaged):
    with pytest.raises(CampaignError, match="line 42"):
        read(tmp_path, f"{TEXT}{damaged}\n").numbers("t_s")


@pytest.mark.parametrize(
    "mark", ["---", "--.--", "****", "INVALID", "n.a.", "-nan(ind)", "1.#QNAN"]
)
def test_marks_of_no_reading(tmp_path, mark):
    values = read(tmp_path, TEXT.replace("\n0.5,0.010", f"\n0.5,{mark}")).numbers("wx")
    assert np.flatnonzero(np.isnan(values)).tolist() == [1]


def test_a_parameter_whose_unit_changes_becomes_two_columns(tmp_path):
    rows = [
        f"{k},{name},{k}.5,{unit}"
        for k in range(10)
        for name, unit in (("wx", "deg/s" if k < 5 else "rad/s"), ("wy", "deg/s"), ("T", "°"))
    ]
    table = read(tmp_path, "\n".join(["time,parameter,value,unit", *rows]))
    units = {name: column.unit for name, column in table.columns.items() if name != "time"}
    assert units == {"wx [deg/s]": "deg/s", "wx [rad/s]": "rad/s", "wy": "deg/s", "T": "°"}
    assert np.isfinite(table.numbers("wx [deg/s]")).sum() == 5


def test_times_of_the_day_alone_run_on_through_midnight(tmp_path):
    columns = log_columns(TURNS, 200.0)
    seconds = (columns.pop("t_ms") / 1e3 + 86300.0) % 86400.0
    clock = [f"{int(s // 3600):02}:{int(s // 60 % 60):02}:{s % 60:04.1f}" for s in seconds]
    columns = {"t_ms": np.array(clock)} | columns
    change = ('kind = "ms", epoch = "campaign"', 'kind = "s", epoch = "campaign"')
    file = write_csv(tmp_path / "log.csv", columns)
    mapping = parse_mapping(edited_mapping(tmp_path, change).read_text(), "mapping.toml")
    rate = read_logs([file], mapping, "mapping.toml").streams["rate"]
    np.testing.assert_array_equal(rate.time, np.arange(400) * 0.5)
    assert "86400 s" in rate.notes[0]
    assert 'kind = "s"' in starting_mapping([file]).text


def test_dates_with_an_offset_are_utc(tmp_path):
    columns = log_columns(TURNS, 200.0)
    dates = np.datetime64("2026-03-01T12:00") + columns.pop("t_ms").astype("m8[ms]")
    file = write_csv(
        tmp_path / "log.csv", {"time": np.char.add(dates.astype(str), "+01:00")} | columns
    )
    assert 'names = ["time"], kind = "utc" }' in starting_mapping([file]).text


def test_days_as_excel_and_matlab_count_them():
    numbers = {"excel": 46082.5, "datenum": 740042.5, "mjd_utc": 61100.5}
    ns = {
        kind: int(times_to_seconds(Table("a", {"t": Column(np.array([n]))}), ["t"], kind).ns[0])
        for kind, n in numbers.items()
    }
    date = Table("a", {"t": Column(np.array(["2026-03-01T12:00:00Z"]))})
    assert set(ns.values()) == {int(times_to_seconds(date, ["t"], "utc").ns[0])}


def test_vectors_in_one_cell_become_columns(tmp_path):
    lists = [f'{k},"[0.1, {k}.5, 0, 1]"' if k != 3 else f"{k}," for k in range(9)]
    table = read(tmp_path, "\n".join(["t,q", *lists]))
    assert list(table.columns) == ["t", "q[0]", "q[1]", "q[2]", "q[3]"]
    np.testing.assert_array_equal(np.isnan(table.numbers("q[1]")), np.arange(9) == 3)
    tuples = [f"{k};({k}.5 2.5)" for k in range(9)]
    assert read(tmp_path, "\n".join(["t;w", *tuples])).numbers("w[0]").tolist()[-1] == 8.5
    words = [f"{k};[mode {k % 2} {k}] on" if k % 2 else f"{k};[mode]" for k in range(9)]
    assert "w" in read(tmp_path, "\n".join(["t;w", *words])).columns


def test_minus_signs_of_typesetters_and_byte_order_marks_within(tmp_path):
    text = "\ufeff" + TEXT.replace(",0.010", ",\u22120.010") + "\ufeff" + TEXT
    table = read(tmp_path, text)
    assert table.numbers("wx")[1] == -0.01
    assert table.rows == 80


def test_units_in_cells_are_those_of_the_column(tmp_path):
    rows = [f"{0.5 * k},{0.1 * k:.3f} deg/s,{k} mNm,{k}{'A' if k % 2 else 'B'}" for k in range(9)]
    rows[3] = "1.5,---,3 mNm,"
    table = read(tmp_path, "\n".join(["t_s,wx,u,id", *rows]))
    assert [table.columns[name].unit for name in ("wx", "u", "id")] == ["deg/s", "mNm", ""]
    assert table.numbers("wx")[4] == 0.4
    assert np.isnan(table.numbers("wx")[3])
    assert table.columns["id"].is_text
    changed = "\n".join(["t_s,wx", *rows[:5], "2.5,1.0 rad/s,5 mNm,"])
    with pytest.raises(CampaignError, match=r"'0.000 deg/s' is not a number"):
        read(tmp_path, changed.replace("t_s,wx", "t_s,wx,u,id")).numbers("wx")
    with pytest.raises(CampaignError, match=r"'0.000 deg/s' is not a number"):
        parse_csv("\n".join(["t_s,wx,u,id", *rows]), ["t_s", "wx"], "a.csv")


def test_flags_are_alike_in_small_and_capital_letters(tmp_path):
    columns = log_columns(TURNS, 200.0)
    columns["valid"] = np.array(["FALSE", *["TRUE"] * 399])
    file = write_csv(tmp_path / "log.csv", columns)
    change = (
        'form = "quaternion"',
        'form = "quaternion"\nvalid = { name = "valid", equals = true }',
    )
    mapping = parse_mapping(edited_mapping(tmp_path, change).read_text(), "mapping.toml")
    fixes = read_logs([file], mapping, "mapping.toml").streams["attitude"]
    assert "1 rows are flagged as not valid" in fixes.notes[0]
