"""Verdicts of a report: may the result be used, what is missing, and the answer in one sentence.

First whether the result may be used, then how well J and K are known, then whether the model
explains the data. The numbers are the quoted sds; a result that quotes none gives no accuracy.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from bayes_inertia.maths.inertia_tensor import ELEMENTS
from bayes_inertia.report.criteria import (
    Criteria,
    channel_verdict,
    criteria_of,
    names_by_determination,
    ratios_told,
    scale_factors,
)
from bayes_inertia.report.formatting import brief, channel_name, probability
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.words import averaged_over, dirt_sentences, phrase, sentences

Level = Literal["good", "caution", "bad"]
_FROM_THE_WORST: tuple[Level, ...] = ("bad", "caution", "good")


@dataclass(frozen=True)
class Verdict:
    """The first answer of a report."""

    level: Level  # decides the colour
    title: str  # the answer in one line
    sentences: tuple[str, ...]  # why it is so and what to do, one item each


def level_of(summary: Mapping[str, Any], levels: Sequence[Level]) -> Level:
    """The one level of a report: what is not trusted is refused, whatever else is said.

    >>> level_of({"trusted": True}, ["good", "bad", "caution"])
    'bad'
    """
    return min(levels, key=_FROM_THE_WORST.index) if summary["trusted"] else "bad"


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
        "undetermined": _undetermined(summary),
        "causes": averaged_over(summary),
        "alone": _on_one_slew(summary["parameters"]),
    }
    level: Level = "good"
    if failed:
        level = "bad"
    elif _rests_on_priors(summary) or fit["starts_agreeing"][0] < fit["starts_agreeing"][1]:
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


def _on_one_slew(rows: Mapping[str, Any]) -> list[tuple[str, list[str], list[float]]]:
    """Slews that alone determine parameters, these, and what one more gains each [% of its sd]."""
    alone: dict[str, list[str]] = {}
    for name, row in rows.items():
        if rests_on_one_slew(row):
            alone.setdefault(row["decisive_slew"], []).append(name)
    told = "sd_with_it_again"
    found = []
    for slew, names in alone.items():
        again = [rows[n] for n in names if told in rows[n]]
        found.append((slew, names, [100.0 * (1.0 - row[told] / row["sd"]) for row in again]))
    return found


def rests_on_one_slew(row: Mapping[str, Any]) -> bool:
    """Whether one slew alone determines a parameter, so that the others cannot check it.

    Returns: false for runs of versions that do not tell.

    >>> rests_on_one_slew({"sd": 1e-4, "sd_without_it": 2e-3}), rests_on_one_slew({"sd": 1e-4})
    (True, False)
    """
    return bool(row.get("sd_without_it", 0.0) > LAYOUT.rests_on_one_slew * row["sd"])


_LEVELS: dict[str, Level] = {
    "consistent": "good",
    "named": "good",
    "ambiguous": "caution",
    "formula": "caution",
    "partial": "caution",
    "unknown": "bad",
}


def diagnosis_verdict(content: Mapping[str, Any]) -> Verdict:
    """What is missing, and what that means.

    Returns: the answer first, then where, how much, what to fly next, and what remains open.
    """
    reasons = sentences("diagnosis", "reasons", content, dirt_sentences(content.get("dirt", [])))
    return Verdict(_LEVELS[content["verdict"]], headline(content), tuple(reasons))


def in_brief(content: Mapping[str, Any]) -> list[str]:
    """What of a diagnosis a terminal shows: where, how much, what to fly next. The page has all."""
    return sentences("diagnosis", "brief", content)


def headline(content: Mapping[str, Any]) -> str:
    """The verdict of a diagnosis in one line.

    >>> headline({"verdict": "consistent", "named": [], "ambiguous_with": []})
    'Nothing is missing that these slews show: the model explains the data.'
    """
    return phrase("diagnosis", "headline", content)


def verdict_sentence(summary: Mapping[str, Any], diagnosis: Mapping[str, Any] | None = None) -> str:
    """The answer of a run in one sentence.

    >>> row = {"mean": 3.3, "sd": 4e-4, "quoted_sd": 4e-4, "prior_sd": 0.1}
    >>> verdict_sentence({
    ...     "parameters": {"Jxx": row}, "gates": [], "fit": {"starts_agreeing": [3, 3]},
    ...     "effects": []})
    'J to 0.012 % (1 sd, the worst element); the model explains the data.'
    """
    return phrase("fit", "answer", summary, diagnosis, _FUNCTIONS)


def with_verdict_sentence(
    summary: Mapping[str, Any], diagnosis: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """The content of summary.json, the verdict first."""
    first = {key: summary[key] for key in ("format", "campaign") if key in summary}
    return first | {"verdict_sentence": verdict_sentence(summary, diagnosis)} | dict(summary)


def _misfit(summary: Mapping[str, Any]) -> list[str]:
    """Channels that the model does not explain, and by what that shows."""
    fit, criteria = summary["fit"], criteria_of(summary)
    too_large, too_small = misfit_channels(fit, criteria)
    return [
        f"{channel_name(channel)} ({_shown_by(fit, channel, criteria)})"
        for channel in too_large or too_small
    ]


def _shown_by(fit: Mapping[str, Any], channel: str, criteria: Criteria) -> str:
    """Reduced chi^2; where that is as predicted, the structure in time."""
    reduced = fit["reduced_chi2"]
    if channel in reduced and channel_verdict(fit, channel, criteria) == "structured in time":
        return f"residuals structured in time, {probability(fit['p_white'][channel])}"
    return f"reduced χ² {brief(reduced.get(channel, reduced['total']), 3)}"


def _undetermined(summary: Mapping[str, Any]) -> list[str]:
    """Parameters that stay at their prior; where nothing ties the size of J, not those of J."""
    names = names_by_determination(summary["parameters"], criteria_of(summary))["not determined"]
    return [n for n in names if n not in ELEMENTS] if ratios_told(summary) else names


def _rests_on_priors(summary: Mapping[str, Any]) -> bool:
    """Whether a prior makes J or K: their own, or that of what they cannot be told from.

    What stays at its prior beside J and K that are determined is in their sds, and small there.
    """
    answers = {name for names in scale_factors(summary).values() for name in names}
    answers |= set() if ratios_told(summary) else set(ELEMENTS)
    rows = {name: row for name, row in summary["parameters"].items() if name in answers}
    known = names_by_determination(rows, criteria_of(summary))["determined"]
    return bool(_undetermined(summary)) and len(known) < len(rows)


# What the words of the answer ask for, each only where they need it.
_FUNCTIONS = {"misfit": _misfit, "undetermined": _undetermined}
