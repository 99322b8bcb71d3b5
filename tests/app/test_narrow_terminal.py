"""A terminal of 80 columns cuts nothing off: no table needs more, no number is shortened."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import bayes_inertia
from bayes_inertia.app.commands.check import show_campaign
from bayes_inertia.app.commands.many import show_calibration, show_fits, show_study
from bayes_inertia.app.commands.plans import show_comparison, show_design, show_observability
from bayes_inertia.app.commands.runs import show_promise
from bayes_inertia.app.study_folder import Study
from bayes_inertia.campaign.reader import read_campaign
from bayes_inertia.design.comparison import AchievedErrors, Contender
from bayes_inertia.design.goals import parse_goal
from bayes_inertia.flight.plan import paper_like_plan
from bayes_inertia.inference.optimizer import estimate
from bayes_inertia.observability.analysis import observe
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.named_effects import effects_named
from bayes_inertia.physics.parameters import BASE_NAMES
from bayes_inertia.physics.small_campaign import small_campaign
from bayes_inertia.report.plan_promise import plan_promise
from bayes_inertia.studies.calibration import QUANTITIES, Calibration, CaseCalibration
from bayes_inertia.studies.work import WorkResult

EXAMPLE = Path(bayes_inertia.__file__).parent / "example"
FOLDER = Path("results")
RNG = np.random.default_rng(1)


@pytest.fixture(autouse=True)
def narrow(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")


@pytest.fixture
def printed(capsys):
    """What was printed since; it fits."""

    def text() -> str:
        out = capsys.readouterr().out
        assert "…" not in out
        assert max(map(len, out.splitlines())) <= 80
        return out

    return text


def margin() -> SimpleNamespace:
    return SimpleNamespace(limit="rate", kept=True, left=0.1, says="rate: 0.9 of 1 deg/s")


def achieved() -> AchievedErrors:
    errors = 1.234e-4 * RNG.normal(size=(50, 9))
    return AchievedErrors(errors, np.full((50, 9), 1.2345e-4), *np.ones((3, 50)))


def test_a_campaign(printed):
    campaign = read_campaign(EXAMPLE)
    slews = tuple(replace(s, name=f"2026-11-22 {s.name}") for s in campaign.slews)
    show_campaign(replace(campaign, slews=slews))
    assert "duration" in printed()


def test_a_promise(printed):
    row = {"unit": "kg m^2", "prior_sd": 0.12345, "sd": 1.2345e-4, "quoted_sd": 2.345e-4}
    rows = {name: row | ({} if name[0] == "J" else {"unit": ""}) for name in BASE_NAMES}
    summary = {"parameters": rows, "effects": []}
    promised = dict.fromkeys(BASE_NAMES, 6.789e-5)
    show_promise(plan_promise("a plan with a long name", "plan.toml", "design", promised, summary))
    text = printed()
    assert "10⁻³ kg m²" in text
    assert "Jxy 3.5 times" in " ".join(text.split())


def test_a_design(printed):
    design = SimpleNamespace(
        goal=parse_goal("cross_terms"),
        value=1.234e-4,
        reference_value=2.345e-4,
        gain=2.0,
        sd={"Jxy": 1e-4, "K3": 2.3e-4},
        reference_sd={"Jxy": 2e-4, "K3": 1e-4},
        sd_before={"Jxy": 0.03, "K3": 0.03},
        units={"Jxy": "kg m^2", "K3": ""},
        plan=paper_like_plan(),
        reference=paper_like_plan(),
        flown=(margin(),),
        active=("rate",),
        kept=True,
    )
    show_design(SimpleNamespace(design=design, notes=("at rest",)), FOLDER)
    assert "[deg/s²]" in printed()


def test_a_comparison_of_three_plans_that_were_simulated(printed):
    plan = paper_like_plan()
    contenders = [
        Contender(name, plan, np.full(9, 1.23e-4), achieved(), 1.23e-4, 711, 0.123, 0.01, ())
        for name in ("paper", "designed", "flown before")
    ]
    show_comparison(contenders, FOLDER)
    out = " ".join(printed().split())
    assert "1.2 (1.2" in out
    assert "sd × 10⁻⁴" in out
    assert "designed" in out


def test_a_study(printed):
    show_study(Study(paper_like_plan(), achieved()), FOLDER)
    out = printed()
    assert out.startswith("Stated sds hold. 50 campaigns")
    assert "10⁻³ kg m²" in out


def test_a_calibration(printed):
    n = len(QUANTITIES)
    ranks, z = RNG.integers(0, 200, size=(60, n)), RNG.normal(size=(60, n))
    case = CaseCalibration("measured_drive", "says", ranks, z, np.ones(60, bool), np.ones(60))
    show_calibration(Calibration((case,)), FOLDER)
    out = printed()
    assert all(name in out for name in QUANTITIES)


def test_fits_of_a_fleet(printed):
    row = {"campaign": "fleet/spacecraft_17/2026-11-22", "trusted": True, "reduced_chi2_total": 1.0}
    for name, mean in (
        *((f"J{a}{a}", 3.31234) for a in "xyz"),
        *((f"K{i}", 1.0) for i in (1, 2, 3)),
    ):
        row |= {name: mean, f"{name}_sd": 1.2e-4, f"{name}_quoted_sd": 1.2e-4}
    show_fits(WorkResult((row,), ()), FOLDER)
    out = printed()
    assert "3.31234" in out
    assert "0.00012" in out
    # The name stays readable beside every number.
    assert out.count("fleet/spacecraft_17") == out.count("campaign ") > 1


@pytest.mark.parametrize(
    ("quoted", "unknown"),
    [
        (("Jxx", "K1", "K2", "K3", "K4"), ("K5",)),
        (("Jxx",), ("K1",)),
        (("Jxx/trace",), ("Jxx", "K1")),
    ],
    ids=["four-axis gyro", "no gyro", "free body"],
)
def test_fits_of_spacecraft_of_other_kinds(quoted, unknown, printed):
    """Each quoted moment and K has a column; what no campaign tells has none."""
    row = {"campaign": "a", "trusted": True, "reduced_chi2_total": 1.0}
    for name in quoted:
        row |= {name: 0.5, f"{name}_quoted_sd": 1e-3}
    for name in unknown:
        row |= {name: 0.5, f"{name}_quoted_sd": None}
    show_fits(WorkResult((row,), ()), FOLDER)
    heads = [x for x in printed().split() if x in {"campaign", "use", *quoted, *unknown, "χ²"}]
    assert heads == ["campaign", "use", *quoted, "χ²"]


@pytest.mark.long
@pytest.mark.slow
def test_observability(printed):
    campaign = small_campaign()
    campaign = replace(campaign, slews=campaign.slews[:1])
    observability = observe(estimate(Model(campaign, effects_named(["wheel_misalignment"]))))
    show_observability(SimpleNamespace(observability=observability, comparison=()), FOLDER)
    out = printed()
    for text in ("determined", "mostly the", "more, in observability.json", "× 10⁻³"):
        assert text in out
    assert "e+0" not in out
    assert "determi\n" not in out
