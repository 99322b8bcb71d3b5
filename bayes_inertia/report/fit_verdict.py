"""Can I trust this fit? The verdict on the content of summary.json."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from bayes_inertia.report.criteria import Criteria, criteria_of
from bayes_inertia.report.formatting import listed, probability, typeset
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.parameter_wording import averaged_over
from bayes_inertia.report.residual_wording import channel_verdict
from bayes_inertia.report.uncertainty import names_by_determination
from bayes_inertia.report.verdict import Level, Verdict


def fit_verdict(summary: Mapping[str, Any], n_slews: int) -> Verdict:
    """Can the result be trusted, why, and which uncertainty to use."""
    criteria, rows, fit = criteria_of(summary), summary["parameters"], summary["fit"]
    gates = {gate["name"]: gate for gate in summary["gates"]}
    converged, explained = (_passed(gates, name) for name in ("converged", "explained"))
    too_large, too_small = ([], []) if explained else misfit_channels(fit, criteria)
    failed = [typeset(gate["says"]) for gate in gates.values() if _failed_besides(gate)]
    undetermined = names_by_determination(rows, criteria)["not determined"]
    sentences = [_on_sampler(converged, summary["diagnostics"], criteria)]
    if explained:
        says = (
            gates["explained"]["says"] if "explained" in gates else "the residuals are as predicted"
        )
        sentences.append(f"The model explains the data: {typeset(says)}.")
    else:
        sentences += _on_misfit(too_large, too_small, fit, diagnosed="diagnosed" in gates)
    sentences += [f"{text[0].upper()}{text[1:]}." for text in failed]
    sentences += _on_starts(fit["starts_agreeing"])
    if explained and not failed:
        sentences += _on_uncertainty(summary, n_slews)
    sentences += _on_undetermined(undetermined)
    level, title = _headline(
        converged=converged,
        explained=explained,
        too_large=bool(too_large),
        another_failed=bool(failed),
        all_starts_agree=fit["starts_agreeing"][0] >= fit["starts_agreeing"][1],
        all_determined=not undetermined,
    )
    return Verdict(level, title, tuple(sentences))


def _passed(gates: Mapping[str, Mapping[str, Any]], name: str) -> bool:
    return gates[name]["passed"] if name in gates else True


def _failed_besides(gate: Mapping[str, Any]) -> bool:
    """Whether a gate failed that has no sentences of its own here."""
    return not gate["passed"] and gate["name"] not in ("converged", "explained")


def _headline(
    *,
    converged: bool,
    explained: bool,
    too_large: bool,
    another_failed: bool,
    all_starts_agree: bool,
    all_determined: bool,
) -> tuple[Level, str]:
    """The worst that is so, in one line."""
    if not converged and not explained:
        return "bad", (
            "Do not use these numbers yet: the sampler has not converged, "
            "and the model does not explain the data."
        )
    if not converged:
        return "bad", "Do not use these numbers yet: the sampler has not converged."
    if not explained and too_large:
        return "bad", (
            "Do not use these numbers: the model does not explain the data, "
            "something is missing from it."
        )
    if not explained:
        return "bad", (
            "Do not use these numbers yet: the stated noise is wrong, the residuals are smaller "
            "than it predicts."
        )
    if another_failed:
        return "bad", "Do not use these numbers yet: a gate failed."
    if not all_starts_agree:
        return "caution", (
            "Usable with care: not every start of the optimizer led to this solution."
        )
    if not all_determined:
        return "caution", (
            "The fit can be trusted, but this campaign does not determine every parameter."
        )
    return "good", "Yes, these numbers can be trusted."


def _on_sampler(converged: bool, diagnostics: Mapping[str, Any], criteria: Criteria) -> str:
    rhat, tau = diagnostics["nested_rhat_max"], diagnostics["tau_max"]
    effective = min(diagnostics["ess_bulk_min"], diagnostics["ess_tail_min"])
    if converged:
        return "The sampler has converged: independently started ensembles agree."
    kept = diagnostics["steps"] - diagnostics["discarded"]
    reasons = []
    if rhat >= criteria.nested_rhat_below:
        reasons.append(
            f"its ensembles disagree (nested R-hat {rhat:.3f}, "
            f"wanted below {criteria.nested_rhat_below:g})"
        )
    if effective < criteria.effective_samples:
        reasons.append(
            f"it has only {effective:,.0f} effective samples of the worst parameter "
            f"(wanted {criteria.effective_samples:g})"
        )
    if kept < criteria.autocorrelation_times * tau:
        reasons.append(
            f"{kept} kept steps are too few for an autocorrelation time of {tau:.1f} steps "
            f"(wanted {criteria.autocorrelation_times:g} times it)"
        )
    return (
        f"The sampler has not converged: {listed(reasons) or 'its gate failed'}. "
        "Run it for more steps before using any number below."
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


def _on_groups(fit: Mapping[str, Any]) -> list[str]:
    """Groups of slews that disagree with each other; runs of before do not tell."""
    groups = fit.get("groups")
    return [f"{groups['says'][0].upper()}{typeset(groups['says'][1:])}."] if groups else []


def _on_misfit(
    too_large: list[str], too_small: list[str], fit: Mapping[str, Any], *, diagnosed: bool
) -> list[str]:
    if too_large:
        missing = (
            f"The residuals ({listed(too_large)}) are larger, or more structured, "
            "than the model and the stated noise predict: an effect is missing."
        )
        if diagnosed:
            # The gate of the diagnosis says what that means for J and K.
            return [missing, "A bias of the estimate that all slews share shows in no sd."]
        return [
            missing,
            "No sd is quoted: a bias that all slews share shows in none.",
            *_on_groups(fit),
            "Run “bayes-inertia diagnose” to find the missing effect.",
        ]
    if too_small:
        return [
            f"The residuals ({listed(too_small)}) are smaller than the stated noise: "
            "the sd is probably too large, not too small.",
            "Correct the stated sigma of that sensor in campaign.toml and fit again.",
        ]
    return []


def _on_starts(agreeing: Sequence[int]) -> list[str]:
    if agreeing[0] >= agreeing[1]:
        return []
    return [
        f"Only {agreeing[0]} of {agreeing[1]} starts of the optimizer reached this solution; "
        "the others ended in worse ones. Check the signs and units of the telemetry."
    ]


def _on_uncertainty(summary: Mapping[str, Any], n_slews: int) -> list[str]:
    """Parts of the quoted sd, and which parameters no other slew checks."""
    sentences = []
    if dispersion := summary["fit"].get("dispersion"):
        scatter = (
            f"they scatter {math.sqrt(dispersion['ratio']):.2f} times as much as noise makes them "
            f"({probability(dispersion['p_value'])} by chance)"
        )
        sentences.append(
            f"The slews disagree: {scatter}. The quoted sd is that much larger."
            if dispersion["factor"] > 1.0
            else f"The slews agree: {scatter}."
        )
        sentences += _on_groups(summary["fit"])
    elif n_slews == 1:
        sentences.append(
            "One slew is checked by no other: the quoted sd is right if the model and the stated "
            "noise are."
        )
    if causes := averaged_over(summary):
        sentences.append(
            f"J, K and the quoted sd are averaged over what may be true ({causes}): "
            "effects too weak to be found count by their probability."
        )
    return sentences + _on_one_slew(summary["parameters"])


def _on_one_slew(rows: Mapping[str, Any]) -> list[str]:
    """Parameters that one slew alone determines, and what flying it again would bring."""
    alone: dict[str, list[str]] = {}
    for name, row in rows.items():
        if rests_on_one_slew(row):
            alone.setdefault(row["decisive_slew"], []).append(name)
    sentences = []
    for slew, names in alone.items():
        rest = "rests" if len(names) == 1 else "rest"
        text = (
            f"{listed(names)} {rest} on {slew} alone: no other slew checks "
            f"{'it' if len(names) == 1 else 'them'}, and an error of that slew would not show."
        )
        gains = [
            1.0 - rows[name]["sd_with_it_again"] / rows[name]["sd"]
            for name in names
            if "sd_with_it_again" in rows[name]
        ]
        if gains:
            text += (
                f" Fly {slew} once more: then two slews check each other, and the sd shrinks by "
                f"{_percents(gains)}."
            )
        sentences.append(text)
    return sentences


def _percents(shares: list[float]) -> str:
    """Shares in per cent, their range if they differ."""
    low, high = round(100.0 * min(shares)), round(100.0 * max(shares))
    return f"{low} %" if low == high else f"{low} to {high} %"


def rests_on_one_slew(row: Mapping[str, Any]) -> bool:
    """Whether one slew alone determines a parameter, so that the others cannot check it.

    Returns: false for runs of versions that do not tell.

    Examples
    --------
    >>> rests_on_one_slew({"sd": 1e-4, "sd_without_it": 2e-3}), rests_on_one_slew({"sd": 1e-4})
    (True, False)
    """
    return bool(row.get("sd_without_it", 0.0) > LAYOUT.rests_on_one_slew * row["sd"])


def _on_undetermined(names: list[str]) -> list[str]:
    if not names:
        return []
    them = "it" if len(names) == 1 else "them"
    return [
        f"Not determined by this campaign: {listed(names)}. "
        f"What is printed for {them} is mostly the prior."
    ]
