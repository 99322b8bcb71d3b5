"""`design`: the slews to fly next. `compare`: plans side by side. `observe`: how well is each
parameter determined, and why not better?
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from rich.console import Console
from rich.text import Text

from bayes_inertia.app.layout import LAYOUT
from bayes_inertia.app.options import DesignRequest, DriveName, EngineOptions, names_in
from bayes_inertia.app.terminal import (
    headed,
    indented,
    plain_console,
    print_table,
    progress_bar,
    say,
    show_result,
)

if TYPE_CHECKING:
    from bayes_inertia.app.observe_folder import ObservedCampaign
    from bayes_inertia.app.plan_folder import DesignedPlan
    from bayes_inertia.design.comparison import Contender
    from bayes_inertia.design.result import Design


def design_command(
    campaign: Path,
    out: Path,
    asked: DesignRequest,
    open_page: bool = False,
    as_json: bool = False,
) -> None:
    """Design the slews to fly next.

    Writes design.json, design.png, design.html, and plan.toml, which `simulate` flies. Where
    nothing on board turns the spacecraft, it does what `observe` does, and exits with 2.
    """
    with progress_bar() as progress:
        from bayes_inertia.app.plan_folder import run_design
        from bayes_inertia.campaign.reader import read_campaign
        from bayes_inertia.flight.mission import why_no_plans

        nothing_to_fly = why_no_plans(read_campaign(campaign))
    if nothing_to_fly:
        say(f"{nothing_to_fly}; what its motion tells as it is, as `observe` says it:")
        effects, seed = asked.effects, asked.seed
        observe_command(campaign, out, effects, None, seed, True, open_page, as_json)
        raise typer.Exit(2)
    with progress_bar() as progress:
        designed = run_design(campaign, out, asked, progress)
    show_result(out / "design.json", as_json, open_page, show_design, designed, out, asked.after)
    raise typer.Exit(0 if designed.kept else 3)


def show_design(designed: DesignedPlan, folder: Path, after: bool = False) -> None:
    """Print a designed plan: what each parameter gains or loses, its slews, its margins."""
    from bayes_inertia.report.plan_sections import (
        gain_answer,
        gain_table,
        slews_table,
        worse_than_paper,
    )

    console, design = plain_console(), designed.design
    console.print(headed(gain_answer(design)))
    console.print(worse_than_paper(design))
    gained = gain_table(design)
    print_table(gained.columns, gained.rows)
    if not after:
        console.print("now: the prior; with --after this campaign's telemetry counts too")
    slews = slews_table({"": design.plan})
    print_table(slews.columns, slews.rows)
    _show_margins(console, design)
    for note in designed.notes:
        console.print(headed("note", f": {note}", style="bold yellow"))
    console.print(
        "wrote design.json, design.png, design.html and plan.toml (for `simulate --plan`) in "
        f"{folder}"
    )


def _show_margins(console: Console, design: Design) -> None:
    """The tightest margins, and all that are broken."""
    margins = sorted(design.flown, key=lambda m: m.left)
    shown = [m for i, m in enumerate(margins) if i < LAYOUT.margins_of_design or not m.kept]
    more = f" ({len(margins) - len(shown)} more are kept)" if len(shown) < len(margins) else ""
    console.print(headed(f"tightest margins when flown{more}:"))
    for margin in shown:
        console.print(Text.assemble("  ", ("" if margin.kept else "BROKEN ", "red"), margin.says))
    console.print(f"limits that hold the design back: {', '.join(design.active) or 'none'}")


def compare_command(
    campaign: Path,
    plans: list[str],
    out: Path,
    simulated: int = 0,
    *,
    engine: EngineOptions,
    seed: int = 0,
    open_page: bool = False,
    as_json: bool = False,
) -> None:
    """Compare plans by uncertainty, time, momentum and torque.

    Writes compare.json, compare.png and compare.html. A comparison that was killed goes on with the
    same command.
    """
    with progress_bar() as progress:
        from bayes_inertia.app.plan_folder import run_compare

        contenders = run_compare(
            campaign,
            plans,
            out,
            simulated=simulated,
            seed=seed,
            execution=engine.execution(progress),
        )
    show_result(out / "compare.json", as_json, open_page, show_comparison, contenders, out)


def show_comparison(contenders: Sequence[Contender], folder: Path) -> None:
    """Print plans side by side: expected and achieved sds, and what they cost."""
    from bayes_inertia.report.plan_sections import comparison_answer, costs_table, sds_table

    console = plain_console()
    answer, worse = comparison_answer(contenders)
    console.print(headed(answer, f" {worse}"))
    for table in (sds_table(contenders), costs_table(contenders)):
        print_table(table.columns, table.rows, list(table.columns)[2:])
    console.print(f"wrote compare.json, compare.png and compare.html in {folder}")


def observe_command(
    campaign: Path,
    out: Path,
    effects: str = "",
    drive: DriveName | None = None,
    seed: int = 0,
    both_drives: bool = True,
    open_page: bool = False,
    as_json: bool = False,
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
    from bayes_inertia.observability.sentences import answer
    from bayes_inertia.report.formatting import plain
    from bayes_inertia.report.observability_sections import (
        columns_say,
        differences,
        observability_table,
        parameter_sentences,
        undetermined,
    )

    console, observability = plain_console(), observed.observability
    console.print(headed(answer(observability, plain)))
    # In 80 columns; both sds are there.
    table = observability_table(observability).without("times sharper")
    print_table(table.columns, table.rows, list(table.columns)[-1:])
    console.print(columns_say(table))
    weak = parameter_sentences(observability, weak=True)
    for said in (*weak[: LAYOUT.weak_parameters_shown], *undetermined(observability)):
        console.print(indented(said))
    if (more := len(weak) - LAYOUT.weak_parameters_shown) > 0:
        console.print(f"... and {more} weak ones more, in observability.json")
    for warning in differences(observed.comparison):
        console.print(headed(warning, style="bold yellow"))
    console.print(f"wrote observability.json, observability.png and observability.html in {folder}")
