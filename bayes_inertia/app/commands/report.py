"""`report`: write the report of a finished run again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def report_command(
    run: Annotated[Path, typer.Argument(help="Folder of a finished run.")],
) -> None:
    """Write report.html again from posterior.nc (and diagnosis.json)."""
    from bayes_inertia.app.run_folder import sections
    from bayes_inertia.inference.posterior import Posterior
    from bayes_inertia.report.page import write_report

    posterior = Posterior.load(run / "posterior.nc")
    path = write_report(posterior, run / "report.html", sections(posterior, run))
    typer.echo(f"wrote {path}")
