"""The page of `observe`: which parameters are determined, which slew tells it, why not better."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_inertia.observability.against_posterior import PosteriorComparison
from bayes_inertia.observability.result import (
    Observability,
    ParameterObservability,
    commands_worth,
)
from bayes_inertia.observability.sentences import answer, sentence, verdict_of
from bayes_inertia.report.formatting import (
    NOT_GIVEN,
    listed,
    plain,
    sd_column,
    sd_head,
    typeset,
    unit_text,
)
from bayes_inertia.report.pictures.observability import draw_observability
from bayes_inertia.report.section import Section, Table, captioned, packaged

_HEADS = (
    "parameter",
    "unit",
    "prior sd",
    "sd",
    "times sharper",
    "most from",
    "others cost",
    "commands worth",
    "this campaign",
)
_CLASSES = ("", "extra", "n extra", "n", "n extra", "", "n extra", "n extra", "")
_NOTE = (
    "Most from: the slew that tells most of the parameter, and its share. Others cost: sd over its "
    "value were everything else known. Commands worth: sd with the recorded torque commands "
    "ignored over sd with them."
)


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
    return [
        _result_section(observability),
        Section("Why not better", packaged("reasons.html"), context),
        Section("Settings", packaged("settings.html"), {"rows": _settings(observability)}),
    ]


def _result_section(observability: Observability) -> Section:
    (prior_power, priors), (power, sds) = (
        sd_column([getattr(p, key) for p in observability.parameters]) for key in ("prior_sd", "sd")
    )
    heads = list(_HEADS)
    heads[2:4] = sd_head("prior sd", prior_power), sd_head("sd", power)
    all_determined = all(p.verdict == "determined" for p in observability.parameters)
    parts = zip(observability.parameters, priors, sds, strict=True)
    rows = [_row(observability, *part) for part in parts]
    columns = dict(zip(heads, _CLASSES, strict=True))
    return Table(columns, rows, "many short").section(
        "Result",
        captioned("observability", draw_observability(observability)),
        sentence=answer(observability),
        level="good" if all_determined else "caution",
        notes=(_NOTE,),
    )


def _row(
    observability: Observability, p: ParameterObservability, prior: str, sd: str
) -> tuple[str, ...]:
    """The cells of one parameter, its sds as they are printed."""
    worth, by_slew = commands_worth(p, observability.drive), p.share.sum(1)
    best = int(np.argmax(by_slew))
    return (
        plain(p.name),
        unit_text(p.unit),
        prior,
        sd,
        f"{p.prior_sd / p.sd:,.3g}",
        f"{observability.slews[best]}, {100.0 * by_slew[best]:.0f} %",
        f"× {np.sqrt(p.variance_inflation):.1f}",
        NOT_GIVEN if worth is None else f"× {worth:.1f}",
        verdict_of(observability, p),
    )


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
