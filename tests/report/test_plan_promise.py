"""`report RUN --plan PLAN`: what a plan promised beside what the run of its flight achieved."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.commands import run

from bayes_inertia.app import finished_runs, run_folder
from bayes_inertia.app.result_folder import write_json
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.flight.mission import most_like_mission, other_slews
from bayes_inertia.flight.plan import Plan, PlannedSlew
from bayes_inertia.flight.plan_file import write_plan
from bayes_inertia.flight.plan_flight import fly
from bayes_inertia.flight.simulated_campaigns import simulate
from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.physics.parameters import BASE_NAMES
from bayes_inertia.report.plan_promise import plan_promise
from bayes_inertia.sealing import sealed

DEGREE = math.pi / 180.0
AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 1.0))
PLAN = Plan("two slews", tuple(PlannedSlew(axis, 40.0 * DEGREE) for axis in AXES))


@pytest.fixture
def finished(made, tmp_path):
    """A run of the plan's flight whose posterior is made up."""
    simulate(PLAN, most_like_mission(), tmp_path / "flown", 1)
    run_folder.start(tmp_path / "flown", tmp_path / "run")
    made("good").save(tmp_path / "run" / "posterior.nc")
    write_plan(PLAN, tmp_path / "plan.toml")
    return tmp_path


def stated_sds(folder) -> dict[str, float]:
    rows = Posterior.load(folder / "run" / "posterior.nc").summary()["parameters"]
    return {name: rows[name]["quoted_sd"] for name in BASE_NAMES}


def write_design(folder, promised, plan=PLAN):
    content = {"plan": {"expected_sd": promised, "slews": plan.slew_rows()}}
    write_json(folder / "design.json", sealed(content))


@pytest.mark.slow
def test_promised_by_a_design(finished, capsys, monkeypatch):
    sds = stated_sds(finished)
    write_design(finished, {name: sd / (2.0 if name == "Jxy" else 0.9) for name, sd in sds.items()})
    monkeypatch.setattr(finished_runs, "compare_plans", None)  # nothing is forecast anew
    assert run("report", finished / "run", "--plan", finished / "plan.toml", "--json") == 0
    plan = json.loads(capsys.readouterr().out)["plan"]
    ratios = {name: row["ratio"] for name, row in plan["parameters"].items()}
    assert ratios == pytest.approx({name: 2.0 if name == "Jxy" else 0.9 for name in BASE_NAMES})
    assert plan["sentence"].startswith("1 of 9 elements of J and K are known worse")
    page = (finished / "run" / "report.html").read_text()
    assert "Promised and achieved" in page
    assert "design.json" in page


@pytest.mark.slow
def test_a_plan_without_its_design_is_forecast(finished, capsys, monkeypatch):
    asked = []

    def compare_plans(plans, mission):
        asked.append((plans[0], mission.prior.product_sigma))
        return (SimpleNamespace(expected=np.array(list(stated_sds(finished).values()))),)

    monkeypatch.setattr(finished_runs, "compare_plans", compare_plans)
    # What stands beside it is of other slews.
    write_design(finished, stated_sds(finished), replace(PLAN, slews=PLAN.slews[:1]))
    assert run("report", finished / "run", "--plan", finished / "plan.toml", "--json") == 0
    plan = json.loads(capsys.readouterr().out)["plan"]
    assert "forecast now" in plan["promised_by"]
    assert [row["ratio"] for row in plan["parameters"].values()] == pytest.approx([1.0] * 9)
    assert asked == [(PLAN, most_like_mission().prior.product_sigma)]


