"""The sections of a report on a diagnosis, made from the content of diagnosis.json."""

# Printed text has typographic signs on purpose.
from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from bayes_inertia.report import diagnosis_wording as wording
from bayes_inertia.report.pictures import diagnosis as plots
from bayes_inertia.report.pictures.style import tenths
from bayes_inertia.report.section import Picture, Section, packaged
from bayes_inertia.report.wording import exponent, number, unit_text

_MOST_WINDOWS = 12


def diagnosis_sections(content: Mapping[str, Any]) -> list[Section]:
    """Verdict, where the model disagrees, candidates, what naming changed, what may be true instead or hide still, the torque that nothing explains."""
    built = (
        missing(content),
        disagreement(content),
        candidates(content),
        changes(content),
        whichever(content),
        hidden(content),
        unknown(content),
    )
    return [section for section in built if section is not None]


def missing(content: Mapping[str, Any]) -> Section:
    """What is missing?"""
    return Section(
        "What is missing?", packaged("verdict.html"), {"verdict": wording.verdict(content)}
    )


def disagreement(content: Mapping[str, Any]) -> Section:
    """Where the base model disagrees with the data, before and after effects were added."""
    before, after = content["pictures"]["before"], content["pictures"]["after"]
    windows, starts = content["disagreement"], content.get("slew_start", {})
    cut = len(before["slews"]) > 9
    which = " The nine slews that disagree most are drawn." if cut else ""
    explained = (
        "Mean of measured minus predicted in short stretches of time, in standard deviations of such a mean: white is what noise gives, strong colours of one "
        "sense over many stretches are not. Frames: the two clearest stretches of a channel that noise does not explain, all places looked at counted."
    )
    figure = plots.disagreement_map(before, windows, starts)
    pictures = [
        Picture(
            figure,
            f"The base model. {explained}{which}",
            "Map of residuals of the base model",
            dense=True,
        )
    ]
    if after is not None:
        left = content["disagreement_after"]
        said = (
            "Nothing is framed: no stretch stands out."
            if not left
            else f"{len(left)} stretches are still not explained."
        )
        with_what = wording.added(content)
        figure = plots.disagreement_map(after, left, starts)
        pictures.append(
            Picture(
                figure, f"The same {with_what}. {said}", f"Map of residuals {with_what}", dense=True
            )
        )
    rows = [
        {
            "where": wording.window_text(w, starts.get(w["slew"], 0.0)),
            "kind": "mean is off" if w["kind"] == "shift" else "too large",
            "score": f"{w['score']:.1f}",
            "p": wording.probability(w["p_value"]).removeprefix("p ").removeprefix("= "),
        }
        for w in windows[:_MOST_WINDOWS]
    ]
    context = {"rows": rows, "total": len(windows)}
    return Section(
        "Where does the base model disagree?",
        packaged("disagreement.html"),
        context,
        tuple(pictures),
    )


def candidates(content: Mapping[str, Any]) -> Section:
    """All candidates, ranked."""
    rows = [
        {
            "name": wording.plain(c["effect"]),
            "dof": c["dof"] or "–",
            "score": "–" if c["score"] is None else tenths(c["score"]),
            "p": "–"
            if c["p_value"] is None
            else wording.probability(c["p_value"]).removeprefix("p ").removeprefix("= "),
            "bayes": "–" if c["log_bayes_factor"] is None else tenths(c["log_bayes_factor"]),
            "word": "named"
            if c["effect"] in content["named"]
            else wording.significance(c, content["threshold"]),
            "parameters": "; ".join(
                f"{wording.plain(n)} = {wording.value_text(v)}"
                for n, v in (c["parameters"] or {}).items()
            ),
        }
        for c in content["candidates"]
    ]
    figure = plots.ranking(content["candidates"], content["threshold"], content["named"])
    caption = (
        "How strongly the residuals of the base model speak for each candidate if it were the only thing missing. Several are significant as soon as one is "
        "present, because they imitate each other in part: what is named is decided by refitting, one effect after the other. The dashed line is passed by "
        "the best of all candidates once in fifty campaigns in which nothing is missing."
    )
    pictures = (
        () if figure is None else (Picture(figure, caption, "Candidates by strength of evidence"),)
    )
    context = {"rows": rows, "alike": wording.alike_text(content)}
    return Section("Candidates", packaged("candidates.html"), context, pictures)


