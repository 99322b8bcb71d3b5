"""`compare`: plans side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.box import SIMPLE
from rich.table import Table

from bayes_inertia.app.commands.options import (
    PAPER_HELP,
    AsJson,
    CampaignFolder,
    EngineName,
    Jobs,
    OutputFolder,
    SchedulerAddress,
    Seed,
)
from bayes_inertia.app.terminal import plain_console, print_json_file, progress_bar, say

if TYPE_CHECKING:
    from bayes_inertia.design.comparison import Contender


def compare_command(
    campaign: CampaignFolder,
    plans: Annotated[list[str], typer.Argument(help=f"Plan files, {PAPER_HELP}.")],
    out: OutputFolder,
    simulated: Annotated[
        int, typer.Option(help="Campaigns to simulate and fit for each plan.", min=0)
    ] = 0,
    engine: EngineName = None,
    scheduler: SchedulerAddress = None,
    jobs: Jobs = 1,
    seed: Seed = 0,
    as_json: AsJson = False,
) -> None:
    """Compare plans by uncertainty, time, momentum and torque.

    Writes compare.json and compare.png. A comparison that was killed goes on with the same command.
    """
    with progress_bar() as progress:
        from bayes_inertia.app.compare_folder import run_compare
        from bayes_inertia.studies.engine import Execution

        contenders = run_compare(
            campaign,
            plans,
            out,
            simulated=simulated,
            seed=seed,
            execution=Execution(engine, jobs, scheduler, progress, say),
        )
    if as_json:
        print_json_file(out / "compare.json")
    else:
        show_comparison(contenders, out)


def show_comparison(contenders: Sequence[Contender], folder: Path) -> None:
    """Print plans side by side: expected and achieved sds, and what they cost.

    Parameters
    ----------
    contenders : sequence of Contender
        The plans.
    folder : Path
        Where the files of the comparison are.
    """
    from bayes_inertia.physics.parameters import BASE_NAMES

    console = plain_console()
    table = Table(box=SIMPLE)
    table.add_column("", no_wrap=True)
    for contender in contenders:
        table.add_column(contender.name, justify="right")
    for i, name in enumerate(BASE_NAMES):
        table.add_row(f"sd {name}", *(_sd_cell(c, i) for c in contenders))
    for heading, cells in _cost_rows(contenders).items():
        table.add_row(heading, *cells)
    console.print(table)
    console.print(f"wrote compare.json and compare.png in {folder}")


def _sd_cell(contender: Contender, i: int) -> str:
    expected, achieved = f"{contender.expected[i]:.3g}", contender.achieved
    if achieved is None:
        return expected
    return f"{expected} (achieved {achieved.sd[i]:.3g} ± {achieved.sd_error[i]:.1g})"


def _cost_rows(contenders: Sequence[Contender]) -> dict[str, list[str]]:
    return {
        "worst cross term [kg m²]": [f"{c.worst_cross_term:.3g}" for c in contenders],
        "total time [s]": [f"{c.total_time:.0f}" for c in contenders],
        "in motion [s]": [f"{c.motion_time:.0f}" for c in contenders],
        "peak momentum [N m s]": [f"{c.peak_momentum:.3g}" for c in contenders],
        "peak torque [N m]": [f"{c.peak_torque:.3g}" for c in contenders],
        "limits broken": [
            ", ".join(m.limit for m in c.margins if not m.kept) or "none" for c in contenders
        ],
    }
