"""The page of `observe`: which parameters are determined, which slew tells it, why not better."""

from __future__ import annotations

from collections.abc import Sequence

from bayes_inertia.observability.against_posterior import PosteriorComparison
from bayes_inertia.observability.result import Observability, commands_worth
from bayes_inertia.observability.sentences import answer, sentence, verdict_of
from bayes_inertia.report.formatting import (
    NOT_GIVEN,
    brief,
    drive_text,
    listed,
    plain,
    sd_column,
    sd_head,
    tenths,
    typeset,
    unit_text,
)
from bayes_inertia.report.pictures.observability import draw_observability
from bayes_inertia.report.section import Section, Table, captioned, packaged

_COLUMNS_SAY = {
    "most from": "the slew that tells most of the parameter, and its share",
    "others cost": "sd over its value were everything else known",
    "commands worth": "sd with the recorded torque commands ignored over sd with them",
}
_WELL_KNOWN = "The parameters that are determined"


def observability_table(observability: Observability) -> Table:
    """What the campaign tells of each parameter, for page and terminal."""
    parameters = observability.parameters
    (before, priors), (power, sds) = (
        sd_column([getattr(p, key) for p in parameters]) for key in ("prior_sd", "sd")
    )
    rows = []
    for p, prior, sd in zip(parameters, priors, sds, strict=True):
        best, worth = p.tells_most, commands_worth(p, observability.drive)
        told = NOT_GIVEN
        if best is not None:
            told = f"{observability.slews[best]}, {100.0 * p.share[best].sum():.0f} %"
        rows.append(
            (
                plain(p.name),
                unit_text(p.unit),
                prior,
                sd,
                brief(p.prior_sd / p.sd, 3),
                told,
                f"× {tenths(p.variance_inflation**0.5)}",
                NOT_GIVEN if worth is None else f"× {tenths(worth)}",
                verdict_of(observability, p),
            )
        )
    columns = {
        "parameter": "",
        "unit": "extra",
        sd_head("prior sd", before): "n extra",
        sd_head("sd", power): "n",
        "times sharper": "n extra",
        "most from": "",
        "others cost": "n extra",
        "commands worth": "n extra",
        "how far determined": "",
    }
    table = Table(columns, rows, "many short")
    one_drive = all(row[-2] == NOT_GIVEN for row in rows)
    return table.without("commands worth") if one_drive else table


def columns_say(table: Table) -> str:
    """What the columns of `observability_table` mean."""
    told = ((head, said) for head, said in _COLUMNS_SAY.items() if head in table.columns)
    return " ".join(f"{head.capitalize()}: {said}." for head, said in told)


def observability_sections(
    observability: Observability, comparison: Sequence[PosteriorComparison] | None = None
) -> list[Section]:
    """Information of a campaign on each parameter, the answer first."""
    weak = parameter_sentences(observability, weak=True)
    sentences = {
        "Not fully determined": weak,
        "What the campaign cannot tell apart": undetermined(observability),
        "Where the posterior differs": differences(comparison),
        _WELL_KNOWN: parameter_sentences(observability, weak=False),
    }
    reasons = {title: ("", lines) for title, lines in sentences.items() if lines}
    table = observability_table(observability)
    result = table.section(
        "Result",
        captioned("observability", draw_observability(observability)),
        sentence=answer(observability, plain),
        level="caution" if weak else "good",
        notes=(columns_say(table),),
    )
    why = {"reasons": reasons, "folded": (_WELL_KNOWN,)}
    return [
        result,
        Section("Why not better", packaged("reasons.html"), why),
        Section("Settings", packaged("settings.html"), {"rows": _settings(observability)}),
    ]


def parameter_sentences(observability: Observability, *, weak: bool) -> list[str]:
    """Why parameters are as uncertain as they are: the weak, the least known first; or others."""
    told = [p for p in observability.parameters if (p.verdict != "determined") is weak]
    told = sorted(told, key=lambda p: p.contraction) if weak else told
    return [typeset(sentence(observability, p.name)) for p in told]


def undetermined(observability: Observability) -> list[str]:
    """Directions that stay at their prior, and parameters that trade against each other."""
    directions = [
        f"Least known together: {typeset(direction.says)} "
        f"({'exactly degenerate' if direction.exact else 'hardly narrower than the prior'})."
        for direction in observability.directions
        if direction.verdict_is_prior
    ]
    return directions + [f"{d.name}: {typeset(d.says)}" for d in observability.degeneracies]


def differences(comparison: Sequence[PosteriorComparison] | None) -> list[str]:
    """Where the posterior of the same fit says something else."""
    return [
        f"{row.name}: {typeset(warning)}" for row in comparison or () for warning in row.warnings
    ]


def _settings(observability: Observability) -> list[tuple[str, str]]:
    effects = listed([plain(name) for name in observability.effects])
    return [
        ("campaign", observability.campaign),
        ("slews", listed(observability.slews)),
        ("drive", drive_text(observability.drive, observability.wheels)),
        ("effects fitted along", effects or "none"),
    ]
