"""What commands print: every table with its units, and names with brackets as they are."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import bayes_inertia
from bayes_inertia.app.cli import COMMANDS, main
from bayes_inertia.app.commands.check import show_campaign
from bayes_inertia.app.commands.many import show_study
from bayes_inertia.app.commands.plans import show_comparison, show_design, show_observability
from bayes_inertia.app.commands.runs import show_diagnosis, show_summary
from bayes_inertia.app.plan_folder import plans_named
from bayes_inertia.app.study_folder import Study
from bayes_inertia.campaign.prior import GaussianPrior
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.design.comparison import AchievedErrors, Contender
from bayes_inertia.design.goals import parse_goal
from bayes_inertia.flight.plan import paper_like_plan
from bayes_inertia.flight.plan_file import write_plan
from bayes_inertia.physics.parameters import BASE_NAMES

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"
# To Rich these are markup: unknown tags vanish, a closing tag without its opening one is an error.
HOSTILE = "MOST [/run 3]"
FOLDER = Path("runs [s]")


@pytest.fixture(autouse=True)
def wide(monkeypatch):
    """A terminal on which no line is broken."""
    monkeypatch.setenv("COLUMNS", "240")


@pytest.fixture
def printed(capsys):
    """What was printed since, with spaces and lines collapsed."""
    return lambda: " ".join(capsys.readouterr().out.split())


def margin(name: str, kept: bool) -> SimpleNamespace:
    return SimpleNamespace(limit=name, kept=kept, left=0.1, says=f"{name}: 0.9 of 1 [deg/s]")


def contender(name: str, achieved: AchievedErrors | None) -> Contender:
    margins = (margin("torque of [wheel x]", False),)
    return Contender(name, paper_like_plan(), np.ones(9), achieved, 1.0, 1.0, 1.0, 1.0, margins)


def test_a_campaign_with_its_units_and_hostile_names(printed):
    campaign = read_campaign(EXAMPLE)
    slews = (replace(campaign.slews[0], name="slew [yaw 1]"), *campaign.slews[1:])
    show_campaign(replace(campaign, name=HOSTILE, slews=slews))
    out = printed()
    for text in (HOSTILE, "slew [yaw 1]", "step [s]", "duration [s]", "peak rate [deg/s]"):
        assert text in out


def test_a_campaign_with_a_former_result_says_what_that_replaces(printed):
    known = GaussianPrior(("Jxx", "K1"), [3.3, 1.0], np.diag([1e-4, 1e-4]))
    show_campaign(replace(read_campaign(EXAMPLE), prior=known))
    assert "known before, in place of what is stated: Jxx, K1" in printed()


def test_the_command_check_with_hostile_names(tmp_path, printed):
    shutil.copytree(EXAMPLE, tmp_path / "campaign")
    toml = tmp_path / "campaign" / "campaign.toml"
    text = re.sub(r'(?m)^name = ".*"', f'name = "{HOSTILE}"', toml.read_text(), count=1)
    toml.write_text(text.replace('name = "slew 1"', 'name = "slew [yaw 1]"'))
    with pytest.raises(SystemExit) as stop:
        main(["check", str(tmp_path / "campaign")])
    assert stop.value.code == 0
    out = printed()
    assert HOSTILE in out
    assert "slew [yaw 1]" in out


def test_a_design_with_its_units_and_hostile_margins(printed):
    design = SimpleNamespace(
        goal=parse_goal("cross_terms"),
        value=1e-3,
        reference_value=2e-3,
        gain=2.0,
        sd={"Jxy": 1e-4, "K3": 2.3e-4},
        reference_sd={"Jxy": 2e-4, "K3": 1e-4},
        sd_before={"Jxy": 0.03, "K3": 0.03},
        units={"Jxy": "kg m^2", "K3": ""},
        plan=paper_like_plan(),
        reference=paper_like_plan(),
        flown=(margin("keep-out [Sun]", True), margin("rate [/all]", False)),
        active=("keep-out [Sun]",),
        kept=False,
    )
    show_design(SimpleNamespace(design=design, notes=("at rest",)), FOLDER)
    out = printed()
    for text in ("angle [deg]", "rate [deg/s]", "ramps [deg/s²]", "starts [s]", "lasts [s]"):
        assert text in out
    assert "Known worse than with slews like the paper's: K3 (2.3 times)." in out
    assert "kg m², 2 times smaller than with slews like the paper's" in out
    assert "Jxy kg m² 0.030 1.0 2.0 300" in out
    assert "after the plan × 10⁻⁴" in out
    assert "A limit is broken: do not fly it." in out
    for text in ("keep-out [Sun]: 0.9 of 1 [deg/s]", "BROKEN rate [/all]", str(FOLDER)):
        assert text in out


def test_a_comparison_with_its_units_and_hostile_plans(printed):
    achieved = AchievedErrors(np.ones((3, 9)), np.ones((3, 9)), *np.ones((3, 3)))
    show_comparison([contender("plan [b]", achieved), contender(HOSTILE, None)], FOLDER)
    out = printed()
    for text in ("plan [b]", HOSTILE, "torque of [wheel x]", str(FOLDER)):
        assert text in out
    assert "plan [b]: products of inertia to 1.0 kg m² (1 sd)" in out
    for unit in ("kg m²", " s ", "N m s", "N m "):
        assert unit in out


def test_a_study_of_a_hostile_plan(printed):
    study = Study(
        replace(paper_like_plan(), name=HOSTILE),
        AchievedErrors(np.ones((9, 9)), np.ones((9, 9)), *np.ones((3, 9))),
    )
    show_study(study, FOLDER)
    out = printed()
    assert f"of {HOSTILE}." in out
    assert str(FOLDER) in out
    assert all(name in out for name in BASE_NAMES)


def test_observability_of_hostile_names(printed):
    parameter = SimpleNamespace(
        name="effect [x].gain",
        prior_sd=1.0,
        sd=0.1,
        unit="N m [s]",
        signal=5.0,
        variance_inflation=4.0,
        verdict="determined",
        share=np.array([[0.6, 0.0, 0.1], [0.1, 0.1, 0.1]]),
        tells_most=0,
        sd_other_drive=0.2,
    )
    direction = SimpleNamespace(verdict_is_prior=True, exact=True, says="a [b] c", contraction=0.1)
    observability = SimpleNamespace(
        parameters=(parameter,),
        slews=("slew [yaw 1]", "slew 2"),
        drive="commanded",
        directions=(direction,),
        degeneracies=(SimpleNamespace(name="gain [/g]", says="J [kg m^2] and h"),),
    )
    row = SimpleNamespace(name="K1 [-]", warnings=("prior [deg] holds",))
    show_observability(SimpleNamespace(observability=observability, comparison=(row,)), FOLDER)
    out = printed()
    for text in ("effect [x]: gain", "N m [s]", "a [b] c", "gain [/g]: J [kg m²]", "K1 [-]:"):
        assert text in out
    for text in (
        "prior [deg] holds",
        "All 1 parameters are determined; slew [yaw 1] carries effect [x]: gain.",
        "slew [yaw 1], 70 %",
        "70 % × 2.0 × 2.0 determined",
    ):
        assert text in out


def test_a_fit_with_hostile_names(printed):
    parameter = {"mean": 1.0, "sd": 0.1, "quoted_sd": 0.1, "prior_sd": 1.0, "unit": "kg m^2"}
    summary = {
        "trusted": False,
        "gates": [{"passed": False, "name": "gate [a]", "says": "chi^2 [/b]"}],
        "parameters": {"pump [x].gain": parameter},
        "fit": {"reduced_chi2": {"rate": 1.0, "total": None}},
        "diagnostics": {"ess_bulk_min": 1.0, "evaluations": 1, "seconds": 1.0},
    }
    show_summary(summary, FOLDER)
    out = printed()
    for text in ("FAILED gate [a]: χ² [/b]", "pump [x]: gain", str(FOLDER)):
        assert text in out


@pytest.mark.parametrize(("quoted", "told"), [(0.1, "yes"), (None, "–")])
def test_a_refused_fit_is_not_said_to_determine_anything(printed, quoted, told):
    row = {"mean": 1.0, "sd": 0.1, "quoted_sd": quoted, "prior_sd": 1.0, "unit": "kg m^2"}
    summary = {
        "gates": [{"passed": quoted is not None, "name": "explained", "says": "so"}],
        "parameters": {"Jxx": row},
        "fit": {"reduced_chi2": {"rate": 1.0}},
        "diagnostics": {"ess_bulk_min": 1.0},
    }
    show_summary(summary, FOLDER)
    assert f"kg m² 1.0 {told}" in printed()


def test_a_diagnosis_with_hostile_names(printed, monkeypatch):
    said = "bayes_inertia.report.verdict"
    monkeypatch.setattr(f"{said}.headline", lambda _: "Missing [/x]")
    monkeypatch.setattr(f"{said}.in_brief", lambda _: ["slew [yaw 1] rings: pump [b]"])
    show_diagnosis({"candidates": [], "verdict": "ambiguous"})
    out = printed()
    for text in ("Missing [/x]", "slew [yaw 1] rings", "pump [b]"):
        assert text in out


@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_of_every_command_says_what_it_is_for(command, printed):
    with pytest.raises(SystemExit) as stop:
        main([command, "--help"])
    assert stop.value.code == 0
    assert COMMANDS[command].__doc__.splitlines()[0] in printed()


def test_the_help_keeps_its_units(printed):
    with pytest.raises(SystemExit):
        main(["design", "--help"])
    out = printed()
    for unit in ("[s]", "[deg/s]", "[deg]", "[deg/s^2]"):
        assert unit in out


def test_plans_that_would_be_printed_alike_bear_the_names_of_their_files(tmp_path):
    files = [
        str(write_plan(replace(paper_like_plan(), name=name), tmp_path / f"{stem}.toml"))
        for stem, name in (("first", "fast_slews"), ("second", "fast slews"), ("third", "slow"))
    ]
    named = plans_named(files, read_campaign(EXAMPLE))
    assert list(named) == ["fast_slews (first)", "fast slews (second)", "slow"]
