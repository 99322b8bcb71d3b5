"""The pages of `design` and `compare`: what plans give, what they cost, what they fly."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bayes_inertia.design.comparison import Contender
from bayes_inertia.design.result import Design
from bayes_inertia.physics.parameters import BASE_UNITS, base_names, base_units
from bayes_inertia.report.formatting import (
    NOT_GIVEN,
    listed,
    number,
    plain,
    sd_column,
    sd_head,
    two_digits,
    unit_text,
    vector_text,
)
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.pictures.design import draw_comparison
from bayes_inertia.report.section import Section, Table, captioned
from bayes_inertia.report.words import phrase, sentences

_OF_SLEW = {"slew": "", "about body axis": ""} | dict.fromkeys(
    ("angle [deg]", "rate [deg/s]", "ramps [deg/s²]", "starts [s]", "lasts [s]"), "n"
)


def design_sections(
    design: Design, contenders: Sequence[Contender], after: bool, notes: Sequence[str] = ()
) -> list[Section]:
    """A designed plan: each parameter's sd now and afterwards, its slews, its limits.

    `after`: whether the campaign's telemetry counts. `notes`: what must be known before it is
    flown.
    """
    result = gain_table(design).section(
        "Result",
        captioned("plan", draw_comparison(contenders)),
        sentence=gain_answer(design),
        level="good" if design.kept else "bad",
        more=worse_than_paper(design),
        notes=sentences("plans", "gain_notes", after, notes),
    )
    return [result, slews_table({"": design.plan}).section("Slews"), _margins_section(design)]


def gain_answer(design: Design) -> str:
    """What the plan reaches of its goal, and slews like the paper's; whether it can be flown."""
    goal, reached = design.goal, (design.value, design.reference_value)
    # Where no rate is asked for it is the campaign's own, and not that of `compare ... paper`.
    rate = max(row["rate_deg_s"] for row in design.reference.slew_rows())
    return phrase("plans", "gain", goal.says, goal.unit, *reached, rate, design.kept)


def gain_table(design: Design) -> Table:
    """Each parameter's sd now, after the plan, after slews like the paper's."""
    before, after, paper = design.sd_before, design.sd, design.reference_sd
    columns = {"sd now": before, "after the plan": after, "after the paper's slews": paper}
    printed = [sd_column([column[name] for name in after]) for column in columns.values()]
    heads = [sd_head(head, power) for head, (power, _) in zip(columns, printed, strict=True)]
    rows = [
        (plain(name), unit_text(design.units[name]), *cells, _times(before[name] / after[name]))
        for name, *cells in zip(after, *(cells for _, cells in printed), strict=True)
    ]
    classes = ("", "", "n", "n", "n extra", "n extra")
    heads = ["parameter", "unit", *heads, "times sharper"]
    return Table(dict(zip(heads, classes, strict=True)), rows, "many short")


def _times(ratio: float) -> str:
    return f"{ratio:.2f}" if ratio < 10.0 else f"{ratio:,.0f}"


def worse_than_paper(design: Design) -> str:
    """Parameters that a plan leaves worse than slews like the paper's."""
    paper = design.reference_sd
    return phrase("plans", "worse", {name: sd / paper[name] for name, sd in design.sd.items()})


def slews_table(plans: Mapping[str, Any]) -> Table:
    """The slews of plans, by what they are called; one alone may have no name."""
    rows = [
        (
            f"{name}{', ' if name else ''}slew {i}",
            f"({vector_text(row['axis_B'], 3)})",
            f"{row['angle_deg']:.1f}",
            f"{row['rate_deg_s']:.3f}",
            two_digits(row["acceleration_deg_s2"]),
            f"{row['start_s']:.0f}",
            f"{row['duration_s']:.0f}",
        )
        for name, plan in plans.items()
        for i, row in enumerate(plan.slew_rows(), 1)
    ]
    return Table(_OF_SLEW, rows)


def _margins_section(design: Design) -> Section:
    """Margins of the flown plan, tightest first."""
    margins = sorted(design.flown, key=lambda m: m.left)
    rows = [(m.says, "kept" if m.kept else "BROKEN") for m in margins]
    notes = sentences("plans", "margin_notes", design.active)
    return Table({"limit, the tightest first": "", "": ""}, rows).section("Limits", notes=notes)


def comparison_sections(contenders: Sequence[Contender]) -> list[Section]:
    """Plans side by side: what they give, what they cost, what they fly."""
    simulated = [len(c.achieved.errors) for c in contenders if c.achieved is not None]
    notes = sentences("plans", "sd_notes", simulated)
    answer, worse = comparison_answer(contenders)
    pictures = captioned("plans", draw_comparison(contenders))
    one = len(contenders) == 1
    plans = {"" if one else plain(c.name): c.plan for c in contenders}
    return [
        sds_table(contenders).section("Result", pictures, sentence=answer, more=worse, notes=notes),
        costs_table(contenders).section("Cost"),
        slews_table(plans).section("Slews"),
    ]


def comparison_answer(contenders: Sequence[Contender]) -> tuple[str, str]:
    """Which plan knows the products of inertia best; and what it knows worse than another."""
    best, *others = sorted(contenders, key=lambda c: c.worst_cross_term)
    answer = phrase("plans", "best", (best, *others), BASE_UNITS[0])
    if not others:
        return answer, ""
    least = np.min([c.expected for c in others], axis=0)
    names = base_names(len(least))
    ratios = dict(zip(names, (best.expected / least).tolist(), strict=True))
    return answer, phrase("plans", "worse", ratios, "another plan")


def sds_table(contenders: Sequence[Contender]) -> Table:
    """Expected sds of each plan, and achieved ones where campaigns were simulated."""
    names = base_names(len(contenders[0].expected))
    power, _ = sd_column([sd for c in contenders for sd in c.expected.tolist()])
    rows = [
        (name, unit_text(unit), *(_sd_cell(c, i, power) for c in contenders))
        for i, (name, unit) in enumerate(zip(names, base_units(len(names)), strict=True))
    ]
    heads = [sd_head(f"{plain(c.name)}: sd", power) for c in contenders]
    kind = "many short" if len(contenders) < LAYOUT.many_plans else "many"
    return Table({"parameter": "", "unit": "extra"} | dict.fromkeys(heads, "n"), rows, kind)


def _sd_cell(contender: Contender, i: int, power: int) -> str:
    sd, achieved = float(contender.expected[i]), contender.achieved
    if achieved is None:
        return number(sd, sd, power)
    scatter, error = float(achieved.sd[i]), float(achieved.sd_error[i])
    flown = f"{number(scatter, error, power)} ± {number(error, error, power)}"
    return f"{number(sd, sd, power)} ({flown})"


def costs_table(contenders: Sequence[Contender]) -> Table:
    """Time, momentum and torque of each plan, and the limits that it breaks."""
    rows = [
        ("total time", "s", *(f"{c.total_time:.0f}" for c in contenders)),
        ("in motion", "s", *(f"{c.motion_time:.0f}" for c in contenders)),
        ("peak momentum", "N m s", *(_peak(c.peak_momentum) for c in contenders)),
        ("peak torque", "N m", *(_peak(c.peak_torque) for c in contenders)),
        ("limits broken", "–", *(_broken(c) for c in contenders)),
    ]
    plans = [plain(c.name) for c in contenders]
    return Table({"cost": "", "unit": ""} | dict.fromkeys(plans, "n"), rows)


def _peak(value: float) -> str:
    return two_digits(value) if math.isfinite(value) else NOT_GIVEN


def _broken(contender: Contender) -> str:
    return listed([m.limit for m in contender.margins if not m.kept]) or "none"
