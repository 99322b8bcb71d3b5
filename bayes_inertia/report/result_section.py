"""The card on top of a report: J and K with their sds, whether to use them, and what for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_inertia.inference.posterior import Posterior
from bayes_inertia.report.formatting import exponent, number, power_text, unit_text
from bayes_inertia.report.pictures.correction import draw_correction
from bayes_inertia.report.pictures.posterior_data import n_slews
from bayes_inertia.report.section import Picture, Section, captioned, packaged
from bayes_inertia.report.uncertainty import ratios_told, sd_in_print
from bayes_inertia.report.verdict import (
    Level,
    Verdict,
    diagnosis_verdict,
    fit_verdict,
    is_scale_factor,
    verdict_sentence,
    worst_level,
)
from bayes_inertia.report.words import phrase

_STATUS: dict[Level, str] = {"good": "Trusted", "caution": "Use with care", "bad": "Refused"}
_TENSOR = (("Jxx", "Jxy", "Jxz"), ("Jxy", "Jyy", "Jyz"), ("Jxz", "Jyz", "Jzz"))


def result_sections(
    posterior: Posterior,
    diagnosis: Mapping[str, Any] | None = None,
    forecast: Mapping[str, Any] | None = None,
) -> list[Section]:
    """The answer, and why: one verdict, J and K, the error of the next slew; then the reasons.

    `forecast`: see `draw_correction`. It is not shown of a result that is not to be used. Returns:
    the card with at most one picture, and the reasons.
    """
    summary, bound = posterior.summary(), ""
    verdicts = {"Can it be used?": fit_verdict(summary, n_slews(posterior))}
    if diagnosis is not None:
        verdicts = {"What is missing?": diagnosis_verdict(diagnosis)} | verdicts
        bound = (
            phrase("diagnosis", "could_hide", hidden)
            if (hidden := diagnosis.get("could_hide"))
            else ""
        )
    level, rows = level_of(summary, list(verdicts.values())), summary["parameters"]
    scale_factors = [[row] for name, row in rows.items() if is_scale_factor(name)]
    context = {
        "level": level,
        "status": _STATUS[level],
        "sentence": verdict_sentence(summary, diagnosis),
        "bound": bound,
        "matrices": [
            *_ratio_matrix(summary),
            _matrix("J", [[rows[name] for name in line] for line in _TENSOR]),
            *([_matrix("K", scale_factors)] if scale_factors else []),
        ],
        "quoted": posterior.quoted_factor is not None,
    }
    pictures: tuple[Picture, ...] = ()
    if forecast and level != "bad":
        pictures = captioned("correction", draw_correction(forecast), forecast)
    reasons = {
        question: (verdict.title, [s for s in verdict.sentences if s != bound])
        for question, verdict in verdicts.items()
    }
    return [
        Section("Result", packaged("result.html"), context, pictures),
        Section("Why", packaged("reasons.html"), {"reasons": reasons, "folded": ()}),
    ]


def level_of(summary: Mapping[str, Any], verdicts: list[Verdict]) -> Level:
    """The one level of a report: what is not trusted is refused, whatever else is said."""
    if not summary["trusted"]:
        return "bad"
    return worst_level([verdict.level for verdict in verdicts])


def _ratio_matrix(summary: Mapping[str, Any]) -> list[dict[str, Any]]:
    """J over its trace, first where nothing ties its size."""
    ratios = ratios_told(summary)
    if not ratios:
        return []
    return [_matrix("J / trace J", [[ratios[f"{n}/trace"] for n in line] for line in _TENSOR])]


def _matrix(symbol: str, rows: list[list[Mapping[str, Any]]]) -> dict[str, Any]:
    """A matrix of estimates, all in one power of ten, each with its quoted sd."""
    cells = [row for line in rows for row in line]
    power = exponent(max(abs(row["mean"]) for row in cells), 0.0)
    unit = unit_text(cells[0]["unit"]) if cells[0]["unit"] else ""
    return {
        "symbol": symbol,
        "unit": " ".join(part for part in (power_text(power) if power else "", unit) if part),
        "rows": [[_estimate(row, power) for row in line] for line in rows],
    }


def _estimate(row: Mapping[str, Any], power: int) -> dict[str, str]:
    quoted = row["quoted_sd"]
    return {
        "mean": number(row["mean"], sd_in_print(row), power),
        "sd": "" if quoted is None else number(quoted, quoted, power),
    }
