"""`resume`: go on with an interrupted run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayes_inertia.app.commands.options import AsJson, OpenPage, WithReport
from bayes_inertia.app.terminal import progress_bar


def resume_command(
    run: Annotated[Path, typer.Argument(help="Folder of a run that was interrupted.")],
    report: WithReport = True,
    open_page: OpenPage = False,
    as_json: AsJson = False,
) -> None:
    """Go on with an interrupted fit or diagnosis.

    The result is bit for bit as if it had never stopped.
    """
    from bayes_inertia.app.commands.run_result import show_run

    with progress_bar() as progress:
        from bayes_inertia.app import run_folder

        posterior = run_folder.finish(run, report=report, progress=progress)
    show_run(posterior, run, report, as_json=as_json, open_page=open_page)
