"""The sections of a report on a diagnosis: templates that read diagnosis.json, and its pictures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_inertia.inference.settings import OPEN_VERDICTS
from bayes_inertia.report.pictures.diagnosis import (
    draw_candidates,
    draw_disagreement,
    draw_misfit_by_step,
    draw_shifts,
    draw_signal,
)
from bayes_inertia.report.section import Picture, Section, captioned, packaged
from bayes_inertia.report.words import phrase, rules_of


def diagnosis_sections(content: Mapping[str, Any]) -> list[Section]:
    """The evidence of a diagnosis, for the report of the fit that follows it.

    Returns: where the model disagrees, candidates, how probable each answer is, what naming
    changed, what may be true instead, what may hide still, the torque that nothing explains. What
    this diagnosis does not have is left out; its verdict stands with that of the fit.
    """
    steps = content["steps"]
    # Where a part has no name the steps are not those of the fit below.
    averaged = content.get("alternatives") and content["verdict"] not in OPEN_VERDICTS
    sections = (
        ("Where does the base model disagree?", "disagreement", _disagreement(content), True),
        ("Candidates", "candidates", _candidates(content), True),
        ("How probable each answer is", "answers", (), content.get("hypotheses")),
        ("What adding effects changes", "changes", _changes(content), steps),
        ("J and K, whichever it is", "alternatives", (), steps and averaged),
        ("What could still hide", "could_hide", (), content.get("could_hide")),
        ("What nothing explains", "unknown", _unknown(content), content["unknown"]),
    )
    return [
        Section(title, packaged(f"{template}.html"), {"d": content}, pictures)
        for title, template, pictures, told in sections
        if told
    ]


def _disagreement(content: Mapping[str, Any]) -> tuple[Picture, ...]:
    """Where the base model disagrees with the data, before and after effects were added."""
    before, after = content["pictures"]["before"], content["pictures"]["after"]
    starts, left = content.get("slew_start", {}), content["disagreement_after"]
    figure = draw_disagreement(before, content["disagreement"], starts)
    pictures = captioned("base_disagreement", figure, len(before["slews"]))
    if after is None:
        return pictures
    figure, what = draw_disagreement(after, left, starts), phrase("diagnosis", "with_what", content)
    return (*pictures, *captioned("disagreement_left", figure, what, len(left)))


def _candidates(content: Mapping[str, Any]) -> tuple[Picture, ...]:
    figure = draw_candidates(content["candidates"], content["threshold"], content["named"])
    false_alarms = rules_of(content)["false_alarm_probability"]
    return captioned("candidates", figure, false_alarms, folded=True)


def _changes(content: Mapping[str, Any]) -> tuple[Picture, ...]:
    """How the misfit shrinks and J and K move."""
    steps, tried = content["steps"], content["verdict"] == "unknown"
    if not steps:
        return ()
    what = phrase("diagnosis", "with_what", content)
    return (
        *captioned("misfit_by_step", draw_misfit_by_step(steps), folded=True),
        *captioned("shifts", draw_shifts(steps), what, folded=tried),
    )


def _unknown(content: Mapping[str, Any]) -> tuple[Picture, ...]:
    """The torque that nothing explains, and another signal that explains more."""
    if content["unknown"] is None:
        return ()
    torque, other = (content["pictures"][key] for key in ("torque", "other"))
    pictures = captioned("torque", draw_signal(torque))
    if other is not None:
        pictures += captioned("other_signal", draw_signal(other), other["source"])
    return pictures
