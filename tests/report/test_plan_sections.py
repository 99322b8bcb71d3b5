"""The pages of `design` and `compare`: the answer, sds in one power a column, one colour a plan."""

import re
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
from matplotlib.colors import to_hex

from bayes_inertia.design.comparison import AchievedErrors, Contender
from bayes_inertia.design.goals import parse_goal
from bayes_inertia.design.limits import Limits
from bayes_inertia.design.margins import Margin
from bayes_inertia.design.result import Design
from bayes_inertia.flight.plan import PlannedSlew, paper_like_plan
from bayes_inertia.physics.parameters import BASE_NAMES
from bayes_inertia.report.formatting import NOT_GIVEN
from bayes_inertia.report.page import render_page
from bayes_inertia.report.pictures.design import draw_comparison
from bayes_inertia.report.pictures.figure_file import figure_bytes
from bayes_inertia.report.plan_sections import (
    comparison_sections,
    costs_table,
    design_sections,
    slews_table,
)

SDS = np.array([2.7e-4, 7e-5, 1.8e-4, 5.7e-5, 5.6e-5, 6.2e-5, 9.2e-5, 9.1e-5, 2.2e-4])
WORSE = np.array([1.0, 1.0, 1.0, 2.0, 1.0, 1.0, 1.0, 1.0, 0.5])


def contender(name: str, expected: np.ndarray, achieved: AchievedErrors | None = None) -> Contender:
    """A plan of five slews, whatever it is called."""
    plan = paper_like_plan()
    margin = Margin("torque of wheel_x", "slew 1", 0.01, 0.02, "N m", 0.5)
    return Contender(name, plan, expected, achieved, 1855.0, 330.0, 0.1, 0.01, (margin,))


PLAN = contender("4 slews for cross_terms", SDS)
PAPER = contender("five slews like the paper's", SDS * WORSE)


DESIGN = Design(
    PLAN.plan,
    parse_goal("cross_terms"),
    Limits(),
    seed=0,
    reference=PAPER.plan,
    value=6.2e-5,
    reference_value=1.2e-4,
    best_random=1e-4,
    random_plans=100,
    sd=dict(zip(BASE_NAMES, SDS.tolist(), strict=True)),
    reference_sd=dict(zip(BASE_NAMES, (SDS * WORSE).tolist(), strict=True)),
    sd_before=dict.fromkeys(BASE_NAMES, 0.03),
    units=dict(zip(BASE_NAMES, ["kg m^2"] * 6 + [""] * 3, strict=True)),
    margins=PLAN.margins,
    flown=PLAN.margins,
    active=("rate",),
    history=(),
    seconds=1.0,
)
BROKEN = replace(DESIGN, flown=(replace(PLAN.margins[0], left=-0.1),))


def text_of(sections) -> str:
    page = re.sub(r"<(style|script)\b.*?</\1>", "", render_page("t", sections), flags=re.S)
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]*>", " ", page)))


def test_a_design_says_each_sd_now_and_after_the_plan_and_what_gets_worse():
    text = text_of(design_sections(DESIGN, (PLAN, PAPER), after=False))
    paper = "than with slews like the paper's of at most 1 deg/s"
    gain = f"1.94 times smaller {paper} (1.2 × 10⁻⁴ kg m²)."
    assert f"inertia: 6.2 × 10⁻⁵ kg m², {gain}" in text
    assert "Known worse than with slews like the paper's: K3 (2.0 times)." in text
    assert "sd now after the plan × 10⁻⁵ after the paper's slews × 10⁻⁵ times sharper" in text
    assert "Jxy kg m² 0.030 5.7 11 526" in text
    assert "Now: the prior." in text
    worse = replace(DESIGN, value=1.2e-4, reference_value=6.0e-5)
    text = text_of(design_sections(worse, (PLAN, PAPER), after=False))
    assert f"kg m², 2 times larger {paper} (6.0 × 10⁻⁵ kg m²)." in text
    assert "2 times worse than slews like the paper's" in str(worse)


def test_gentle_ramps_of_slews_are_told_apart():
    ramps = (0.05, 0.00123, 0.0004)
    slews = tuple(PlannedSlew((1.0, 0.0, 0.0), 1.0, 0.01, np.radians(x)) for x in ramps)
    rows = slews_table({"": replace(PLAN.plan, slews=slews)}).rows
    assert [row[4] for row in rows] == ["0.050", "0.0012", "4.0 × 10⁻⁴"]


@pytest.mark.parametrize(("design", "level"), [(DESIGN, "good"), (BROKEN, "bad")])
def test_a_broken_limit_is_no_green_plan(design, level):
    result = design_sections(design, (PLAN, PAPER), after=False)[0]
    assert result.context["level"] == level
    assert ("do not fly it" in result.context["sentence"]) != design.kept


def test_a_comparison_names_the_best_plan_and_what_it_loses():
    rng = np.random.default_rng(0)
    errors, one = SDS * rng.normal(size=(20, 9)), np.ones(20)
    achieved = AchievedErrors(errors, np.tile(SDS, (20, 1)), one, one, one)
    flown = contender("4 slews for cross_terms", SDS, achieved)
    text = text_of(comparison_sections((PAPER, flown)))
    best = "4 slews for cross terms: products of inertia to 6.2 × 10⁻⁵ kg m² (1 sd)"
    assert f"{best}; 1.1 × 10⁻⁴ kg m² with five slews like the paper's." in text
    assert "Known worse than another plan" not in text
    assert "Known worse than with another plan: K3 (2.0 times)." in text
    assert "in 20 simulated campaigns" in text
    assert "Known worse" not in text_of(comparison_sections((PLAN,)))


def test_a_plan_has_one_colour_whatever_stands_beside_it():
    colors = []
    for order in ((PLAN, PAPER), (PAPER, PLAN)):
        bars = draw_comparison(order).axes[0].containers
        colors.append({bar.get_label(): to_hex(bar.patches[0].get_facecolor()) for bar in bars})
    assert colors[0] == colors[1]
    assert len(set(colors[0].values())) == 2


def test_wheels_without_limits_have_no_peaks_to_print():
    free = replace(PLAN, peak_momentum=float("nan"), peak_torque=float("nan"))
    assert [row[2] for row in costs_table([free]).rows[2:4]] == [NOT_GIVEN] * 2


def test_what_a_plan_asks_of_thrusters_is_drawn():
    margin = Margin("reach of jets", "slew 1", 0.8, 1.0, "of what it can give (N m)", 0.2)
    figure = draw_comparison([replace(PLAN, margins=(margin,))])
    texts = [text.get_text() for part in figure.subfigs for a in part.axes for text in a.texts]
    assert "reach 80 %" in texts


def test_a_limit_that_is_broken_many_times_leaves_room_for_the_axes(recwarn):
    margin = replace(PLAN.margins[0], used=0.3, left=-14.0)
    figure_bytes(draw_comparison([PAPER, replace(PLAN, margins=(margin,))]), "png")
    assert not recwarn.list
