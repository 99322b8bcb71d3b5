"""The page of `observe`: which parameters are determined, which slew tells it, why not better."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from bayes_inertia.observability.against_posterior import PosteriorComparison
from bayes_inertia.observability.result import (
    Observability,
    commands_worth,
)
from bayes_inertia.observability.sentences import answer, sentence, verdict_of
from bayes_inertia.report.formatting import (
    listed,
    plain,
    typeset,
)
from bayes_inertia.report.pictures.observability import draw_observability
from bayes_inertia.report.section import Section, captioned, packaged


def observability_sections(
    observability: Observability, comparison: Sequence[PosteriorComparison] | None = None
) -> list[Section]:
    """Information of a campaign on each parameter, the answer first."""
    warnings = [
        f"{row.name}: {typeset(warning)}" for row in comparison or () for warning in row.warnings
    ]
    told: dict[bool, list[str]] = {False: [], True: []}
    for p in observability.parameters:
        told[p.verdict == "determined"].append(typeset(sentence(observability, p.name)))
    sentences = {
        "Not fully determined": told[False],
        "What the campaign cannot tell apart": _undetermined(observability),
        "Where the posterior differs": warnings,
        "The parameters that are determined": told[True],
    }
    reasons = {title: ("", lines) for title, lines in sentences.items() if lines}
    context = {"reasons": reasons, "folded": ("The parameters that are determined",)}
    told_by = {
        "answer": partial(answer, shown=plain),
        "verdict_of": verdict_of,
        "commands_worth": commands_worth,
    }
    pictures = captioned("observability", draw_observability(observability))
    result = {"o": observability} | told_by
    return [
        Section("Result", packaged("observability.html"), result, pictures),
        Section("Why not better", packaged("reasons.html"), context),
        Section("Settings", packaged("settings.html"), {"rows": _settings(observability)}),
    ]


def _undetermined(observability: Observability) -> list[str]:
    """Directions that stay at their prior, and parameters that trade against each other."""
    directions = [
        f"Least known together: {typeset(direction.says)} "
        f"({'exactly degenerate' if direction.exact else 'hardly narrower than the prior'})."
        for direction in observability.directions
        if direction.verdict_is_prior
    ]
    return directions + [f"{d.name}: {typeset(d.says)}" for d in observability.degeneracies]


def _settings(observability: Observability) -> list[tuple[str, str]]:
    effects = listed([plain(name) for name in observability.effects])
    return [
        ("campaign", observability.campaign),
        ("slews", listed(observability.slews)),
        ("drive", observability.drive),
        ("effects fitted along", effects or "none"),
    ]
