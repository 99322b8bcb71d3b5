"""`compare`: plans side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bayes_inertia.app.commands.options import (
    PAPER_HELP,
    AsJson,
    CampaignFolder,
    EngineName,
    Jobs,
    OpenPage,
    OutputFolder,
    SchedulerAddress,
    Seed,
)
from bayes_inertia.app.terminal import (
    headed,
    open_in_browser,
    plain_console,
    print_json_file,
    print_table,
    progress_bar,
    say,
)

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
    open_page: OpenPage = False,
    as_json: AsJson = False,
) -> None:
    """Compare plans by uncertainty, time, momentum and torque.

    Writes compare.json, compare.png and compare.html. A comparison that was killed goes on with the
    same command.
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
    open_in_browser(out / "compare.html", open_page)


def show_comparison(contenders: Sequence[Contender], folder: Path) -> None:
    """Print plans side by side: expected and achieved sds, and what they cost."""
    from bayes_inertia.report.plan_sections import comparison_answer, costs_table, sds_table

    console = plain_console()
    answer, worse = comparison_answer(contenders)
    console.print(headed(answer, f" {worse}"))
    for table in (sds_table(contenders), costs_table(contenders)):
        print_table(table.columns, table.rows, list(table.columns)[2:])
    console.print(f"wrote compare.json, compare.png and compare.html in {folder}")
