"""`compare`: plans side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
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
    narrow_table,
    open_in_browser,
    plain_console,
    print_json_file,
    progress_bar,
    quantity,
    say,
    unit_powers,
)
from bayes_inertia.report.layout import LAYOUT as REPORT_LAYOUT

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
    from bayes_inertia.physics.parameters import BASE_NAMES, BASE_UNITS
    from bayes_inertia.report.formatting import unit_text

    console = plain_console()
    console.print(headed(_answer(contenders)))
    powers = unit_powers(
        pair for c in contenders for pair in zip(BASE_UNITS, c.expected, strict=True)
    )
    names = [contender.name for contender in contenders]
    table = narrow_table(console, "", "unit", *names, wrapping=names)
    for i, (name, unit) in enumerate(zip(BASE_NAMES, BASE_UNITS, strict=True)):
        cells = [_sd_cell(c, i, powers[unit]) for c in contenders]
        table.add_row(f"sd {name}", unit_text(unit, powers[unit]), *cells)
    for (heading, unit), cells in _cost_rows(contenders).items():
        table.add_row(heading, unit, *cells)
    console.print(table)
    console.print(f"wrote compare.json, compare.png and compare.html in {folder}")


def _answer(contenders: Sequence[Contender]) -> str:
    """Which plan knows the products of inertia best, and what it knows worse than another."""
    from bayes_inertia.physics.parameters import BASE_NAMES, BASE_UNITS

    best, *others = sorted(contenders, key=lambda c: c.worst_cross_term)
    sizes = [quantity(c.worst_cross_term, BASE_UNITS[0]) for c in (best, *others)]
    said = f"{best.name}: products of inertia to {sizes[0]} (1 sd, the worst)"
    if not others:
        return said
    told = ", ".join(f"{size} with {c.name}" for c, size in zip(others, sizes[1:], strict=True))
    least = np.min([c.expected for c in others], axis=0)
    ratios = zip(BASE_NAMES, best.expected / least, strict=True)
    worse = ", ".join(
        f"{name} × {ratio:.1f}" for name, ratio in ratios if ratio > REPORT_LAYOUT.worse_sd_ratio
    )
    return f"{said}, {told}; {f'worse than another: {worse}' if worse else 'nothing gets worse'}"


def _sd_cell(contender: Contender, i: int, power: int) -> str:
    from bayes_inertia.report.formatting import number

    sd, achieved = contender.expected[i], contender.achieved
    if achieved is None:
        return number(sd, sd, power)
    flown, error = achieved.sd[i], achieved.sd_error[i]
    errors = f"{number(flown, error, power)} ± {number(error, error, power)}"
    return f"{number(sd, sd, power)} (achieved {errors})"


def _cost_rows(contenders: Sequence[Contender]) -> dict[tuple[str, str], list[str]]:
    return {
        ("total time", "s"): [f"{c.total_time:.0f}" for c in contenders],
        ("in motion", "s"): [f"{c.motion_time:.0f}" for c in contenders],
        ("peak momentum", "N m s"): [f"{c.peak_momentum:.3g}" for c in contenders],
        ("peak torque", "N m"): [f"{c.peak_torque:.3g}" for c in contenders],
        ("limits broken", "–"): [
            ", ".join(m.limit for m in c.margins if not m.kept) or "none" for c in contenders
        ],
    }
