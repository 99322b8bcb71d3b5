"""`export`: a result in the format of another tool."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from bayes_inertia.app.terminal import progress_bar, say

FormatName = Literal["apm", "json", "csv", "matlab", "latex", "basilisk", "42"]


def export_command(
    run: Annotated[Path, typer.Argument(help="Folder of a finished run.")],
    to: Annotated[FormatName, typer.Option("--to", help="The format.")],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="File to write; without it, stdout.")
    ] = None,
    even_untrusted: Annotated[
        bool,
        typer.Option(
            "--even-untrusted",
            help="Export a result that must not be used as it stands, with a warning in the file.",
        ),
    ] = False,
) -> None:
    """Write a result for another tool.

    apm: inertia block of a CCSDS attitude parameter message. csv: sheet for an upload (old, new,
    change, correction slew). json, matlab: all digits. latex: a table. basilisk, 42: lines for
    these simulators. A result whose gates failed is not written (exit code 3) unless
    --even-untrusted; then the file begins with a warning.
    """
    with progress_bar() as progress:
        progress("reading the run", 0, 0)
        from bayes_inertia.app.export_run import exported_result, write_export
        from bayes_inertia.report.export.formats import EXPORT_FORMATS

        form = EXPORT_FORMATS[to]
        result = exported_result(run, with_correction=form.shows_correction, progress=progress)
    if not result.trusted and not even_untrusted:
        say("Do not use this result as it stands; nothing was exported:")
        for reason in result.reasons:
            say(f"  {reason}")
        say("--even-untrusted writes it all the same, with a warning in the file.")
        raise typer.Exit(3)
    if out is None:
        typer.echo(form.text(result), nl=False)
    else:
        say(f"wrote {write_export(result, form, out)}")
    if not result.trusted:
        raise typer.Exit(3)
