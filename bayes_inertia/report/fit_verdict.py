"""Can I trust this fit? The verdict on the content of summary.json."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_inertia.report.criteria import Criteria, criteria_of
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.parameter_wording import averaged_over
from bayes_inertia.report.residual_wording import channel_verdict
from bayes_inertia.report.uncertainty import names_by_determination
from bayes_inertia.report.verdict import Level, Verdict
from bayes_inertia.report.words import phrase, sentences


def fit_verdict(summary: Mapping[str, Any], n_slews: int) -> Verdict:
    """Can the result be trusted, why, and which uncertainty to use."""
    criteria, fit = criteria_of(summary), summary["fit"]
    gates = {gate["name"]: gate for gate in summary["gates"]}
    failed = {name for name, gate in gates.items() if not gate["passed"]}
    explained = "explained" not in failed
    too_large, too_small = ([], []) if explained else misfit_channels(fit, criteria)
    as_predicted = {"says": "the residuals are as predicted"}
    found = {
        "summary": summary,
        "criteria": criteria,
        "n_slews": n_slews,
        "converged": "converged" not in failed,
        "explained": explained,
        "explanation": gates.get("explained", as_predicted)["says"],
        "diagnosed": "diagnosed" in gates,
        "too_large": too_large,
        "too_small": too_small,
        # Gates that have no sentences of their own.
        "failed": [
            gate["says"]
            for name, gate in gates.items()
            if name in failed - {"converged", "explained"}
        ],
        "starts": fit["starts_agreeing"],
        "undetermined": names_by_determination(summary["parameters"], criteria)["not determined"],
        "causes": averaged_over(summary),
        "alone": _on_one_slew(summary["parameters"]),
    }
    level: Level = "good"
    if failed:
        level = "bad"
    elif found["undetermined"] or fit["starts_agreeing"][0] < fit["starts_agreeing"][1]:
        level = "caution"
    return Verdict(
        level, phrase("fit", "headline", found), tuple(sentences("fit", "reasons", found))
    )


def misfit_channels(fit: Mapping[str, Any], criteria: Criteria) -> tuple[list[str], list[str]]:
    """Channels whose residuals are not what model and noise predict.

    Returns `too_large, too_small`: names of channels, or "all channels together". Those structured
    in time count as too large.
    """
    too_large, too_small = [], []
    for channel in (c for c in fit["reduced_chi2"] if c != "total"):
        verdict = channel_verdict(fit, channel, criteria)
        if verdict.startswith(("too large", "structured")):
            too_large.append(channel)
        elif verdict.startswith("smaller"):
            too_small.append(channel)
    total = fit["reduced_chi2"]["total"]
    if not too_large and not too_small and total is not None:
        (too_large if total > 1.0 else too_small).append("all channels together")
    return too_large, too_small


def _on_one_slew(rows: Mapping[str, Any]) -> dict[str, list[str]]:
    """Parameters that one slew alone determines, by slew."""
    alone: dict[str, list[str]] = {}
    for name, row in rows.items():
        if rests_on_one_slew(row):
            alone.setdefault(row["decisive_slew"], []).append(name)
    return alone


def rests_on_one_slew(row: Mapping[str, Any]) -> bool:
    """Whether one slew alone determines a parameter, so that the others cannot check it.

    Returns: false for runs of versions that do not tell.

    Examples
    --------
    >>> rests_on_one_slew({"sd": 1e-4, "sd_without_it": 2e-3}), rests_on_one_slew({"sd": 1e-4})
    (True, False)
    """
    return bool(row.get("sd_without_it", 0.0) > LAYOUT.rests_on_one_slew * row["sd"])
