"""`study`: stated uncertainties against achieved ones; sds that are too small are called so."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from support.commands import run

import bayes_inertia
from bayes_inertia.app.plan_folder import contender_json
from bayes_inertia.app.study_folder import Study, run_study
from bayes_inertia.app.study_folder import _content as study_content
from bayes_inertia.design.comparison import AchievedErrors, Contender
from bayes_inertia.errors import EstimateError, OutputError
from bayes_inertia.flight.plan import paper_like_plan
from bayes_inertia.physics.parameters import BASE_NAMES
from bayes_inertia.report.pictures.study import draw_coverage

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"


def made(n: int, seed: int, shrink: float = 1.0) -> Study:
    """A study of n campaigns with normal errors, whose stated sds are theirs times `shrink`."""
    rng = np.random.default_rng(seed)
    sd = np.geomspace(1e-5, 1e-2, len(BASE_NAMES)) * rng.uniform(0.8, 1.2, (n, len(BASE_NAMES)))
    return Study(
        paper_like_plan(),
        AchievedErrors(sd * rng.standard_normal(sd.shape), shrink * sd, *np.ones((3, n))),
    )


@pytest.mark.parametrize(
    ("what", "option", "value"),
    [
        ("calibration", "--campaigns", "5"),
        ("calibration", "--plan", "paper"),
        (EXAMPLE, "--fits", "5"),
        (EXAMPLE, "--cases", "weak"),
    ],
)
def test_an_option_of_the_other_study_is_refused(what, option, value, tmp_path, capsys):
    assert run("study", what, "-o", tmp_path / "out", option, value) == 2
    assert f"{option}: the study that is asked for does not take it" in capsys.readouterr().err


def test_sound_uncertainties_are_rarely_called_too_small():
    """At most the 1 % that is meant, within Monte Carlo error; sds 15 % too small are found."""
    trials = 1000
    alarms = sum(bool(made(200, seed).too_small) for seed in range(trials))
    assert alarms <= stats.binom.ppf(0.999, trials, 0.01)
    assert all(made(200, seed, shrink=0.85).too_small for seed in range(100))


@pytest.mark.slow
def test_a_comparison_states_the_sds_that_a_study_states():
    study, plan = made(20, 3), paper_like_plan()
    flown = Contender("plan", plan, np.ones(9), study.achieved, 1.0, 1.0, 1.0, 1.0, ())
    stated = contender_json(flown)["stated_sd"]
    rows = study_content(study)["parameters"]
    assert stated == pytest.approx({name: row["stated_sd"] for name, row in rows.items()})


@pytest.mark.long
@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say():
    """The 95 % interval of each share holds the level in about 95 %; halved sds hold in 67 %."""
    inside = [
        low <= level <= high
        for seed in range(100)
        for level in (0.68, 0.95)
        for _, low, high in made(200, seed).coverage(level)
    ]
    assert np.mean(inside) > 0.93
    halved = np.mean([share for share, _, _ in made(2000, 0, shrink=0.5).coverage(0.95)])
    assert halved == pytest.approx(2.0 * stats.norm.cdf(0.98) - 1.0, abs=0.02)


@pytest.mark.long
@pytest.mark.slow
def test_study_of_the_example_goes_on_where_it_was(tmp_path, capsys, monkeypatch):
    out = tmp_path / "run"
    assert run("study", EXAMPLE, "-o", out, "--campaigns", 6) == 0
    printed = capsys.readouterr().out
    assert "Stated sds hold" in printed
    assert "6 campaigns" in printed
    first = (out / "study.json").read_bytes()
    rows = json.loads(first)["parameters"]
    assert set(rows) == set(BASE_NAMES)
    for row in rows.values():  # Six campaigns: the sd of errors is uncertain to 29 %.
        assert 0.3 < row["achieved_sd"] / row["stated_sd"] < 2.2

    def never(*_):
        raise AssertionError("a shard that is there was made again")

    (out / "study.json").unlink()
    monkeypatch.setattr("bayes_inertia.studies.plan_comparison.fit_simulated_campaign", never)
    run_study(EXAMPLE, out, campaigns=6)
    assert (out / "study.json").read_bytes() == first
    with pytest.raises(OutputError, match="other seed"):
        run_study(EXAMPLE, out, campaigns=6, seed=1)
    assert (out / "study.json").read_bytes() == first


@pytest.mark.slow
def test_sds_that_are_too_small_end_with_3(tmp_path, capsys, monkeypatch):
    shrunk = made(25, 3, shrink=0.5).achieved
    rows = zip(*(getattr(shrunk, f.name) for f in fields(shrunk)), strict=True)
    names = [f.name for f in fields(shrunk)]
    monkeypatch.setattr(
        "bayes_inertia.studies.plan_comparison.fit_simulated_campaign",
        lambda *_: dict(zip(names, next(rows), strict=True)),
    )
    assert run("study", EXAMPLE, "-o", tmp_path / "run", "--campaigns", 25) == 3
    assert "TOO SMALL for Jxx" in capsys.readouterr().out
    assert "Jxx" in json.loads((tmp_path / "run" / "study.json").read_text())["too_small"]


@pytest.mark.slow
def test_campaigns_that_cannot_be_fitted_are_reported_and_left_out(tmp_path, capsys, monkeypatch):
    good, calls = made(25, 3).achieved, iter(range(25))

    def fit(*_):
        i = next(calls)
        if i in (3, 11):
            raise EstimateError("no finite residuals", advice="check units")
        return {f.name: getattr(good, f.name)[i] for f in fields(good)}

    monkeypatch.setattr("bayes_inertia.studies.plan_comparison.fit_simulated_campaign", fit)
    out = tmp_path / "run"
    assert run("study", EXAMPLE, "-o", out, "--campaigns", 25) == 3
    printed = capsys.readouterr()
    assert "2 more could not be fitted" in printed.out
    assert "11 failed: no finite residuals; check units" in printed.err
    content = json.loads((out / "study.json").read_text())
    assert content["campaigns"] == 23
    assert [failure["task"] for failure in content["failures"]] == ["3", "11"]
    # They would fail again: the same command only tells.
    assert run("study", EXAMPLE, "-o", out, "--campaigns", 25) == 3


def test_bad_requests_end_with_2(tmp_path, capsys):
    (tmp_path / "mine.txt").write_text("mine")
    assert run("study", EXAMPLE, "-o", tmp_path) == 2
    assert (tmp_path / "mine.txt").read_text() == "mine"
    assert run("study", EXAMPLE, "-o", tmp_path / "run", "--plan", tmp_path / "none.toml") == 2
    assert "none.toml" in capsys.readouterr().err


def test_coverage_is_drawn_inside_its_band_or_not():
    """Sound uncertainties stay inside the drawn band; halved ones leave it."""
    for shrink, leaves in ((1.0, False), (0.5, True)):
        study = made(400, 2, shrink)
        right = draw_coverage(BASE_NAMES, study.achieved, study.z).axes[1]
        band = right.collections[0].get_paths()[0].vertices[:, 1].max()
        assert (
            max(np.abs(line.get_ydata()).max() for line in right.lines[: len(BASE_NAMES)]) > band
        ) == leaves
