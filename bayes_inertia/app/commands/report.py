"""`report`: write the report of a finished run again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayes_inertia.app.commands.options import AsJson
from bayes_inertia.app.terminal import plain_console, print_json

FORMAT = "bayes-inertia-report/1"


def report_command(
    run: Annotated[Path, typer.Argument(help="Folder of a finished run.")],
    as_json: AsJson = False,
) -> None:
    """Write report.html again from posterior.nc (and diagnosis.json)."""
    from bayes_inertia.app.run_folder import write_run_report
    from bayes_inertia.inference.posterior import Posterior
    from bayes_inertia.sealing import is_sealed

    stored = run / "posterior.nc"
    posterior = Posterior.load(stored)
    path = write_run_report(posterior, run, intact=is_sealed(stored, ""))
    if as_json:
        print_json({"format": FORMAT, "report": str(path), "trusted": posterior.trusted})
    else:
        plain_console().print(f"wrote {path}", soft_wrap=True)
