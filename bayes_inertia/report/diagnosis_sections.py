"""The sections of a report on a diagnosis, made from the content of diagnosis.json."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import Any

from bayes_inertia.inference.settings import OPEN_VERDICTS
from bayes_inertia.report.formatting import (
    NOT_GIVEN,
    channel_name,
    exponent,
    number,
    p_value_text,
    plain,
    sd_column,
    sd_head,
    tenths,
    unit_text,
    value_text,
    vector_text,
)
from bayes_inertia.report.layout import LAYOUT
from bayes_inertia.report.pictures.diagnosis import (
    draw_candidates,
    draw_disagreement,
    draw_misfit_by_step,
    draw_shifts,
    draw_signal,
)
from bayes_inertia.report.section import Picture, Section, Table, captioned, packaged
from bayes_inertia.report.words import phrase, probabilities, rules_of, sentences

_said = partial(phrase, "diagnosis")


def diagnosis_sections(content: Mapping[str, Any]) -> list[Section]:
    """The evidence of a diagnosis, for the report of the fit that follows it.

    Returns: where the model disagrees, candidates, how probable each answer is, what naming
    changed, what may be true instead, what may hide still, the torque that nothing explains. What
    this diagnosis does not have is left out; its verdict stands with that of the fit.
    """
    sections = (
        _disagreement_section(content),
        _candidates_section(content),
        _answers_section(content),
        _changes_section(content),
        _alternatives_section(content),
        _could_hide_section(content),
        _unknown_section(content),
    )
    return [section for section in sections if section is not None]


def _disagreement_section(content: Mapping[str, Any]) -> Section:
    """Where the base model disagrees with the data, before and after effects were added."""
    windows, starts = content["disagreement"], content.get("slew_start", {})
    rows = [
        (
            _said("window", window, starts.get(window["slew"], 0.0)),
            "mean is off" if window["kind"] == "shift" else "too large",
            f"{window['score']:.1f}",
            p_value_text(window["p_value"]),
        )
        for window in windows[: LAYOUT.most_windows_listed]
    ]
    columns = {"where": "", "residuals": "", "standard deviations": "n"}
    table = Table(columns | {"p, all places counted": "n"}, rows)
    context = {"table": table, "shown": LAYOUT.evidence_rows_shown, "total": len(windows)}
    title, pictures = "Where does the base model disagree?", _disagreement_pictures(content)
    return Section(title, packaged("disagreement.html"), context, pictures)


def _disagreement_pictures(content: Mapping[str, Any]) -> tuple[Picture, ...]:
    before, after = content["pictures"]["before"], content["pictures"]["after"]
    starts = content.get("slew_start", {})
    figure = draw_disagreement(before, content["disagreement"], starts)
    pictures = captioned("base_disagreement", figure, len(before["slews"]))
    if after is None:
        return pictures
    left = content["disagreement_after"]
    figure = draw_disagreement(after, left, starts)
    words = _said("with_what", content), len(left)
    return (*pictures, *captioned("disagreement_left", figure, *words))


def _candidates_section(content: Mapping[str, Any]) -> Section:
    """All candidates, ranked."""
    figure = draw_candidates(content["candidates"], content["threshold"], content["named"])
    false_alarms = rules_of(content)["false_alarm_probability"]
    context = {
        "shown": LAYOUT.evidence_rows_shown,
        "rows": [_candidate_row(candidate, content) for candidate in content["candidates"]],
        "alike": sentences("diagnosis", "alike", content, LAYOUT.most_alike_listed),
    }
    pictures = captioned("candidates", figure, false_alarms, folded=True)
    return Section("Candidates", packaged("candidates.html"), context, pictures)


def _candidate_row(candidate: Mapping[str, Any], content: Mapping[str, Any]) -> dict[str, Any]:
    p_value = candidate["p_value"]
    bayes, parameters = candidate["log_bayes_factor"], candidate["parameters"] or {}
    named = candidate["effect"] in content["named"]
    return {
        "name": plain(candidate["effect"]),
        "p": NOT_GIVEN if p_value is None else p_value_text(p_value),
        "bayes": NOT_GIVEN if bayes is None else tenths(bayes),
        "word": "named" if named else _said("significance", candidate, content["threshold"]),
        "parameters": "; ".join(
            f"{plain(name)} = {value_text(value)}" for name, value in parameters.items()
        ),
    }


def _changes_section(content: Mapping[str, Any]) -> Section | None:
    """How the misfit shrinks and J and K move; None if nothing was added."""
    steps = content["steps"]
    if not steps:
        return None
    measured = [
        channel for channel, value in steps[0]["reduced_chi2_before"].items() if value is not None
    ]
    rows = [_step_row("base model", steps[0], "before", measured)]
    rows += [_step_row(f"+ {plain(step['added'])}", step, "after", measured) for step in steps]
    heads = (*(channel_name(channel) for channel in measured), "slews left out")
    tried = content["verdict"] == "unknown"
    pictures = (
        *captioned("misfit_by_step", draw_misfit_by_step(steps), folded=True),
        *captioned("shifts", draw_shifts(steps), _said("with_what", content), folded=tried),
    )
    table = Table({"model": ""} | dict.fromkeys(heads, "n"), rows)
    context = {"table": table, "unexplained": content["verdict"] in OPEN_VERDICTS}
    return Section("What adding effects changes", packaged("changes.html"), context, pictures)


def _step_row(
    label: str, step: Mapping[str, Any], side: str, channels: list[str]
) -> tuple[str, ...]:
    held_out = step[f"held_out_{side}"]
    reduced = (_chi2_text(step[f"reduced_chi2_{side}"][channel]) for channel in channels)
    return (label, *reduced, NOT_GIVEN if held_out is None else _chi2_text(held_out))


def _chi2_text(reduced: float) -> str:
    return f"{reduced:.3f}" if reduced < 100.0 else f"{reduced:,.0f}"


def _answers_section(content: Mapping[str, Any]) -> Section | None:
    """How probable each answer is; None in a diagnosis of an earlier version."""
    rows = [
        (
            _said("answer", row),
            _said("per_cent", row["probability"]),
            _said("per_cent", math.exp(row["log_prior"])),
            tenths(row["log_evidence"]),
            "" if row.get("pareto_k") is None else tenths(row["pareto_k"]),
        )
        for row in content.get("hypotheses", [])[: LAYOUT.most_answers_listed]
    ]
    if not rows:
        return None
    columns = {"what is missing from the base model": "", "probability": "n"}
    columns |= dict.fromkeys(("before the data", "log evidence", "Pareto k"), "n extra")
    context = {"table": Table(columns, rows, "narrow short"), "shown": LAYOUT.evidence_rows_shown}
    return Section("How probable each answer is", packaged("answers.html"), context)


def _alternatives_section(content: Mapping[str, Any]) -> Section | None:
    """J and K with each effect of the ambiguous sets; None if there is no set.

    None where a part has no name, too: the steps are not those of the fit below.
    """
    alternatives = content.get("alternatives")
    if not alternatives or not content["steps"] or content["verdict"] in OPEN_VERDICTS:
        return None
    rows = []
    for i, (name, shift) in enumerate(content["steps"][-1]["shift"].items()):
        cases = [(shift["after"], shift["sd_after"])]
        cases += [(a["mean"][i], math.sqrt(a["covariance"][i][i])) for a in alternatives]
        power = exponent(*cases[0])
        cells = [f"{number(mean, sd, power)} ± {number(sd, sd, power)}" for mean, sd in cases]
        rows.append((name, unit_text(shift["unit"], power), *cells))
    heads = [f"{what} ({100.0 * p:.0f} %)" for what, p in probabilities(content)]
    columns = {"parameter": "", "unit": "unit"} | dict.fromkeys(heads, "n")
    context = {"table": Table(columns, rows, "")}
    return Section("J and K, whichever it is", packaged("alternatives.html"), context)


def _could_hide_section(content: Mapping[str, Any]) -> Section | None:
    """How far an effect too weak to be found could have moved J and K; None where unknown."""
    found = sorted(content.get("could_hide", []), key=lambda row: -row["shift"] / row["sd"])
    if not found:
        return None
    (shift_power, shifts), (sd_power, sds) = (
        sd_column([row[key] for row in found]) for key in ("shift", "sd")
    )
    rows = [
        (
            row["parameter"],
            unit_text(row["unit"]),
            shift,
            sd,
            tenths(row["shift"] / row["sd"]),
            plain(row["effect"]),
            "its prior ends there" if row["unseen"] else "a larger one is found",
        )
        for row, shift, sd in zip(found, shifts, sds, strict=True)
    ]
    heads = (sd_head("could be off by", shift_power), sd_head("model's sd", sd_power), "in sds")
    columns = {"parameter": "", "unit": "unit"} | dict.fromkeys(heads, "n")
    columns |= {"if there is": "", "not more, because": ""}
    context = {"table": Table(columns, rows), "shown": LAYOUT.evidence_rows_shown}
    return Section("What could still hide", packaged("could_hide.html"), context)


def _unknown_section(content: Mapping[str, Any]) -> Section | None:
    """The torque that nothing explains; None if everything is explained."""
    unknown = content["unknown"]
    if unknown is None:
        return None
    torque, other = (content["pictures"][key] for key in ("torque", "other"))
    pictures = captioned("torque", draw_signal(torque))
    if other is not None:
        pictures += captioned("other_signal", draw_signal(other), other["source"])
    context = {"rows": _unknown_rows(unknown)}
    return Section("What nothing explains", packaged("settings.html"), context, pictures)


def _unknown_rows(unknown: Mapping[str, Any]) -> list[tuple[str, str]]:
    frequency = unknown["frequency_hz"]
    matches = "; ".join(
        f"{match['with']} ({100.0 * match['share']:.0f} %)"
        for match in unknown["matches"][: LAYOUT.most_matches_listed]
    )
    share = 100.0 * unknown["axis_share"]
    return [
        ("in words", unknown["description"]),
        ("axis (body)", f"({vector_text(unknown['axis'])}), {share:.0f} % of its power"),
        ("size", f"{unknown['torque_rms']:.2g} N m rms"),
        ("line in the spectrum", "none" if frequency is None else f"{frequency:.2g} Hz"),
        (
            "share of the misfit that a torque explains",
            f"{100.0 * unknown['explained']:.0f} %",
        ),
        ("goes with", matches or "nothing known"),
    ]
