"""Phrases on a diagnosis, made from the content of diagnosis.json: a window, a step, a choice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bayes_inertia.report.formatting import (
    channel_name,
    listed,
    plain,
    two_digits,
    unit_text,
    value_text,
)
from bayes_inertia.report.layout import LAYOUT

# Files of version 0.1 do not state the rules of their search: they were these.
_RULES_OF_0_1 = {
    "false_alarm_probability": 0.02,
    "log_evidence_margin": 3.0,
    "imitation_correlation": 0.6,
}


def rules_of(content: Mapping[str, Any]) -> Mapping[str, float]:
    """The rules that the search went by.

    Examples
    --------
    >>> rules_of({"rules": {"log_evidence_margin": 4.0}})["log_evidence_margin"]
    4.0
    """
    return _RULES_OF_0_1 | content.get("rules", {})


def with_what(content: Mapping[str, Any]) -> str:
    """What the model of the pictures "after" has that the base model has not.

    Examples
    --------
    >>> with_what({"steps": [], "verdict": "named"})
    'with the noise as measured'
    >>> with_what({"steps": [{}], "verdict": "unknown"})
    'with the effects that were tried'
    """
    if not content["steps"]:
        return "with the noise as measured"
    if content["verdict"] == "unknown":
        return "with the effects that were tried"
    return "with the named effects"


def formula_texts(content: Mapping[str, Any]) -> list[str]:
    """What formulas say of a disturbance without a name, and how far to believe them.

    Examples
    --------
    >>> term = {"formula": "body torque = c |ω|²", "behind_best": 0.0}
    >>> content = {"verdict": "formula", "formulas": {
    ...     "tried": 1598, "false_alarm_at_most": 0.001, "terms": [term]}}
    >>> formula_texts(content)
    ['Of 1598 formulas only this one explains the data (false alarms: at most 0.10 %).']
    """
    found = content.get("formulas")
    if not found:
        return []
    share = max(found["false_alarm_at_most"], LAYOUT.least_false_alarms)
    percent = f"{two_digits(100.0 * share)} %"
    formulas = [term["formula"] for term in found["terms"]]
    alarm = f"(false alarms: at most {percent})"
    if content["verdict"] != "formula":
        best = listed(formulas[: LAYOUT.formulas_listed])
        return [f"What has no name may be, of {found['tried']} formulas, {best} {alarm}."]
    if len(formulas) == 1:
        return [f"Of {found['tried']} formulas only this one explains the data {alarm}."]
    others = listed(formulas[1 : 1 + LAYOUT.formulas_listed])
    return [f"Of {found['tried']} formulas these explain the data as well: {others} {alarm}."]


def probabilities(content: Mapping[str, Any]) -> list[tuple[str, float]]:
    """What of the ambiguous sets may be true, and how probable it is.

    Examples
    --------
    >>> probabilities({"alternatives": [
    ...     {"effect": "wheel_friction", "instead_of": "viscous_torque", "probability": 0.25}]})
    [('viscous torque', 0.75), ('wheel friction', 0.25)]
    """
    alternatives = content["alternatives"]
    replaced = list(dict.fromkeys(a["instead_of"] for a in alternatives))
    rows: list[tuple[str, float]] = []
    for alternative in alternatives:
        effect = plain(alternative["effect"]) or "nothing"
        if len(replaced) > 1:
            effect += f" instead of {plain(alternative['instead_of'])}"
        rows.append((effect, alternative["probability"]))
    named = listed([plain(name) for name in replaced])
    return [(named, 1.0 - sum(p for _, p in rows)), *rows]


def averaging_text(content: Mapping[str, Any]) -> str:
    """That J and K are averaged over an ambiguous set, and what difference that makes."""
    shift = content["steps"][-1]["shift"]
    gaps = [
        (abs(mean - shift[name]["after"]) / shift[name]["sd_after"], name, alternative["effect"])
        for alternative in content["alternatives"]
        for name, mean in zip(alternative["names"], alternative["mean"], strict=True)
    ]
    gap, name, effect = max(gaps)
    shares = ", ".join(f"{what} {100.0 * p:.0f} %" for what, p in probabilities(content))
    text = (
        f"J and K are averaged over what may be true ({shares}), so that they hold whichever it is"
    )
    if gap < LAYOUT.negligible_difference_sd:
        return f"{text}; it makes no difference to them."
    case = plain(effect) or "nothing"
    return f"{text}: if it is {case}, {name} is {gap:.1f} sd from where the first has it."


def nameless_text(content: Mapping[str, Any]) -> str:
    """That something outside the library could be the cause as well.

    Returns: empty where the named effects explain the data clearly better.

    Examples
    --------
    >>> nameless_text({"nameless_lead": 1.5})[:61]
    'An unmodelled disturbance (a torque or sensor error of free s'
    >>> nameless_text({"nameless_lead": -20.0})
    ''
    """
    lead = content.get("nameless_lead")
    if lead is None or lead < -rules_of(content)["log_evidence_margin"]:
        return ""
    return (
        "An unmodelled disturbance (a torque or sensor error of free shape, "
        "or in proportion to a rate, momentum, field or time) explains the data about as well: "
        "what is named is likely, not proven."
    )


def nameless_signal(content: Mapping[str, Any]) -> str:
    """The unmodelled disturbance, and where it enters.

    Examples
    --------
    >>> nameless_signal({"nameless_source": "rate sensor"})
    'an unmodelled error of the rate sensor (of free shape over time)'
    >>> nameless_signal({"nameless_source": "body torque"})
    'an unmodelled body torque (of free shape over time)'
    >>> nameless_signal({"nameless_source": "body torque that follows wheel momentum"})
    'an unmodelled body torque (in proportion to: wheel momentum)'
    """
    source, _, driver = content.get("nameless_source", "").partition(" that follows ")
    if source:
        what = source if source.endswith("torque") else f"error of the {source}"
        shape = f"in proportion to: {driver}" if driver else "of free shape over time"
        return f"an unmodelled {what} ({shape})"
    return (
        "an unmodelled disturbance (a signal of free shape, "
        "or in proportion to a rate, momentum, field or time)"
    )


def could_hide_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """How far what is too weak to be found could have moved J and K, at most.

    Returns: A bound with its condition, and what it is not.

    Examples
    --------
    >>> could_hide_text([{"parameter": "Jxx", "shift": 6e-4, "sd": 2e-4, "unit": "kg m^2",
    ...     "effect": "wheel_friction"}])[:70]
    'If there is wheel friction, too weak to be found, Jxx may be off by up'
    """
    worst = max(rows, key=lambda row: row["shift"] / row["sd"])
    unit = unit_text(worst["unit"]) if worst["unit"] else ""
    return (
        f"If there is {plain(worst['effect'])}, too weak to be found, {worst['parameter']} may be "
        f"off by up to {two_digits(worst['shift'])} {unit}".rstrip()
        + f" ({two_digits(worst['shift'] / worst['sd'])} times the model's sd): a bound, which the "
        "quoted sd counts by its probability."
    )


def window_text(window: Mapping[str, Any], slew_start: float = 0.0) -> str:
    """Where and when a stretch of residuals is.

    `slew_start`: time of the slew's first row [s]; the window's times are counted from it.

    Examples
    --------
    >>> window_text({"channel": "rate", "slew": "slew 2", "component": "axis 1",
    ...     "t_start": 103.25, "t_end": 140.0}, 100.0)
    'slew 2, rate sensor axis 1, 3.25 to 40 s'
    """
    begin, end = window["t_start"] - slew_start, window["t_end"] - slew_start
    sensor = channel_name(window["channel"])
    return f"{window['slew']}, {sensor} {window['component']}, {begin:.4g} to {end:.4g} s"


def step_text(step: Mapping[str, Any], candidates: Sequence[Mapping[str, Any]]) -> str:
    """What adding one effect changed, and the effect's parameters."""
    before, after = step["reduced_chi2_before"]["total"], step["reduced_chi2_after"]["total"]
    text = f"Adding {plain(step['added'])} takes the reduced χ² from {before:.4g} to {after:.4g}"
    if step["held_out_before"] is not None:
        text += (
            f", and of slews left out of the fit from {step['held_out_before']:.4g} "
            f"to {step['held_out_after']:.4g}"
        )
    for candidate in candidates:
        if candidate["effect"] == step["added"] and candidate["parameters"]:
            return f"{text}. {parameters_text(candidate['parameters'])}"
    return f"{text}."


