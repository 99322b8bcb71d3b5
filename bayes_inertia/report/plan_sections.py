"""The pages of `design` and `compare`: what plans give, what they cost, what they fly."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bayes_inertia.design.comparison import Contender
from bayes_inertia.physics.parameters import BASE_NAMES, BASE_UNITS
from bayes_inertia.report.formatting import (
    arcsec_text,
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
from bayes_inertia.report.section import Section, captioned, packaged

_PAPER = "slews like the paper's"


def design_sections(
    content: Mapping[str, Any], contenders: Sequence[Contender], units: Mapping[str, str]
) -> list[Section]:
    """A designed plan: each parameter's sd now and afterwards, its slews, its limits."""
    return [
        _gain_section(content, contenders, units),
        _slews_section(contenders[:1]),
        _margins_section(content),
    ]


def _gain_section(
    content: Mapping[str, Any], contenders: Sequence[Contender], units: Mapping[str, str]
) -> Section:
    heads, rows = _gain_table(content, units)
    goal, sd, paper = content["goal"], content["expected_sd"], content["reference_sd"]
    value, reference = (
        _quantity(content[key], goal["unit"]) for key in ("value", "reference_value")
    )
    says = f"{goal['says'][0].upper()}{goal['says'][1:]}: {value}"
    broken = "" if content["kept"] else " A limit is broken: do not fly it."
    now = "the fit of this campaign" if content["after"] else "the prior"
    context = {
        "sentence": f"{says}; {reference} with slews like the paper's.{broken}",
        "level": "good" if content["kept"] else "bad",
        "more": _worse_text({name: sd[name] / paper[name] for name in sd}, _PAPER),
        "heads": heads,
        "kind": "many short",
        "numbers": (2, 3, 4, 5),
        "extra": (4, 5),
        "rows": rows,
        "notes": (
            f"Now: {now}. Paper's slews: such slews in the same time and limits. Sds if the model "
            "and the stated noise are right.",
            *(f"{note[0].upper()}{note[1:]}." for note in content.get("left_out", ())),
        ),
    }
    pictures = captioned("plan", draw_comparison(contenders))
    return Section("Result", packaged("table.html"), context, pictures)


def _gain_table(
    content: Mapping[str, Any], units: Mapping[str, str]
) -> tuple[list[str], list[tuple[str, ...]]]:
    """Headings and rows: each parameter's sd now, after the plan, after slews like the paper's."""
    columns = {
        "sd now": content["sd_before"],
        "after the plan": content["expected_sd"],
        "after the paper's slews": content["reference_sd"],
    }
    names = list(content["expected_sd"])
    printed = [sd_column([column[name] for name in names]) for column in columns.values()]
    heads = [sd_head(head, power) for head, (power, _) in zip(columns, printed, strict=True)]
    before, after = content["sd_before"], content["expected_sd"]
    rows = [
        (plain(name), unit_text(units[name]), *cells, _times(before[name] / after[name]))
        for name, *cells in zip(names, *(cells for _, cells in printed), strict=True)
    ]
    return ["parameter", "unit", *heads, "times sharper"], rows


def _quantity(value: float, unit: str) -> str:
    """A size with its unit; angles in arc seconds."""
    if unit == "rad":
        return f"{arcsec_text(value)} arcsec"
    return f"{two_digits(value)} {unit_text(unit) if unit else ''}".rstrip()


def _times(ratio: float) -> str:
    return f"{ratio:.2f}" if ratio < 10.0 else f"{ratio:,.0f}"


def _worse_text(ratios: dict[str, float], than: str) -> str:
    """Parameters that a plan leaves worse than another."""
    worse = [
        f"{plain(name)} ({r:.1f} times)" for name, r in ratios.items() if r > LAYOUT.worse_sd_ratio
    ]
    if not worse:
        return f"No parameter is known worse than with {than}."
    return f"Known worse than with {than}: {listed(worse)}."


def _slews_section(contenders: Sequence[Contender]) -> Section:
    """Slews of a plan."""
    rows = []
    for contender in contenders:
        plan = contender.plan
        parts = zip(plan.slews, plan.starts, plan.durations, strict=True)
        for i, (slew, start, duration) in enumerate(parts):
            whose = "" if len(contenders) == 1 else f"{plain(contender.name)}, "
            rows.append(
                (
                    f"{whose}slew {i + 1}",
                    f"({vector_text(slew.axis_B)})",
                    f"{math.degrees(slew.angle):.1f}",
                    f"{math.degrees(slew.rate):.3f}",
                    f"{math.degrees(slew.acceleration):.3f}",
                    f"{start:.0f}",
                    f"{duration:.0f}",
                )
            )
    heads = (
        "slew",
        "about body axis",
        "angle [deg]",
        "rate [deg/s]",
        "ramps [deg/s²]",
        "starts [s]",
        "lasts [s]",
    )
    context = _plain_table(heads, rows, numbers=(2, 3, 4, 5, 6))
    return Section("Slews", packaged("table.html"), context)


