"""Text tables as spreadsheets, ground stations and numpy write them."""

from __future__ import annotations

import io

import numpy as np
import pandas as pd
import pytest

from bayes_inertia.errors import CampaignError
from bayes_inertia.tables.raw_files import read_raw, tables_in
from bayes_inertia.tables.table import Table
from bayes_inertia.tables.text_cells import TextOptions
from bayes_inertia.tables.text_table import parse_text

ROWS = 20
TIME = np.round(np.arange(ROWS) * 0.25, 2)
RATE = np.round(np.random.default_rng(1).normal(size=ROWS), 9)
FIX = np.where(np.arange(ROWS) % 4 == 0, RATE, np.nan)
FRAME = pd.DataFrame({"t": TIME, "w": RATE, "q": FIX, "mode": ["SLEW"] * ROWS})


def check(table: Table) -> None:
    """All numbers of the frame, to the last digit."""
    assert list(table.columns) == ["t", "w", "q", "mode"]
    np.testing.assert_array_equal(table.stack(["t", "w", "q"]), np.c_[TIME, RATE, FIX])
    assert set(table.columns["mode"].values.tolist()) == {"SLEW"}


def written(**options) -> str:
    text = io.StringIO()
    FRAME.to_csv(text, index=False, **options)
    return text.getvalue()


@pytest.mark.parametrize("sep", [",", ";", "\t", "|"])
@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_delimiter_decimal_sign_and_line_ends_are_recognised(sep, decimal, end):
    check(parse_text(written(sep=sep, decimal=decimal, lineterminator=end), "a", TextOptions()))


@pytest.mark.parametrize("sep", [",", ";", "\t", "|"])
def test_columns_that_are_nearly_always_empty(sep):
    """Fixes of a star tracker before and after a long slew."""
    rows = [
        [f"{0.25 * i}", f"{i % 7}.5", *(["1.0"] * 4 if i < 3 else [""] * 4)] for i in range(500)
    ]
    text = "\n".join(sep.join(cells) for cells in [["t", "w", "q1", "q2", "q3", "q4"], *rows])
    table = parse_text(text, "a.txt", TextOptions())
    assert np.isfinite(table.numbers("q4")).sum() == 3
    assert table.numbers("w")[3] == 3.5


@pytest.mark.parametrize(
    "encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32", "latin-1"]
)
def test_encodings_are_recognised(tmp_path, encoding):
    text = "# Drehrate in °/s\n" + written(sep=";", decimal=",").replace("w;", "w;", 1)
    file = tmp_path / "log.csv"
    file.write_bytes(text.encode(encoding))
    check(read_raw(file))
    assert tables_in(file) == [""]


def test_rows_of_metadata_units_and_comments_above_the_data():
    body = written(header=False)
    for head in (
        "Spacecraft,DEMO,,\nExported,2024-05-01,,\nt,w,q,mode\ns,deg/s,-,\n",
        "t,w,q,mode\n[s],[deg/s],[-],[-]\n",
        "# made by X\n\n% and Y\nt, w, q, mode\ns, deg/s, , \n\n",
        "s,deg/s,,\nt,w,q,mode\n",
        "# t,w,q,mode\n# s,deg/s,,\n",
        "sep=,\nt,w,q,mode\ns,deg/s,-,-\n",
        '"t","w","q","mode"\n"s","deg/s","",""\n',
    ):
        table = parse_text(head + body, "a.csv", TextOptions())
        check(table)
        assert [table.columns[name].unit for name in "twq"] == ["s", "deg/s", ""], head


def test_names_can_hold_the_unit():
    table = parse_text("t (s),w [deg/s],n [x]\n0,1,2\n1,2,3\n", "a.csv", TextOptions())
    assert {name: c.unit for name, c in table.columns.items()} == {
        "t (s)": "s",
        "w [deg/s]": "deg/s",
        "n [x]": "",
    }


