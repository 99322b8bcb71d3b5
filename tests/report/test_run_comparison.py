"""Two runs side by side: the numbers, the page, the command, and what is refused."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from support.commands import run

import bayes_inertia
from bayes_inertia.app import run_folder
from bayes_inertia.app.finished_runs import compare_two_runs
from bayes_inertia.campaign.prior import prior_from_json
from bayes_inertia.physics.parameters import base_names
from bayes_inertia.report.comparison_sections import comparison_page
from bayes_inertia.report.run_comparison import ComparedRun, compare_runs

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"


def row(mean: float, sd: float, quoted_sd: float | None = None) -> dict:
    return {"mean": mean, "sd": sd, "quoted_sd": quoted_sd or sd, "unit": "kg m^2"}


def compared(name: str, digest: str, *, trusted: bool = True, **parameters) -> ComparedRun:
    if not trusted:
        parameters = {name: row | {"quoted_sd": None} for name, row in parameters.items()}
    summary = {"parameters": parameters, "derived": {}, "campaign_sha256": digest}
    summary |= {"trusted": trusted, "effects": []}
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


def test_scale_factors_of_every_rate_sensor_are_compared():
    first = compared("a", "1", K1=row(1.0, 0.01), **{"mems.K1": row(1.0, 0.01)})
    second = compared("b", "2", K1=row(1.0, 0.01), **{"mems.K1": row(1.1, 0.01)})
    assert compare_runs(first, second).sentence == (
        "1 of 2 elements of J and K differ by more than 3 combined sd, most of all mems: K1: +7.1."
    )


def test_a_device_is_no_element_of_J():
    gain = {"Jets.gain": row(1.0, 0.01)}
    first = compared("a", "1", Jxx=row(3.0, 0.03), **gain)
    second = compared("b", "2", Jxx=row(3.0, 0.03), **{"Jets.gain": row(2.0, 0.01)})
    comparison = compare_runs(first, second)
    assert [p.name for p in comparison.J_and_K] == ["Jxx"]
    assert comparison.sentence.startswith("J and K of both runs agree")


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


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_free_body_is_compared_by_its_ratios(made, folders):
    """Nothing ties the size of J: its elements have no sd to count in, their ratios have."""
    free = made("good")
    attributes = free.attributes | {"scale_of_J": []}
    free.tree.attrs["bayes_inertia"] = json.dumps(attributes)
    free.save(folders / "free.nc")
    (folders / "second").mkdir()
    (folders / "free.nc").rename(folders / "second" / "posterior.nc")
    comparison = compare_two_runs(folders / "after", folders / "second")
    compared = [p.name for p in comparison.J_and_K]
    assert compared[:6] == [f"{name}/trace" for name in base_names(6)]
    assert compared[6:] == ["K1", "K2", "K3"]
    assert "Jxx/trace" in comparison_page(comparison)


@pytest.mark.slow
def test_runs_that_differ_by_a_former_result_say_so(made, tmp_path):
    known = {"names": ["Jxx"], "mean": [3.3], "covariance": [[1e-4]]}
    for name, prior in (("a", None), ("b", prior_from_json(known, "prior"))):
        run_folder.start(EXAMPLE, tmp_path / name, prior=prior)
        made("good").save(tmp_path / name / "posterior.nc")
    differing = compare_two_runs(tmp_path / "a", tmp_path / "b").differing_settings
    assert [name for name, *_ in differing] == ["prior of J and K"]
    assert differing[0][1] == "the campaign's"


@pytest.mark.slow
def test_the_page_tells_nothing_of_wheels_that_neither_spacecraft_has(made, folders):
    for name in ("before", "after"):
        free = made("good")
        fit = free.attributes["fit"]
        fit["reduced_chi2"]["momentum"] = None
        changed = {"wheels": 0, "fit": fit, "campaign_sha256": name}
        free.tree.attrs["bayes_inertia"] = json.dumps(free.attributes | changed)
        free.save(folders / name / "posterior.nc")
    page = comparison_page(compare_two_runs(folders / "before", folders / "after"))
    assert "errors are independent" in page
    assert "star tracker" in page
    assert "wheel momentum" not in page
    assert "spin inertia" not in page
