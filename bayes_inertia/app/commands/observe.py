"""`observe`: how well is each parameter determined, and why not better?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bayes_inertia.app.layout import LAYOUT
from bayes_inertia.app.options import DriveName, names_in
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
