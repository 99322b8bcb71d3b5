"""`report`, `export`: a finished run again, beside another, or for another tool."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import typer

from bayes_inertia.app.terminal import (
    open_in_browser,
    plain_console,
    print_json,
    print_table,
    progress_bar,
    say,
)
from bayes_inertia.errors import require

if TYPE_CHECKING:
    from bayes_inertia.report.plan_promise import PlanPromise

FORMAT = "bayes-inertia-report/1"
COMPARISON_FORMAT = "bayes-inertia-run-comparison/1"


def report_command(
    run: Path,
    other: Path | None = None,
    plan: Path | None = None,
    out: Path | None = None,
    open_page: bool = False,
    as_json: bool = False,
) -> None:
    """Write report.html again, compare two runs, or hold a run against its plan.

    One run: from posterior.nc (and diagnosis.json). With --plan also what the plan promised, which
    is that of the design.json beside it or is forecast now. Two runs (before and after an effect,
    two campaigns, two drives): parameters with both sds and their difference in combined sd,
    gates, verdicts, and what differs in settings.
    """
    what = "a plan goes with one run, two are named"
    advice = "leave the second run out, or the plan"
    require(other is None or plan is None, "--plan", what, advice)
    path = _compare(run, other, out, as_json) if other else _report(run, plan, out, as_json)
    open_in_browser(path, open_page)


def _report(run: Path, plan: Path | None, out: Path | None, as_json: bool) -> Path:
    with progress_bar() as progress:
        progress("reading the run", 0, 0)
        from bayes_inertia.app.finished_runs import promise_of_plan
        from bayes_inertia.app.result_folder import finished_posterior
        from bayes_inertia.app.run_folder import run_page, run_summary
        from bayes_inertia.sealing import is_sealed

        posterior = finished_posterior(run)
        intact, summary = is_sealed(run / "posterior.nc", ""), run_summary(posterior, run)
        progress("drawing the report", 0, 0)
        promise = None if plan is None else promise_of_plan(run, plan, summary)
        page = run_page(posterior, run, intact=intact, promise=promise)
        path = _written(page, out, run / "report.html")
    sentence = summary["verdict_sentence"]
    document = {
        "report": str(path),
        "trusted": posterior.trusted,
        "verdict_sentence": sentence,
        "plan": None if promise is None else promise.json(),
    }
    if promise is not None and not as_json:
        show_promise(promise)
    _say({"format": FORMAT} | document, sentence, path, as_json)
    return path


def show_promise(promise: PlanPromise) -> None:
    """Print what a plan promised beside what was achieved."""
    from bayes_inertia.report.plan_promise import promise_table

    console = plain_console()
    console.print(promise.sentence)
    table = promise_table(promise)
    print_table(table.columns, table.rows)
    console.print(f"promised: {promise.promised_by}")


def _compare(first: Path, second: Path, out: Path | None, as_json: bool) -> Path:
    with progress_bar() as progress:
        progress("reading the runs", 0, 0)
        from bayes_inertia.app.finished_runs import compare_two_runs
        from bayes_inertia.report.comparison_sections import comparison_page
        from bayes_inertia.report.run_comparison import comparison_json

        comparison = compare_two_runs(first, second)
        progress("drawing the page", 0, 0)
        path = _written(comparison_page(comparison), out, second / "comparison.html")
    if not as_json:
        plain_console().print(f"A: {first}; B: {second}", soft_wrap=True)
    document = {"format": COMPARISON_FORMAT, "report": str(path)} | comparison_json(comparison)
    _say(document, comparison.sentence, path, as_json)
    return path


def _written(text: str, out: Path | None, usual: Path) -> Path:
    """Where a text was written: to a file of the user's choice, which replaces no other one."""
    from bayes_inertia.files import write_atomically, write_new_files

    if out is None:
        return write_atomically(usual, text)
    write_new_files(out.parent, {out.name: text.encode("utf-8")}, holds="file")
    return out


def _say(document: dict[str, Any], sentence: str, path: Path, as_json: bool) -> None:
    if as_json:
        print_json(document)
        return
    console = plain_console()
    console.print(sentence)
    console.print(f"wrote {path}", soft_wrap=True)


FormatName = Literal["acm", "apm", "json", "csv", "matlab", "latex", "basilisk", "42"]


def export_command(
    run: Path, to: FormatName, out: Path | None = None, even_untrusted: bool = False
) -> None:
    """Write a result for another tool.

    acm: CCSDS attitude comprehensive message with J, K and their covariance. apm: inertia block of
    a CCSDS attitude parameter message. csv: sheet for an upload (old, new, change, correction
    slew). json, matlab: all digits. latex: a table. basilisk, 42: lines for these simulators. A
    result whose gates failed is not written (exit code 3) unless --even-untrusted; then the file
    begins with a warning.
    """
    with progress_bar() as progress:
        progress("reading the run", 0, 0)
        from bayes_inertia.app.export_run import exported_result
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
        say(f"wrote {_written(form.text(result), out, out)}")
    if not result.trusted:
        raise typer.Exit(3)
