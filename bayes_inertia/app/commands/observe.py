"""`observe`: how well is each parameter determined, and why not better?"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from bayes_inertia.app.commands.options import (
    AsJson,
    CampaignFolder,
    DriveName,
    EffectNames,
    OpenPage,
    OutputFolder,
    Seed,
    names_in,
)
from bayes_inertia.app.layout import LAYOUT
from bayes_inertia.app.terminal import (
    headed,
    indented,
    plain_console,
    print_table,
    progress_bar,
    show_result,
)

if TYPE_CHECKING:
    from bayes_inertia.app.observe_folder import ObservedCampaign
    from bayes_inertia.observability.result import Observability

_COLUMNS = ("name", "prior sd", "sd", "unit", "signal [σ]", "lost", "most from", "determined")
_DETERMINED = {
    "determined": "yes",
    "partly determined": "partly",
    "mostly the prior": "no: mostly prior",
    "the prior": "no: prior",
}


def observe_command(
    campaign: CampaignFolder,
    out: OutputFolder,
    effects: EffectNames = "",
    drive: DriveName = None,
    seed: Seed = 0,
    both_drives: Annotated[
        bool,
        typer.Option(
            help="Also estimate in the other drive: what are the recorded commands worth?"
        ),
    ] = True,
    open_page: OpenPage = False,
    as_json: AsJson = False,
) -> None:
    """Say how well each parameter is determined, and why not better.

    Writes observability.json, observability.png and observability.html.
    """
    with progress_bar() as progress:
        from bayes_inertia.app.observe_folder import FILE, run_observe

        observed = run_observe(
            campaign,
            out,
            effects=names_in(effects),
            drive=drive,
            seed=seed,
            both_drives=both_drives,
            progress=progress,
        )
    show_result(out / FILE, as_json, open_page, show_observability, observed, out)


def show_observability(observed: ObservedCampaign, folder: Path) -> None:
    """Print what a campaign tells about each parameter, what it cannot tell, and where emcee
    differs.
    """
    from bayes_inertia.observability.sentences import answer, sentence
    from bayes_inertia.report.formatting import plain, typeset

    console, observability = plain_console(), observed.observability
    console.print(headed(answer(observability, plain)))
    print_table(_COLUMNS, _parameter_rows(observability), _COLUMNS[-1:])
    console.print(
        "signal: response of all telemetry to one prior sd; lost: sd over its value if all else "
        "were known; most from: the slew that tells most, and its share"
    )
    weak = [p for p in observability.parameters if p.verdict != "determined"]
    for p in sorted(weak, key=lambda p: p.contraction)[: LAYOUT.weak_parameters_shown]:
        console.print(indented(typeset(sentence(observability, p.name))))
    if (more := len(weak) - LAYOUT.weak_parameters_shown) > 0:
        console.print(f"... and {more} weak ones more, in observability.json")
    if worth := _commands_worth(observability):
        console.print(worth)
    _show_directions(observability)
    for degeneracy in observability.degeneracies:
        console.print(headed(f"{degeneracy.name}:", f" {typeset(degeneracy.says)}"))
    for row in observed.comparison or ():
        for warning in row.warnings:
            console.print(headed(f"{row.name}:", f" {typeset(warning)}", style="bold yellow"))
    console.print(f"wrote observability.json, observability.png and observability.html in {folder}")


def _parameter_rows(observability: Observability) -> Iterator[tuple[str, ...]]:
    from bayes_inertia.observability.sentences import verdict_of
    from bayes_inertia.report.formatting import number, plain, tenths, unit_powers, unit_text

    powers = unit_powers((p.unit, p.sd) for p in observability.parameters)
    for p in observability.parameters:
        power, by_slew = powers[p.unit], p.share.sum(1)
        best = int(np.argmax(by_slew))
        yield (
            plain(p.name),
            *(number(sd, sd, power) for sd in (p.prior_sd, p.sd)),
            unit_text(p.unit, power),
            tenths(p.signal),
            f"× {np.sqrt(p.variance_inflation):.1f}",
            f"{observability.slews[best]}, {100.0 * by_slew[best]:.0f} %",
            _DETERMINED.get(verdict := verdict_of(observability, p), verdict),
        )


def _commands_worth(observability: Observability) -> str:
    """Worth of the recorded torque commands; empty where only one drive was asked or possible."""
    from bayes_inertia.observability.result import commands_worth

    worth = {p.name: commands_worth(p, observability.drive) for p in observability.parameters}
    known = {name: ratio for name, ratio in worth.items() if ratio is not None}
    if not known:
        return ""
    large = ", ".join(
        f"{name} × {r:.2g}" for name, r in known.items() if r > LAYOUT.worth_of_commands
    )
    return "sd without the recorded commands: " + (
        large or f"less than × {LAYOUT.worth_of_commands} for each"
    )


def _show_directions(observability: Observability) -> None:
    from bayes_inertia.report.formatting import typeset

    console = plain_console()
    for direction in [d for d in observability.directions if d.verdict_is_prior][
        : LAYOUT.weak_parameters_shown
    ]:
        shrinks = 100 * (1 - (1 - direction.contraction) ** 0.5)
        kind = "exactly degenerate" if direction.exact else f"prior sd shrinks by {shrinks:.4g} %"
        console.print(headed("least known together:", f" {typeset(direction.says)} ({kind})"))
