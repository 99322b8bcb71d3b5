"""`observe`: how well is each parameter determined, and why not better?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from rich.table import Table

from bayes_inertia.app.commands.options import (
    AsJson,
    CampaignFolder,
    DriveName,
    EffectNames,
    OutputFolder,
    Seed,
    names_in,
)
from bayes_inertia.app.terminal import (
    headed,
    narrow_table,
    plain_console,
    print_json_file,
    progress_bar,
)

if TYPE_CHECKING:
    from rich.console import Console

    from bayes_inertia.app.observe_folder import ObservedCampaign
    from bayes_inertia.observability.result import Observability

_COLUMNS = ("name", "prior sd", "sd", "unit", "signal", "lost", "commands", "determined")
_DETERMINED = {"determined": "yes", "weakly": "no: mostly prior", "prior": "no: prior"}


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
    as_json: AsJson = False,
) -> None:
    """Say how well each parameter is determined, and why not better.

    Writes observability.json and observability.png.
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
    if as_json:
        print_json_file(out / FILE)
    else:
        show_observability(observed, out)


def show_observability(observed: ObservedCampaign, folder: Path) -> None:
    """Print what a campaign tells about each parameter, what it cannot tell, and where emcee
    differs.

    Parameters
    ----------
    observed : ObservedCampaign
        What `observe` found.
    folder : Path
        Where its files are.
    """
    from bayes_inertia.observability.sentences import sentence

    console, observability = plain_console(), observed.observability
    console.print(_parameter_table(console, observability))
    console.print(
        "signal: response of all telemetry to one prior sd, in sigmas; "
        "lost: sd over its value if all else were known;"
    )
    console.print("commands: sd with the torque commands ignored over sd with them")
    for name in observability.names:
        console.print(f"  {sentence(observability, name)}")
    _show_directions(observability)
    for degeneracy in observability.degeneracies:
        console.print(headed(f"{degeneracy.name}:", f" {degeneracy.says}"))
    for row in observed.comparison or ():
        for warning in row.warnings:
            console.print(headed(f"{row.name}:", f" {warning}", style="bold yellow"))
    console.print(f"wrote observability.json and observability.png in {folder}")


def _parameter_table(console: Console, observability: Observability) -> Table:
    from bayes_inertia.observability.result import commands_worth

    table = narrow_table(console, *_COLUMNS, wrapping=_COLUMNS[-1:])
    for p in observability.parameters:
        worth = commands_worth(p, observability.drive)
        table.add_row(
            p.name,
            f"{p.prior_sd:.2g}",
            f"{p.sd:.2g}",
            p.unit,
            f"{p.signal:,.3g}",
            f"x{np.sqrt(p.variance_inflation):.2g}",
            "-" if worth is None else f"x{worth:.2g}",
            _DETERMINED.get(p.verdict, p.verdict),
        )
    return table


def _show_directions(observability: Observability) -> None:
    console, directions = plain_console(), observability.directions
    for direction in [d for d in directions if d.verdict_is_prior] or directions[:1]:
        shrinks = 100 * (1 - (1 - direction.contraction) ** 0.5)
        kind = "exactly degenerate" if direction.exact else f"prior sd shrinks by {shrinks:.4g} %"
        console.print(headed("least known together:", f" {direction.says} ({kind})"))
