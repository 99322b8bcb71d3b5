"""Telemetry that is wrong is refused, by line."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.campaign_files import (
    CSV,
    assert_teaches,
    make,
    refusal,
)

from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.errors import CampaignError


def cell(line: int, column: str, value: str) -> str:
    """CSV with one cell replaced; `line` as in a text editor."""
    lines = CSV.splitlines()
    cells = lines[line - 1].split(",")
    cells[lines[0].split(",").index(column)] = value
    lines[line - 1] = ",".join(cells)
    return "\n".join(lines) + "\n"


BAD_CSV = [
    ("empty file", "", ["a.csv, line 1", "empty"]),
    ("only a header", CSV.splitlines()[0], ["a.csv", "0 row(s)"]),
    ("one row", "\n".join(CSV.splitlines()[:2]), ["a.csv", "1 row(s)"]),
    ("short line", CSV.replace("0.06,0.6,", "0.06,"), ["a.csv, line 3", "15 cells", "16"]),
    ("long line", CSV.replace("0.06,0.6,", "0.06,0.6,0.6,"), ["a.csv, line 3", "17 cells", "16"]),
    ("long first line", CSV.replace("\n0,", "\n0,0,"), ["a.csv, line 2", "17 cells"]),
    (
        "all lines long",
        CSV.replace(",idle", ",idle,").replace(",slew", ",slew,"),
        ["a.csv, line 2", "17 cells"],
    ),
    ("decimal comma", CSV.replace("0.25,", "0,25,"), ["a.csv, line 3", "decimal points"]),
    (
        "quoted decimal comma",
        CSV.replace("0.25,", '"0,25",'),
        ["a.csv, line 3, column t", "decimal point, not a comma"],
    ),
    ("semicolons", CSV.replace(",", ";"), ["a.csv, line 1", "semicolons"]),
    ("tabs", CSV.replace(",", "\t"), ["a.csv, line 1", "tabs"]),
    ("column twice", CSV.replace("mode", "wx"), ["a.csv, line 1", "two columns are named 'wx'"]),
    (
        "column missing",
        CSV.replace("wx", "w_x"),
        ["a.csv, line 1", "no column 'wx'", "did you mean 'w_x'"],
    ),
    (
        "column named by several lines",
        CSV.replace("wx,", '"w\nx",', 1),
        ["a.csv, line 1", "no column 'wx'", "The table has: t, u1", "w\\nx, wy"],
    ),
    ("text", cell(4, "wx", "high"), ["a.csv, line 4, column wx", "'high' is not a number"]),
    ("long text", cell(4, "wx", "x" * 9000), ["a.csv, line 4, column wx", "..."]),
    (
        "quaternion beyond all numbers",
        cell(4, "q4", "1e300"),
        ["a.csv, line 4, columns q1, q2, q3, q4", "length inf"],
    ),
    ("underscore", cell(4, "wx", "1_000"), ["a.csv, line 4, column wx", "'1_000'"]),
    ("date", cell(4, "t", "2024-01-01T00:00:00"), ["a.csv, line 4, column t", "seconds"]),
    ("infinity", cell(5, "wz", "inf"), ["a.csv, line 5, column wz", "infinite"]),
    (
        "infinity in the quaternion",
        cell(4, "q4", "-Infinity"),
        ["a.csv, line 4, column q4", "infinite"],
    ),
    ("overflow", cell(5, "wz", "1e999"), ["a.csv, line 5, column wz", "infinite"]),
    ("empty time", cell(4, "t", ""), ["a.csv, line 4, column t", "empty"]),
    ("nan time", cell(4, "t", "nan"), ["a.csv, line 4, column t", "empty"]),
    (
        "repeated time",
        cell(4, "t", "0.25"),
        ["a.csv, line 4, column t", "0.25 is repeated", "line 3"],
    ),
    (
        "time goes back",
        cell(5, "t", "0.1"),
        ["a.csv, line 5, column t", "goes back from 0.5 to 0.1"],
    ),
    (
        "lines counted over empty ones",
        cell(5, "t", "0.1").replace("\n0.5", "\n\n\n0.5"),
        ["a.csv, line 7, column t", "line 6"],
    ),
    ("zero quaternion", cell(4, "q4", "0"), ["a.csv, line 4, columns q1, q2, q3, q4", "length 0"]),
    (
        "quaternion not unit",
        cell(4, "q4", "0.9"),
        ["a.csv, line 4, columns q1, q2, q3, q4", "length 0.9"],
    ),
    (
        "quaternion incomplete",
        cell(4, "q2", ""),
        ["a.csv, line 4, columns q1, q2, q3, q4", "incomplete"],
    ),
    (
        "quaternion almost empty",
        cell(5, "q2", "0.0"),
        ["a.csv, line 5, columns q1, q2, q3, q4", "incomplete"],
    ),
    ("empty command", cell(3, "u2", ""), ["a.csv, line 3, column u2", "empty"]),
    ("gap in the field", cell(5, "by", ""), ["a.csv, line 5, column by", "empty"]),
    ("open quote", CSV.replace(",slew", ',"slew', 1), ["a.csv, line 3", "quote"]),
    ("huge quoted cell", cell(3, "mode", f'"{200_000 * "x"}"'), ["a.csv, line 3", "field limit"]),
]


@pytest.mark.parametrize(
    ("csv", "named"), [row[1:] for row in BAD_CSV], ids=[row[0] for row in BAD_CSV]
)
def test_bad_telemetry(tmp_path, csv, named):
    folder = make(tmp_path, csv=csv)
    with pytest.raises(CampaignError) as caught:
        read_campaign(folder)
    assert_teaches(caught.value, named)


@pytest.mark.parametrize("column", ["t", "wy", "u1", "h2", "bx"])
def test_a_column_that_is_empty_everywhere(tmp_path, column):
    lines = CSV.splitlines()
    at = lines[0].split(",").index(column)
    rows = [row.split(",") for row in lines[1:]]
    csv = "\n".join([lines[0], *(",".join([*row[:at], "", *row[at + 1 :]]) for row in rows)])
    with pytest.raises(CampaignError) as caught:
        read_campaign(make(tmp_path, csv=csv))
    assert_teaches(caught.value, [f"a.csv, column {column}", "every cell is empty"])


def test_a_slew_without_any_fix_or_field(tmp_path):
    folder = make(tmp_path)
    csv = (
        CSV.replace("1e-5,2e-5,3e-5", ",,")
        .replace("0.6,0.0,0.0,0.8", ",,,")
        .replace("0.0,0.0,0.0,1.0", ",,,")
    )
    (folder / "b.csv").write_text(csv)
    first, second = read_campaign(folder).slews
    assert first.attitude is not None
    assert second.attitude is second.magnetic_field_N is None


def test_symlinks_may_not_leave_the_folder(tmp_path):
    folder = make(tmp_path / "campaign")
    outside = tmp_path / "outside.csv"
    outside.write_text(CSV)
    (folder / "b.csv").unlink()
    (folder / "b.csv").symlink_to(outside)
    with pytest.raises(CampaignError) as caught:
        read_campaign(folder)
    assert_teaches(caught.value, ["key slews.second.file", "links to a place outside"])
    (folder / "b.csv").unlink()
    (folder / "inner.csv").write_text(CSV)
    (folder / "b.csv").symlink_to("inner.csv")
    (tmp_path / "alias").symlink_to(folder)
    assert len(read_campaign(tmp_path / "alias").slews) == 2


@given(position=st.integers(0, len(CSV) - 1), junk=st.text(max_size=3))
@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_damaged_tables_never_end_in_a_traceback(tmp_path, position, junk):
    folder = make(tmp_path, csv=CSV[:position] + junk + CSV[position + 1 :])
    error = refusal(folder)
    assert error is None or (error.where and error.advice)
