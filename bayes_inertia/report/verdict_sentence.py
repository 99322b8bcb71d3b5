"""The answer of a run in one sentence with numbers: on the page, in the terminal, in summary.json.

First whether the result may be used, then how well J and K are known, then whether the model
explains the data. The numbers are the quoted sds; a result that quotes none gives no accuracy.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from bayes_inertia.maths.inertia_tensor import ELEMENTS
from bayes_inertia.report.criteria import criteria_of
from bayes_inertia.report.fit_verdict import misfit_channels
from bayes_inertia.report.formatting import (
    channel_name,
    either_or,
    listed,
    plain,
    two_digits,
    typeset,
    unit_text,
)
from bayes_inertia.report.parameter_wording import averaged_over
from bayes_inertia.report.uncertainty import names_by_determination, sd_in_print

_REFUSED = "Do not use this result as it stands"


def verdict_sentence(summary: Mapping[str, Any], diagnosis: Mapping[str, Any] | None = None) -> str:
    """The answer of a run in one sentence.

    `diagnosis`: the content of diagnosis.json, of a run that has one.

    Examples
    --------
    >>> row = {"mean": 3.3, "sd": 4e-4, "quoted_sd": 4e-4, "prior_sd": 0.1}
    >>> verdict_sentence({
    ...     "parameters": {"Jxx": row}, "gates": [], "fit": {"starts_agreeing": [3, 3]},
    ...     "effects": []})
    'J to 0.012 % (1 sd, the worst element); the model explains the data.'
    """
    gates = {gate["name"]: gate for gate in summary["gates"]}
    failed = {name: gate for name, gate in gates.items() if not gate["passed"]}
    if "converged" in failed:
        return _on_unconverged(summary, "explained" in failed)
    others = [gate for name, gate in failed.items() if name not in ("explained", "diagnosed")]
    if others:
        return f"{_REFUSED}: {_first_clause(others[0]['says'])}."
    if "diagnosed" in failed:
        return _on_unknown(summary)
    if "explained" in failed:
        return _on_misfit(summary)
    return f"{_accuracy(summary)}; {_on_trusted(summary, diagnosis)}."


def with_verdict_sentence(
    summary: Mapping[str, Any], diagnosis: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """The content of summary.json, the verdict first.

    `diagnosis`: the content of diagnosis.json, of a run that has one. Returns: with the key
    `verdict_sentence` more, after format and campaign.
    """
    first = {key: summary[key] for key in ("format", "campaign") if key in summary}
    return first | {"verdict_sentence": verdict_sentence(summary, diagnosis)} | dict(summary)


def _on_unconverged(summary: Mapping[str, Any], misfit: bool) -> str:
    diagnostics = summary["diagnostics"]
    effective = min(diagnostics["ess_bulk_min"], diagnostics["ess_tail_min"])
    besides = ", and the model does not explain the data" if misfit else ""
    return (
        f"{_REFUSED}: the sampler has not converged "
        f"(nested R-hat {diagnostics['nested_rhat_max']:.3f}, "
        f"{effective:,.0f} effective samples){besides}."
    )


def _on_unknown(summary: Mapping[str, Any]) -> str:
    missing = f"{_REFUSED}: something is missing that no candidate explains"
    # Effects of free shape take up what it did.
    if any(name.endswith("_remainder") for name in summary["effects"]):
        return f"{missing}; with a disturbance of free shape allowed for, {_accuracy(summary)}."
    if summary.get("averaged_over"):
        return (
            f"{missing}; averaged over a disturbance of free shape and none, {_accuracy(summary)}."
        )
    return f"{missing}, and J and K may be off by more than any uncertainty here."


def _on_misfit(summary: Mapping[str, Any]) -> str:
    fit = summary["fit"]
    too_large, too_small = misfit_channels(fit, criteria_of(summary))
    where = listed([_channel_text(fit, name) for name in too_large or too_small])
    return (
        f"{_REFUSED}: the model does not explain the data, {where}. "
        "Run “bayes-inertia diagnose” to find what is missing."
    )


def _channel_text(fit: Mapping[str, Any], channel: str) -> str:
    name = channel_name(channel)
    reduced = fit["reduced_chi2"].get(channel, fit["reduced_chi2"]["total"])
    return f"{name} (reduced χ² {reduced:.3g})"


def _on_trusted(summary: Mapping[str, Any], diagnosis: Mapping[str, Any] | None) -> str:
    """Explained data, and open questions."""
    clauses = [_on_model(summary, diagnosis)]
    undetermined = names_by_determination(summary["parameters"], criteria_of(summary))
    names = undetermined["not determined"]
    if summary.get("scale_of_J") == []:
        names = [name for name in names if name not in ELEMENTS]
    if names:
        verb = "is" if len(names) == 1 else "are"
        clauses.append(f"{listed([plain(name) for name in names])} {verb} not determined")
    agreeing, starts = summary["fit"]["starts_agreeing"]
    if agreeing < starts:
        clauses.append(f"only {agreeing} of {starts} starts of the optimizer led here")
    return "; ".join(clauses)


def _on_model(summary: Mapping[str, Any], diagnosis: Mapping[str, Any] | None) -> str:
    verdict = diagnosis["verdict"] if diagnosis else summary.get("verdict")
    effects = [plain(name) for name in summary["effects"]]
    if verdict == "consistent":
        return "nothing is missing that these slews show: the model explains the data"
    if verdict == "named" and effects:
        was, them = ("was", "it") if len(effects) == 1 else ("were", "them")
        return f"{listed(effects)} {was} missing, and with {them} the model explains the data"
    if verdict == "formula" and effects:
        return f"a disturbance was missing, and with {listed(effects)} the model explains the data"
    if verdict == "ambiguous" and effects:
        sets = diagnosis["ambiguous_with"] if diagnosis else []
        choices = " and ".join(either_or([plain(name) for name in names]) for names in sets)
        choices = choices or averaged_over(summary)
        return (
            f"{choices} is missing, this campaign cannot tell which, "
            "and with it the model explains the data"
        )
    along = f", with {listed(effects)} fitted along," if effects else ""
    return f"the model{along} explains the data"


def _accuracy(summary: Mapping[str, Any]) -> str:
    """Worst sd of moments, products and scale factors each."""
    rows, criteria = summary["parameters"], criteria_of(summary)
    undetermined = names_by_determination(rows, criteria)["not determined"]
    known = {name: row for name, row in rows.items() if name not in undetermined}
    kinds: tuple[tuple[str, Callable[[str], bool], Callable[[Mapping[str, Any]], str]], ...] = (
        ("J", _is_moment, _percent),
        ("products of inertia", _is_product, _in_unit),
        ("K", is_scale_factor, _percent),
    )
    said = [_ratios_to(summary)] if summary.get("scale_of_J") == [] else []
    for label, belongs, text in kinds:
        members = [row for name, row in known.items() if belongs(name)]
        if members:
            worst = max(members, key=_relative_sd if text is _percent else _sd)
            said.append(f"{label} to {text(worst)}")
    if not said:
        return "J and K are not determined"
    worst_of = "the worst of each" if len(said) > 1 else "the worst element"
    # What tells the absolute size of J are the wheels, as stated.
    scale = "; J on the scale of the stated wheels" if summary.get("wheels") else ""
    return f"{', '.join(said)} (1 sd, {worst_of}{scale})"


def _ratios_to(summary: Mapping[str, Any]) -> str:
    """Worst sd of J over its trace; its size is the prior's."""
    worst = max(sd_in_print(row) for name, row in summary["ratios"].items() if "trace" in name)
    size = "nothing ties the size of J, which stays the prior's"
    return f"J / trace J to {two_digits(100.0 * worst)} % ({size})"


def _is_moment(name: str) -> bool:
    return len(name) == 3 and name[0] == "J" and name[1] == name[2]


def _is_product(name: str) -> bool:
    return len(name) == 3 and name[0] == "J" and name[1] != name[2]


def is_scale_factor(name: str) -> bool:
    """Whether a parameter is one of K.

    Examples
    --------
    >>> is_scale_factor("K4"), is_scale_factor("mems.K1")
    (True, False)
    """
    return name[0] == "K" and name[1:].isdigit()


def _sd(row: Mapping[str, Any]) -> float:
    return sd_in_print(row)


def _relative_sd(row: Mapping[str, Any]) -> float:
    return _sd(row) / abs(row["mean"]) if row["mean"] else math.inf


def _percent(row: Mapping[str, Any]) -> str:
    return f"{two_digits(100.0 * _relative_sd(row))} %"


def _in_unit(row: Mapping[str, Any]) -> str:
    return f"{two_digits(_sd(row))} {unit_text(row['unit'])}"


def _first_clause(says: str) -> str:
    """The first sentence of what a gate says, which holds the finding; the rest is advice."""
    return typeset(says).split(". ")[0].rstrip(".")
