"""The sections of a page that puts two runs side by side."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_inertia.report.criteria import exponents_of, sd_in_print
from bayes_inertia.report.formatting import (
    NOT_GIVEN,
    channel_name,
    listed,
    number,
    plain,
    tenths,
    typeset,
    unit_text,
)
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.page import render_page
from bayes_inertia.report.pictures.run_differences import draw_run_differences
from bayes_inertia.report.run_comparison import ComparedRun, ParameterDifference, RunComparison
from bayes_inertia.report.section import Section, Table, captioned, packaged

_COLUMNS = {
    "parameter": "",
    "unit": "unit",
    "A: mean": "n strong",
    "A: quoted sd": "n",
    "B: mean": "n strong",
    "B: quoted sd": "n",
    "B − A": "n",
    "in combined sd": "n",
}


def comparison_page(comparison: RunComparison) -> str:
    """Two runs side by side as one HTML page that needs nothing from outside."""
    sections = [
        _verdict_section(comparison),
        _parameters_section(comparison),
        _gates_section(comparison),
        _settings_section(comparison),
    ]
    title = f"{comparison.first.label} and {comparison.second.label}"
    return render_page(title, sections)


def _verdict_section(comparison: RunComparison) -> Section:
    far = any(abs(p.in_sd or 0.0) > LAYOUT.noticeable_sd for p in comparison.J_and_K)
    runs = [_run_box(letter, run) for letter, run in _lettered(comparison)]
    context = {
        "sentence": comparison.sentence,
        "level": "bad" if comparison.refused else "caution" if far else "good",
        "runs": runs,
        "same_telemetry": comparison.same_telemetry,
    }
    return Section("Verdict", packaged("comparison_verdict.html"), context)


def _lettered(comparison: RunComparison) -> tuple[tuple[str, ComparedRun], ...]:
    return (("A", comparison.first), ("B", comparison.second))


def _run_box(letter: str, run: ComparedRun) -> dict[str, str]:
    return {
        "letter": letter,
        "label": run.label,
        "sentence": run.summary["verdict_sentence"],
        "campaign": str(run.summary["campaign"] or ""),
    }


def _parameters_section(comparison: RunComparison) -> Section:
    figure = draw_run_differences(comparison.J_and_K)
    powers = exponents_of(comparison.first.rows, comparison.second.rows)
    rows = [_parameter_row(p, powers[p.name]) for p in comparison.parameters]
    far = [
        k
        for k, p in enumerate(comparison.parameters)
        if p.in_sd is not None and abs(p.in_sd) > LAYOUT.noticeable_sd
    ]
    context = {"table": Table(_COLUMNS, rows, "many", far)}
    pictures = captioned("run_differences", figure)
    return Section("Parameters", packaged("comparison_parameters.html"), context, pictures)


def _parameter_row(parameter: ParameterDifference, power: int) -> tuple[str, ...]:
    difference, combined, in_sd = parameter.difference, parameter.combined_sd, parameter.in_sd
    shown = NOT_GIVEN
    if difference is not None and combined is not None:
        shown = number(difference, combined, power)
    return (
        plain(parameter.name),
        unit_text(parameter.unit, power),
        *_cells(parameter.first, power),
        *_cells(parameter.second, power),
        shown,
        NOT_GIVEN if in_sd is None else tenths(in_sd),
    )


def _cells(row: Mapping[str, Any] | None, power: int) -> tuple[str, str]:
    """Mean and quoted sd of one run."""
    if row is None:
        return NOT_GIVEN, NOT_GIVEN
    quoted = row["quoted_sd"]
    mean = number(row["mean"], sd_in_print(row), power)
    return mean, NOT_GIVEN if quoted is None else number(quoted, quoted, power)


def _gates_section(comparison: RunComparison) -> Section:
    by_name = [
        {gate["name"]: gate | {"says": typeset(gate["says"])} for gate in run.summary["gates"]}
        for _, run in _lettered(comparison)
    ]
    names = dict.fromkeys(name for gates in by_name for name in gates)
    fits = [run.summary["fit"]["reduced_chi2"] for _, run in _lettered(comparison)]
    reduced = [
        (channel_name(channel), *(_reduced_text(fit.get(channel)) for fit in fits))
        for channel in dict.fromkeys(c for fit in fits for c in fit)
    ]
    context = {
        "gates": [{"name": n, "sides": [gates.get(n) for gates in by_name]} for n in names],
        "reduced": Table({"reduced χ²": "", "A": "n", "B": "n"}, reduced, "narrow short"),
    }
    return Section("Gates", packaged("comparison_gates.html"), context)


def _reduced_text(value: float | None) -> str:
    return NOT_GIVEN if value is None else f"{value:.3f}"


def _settings_section(comparison: RunComparison) -> Section:
    rows = [(name, a or NOT_GIVEN, b or NOT_GIVEN) for name, a, b in comparison.differing_settings]
    differing = {row[0] for row in rows}
    same = listed([name for name in comparison.first.settings if name not in differing])
    table = Table({"setting": "", "A": "long value", "B": "long value"}, rows, "")
    context = {"table": table, "same": same}
    return Section("What differs in settings", packaged("comparison_settings.html"), context)
