"""JSON lines and the text outputs of NASA 42."""

from __future__ import annotations

import json

import numpy as np
import pytest

from bayes_inertia.errors import CampaignError
from bayes_inertia.tables.raw_files import file_format, read_raw

ROWS = 12
TIME = np.arange(ROWS) * 0.25
RATE = np.random.default_rng(4).normal(size=(ROWS, 3))


def test_json_lines(tmp_path):
    file = tmp_path / "log.jsonl"
    records = [
        {"t": t, "ns": 2**60 + i, "gyro": {"w": list(w), "ok": True}, "mode": "SLEW"}
        for i, (t, w) in enumerate(zip(TIME, RATE, strict=True))
    ]
    records[3]["gyro"] = {"w": [None, 1, 2.5]}
    file.write_text("\n\n".join(json.dumps(record) for record in records))
    table = read_raw(file)
    expected = RATE.copy()
    expected[3] = [np.nan, 1.0, 2.5]
    np.testing.assert_array_equal(table.stack([f"gyro.w[{i}]" for i in range(3)]), expected)
    assert table.columns["ns"].values[1] == 2**60 + 1
    assert np.isnan(table.numbers("gyro.ok")).tolist() == [row == 3 for row in range(ROWS)]
    assert table.columns["mode"].is_text
    assert table.lines.tolist() == list(range(1, 2 * ROWS, 2))
    file.write_text(json.dumps(records))
    np.testing.assert_array_equal(read_raw(file).numbers("t"), TIME)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"t": 1}\n{"t": 2', "line 2: no JSON"),
        ('{"t": 1}\n[1, 2]', "line 2: no JSON object"),
        ("", "the file is empty"),
        ("[1, 2]", "other things than objects"),
        ('{"a": ' + "[" * 60 + "]" * 60 + "}", "nested too deeply"),
        ('{"a": ' + "[" * 200000, "no JSON"),
        ('{"a": {"b": 1}, "a.b": 2}', "two values are named"),
    ],
)
def test_damaged_json_is_refused_with_the_line(tmp_path, text, message):
    file = tmp_path / "log.jsonl"
    file.write_text(text)
    with pytest.raises(CampaignError, match=message):
        read_raw(file)


def written_42(folder, name: str, form: str, values) -> None:
    """As 42report.c prints it: `form` for every number, a space after each."""
    lines = ["".join(form % x + " " for x in np.atleast_1d(row)) + "\n" for row in values]
    (folder / name).write_text("".join(lines))


def test_outputs_of_42_get_their_names_units_and_stamps(tmp_path):
    written_42(tmp_path, "time.42", "%f", TIME)
    written_42(tmp_path, "wbn.42", "%e", RATE)
    fixes = np.c_[RATE, TIME]
    fixes[:5] = np.nan
    written_42(tmp_path, "qbn.42", "%e", fixes)
    written_42(tmp_path, "Hwhl.42", "%f", 0.05 * RATE[:, [0, 1, 2, 0]])
    written_42(tmp_path, "u00.42", "%18.12e", RATE)
    rates = read_raw(tmp_path / "wbn.42")
    names = [f"wbn[{i}]" for i in range(3)]
    np.testing.assert_allclose(rates.stack(names), RATE, rtol=1e-6)
    assert {rates.columns[name].unit for name in names} == {"rad/s"}
    assert (rates.time_names, rates.time_kind) == (("time",), "s")
    np.testing.assert_array_equal(rates.numbers("time"), TIME)
    tracker = read_raw(tmp_path / "qbn.42")
    np.testing.assert_allclose(tracker.stack([f"qbn[{i}]" for i in range(4)]), fixes, rtol=1e-6)
    attitude = tracker.attitude
    assert attitude is not None
    assert (attitude.scalar, attitude.maps) == ("last", "inertial_to_body")
    wheels = read_raw(tmp_path / "Hwhl.42")
    assert wheels.columns["Hwhl[3]"].unit == "N m s"
    assert "rounded to 1e-6" in wheels.notes[0]
    assert list(read_raw(tmp_path / "u00.42").columns) == ["time", "c1", "c2", "c3"]


def test_outputs_of_42_that_do_not_fit_are_refused(tmp_path):
    written_42(tmp_path, "time.42", "%f", TIME[:-1])
    written_42(tmp_path, "wbn.42", "%e", RATE)
    with pytest.raises(CampaignError, match=r"12 rows, but time\.42 beside it has 11"):
        read_raw(tmp_path / "wbn.42")
    written_42(tmp_path, "qbn.42", "%e", RATE)
    with pytest.raises(CampaignError, match="3 columns, but 42 writes 4"):
        read_raw(tmp_path / "qbn.42")


def test_dates_of_42(tmp_path):
    (tmp_path / "UTC.42").write_text(" 2024:05:01:23:59:59.250000\n 2024:05:02:00:00:00.250000\n")
    table = read_raw(tmp_path / "UTC.42")
    assert table.columns["UTC"].values.tolist()[0] == "2024-05-01T23:59:59.250000Z"
    (tmp_path / "UTC.42").write_text(" 2024:05:01\n")
    with pytest.raises(CampaignError, match="line 1"):
        read_raw(tmp_path / "UTC.42")


def test_formats_are_recognised_by_content(tmp_path):
    heads = {
        b"\x89HDF\r\n\x1a\n": "hdf5",
        b"CDF\x01": "netcdf",
        b"PAR1": "parquet",
        b"\x93NUMPY": "numpy",
        b"MATLAB 5.0 MAT-file": "mat",
        b"CCSDS_AEM_VERS = 2.0": "aem",
        b'{"t": 1}': "json",
        b"t,w": "text",
    }
    for head, form in heads.items():
        file = tmp_path / "log.dat"
        file.write_bytes(head)
        assert file_format(file) == form
    for head in (b"PK\x03\x04", b"SQLite format 3\0"):
        file.write_bytes(head)
        with pytest.raises(CampaignError, match="unpack it, or save its table as CSV"):
            read_raw(file)
    for name, head, said in (
        ("log.bin", b"\xa3\x95\x80\x80\x59", "is a log of ArduPilot; .*mavlogdump"),
    ):
        (tmp_path / name).write_bytes(head)
        with pytest.raises(CampaignError, match=said):
            read_raw(tmp_path / name)
    with pytest.raises(CampaignError, match="cannot be opened"):
        read_raw(tmp_path / "none.csv")
    with pytest.raises(CampaignError, match="cannot be opened"):
        read_raw(tmp_path)