def test_lines_are_those_of_a_text_editor():
    text = '# a comment\n\nt,w,note\n0,1,"two\nlines"\n\n1,x,ok\n2,3,ok\n3,4,ok\n'
    table = parse_text(text, "a.csv", TextOptions())
    assert table.lines.tolist() == [4, 7, 8, 9]
    with pytest.raises(CampaignError, match=r"a\.csv, line 7, column w: 'x' is not a number"):
        table.numbers("w")
    with pytest.raises(CampaignError, match=r"no column 'ww'; did you mean 'w'\?"):
        table.numbers("ww")


def test_white_space_and_no_names():
    text = "\n".join(f"  {t:.2f}   {w: .9e} " for t, w in zip(TIME, RATE, strict=True))
    table = parse_text(text, "a.txt", TextOptions())
    np.testing.assert_allclose(table.stack(["c1", "c2"]), np.c_[TIME, RATE], rtol=1e-9)
    saved = io.StringIO()
    np.savetxt(saved, np.c_[TIME, RATE], header="t w")
    again = parse_text(saved.getvalue(), "a.txt", TextOptions())
    np.testing.assert_array_equal(again.stack(["t", "w"]), np.c_[TIME, RATE])


def test_what_cannot_be_recognised_can_be_stated():
    text = "1;2\n3;4\n5;6\n7;8\n"
    table = parse_text(text, "a.csv", TextOptions(header_line=1))
    assert list(table.columns) == ["1", "2"]
    assert table.numbers("2").tolist() == [4.0, 6.0, 8.0]
    bare = parse_text("0,25\n0,50\n", "a.csv", TextOptions(delimiter=";", decimal=","))
    assert bare.numbers("c1").tolist() == [0.25, 0.5]
    star = parse_text("* note\nt,w\n1,2\n3,4\n", "a.csv", TextOptions(comment="*"))
    assert star.numbers("w").tolist() == [2.0, 4.0]


def test_columns_without_a_name_of_their_own():
    table = parse_text("t,w,w,,\n0,1,2,3,\n1,2,3,4,\n", "a.csv", TextOptions())
    assert list(table.columns) == ["t", "w", "w#2", "c4"]


def test_empty_cells_in_every_spelling():
    cells = ["", "nan", "NaN", "NA", "n/a", "null", "None", "-", " "]
    text = "t,w\n" + "".join(f"{i},{cell}\n" for i, cell in enumerate(cells)) + "99,1.5\n"
    assert np.isnan(parse_text(text, "a.csv", TextOptions()).numbers("w")[:-1]).all()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty"),
        ("\n\n# x\n", "the file is empty"),
        ("t,w\n", "no row of numbers"),
        ("t,w\n0,1\n1\n2,3\n3,4\n", "line 3: 1 cells, but the table has 2"),
        ("t,w\n0,1\n1,2,3\n2,3\n3,4\n", "line 3: 3 cells"),
        ("t,w\nabc,1\n1,2\n2,3\n", "line 2: 2 cells that do not fit"),
        ('t,w\n0,1\n1,"2\n2,3\n', "close every quote|cells"),
        ("t\0w\n1\0 2\n" * 3, "NUL bytes"),
    ],
)
def test_damaged_text_is_refused_with_the_line(text, message):
    with pytest.raises(CampaignError, match=message):
        parse_text_file(text)


def parse_text_file(text: str) -> Table:
    from bayes_inertia.tables.text_cells import decoded

    return parse_text(decoded(text.encode(), "a.csv"), "a.csv", TextOptions())


@pytest.mark.parametrize(("cell", "message"), [("inf", "infinite"), ("1_000", "not a number")])
def test_cells_that_only_look_like_numbers(cell, message):
    table = parse_text(f"t,w\n0,1\n1,{cell}\n2,2\n3,1\n", "a.csv", TextOptions())
    with pytest.raises(CampaignError, match=rf"line 3, column w.*{message}"):
        table.numbers("w")


def test_dates_are_texts_in_every_form():
    for stamp in ("2024-05-01T00:00:0{}.5Z", "2024-122T00:00:0{}", "2024-05-01 00:00:0{}.25"):
        text = "time;w\n" + "".join(f"{stamp.format(i)};{i},5\n" for i in range(9))
        table = parse_text(text, "a.csv", TextOptions())
        assert table.columns["time"].is_text
        assert table.numbers("w")[1] == 1.5
