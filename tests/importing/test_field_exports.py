"""Exports of ground systems, loggers and robots as the field brings them."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from bayes_inertia.errors import CampaignError
from bayes_inertia.importing.starting_mapping import write_starting_mapping
from bayes_inertia.tables.raw_files import read_raw, tables_in
from bayes_inertia.tables.table import Table
from bayes_inertia.tables.time_stamps import times_to_seconds

ROWS = 40
TIME = [0.25 * i for i in range(ROWS)]
RATE = [[0.001 * i, -0.002 * i, 0.0005 * i] for i in range(ROWS)]
STAMPS = [f"2026-03-01T12:00:{t:06.3f}Z" for t in TIME]
AXES = ("GYRO_X", "GYRO_Y", "GYRO_Z")


def read(folder: Path, name: str, content: str | bytes, table: str = "") -> Table:
    file = folder / name
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_raw(file, table=table)


def lines(head: str, delimiter: str = ",") -> list[str]:
    rows = [[f"{t}", *(f"{w:.5f}" for w in rates)] for t, rates in zip(TIME, RATE, strict=True)]
    return [head, *(delimiter.join(row) for row in rows)]


@pytest.mark.parametrize(
    ("head", "delimiter"),
    [("t\twx\twy\twz\t", "\t"), ("t,wx,wy,wz,,", ","), ("# t;wx;wy;wz;", ";")],
)
def test_delimiters_at_the_end_of_the_names_alone(tmp_path, head, delimiter):
    table = read(tmp_path, "a.txt", "\n".join(lines(head, delimiter)))
    assert list(table.columns) == ["t", "wx", "wy", "wz"]
    np.testing.assert_allclose(table.stack(["wx", "wy", "wz"]), RATE, atol=1e-9)


def by_time() -> list[list[str]]:
    return [
        [stamp, axis, f"{w:.5f}"]
        for stamp, rates in zip(STAMPS, RATE, strict=True)
        for axis, w in zip(AXES, rates, strict=True)
    ]


def by_axis() -> list[list[str]]:
    return sorted(by_time(), key=lambda row: row[1])


def influx(rows: list[list[str]], plain: bool) -> str:
    """As InfluxDB writes a table for each field: with notes, or with names alone."""
    notes = (
        "#group,false,false,true,true\n#datatype,string,long,double,string\n#default,_result,,,\n"
    )
    head = ("" if plain else notes) + ",result,table,_time,_value,_field,_measurement\n"
    parts = [[row for row in rows if row[1] == axis] for axis in AXES]
    return "\n".join(
        head + "".join(f",,{k},{t},{v},{name[-1]},GYRO\n" for t, name, v in part)
        for k, part in enumerate(parts)
    )


LONG = {
    "YAMCS": "timestamp,parameter,value,unit\n"
    + "".join(f"{','.join(row)},rad/s\n" for row in by_time()),
    "Grafana": '"Series";"Time";"Value"\n'
    + "".join(f'"{name}";"{t}";"{v}"\n' for t, name, v in by_axis()),
    "with texts": "Generation Time\tName\tRaw value\tEng value\n"
    + "".join(f"{t}\t{name}\t{k}\t{v}\n" for k, (t, name, v) in enumerate(by_time()))
    + f"{STAMPS[0]}\tMODE\t1\tSLEW\n",
    "InfluxDB": influx(by_axis(), plain=False),
    "InfluxDB, plain": influx(by_axis(), plain=True),
    "JSON": "\n".join(json.dumps(dict(zip("time name value".split(), row))) for row in by_time()),  # noqa: B905, SIM905
    "decimal commas": "time;mnemonic;value\n"
    + "".join(f"{t};{name};{v.replace('.', ',')}\n" for t, name, v in by_time()),
}


@pytest.mark.parametrize("kind", LONG)
def test_one_row_a_parameter_becomes_one_row_a_time(tmp_path, kind):
    table = read(tmp_path, "a.json" if kind == "JSON" else "a.csv", LONG[kind])
    names = [n for n in table.columns if n[-1] in "XYZ"]
    assert len(names) == 3
    assert table.rows == ROWS
    np.testing.assert_allclose(table.stack(names).astype(float), RATE, atol=1e-9)
    assert any("one row a parameter" in note for note in table.notes)
    assert table.columns[names[0]].unit == ("rad/s" if kind == "YAMCS" else "")


def cosmos(mode: str) -> str:
    """As COSMOS extracts two packets: each leaves the cells of the other empty."""
    names = ["PACKET_TIMESECONDS", "PACKET_TIMEFORMATTED", *AXES, "MODE"]
    if mode == "full":
        names = [f"INST {'HK' if name == 'MODE' else 'ADCS'} {name}" for name in names]
    head = [*([] if mode == "full" else ["TARGET", "PACKET"]), *names]
    rows = []
    for t, stamp, rates in zip(TIME, STAMPS, RATE, strict=True):
        shown = stamp.replace("-", "/").replace("T", " ").removesuffix("Z")
        time = [f"{1772366400.0 + t}", shown]
        rates = [f"{w:.5f}" for w in rates]
        for packet, cells in (("ADCS", [*time, *rates, ""]), ("HK", [*time, "", "", "", "SLEW"])):
            rows.append([*([] if mode == "full" else ["INST", packet]), *cells])
    mark, tab = ("% ", "\t") if mode == "MATLAB" else ("", ",")
    return "\n".join([mark + tab.join(head), *(tab.join(row) for row in rows)]) + "\n"


@pytest.mark.parametrize("mode", ["normal", "MATLAB", "full"])
def test_two_packets_of_cosmos_in_one_table(tmp_path, mode):
    table = read(tmp_path, "a.csv", cosmos(mode))
    of_packet = "INST ADCS " if mode == "full" else ""
    read_rates = table.stack([f"{of_packet}{axis}" for axis in AXES])
    held = np.isfinite(read_rates).all(axis=1)
    np.testing.assert_allclose(read_rates[held], RATE, atol=1e-9)
    for name, kind in (("PACKET_TIMESECONDS", "unix_s"), ("PACKET_TIMEFORMATTED", "utc")):
        stamps = times_to_seconds(table, [f"{of_packet}{name}"], kind)
        seconds = stamps.seconds_since(stamps.first_ns)[held]
        np.testing.assert_allclose(seconds, TIME, atol=1e-6)
    mapping = tmp_path / "mapping.toml"
    write_starting_mapping([tmp_path / "a.csv"], mapping)
    assert 'holds = "rate"' in mapping.read_text()


def test_parameters_below_each_other_with_times_of_their_own_come_in_the_order_of_time(tmp_path):
    rows = [f"{t + 0.1 * k},{axis},{k}" for k, axis in enumerate(AXES) for t in TIME]
    table = read(tmp_path, "a.csv", "\n".join(["t,parameter,value", *rows]))
    assert (np.diff(table.numbers("t")) > 0.0).all()
    assert [int(np.isfinite(table.numbers(axis)).sum()) for axis in AXES] == [ROWS] * 3
    back = [row for row in rows if "GYRO_X" in row]
    table = read(tmp_path, "b.csv", "\n".join(["t,parameter,value", *back[9:], *back[:9]]))
    assert (np.diff(table.numbers("t")) < 0.0).any()


def test_what_a_parameter_reads_twice_at_one_time_stays(tmp_path):
    text = "t,parameter,value\n" + "".join(f"{t},w,1\n{t},w,2\n{t},h,3\n" for t in TIME)
    table = read(tmp_path, "a.csv", text)
    assert table.numbers("w").tolist() == [1.0, 2.0] * ROWS
    wide = read(tmp_path, "b.csv", "t,name,wx,wy\n" + "".join(f"{t},a,1,2\n" for t in TIME))
    assert list(wide.columns) == ["t", "name", "wx", "wy"]


@pytest.mark.parametrize(
    ("end", "rows", "note"),
    [
        (b"\n" + b"\0" * 9000, ROWS, "NUL bytes in line 42 .*: left out"),
        (b"\n99.0,0.1,0.\0\0\0\n98.0,0,0,0\n", ROWS + 1, "line 42 .*: 1 line cut left out"),
        (b"\n\0\0\0\0\0.1,0,0\n\n50,0,0,0\n51,0,0,0", ROWS + 2, "line 42 .*: 1 line cut"),
        (b"\n99.0,0.1,0.", ROWS, "line 42, the last, breaks off"),
    ],
)
def test_a_loss_of_power_costs_the_lines_that_it_cut(tmp_path, end, rows, note):
    table = read(tmp_path, "a.csv", "\n".join(lines("t,wx,wy,wz")).encode() + end)
    assert table.rows == rows
    np.testing.assert_allclose(table.stack(["wx", "wy", "wz"])[:ROWS], RATE, atol=1e-9)
    assert len(table.notes) == 1
    assert re.search(note, table.notes[0])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\0" * 5000, "nothing but NUL bytes; the logger lost power before it wrote"),
        (b"t,w\n0,1\n\x01\x02,3\n\x04,\0\n", "line 4: NUL bytes"),
        (b"t,w\n" + b"0\0,1\n" * 9, "line 2: NUL bytes"),
    ],
)
def test_zero_bytes_that_are_no_loss_of_power_are_refused(tmp_path, content, message):
    with pytest.raises(CampaignError, match=message):
        read(tmp_path, "a.csv", content)


def test_short_logs_with_many_zero_bytes_are_no_utf_16(tmp_path):
    assert read(tmp_path, "a.csv", b"t,w\n0,1\n1,2\n2,3\n" + b"\0" * 4096).rows == 3


def test_logs_that_were_put_together_have_their_names_once(tmp_path):
    body = "\n".join(lines("t,wx,wy,wz"))
    table = read(tmp_path, "a.csv", body + "\n" + body)
    assert table.rows == 2 * ROWS
    assert table.notes == ("the names stand again in line 42: taken once",)


COLUMNS = {"t": TIME, "gyro": RATE}
BY_INDEX = {
    name: {str(k): v for k, v in enumerate(values)}
    for name, values in {"t": TIME, "gyro": RATE}.items()
}
RECORDS = [{"t": t, "gyro": w} for t, w in zip(TIME, RATE, strict=True)]
DOCUMENTS = {
    "arrays": COLUMNS,
    "wrapped": {"meta": {"rate_hz": 4, "exported": 1.7e9}, "data": COLUMNS},
    "in a list": [COLUMNS],
    "null": {"t": TIME, "gyro": [*RATE[:-1], None]},
    "objects": {"status": "ok", "data": {"rows": RECORDS}},
    "by index": BY_INDEX,
    "pandas split": {
        "columns": ["t", "gyro[0]", "gyro[1]", "gyro[2]"],
        "data": [[t, *w] for t, w in zip(TIME, RATE, strict=True)],
    },
    "InfluxDB": {
        "results": [
            {
                "series": [
                    {
                        "name": "imu",
                        "columns": ["t", "gyro"],
                        "values": [list(row) for row in zip(TIME, RATE, strict=True)],
                    }
                ]
            }
        ]
    },
}


@pytest.mark.parametrize("kind", DOCUMENTS)
def test_one_json_document_with_arrays_by_name(tmp_path, kind):
    for indent in (None, 1):
        table = read(tmp_path, "a.json", json.dumps(DOCUMENTS[kind], indent=indent))
        assert tables_in(tmp_path / "a.json") == [""]
        assert list(table.columns) == ["t", "gyro[0]", "gyro[1]", "gyro[2]"]
        expected = np.array(RATE)
        expected[-1] = np.nan if kind == "null" else expected[-1]
        np.testing.assert_array_equal(table.stack([f"gyro[{k}]" for k in range(3)]), expected)
        assert table.numbers("t").tolist() == TIME


def test_json_documents_of_several_streams_and_in_parts(tmp_path):
    streams = {"imu": COLUMNS, "st": {"t": [0.0, 1.0], "q": [[0, 0, 0, 1]] * 2}}
    table = read(tmp_path, "a.json", json.dumps(streams), "st")
    assert tables_in(tmp_path / "a.json") == ["imu", "st"]
    assert table.stack(["t", "q[3]"]).tolist() == [[0.0, 1.0], [1.0, 1.0]]
    parts = "\n".join(json.dumps({"t": [t + 100 * k for t in TIME], "w": TIME}) for k in range(3))
    assert read(tmp_path, "b.jsonl", parts).rows == 3 * ROWS
    damaged = "\n".join(json.dumps({"t": TIME, "w": w}) for w in (TIME, ["n/d", *TIME[1:]]))
    with pytest.raises(CampaignError, match="'n/d' is not a number"):
        read(tmp_path, "d.jsonl", damaged).numbers("w")
    wider = "\n".join(json.dumps({"t": TIME, "w": w}) for w in (TIME, RATE))
    assert read(tmp_path, "e.jsonl", wider).rows == 2
    with pytest.raises(CampaignError, match="key gyro: its rows differ in length"):
        read(tmp_path, "c.json", json.dumps({"t": TIME, "gyro": [*RATE[:-1], [1, 2]]}))
    one = read(tmp_path, "d.json", json.dumps({"t": 1.5, "gyro": [0.1, 0.2, 0.3]}))
    assert (one.rows, list(one.columns)) == (1, ["t", "gyro[0]", "gyro[1]", "gyro[2]"])


def test_json_lines_that_break_off(tmp_path):
    table = read(tmp_path, "a.jsonl", "\n".join(map(json.dumps, RECORDS))[:-7])
    assert table.rows == ROWS - 1
    assert "line 40, the last, breaks off" in table.notes[0]