def parameters_text(parameters: Mapping[str, Mapping[str, Any]]) -> str:
    """The parameters of an effect with their sds, in a sentence.

    Examples
    --------
    >>> parameters_text({"tau": {"mean": 0.0512, "sd": 0.0013, "unit": "s"}})
    'Found: tau = 0.0512 ± 0.0013 s.'
    """
    found = (f"{plain(name)} = {value_text(value)}" for name, value in parameters.items())
    return f"Found: {'; '.join(found)}."


def significance(candidate: Mapping[str, Any], threshold: float) -> str:
    """One candidate in a word or two.

    Examples
    --------
    >>> significance({"p_value": 1e-9, "dof": 3, "reason": None}, 1e-3)
    'significant'
    """
    if candidate["p_value"] is None:
        return candidate["reason"]
    if not candidate["dof"]:
        return "cannot be seen in this campaign"
    return "significant" if candidate["p_value"] < threshold else "not significant"


def alike_sentences(content: Mapping[str, Any], max_pairs: int = 8) -> list[str]:
    """Sentences on candidates that this campaign can hardly tell apart.

    Examples
    --------
    >>> alike_sentences({"alike": [{"effects": ["a_b", "c"], "correlation": 0.9}]})
    ['A b and c look alike in this campaign (correlation 0.90).']
    """
    limit = rules_of(content)["imitation_correlation"]
    if not content["alike"]:
        return [f"No two candidates look alike in this campaign beyond a correlation of {limit:g}."]
    sentences = []
    for pair in content["alike"][:max_pairs]:
        first, second = (plain(name) for name in pair["effects"])
        sentences.append(
            f"{first.capitalize()} and {second} look alike in this campaign "
            f"(correlation {pair['correlation']:.2f})."
        )
    if len(content["alike"]) > max_pairs:
        sentences.append(
            f"{len(content['alike']) - max_pairs} further pairs correlate beyond {limit:g} "
            "(see diagnosis.json)."
        )
    return sentences
