"""The sections of a page that puts two runs side by side."""

from __future__ import annotations

from bayes_inertia.report.criteria import exponents_of
from bayes_inertia.report.page import render_page
from bayes_inertia.report.pictures.series import draw_run_differences
from bayes_inertia.report.run_comparison import RunComparison
from bayes_inertia.report.section import Section, captioned, packaged


def comparison_page(comparison: RunComparison) -> str:
    """Two runs side by side as one HTML page that needs nothing from outside."""
    pictures = captioned("run_differences", draw_run_differences(comparison.J_and_K))
    sections = {"Verdict": "verdict", "Parameters": "parameters", "Gates": "gates"}
    sections |= {"What differs in settings": "settings"}
    context = {"c": comparison, "powers": exponents_of(*comparison.rows)}
    drawn = {"parameters": pictures}
    shown = [
        Section(title, packaged(f"comparison_{name}.html"), context, drawn.get(name, ()))
        for title, name in sections.items()
    ]
    return render_page(f"{comparison.first.label} and {comparison.second.label}", shown)
