"""Two runs side by side: the numbers, the page, the command, and what is refused."""

from __future__ import annotations

import json
import math

import pytest
from support.commands import run

from bayes_inertia.report.run_comparison import ComparedRun, compare_runs


def row(mean: float, sd: float, quoted_sd: float | None = None) -> dict:
    return {"mean": mean, "sd": sd, "quoted_sd": quoted_sd or sd, "unit": "kg m^2"}


def compared(name: str, digest: str, *, trusted: bool = True, **parameters) -> ComparedRun:
    if not trusted:
        parameters = {name: row | {"quoted_sd": None} for name, row in parameters.items()}
    summary = {"parameters": parameters, "derived": {}, "campaign_sha256": digest}
    summary["trusted"] = trusted
    return ComparedRun(name, name, summary, {"seed": name, "drive": "commanded"})


def test_differences_are_counted_in_the_combined_quoted_sd():
    first = compared("a", "1", Jxx=row(3.0, 0.01, 0.03), Jyy=row(2.0, 0.1))
    second = compared("b", "2", Jxx=row(3.1, 0.02, 0.04), K1=row(1.0, 0.1))
    comparison = compare_runs(first, second)
    by_name = {p.name: p for p in comparison.parameters}
    assert list(by_name) == ["Jxx", "Jyy", "K1"]
    assert by_name["Jxx"].difference == pytest.approx(0.1)
    assert by_name["Jxx"].combined_sd == pytest.approx(math.hypot(0.03, 0.04))
    assert by_name["Jxx"].in_sd == pytest.approx(2.0)
    assert (by_name["Jyy"].in_sd, by_name["K1"].in_sd) == (None, None)
    assert comparison.sentence.endswith("that of Jxx, +2.0 combined sd.")
    assert comparison.differing_settings == (("seed", "a", "b"),)
    assert not comparison.same_telemetry
    assert compare_runs(first, compared("c", "1", Jxx=row(3.0, 0.01))).same_telemetry


def test_noticeable_differences_come_first():
    first = compared("a", "1", Jxx=row(3.0, 0.03), K1=row(1.0, 0.1))
    second = compared("b", "2", Jxx=row(2.8, 0.04), K1=row(1.0, 0.1))
    assert compare_runs(first, second).sentence == (
        "1 of 2 elements of J and K differ by more than 3 combined sd, most of all Jxx: −4.0."
    )


@pytest.mark.parametrize(
    ("trusted", "says"),
    [
        ((False, True), "A is not to be used"),
        ((True, False), "B is not to be used"),
        ((False, False), "A and B are not to be used"),
    ],
)
def test_nothing_agrees_with_a_refused_run(trusted, says):
    runs = [
        compared(n, n, trusted=t, Jxx=row(3.0, 0.01)) for n, t in zip("ab", trusted, strict=True)
    ]
    comparison = compare_runs(*runs)
    assert comparison.sentence.startswith(f"{says}: whether J and K of the runs agree cannot be")
    assert [p.in_sd for p in comparison.parameters] == [None]


@pytest.fixture
def folders(made, tmp_path):
    """Two finished runs, as `Posterior.save` leaves them."""
    for name, kind in (("before", "one_slew"), ("after", "good")):
        (tmp_path / name).mkdir()
        made(kind).save(tmp_path / name / "posterior.nc")
    return tmp_path


def test_two_runs_make_a_page(folders, capsys):
    before, after = folders / "before", folders / "after"
    assert run("report", before, after, "--json") == 0
    content = json.loads(capsys.readouterr().out)
    assert content["format"] == "bayes-inertia-run-comparison/1"
    assert [r["run"] for r in content["runs"]] == [str(before), str(after)]
    assert content["parameters"]["Jxx"]["first"]["quoted_sd"] is not None
    page = (after / "comparison.html").read_bytes()
    other = folders / "page.html"
    assert run("report", before, after, "-o", other) == 0
    assert other.read_bytes() == page
    assert content["sentence"] in " ".join(capsys.readouterr().out.split())


def test_no_other_file_is_overwritten(folders, capsys):
    other = folders / "notes.html"
    other.write_text("mine")
    assert run("report", folders / "before", folders / "after", "-o", other) == 2
    assert "would overwrite" in capsys.readouterr().err
    assert other.read_text() == "mine"


@pytest.mark.parametrize(
    ("first", "second", "says"),
    [
        ("before", "empty", "no run here"),
        ("before", "unfinished", "bayes-inertia resume"),
        ("before", "before", "both runs are the same folder"),
    ],
)
def test_what_is_no_run_is_refused(folders, capsys, first, second, says):
    (folders / "empty").mkdir()
    (folders / "unfinished").mkdir()
    (folders / "unfinished" / "run.json").write_text("{}")
    assert run("report", folders / first, folders / second) == 2
    assert says in capsys.readouterr().err