def changes(content: Mapping[str, Any]) -> Section | None:
    """How the gap shrinks and J and K move; None if nothing was added."""
    steps = content["steps"]
    if not steps:
        return None
    channels = [
        c
        for c in ("rate", "attitude", "momentum", "total")
        if steps[0]["reduced_chi2_before"][c] is not None
    ]
    rows = [_change("base model", steps[0], "before", channels)] + [
        _change(f"+ {wording.plain(s['added'])}", s, "after", channels) for s in steps
    ]
    pictures = [
        Picture(
            plots.gap(steps),
            "Reduced χ² (1 if model and noise are right), of the data in the fit and of each slew predicted from the others.",
            "Reduced chi squared, step by step",
        ),
        Picture(
            plots.shifts(steps),
            f"J and K with the base model (squares) and {wording.added(content)} (dots): an effect left out biases them; the base model's sd does not show it.",
            "J and K before and after the effects were added",
        ),
    ]
    note = "unexplained" if content["verdict"] == "unknown" else ""
    context = {"rows": rows, "channels": [wording.CHANNEL_NAMES[c] for c in channels], "note": note}
    return Section(
        "What adding effects changes", packaged("changes.html"), context, tuple(pictures)
    )


def _change(label: str, step: Mapping[str, Any], side: str, channels: list[str]) -> dict[str, Any]:
    values = [step[f"reduced_chi2_{side}"][c] for c in channels]
    held = step[f"held_out_{side}"]
    return {
        "label": label,
        "cells": [f"{v:.4g}" for v in values],
        "held": "–" if held is None else f"{held:.4g}",
    }


def whichever(content: Mapping[str, Any]) -> Section | None:
    """J and K with each effect of the ambiguous sets; None if there is no set."""
    others = content.get("alternatives")
    if not others:
        return None
    rows = []
    for i, (name, moved) in enumerate(content["steps"][-1]["shift"].items()):
        cases = [
            (moved["after"], moved["sd_after"]),
            *((a["mean"][i], math.sqrt(a["covariance"][i][i])) for a in others),
        ]
        power = exponent(cases[0][0], cases[0][1])
        cells = [f"{number(mean, sd, power)} ± {number(sd, sd, power)}" for mean, sd in cases]
        rows.append({"name": name, "unit": unit_text(moved["unit"], power), "cells": cells})
    heads = [f"{what} ({100.0 * p:.0f} %)" for what, p in wording.probabilities(content)]
    return Section(
        "J and K, whichever it is", packaged("whichever.html"), {"rows": rows, "heads": heads}
    )


def hidden(content: Mapping[str, Any]) -> Section | None:
    """How far an effect too weak to be found could have moved J and K; None where that is not known."""
    rows = []
    for row in content.get("could_hide", []):
        power = exponent(row["shift"], row["sd"])
        rows.append(
            {
                "name": row["parameter"],
                "unit": unit_text(row["unit"], power),
                "sd": number(row["sd"], row["sd"], power),
                "shift": number(row["shift"], row["sd"], power),
                "sds": tenths(row["shift"] / row["sd"]),
                "effect": wording.plain(row["effect"]),
                "limit": "its prior" if row["unseen"] else "the data",
            }
        )
    return (
        Section("What could still hide", packaged("hidden.html"), {"rows": rows}) if rows else None
    )


def unknown(content: Mapping[str, Any]) -> Section | None:
    """The torque that nothing explains."""
    found = content["unknown"]
    if found is None:
        return None
    axis = ", ".join(f"{x:.2f}".replace("-", "−") for x in found["axis"])
    rows = [
        ("in words", found["description"]),
        ("axis (body)", f"({axis}), {100.0 * found['axis_share']:.0f} % of its power"),
        ("size", f"{found['torque_rms']:.2g} N m rms"),
        (
            "line in the spectrum",
            "none" if found["frequency_hz"] is None else f"{found['frequency_hz']:.2g} Hz",
        ),
        ("share of the misfit that a torque explains", f"{100.0 * found['explained']:.0f} %"),
        (
            "goes with",
            "; ".join(f"{m['with']} ({100.0 * m['share']:.0f} %)" for m in found["matches"][:3])
            or "nothing known",
        ),
    ]
    caption = (
        "The torque on the body (body axes) that would leave the residuals of the base model, with its band of two sd: what J, K, start states and bias can "
        "explain is not in it. Fast wiggles inside the band mean nothing."
    )
    pictures = [
        Picture(
            plots.torque(content["pictures"]["torque"]),
            caption,
            "Equivalent torque over time, slew by slew",
            dense=True,
        )
    ]
    other = content["pictures"]["other"]
    if other is not None:
        said = f"What explains the residuals better than any torque on the body: {other['source']}, as an error over time with its band of two sd."
        pictures.append(
            Picture(
                plots.torque(other), said, f"Error of the {other['source']} over time", dense=True
            )
        )
    return Section(
        "What nothing explains", packaged("settings.html"), {"rows": rows}, tuple(pictures)
    )
