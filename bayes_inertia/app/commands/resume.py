"""`resume`: go on with an interrupted run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayes_inertia.app.commands.options import AsJson, WithReport


def resume_command(
    run: Annotated[Path, typer.Argument(help="Folder of a run that was interrupted.")],
    report: WithReport = True,
    as_json: AsJson = False,
) -> None:
    """Go on with an interrupted fit or diagnosis.

    The result is bit for bit as if it had never stopped.
    """
    from bayes_inertia.app.commands.run_result import finish_and_show

    finish_and_show(run, report, as_json)