def test_what_a_flown_plan_leaves_out_is_as_where_its_flight_began(finished, monkeypatch):
    asked = []

    def compare_plans(plans, mission):
        asked.extend(plans)
        return (SimpleNamespace(expected=np.array(list(stated_sds(finished).values()))),)

    monkeypatch.setattr(finished_runs, "compare_plans", compare_plans)
    path = finished / "plan.toml"
    lines = path.read_text().splitlines()
    left_out = ("start_attitude", "wheel_momentum")
    path.write_text("\n".join(line for line in lines if not line.startswith(left_out)))
    summary = Posterior.load(finished / "run" / "posterior.nc").summary()
    finished_runs.promise_of_plan(finished / "run", path, summary)
    first, (plan,) = read_campaign(finished / "flown").slews[0], asked
    assert plan.start_attitude == pytest.approx(first.attitude[first.fixes][0])
    assert plan.wheel_momentum == pytest.approx(first.wheel_momentum[0])


OTHER = {
    "fewer": (replace(PLAN, slews=PLAN.slews[:1]), "it has 1 slew, the campaign 2 slews"),
    "further": (
        replace(PLAN, slews=(PLAN.slews[0], replace(PLAN.slews[1], angle=55.0 * DEGREE))),
        "slew 2 turned by",
    ),
    "other axis": (
        replace(PLAN, slews=(replace(PLAN.slews[0], axis_B=(0.0, 0.0, 1.0)), PLAN.slews[1])),
        "slew 1 turned by",
    ),
    "slower": (
        replace(PLAN, slews=tuple(replace(s, rate=0.5 * DEGREE) for s in PLAN.slews)),
        "the plan says 0.5 deg/s",
    ),
}


@pytest.mark.parametrize(
    "other", ["fewer", *(pytest.param(n, marks=pytest.mark.slow) for n in [*OTHER][1:])]
)
def test_a_plan_of_other_slews_is_refused(finished, capsys, other):
    plan, says = OTHER[other]
    write_plan(plan, finished / "other.toml")
    assert run("report", finished / "run", "--plan", finished / "other.toml") == 2
    message = capsys.readouterr().err
    assert says in message
    assert "other.toml" in message
    assert not (finished / "run" / "report.html").exists()


def test_the_word_paper_is_a_plan_as_in_other_commands(finished, capsys):
    assert run("report", finished / "run", "--plan", "paper") == 2
    assert 'other slews than the plan "five slews like the paper\'s"' in capsys.readouterr().err


def test_what_cannot_be_held_against_a_plan_is_refused(finished, capsys):
    both = finished / "run", finished / "run"
    assert run("report", *both, "--plan", finished / "plan.toml") == 2
    assert "a plan goes with one run" in capsys.readouterr().err
    (finished / "run" / "run.json").unlink()
    assert run("report", finished / "run", "--plan", finished / "plan.toml") == 2
    assert "the run keeps no campaign" in capsys.readouterr().err


def test_flights_without_a_star_tracker_show_their_slews_by_their_rates():
    mission = most_like_mission()
    mission = replace(mission, spacecraft=replace(mission.spacecraft, star_tracker=None))
    flown = fly(PLAN, mission, 3).campaign
    assert other_slews(PLAN, flown) == ""
    turned = replace(PLAN, slews=PLAN.slews[::-1])
    assert "slew 1 turned by" in other_slews(turned, flown)


def test_the_sentence_of_a_promise_that_is_kept():
    row = {"unit": "kg m^2", "prior_sd": 0.1, "sd": 0.01, "quoted_sd": 0.011}
    summary = {
        "parameters": {"Jxx": row, "Jyy": row | {"quoted_sd": 0.012}},
        "effects": ["rate_bias"],
    }
    promise = plan_promise("p", "p.toml", "design", {"Jxx": 0.01, "Jyy": 0.01}, summary)
    assert promise.sentence.endswith("are 1.10 to 1.20 times those promised.")
    assert promise.json()["effects_fitted_along"] == ["rate_bias"]


def test_the_scale_factor_of_an_axis_that_failed_before_the_flight_has_no_row():
    row = {"unit": "", "prior_sd": 0.1, "sd": 0.02, "quoted_sd": 0.02}
    summary = {"parameters": {"K1": row}, "effects": []}
    promise = plan_promise("p", "p.toml", "", {"K1": 0.02, "K2": 0.02}, summary)
    assert [p.name for p in promise.parameters] == ["K1"]
