"""`history` and `fleet`: J and K over campaigns, and over sister spacecraft."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bayes_inertia.app.commands.options import AsJson, OpenPage, OutputFolder, Seed
from bayes_inertia.app.terminal import (
    headed,
    open_in_browser,
    plain_console,
    print_json_file,
    print_table,
    progress_bar,
)

if TYPE_CHECKING:
    from bayes_inertia.report.section import Table


def history_command(
    sources: Annotated[
        list[Path],
        typer.Argument(
            help="Runs, campaigns or a folder of `fit-many`, in the order flown. Campaigns are "
            "fitted first."
        ),
    ],
    out: OutputFolder,
    seed: Seed = 0,
    open_page: OpenPage = False,
    as_json: AsJson = False,
) -> None:
    """Say whether J and K changed from campaign to campaign: when, by how much, how probable.

    Writes history.json and history.html.
    """
    with progress_bar() as progress:
        from bayes_inertia.app.series_folder import HISTORY, run_history

        history, left_out = run_history(sources, out, seed=seed, progress=progress)
    if as_json:
        print_json_file(out / HISTORY[0])
    else:
        from bayes_inertia.report.formatting import typeset
        from bayes_inertia.report.series_sections import history_answer, history_table

        answer = typeset(history_answer(history))
        _show(answer, history_table(history), left_out, HISTORY, out)
    open_in_browser(out / HISTORY[1], open_page)


def fleet_command(
    fits: Annotated[
        Path,
        typer.Argument(
            help="Folder that `fit-many` wrote; the first folder of a campaign's path is its "
            "spacecraft."
        ),
    ],
    out: OutputFolder,
    seed: Seed = 0,
    open_page: OpenPage = False,
    as_json: AsJson = False,
) -> None:
    """Say what sister spacecraft have in common, and know each better by it.

    Writes fleet.json and fleet.html.
    """
    with progress_bar() as progress:
        from bayes_inertia.app.series_folder import FLEET, run_fleet

        fleet, alone_sd, left_out = run_fleet(fits, out, seed=seed, progress=progress)
    if as_json:
        print_json_file(out / FLEET[0])
    else:
        from bayes_inertia.report.formatting import typeset
        from bayes_inertia.report.series_sections import fleet_answer, fleet_table

        answer = typeset(fleet_answer(fleet, alone_sd))
        _show(answer, fleet_table(fleet, alone_sd), left_out, FLEET, out)
    open_in_browser(out / FLEET[1], open_page)


def _show(
    answer: str, table: Table, left_out: tuple[str, ...], files: tuple[str, str], folder: Path
) -> None:
    """Print the answer, a row a parameter, what was left out, and what was written.

    What gives way in a narrow terminal is the interval of the spread.
    """
    from bayes_inertia.report.series_sections import left_out_in_words

    console = plain_console()
    console.print(headed(answer))
    print_table(table.columns, table.rows, list(table.columns)[5:6])
    for sentence in left_out_in_words(left_out):
        console.print(sentence)
    console.print(f"wrote {' and '.join(files)} in {folder}")
