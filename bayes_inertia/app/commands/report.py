"""`report`: write the report of a finished run again, or put two runs side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from bayes_inertia.app.commands.options import AsJson
from bayes_inertia.app.terminal import plain_console, print_json

FORMAT = "bayes-inertia-report/1"
COMPARISON_FORMAT = "bayes-inertia-run-comparison/1"


def report_command(
    run: Annotated[Path, typer.Argument(help="Folder of a finished run.")],
    other: Annotated[
        Path | None, typer.Argument(help="A second run, to be put beside the first.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            help="Page to write. Without it: report.html in the run, or comparison.html in the "
            "second of two runs.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write report.html again, or compare two runs.

    One run: from posterior.nc (and diagnosis.json). Two runs (before and after an effect, two
    campaigns, two drives): parameters with both sds and their difference in combined sd, gates,
    verdicts, and what differs in settings.
    """
    if other is None:
        _report(run, out, as_json)
    else:
        _compare(run, other, out, as_json)


def _report(run: Path, out: Path | None, as_json: bool) -> None:
    from bayes_inertia.app.compare_two_runs import finished_posterior
    from bayes_inertia.app.run_report import run_page, run_summary, write_run_report
    from bayes_inertia.sealing import is_sealed

    posterior = finished_posterior(run)
    intact = is_sealed(run / "posterior.nc", "")
    if out is None:
        path = write_run_report(posterior, run, intact=intact)
    else:
        path = _new_page(out, run_page(posterior, run, intact=intact))
    sentence = run_summary(posterior, run)["verdict_sentence"]
    document = {"report": str(path), "trusted": posterior.trusted, "verdict_sentence": sentence}
    _say({"format": FORMAT} | document, sentence, path, as_json)


def _compare(first: Path, second: Path, out: Path | None, as_json: bool) -> None:
    from bayes_inertia.app.compare_two_runs import compare_two_runs
    from bayes_inertia.files import write_atomically
    from bayes_inertia.report.comparison_sections import comparison_page
    from bayes_inertia.report.run_comparison import comparison_json

    comparison = compare_two_runs(first, second)
    page = comparison_page(comparison)
    if out is None:
        path = write_atomically(second / "comparison.html", page)
    else:
        path = _new_page(out, page)
    document = {"format": COMPARISON_FORMAT, "report": str(path)} | comparison_json(comparison)
    _say(document, comparison.sentence, path, as_json)


def _new_page(path: Path, page: str) -> Path:
    """A page that replaces no other file."""
    from bayes_inertia.files import write_new_files

    write_new_files(path.parent, {path.name: page.encode("utf-8")}, holds="file")
    return path


def _say(document: dict[str, Any], sentence: str, path: Path, as_json: bool) -> None:
    if as_json:
        print_json(document)
        return
    console = plain_console()
    console.print(sentence)
    console.print(f"wrote {path}", soft_wrap=True)
