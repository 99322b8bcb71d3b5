"""`report`: write the report of a finished run again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def report_command(
    run: Annotated[Path, typer.Argument(help="Folder of a finished run.")],
) -> None:
    """Write report.html again from posterior.nc (and diagnosis.json)."""
    from bayes_inertia.app.run_folder import write_run_report
    from bayes_inertia.inference.posterior import Posterior
    from bayes_inertia.sealing import is_sealed

    stored = run / "posterior.nc"
    posterior = Posterior.load(stored)
    path = write_run_report(posterior, run, intact=is_sealed(stored, ""))
    typer.echo(f"wrote {path}")