def _margins_section(content: Mapping[str, Any]) -> Section:
    """Margins of the flown plan, tightest first."""
    margins = sorted(content["flown_margins"], key=lambda m: m["left"])
    rows = [(m["says"], "kept" if m["kept"] else "BROKEN") for m in margins]
    active = listed(content["active_limits"]) or "none"
    notes = (
        "Flown in closed loop with noise, J and K drawn from what is known. "
        f"Limits that hold the design back: {active}.",
    )
    context = _plain_table(("limit, the tightest first", ""), rows, notes=notes)
    return Section("Limits", packaged("table.html"), context)


def _plain_table(
    heads: Sequence[str],
    rows: Sequence[tuple[str, ...]],
    *,
    numbers: Sequence[int] = (),
    notes: Sequence[str] = (),
) -> dict[str, object]:
    return {
        "sentence": "",
        "more": "",
        "kind": "narrow",
        "extra": (),
        "heads": heads,
        "numbers": numbers,
        "rows": rows,
        "notes": notes,
    }


def comparison_sections(contenders: Sequence[Contender]) -> list[Section]:
    """Plans side by side: what they give, what they cost, what they fly."""
    return [_sds_section(contenders), _costs_section(contenders), _slews_section(contenders)]


def _sds_section(contenders: Sequence[Contender]) -> Section:
    best, *others = sorted(contenders, key=lambda c: c.worst_cross_term)
    names = [plain(c.name) for c in contenders]
    sizes = [_quantity(c.worst_cross_term, BASE_UNITS[0]) for c in (best, *others)]
    told = [f"; {size} with {plain(c.name)}" for c, size in zip(others, sizes[1:], strict=True)]
    least = np.min([c.expected for c in others or [best]], axis=0)
    ratios = dict(zip(BASE_NAMES, (best.expected / least).tolist(), strict=True))
    power, _ = sd_column([sd for c in contenders for sd in c.expected.tolist()])
    rows = [
        (name, unit_text(unit), *(_sd_cell(c, i, power) for c in contenders))
        for i, (name, unit) in enumerate(zip(BASE_NAMES, BASE_UNITS, strict=True))
    ]
    simulated = [c.achieved for c in contenders if c.achieved is not None]
    notes = ["Expected sds, each plan flown alone from the prior."]
    if simulated:
        count = len(simulated[0].errors)
        notes.append(
            f"In brackets: scatter about the truth in {count} simulated campaigns a plan, ± its "
            "standard error."
        )
    context = {
        "sentence": f"{plain(best.name)}: products of inertia to {sizes[0]} (1 sd){''.join(told)}.",
        "level": "",
        "more": _worse_text(ratios, "another plan") if others else "",
        "heads": ["parameter", "unit", *(sd_head(f"{name}: sd", power) for name in names)],
        "kind": "many short" if len(contenders) < LAYOUT.many_plans else "many",
        "numbers": tuple(range(2, 2 + len(contenders))),
        "extra": (1,),
        "rows": rows,
        "notes": notes,
    }
    pictures = captioned("plans", draw_comparison(contenders))
    return Section("Result", packaged("table.html"), context, pictures)


def _sd_cell(contender: Contender, i: int, power: int) -> str:
    sd, achieved = float(contender.expected[i]), contender.achieved
    if achieved is None:
        return number(sd, sd, power)
    scatter, error = float(achieved.sd[i]), float(achieved.sd_error[i])
    flown = f"{number(scatter, error, power)} ± {number(error, error, power)}"
    return f"{number(sd, sd, power)} ({flown})"


def _costs_section(contenders: Sequence[Contender]) -> Section:
    rows = [
        ("total time", "s", *(f"{c.total_time:.0f}" for c in contenders)),
        ("in motion", "s", *(f"{c.motion_time:.0f}" for c in contenders)),
        ("peak momentum", "N m s", *(two_digits(c.peak_momentum) for c in contenders)),
        ("peak torque", "N m", *(two_digits(c.peak_torque) for c in contenders)),
        ("limits broken", "–", *(_broken(c) for c in contenders)),
    ]
    heads = ("cost", "unit", *(plain(c.name) for c in contenders))
    numbers = tuple(range(2, 2 + len(contenders)))
    return Section("Cost", packaged("table.html"), _plain_table(heads, rows, numbers=numbers))


def _broken(contender: Contender) -> str:
    return listed([m.limit for m in contender.margins if not m.kept]) or "none"
