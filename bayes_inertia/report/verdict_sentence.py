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
from bayes_inertia.report.formatting import two_digits, unit_text
from bayes_inertia.report.uncertainty import names_by_determination, sd_in_print
from bayes_inertia.report.words import phrase


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
    return phrase("fit", "answer", summary, diagnosis, _FUNCTIONS)


def with_verdict_sentence(
    summary: Mapping[str, Any], diagnosis: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """The content of summary.json, the verdict first.

    `diagnosis`: the content of diagnosis.json, of a run that has one. Returns: with the key
    `verdict_sentence` more, after format and campaign.
    """
    first = {key: summary[key] for key in ("format", "campaign") if key in summary}
    return first | {"verdict_sentence": verdict_sentence(summary, diagnosis)} | dict(summary)


def _misfit(summary: Mapping[str, Any]) -> list[str]:
    """Channels that the model does not explain."""
    too_large, too_small = misfit_channels(summary["fit"], criteria_of(summary))
    return too_large or too_small


def _undetermined(summary: Mapping[str, Any]) -> list[str]:
    """Parameters that stay at their prior; where nothing ties the size of J, not those of J."""
    names = names_by_determination(summary["parameters"], criteria_of(summary))["not determined"]
    return [n for n in names if n not in ELEMENTS] if summary.get("scale_of_J") == [] else names


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


# What the words of the answer ask for, each only where they need it.
_FUNCTIONS = {"accuracy": _accuracy, "misfit": _misfit, "undetermined": _undetermined}
