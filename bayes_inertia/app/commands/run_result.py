"""What `fit`, `diagnose`, `resume` and `demo` end with: the result of a run, printed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from bayes_inertia.app.terminal import (
    headed,
    indented,
    narrow_table,
    open_in_browser,
    plain_console,
    print_json,
)
from bayes_inertia.sealing import SEAL_KEY

if TYPE_CHECKING:
    from bayes_inertia.inference.posterior import Posterior

FORMAT = "bayes-inertia-run-result/1"
_COLUMNS = ("estimate", "± sd", "unit", "prior sd", "contraction", "determined")
_DETERMINED = {"determined": "yes", "partly determined": "partly", "not determined": "no"}
_COLORS = {"good": "green", "caution": "yellow", "bad": "red"}
_CANDIDATES_SHOWN = 3


def show_run(
    posterior: Posterior,
    folder: Path,
    report: bool,
    *,
    as_json: bool = False,
    open_page: bool = False,
) -> None:
    """Print the result of a finished run, and exit with 3 where it must not be trusted."""
    from bayes_inertia.app.run_report import run_summary
    from bayes_inertia.app.stored_diagnosis import blaming_diagnosis, read_diagnosis

    content, summary = read_diagnosis(folder), run_summary(posterior, folder)
    if as_json:
        print_json(run_result_json(folder, summary, content, posterior.trusted))
    else:
        show_verdict(summary["verdict_sentence"], posterior.trusted)
        if content is not None:
            with blaming_diagnosis(folder, content):
                show_diagnosis(content)
        show_summary(summary, folder, report)
    open_in_browser(folder / "report.html", report and open_page)
    if not posterior.trusted:
        raise typer.Exit(3)


def run_result_json(
    folder: Path, summary: dict[str, Any], diagnosis: dict[str, Any] | None, trusted: bool
) -> dict[str, Any]:
    """What `fit`, `diagnose`, `resume` and `demo` print with --json."""
    if diagnosis is not None:
        left_out = ("pictures", SEAL_KEY)
        diagnosis = {key: value for key, value in diagnosis.items() if key not in left_out}
    return {
        "format": FORMAT,
        "run": str(folder),
        "trusted": trusted,
        "summary": summary,
        "diagnosis": diagnosis,
    }


def show_verdict(sentence: str, trusted: bool) -> None:
    """Print the answer of a run in one sentence."""
    color = _COLORS["good" if trusted else "bad"]
    plain_console().print(headed(sentence, style=f"bold {color}"))


def show_summary(summary: dict[str, Any], folder: Path, report: bool = True) -> None:
    """Print a fit's gates first, then its numbers."""
    from bayes_inertia.report.dirt_wording import dirt_sentences
    from bayes_inertia.report.parameter_wording import averaged_over

    console = plain_console()
    console.print(_gates(summary["gates"]))
    for sentence in dirt_sentences(summary.get("dirt", [])):
        console.print(indented(sentence))
    console.print(_parameter_table(console, summary))
    if all(p["quoted_sd"] is None for p in summary["parameters"].values()):
        console.print("sd: none can be quoted, this result is not to be used")
    elif causes := averaged_over(summary):
        console.print(f"estimate and sd: averaged over what may be true ({causes})")
    chi2 = ", ".join(
        f"{key} {value:.3f}"
        for key, value in summary["fit"]["reduced_chi2"].items()
        if value is not None
    )
    console.print(f"reduced χ²: {chi2}")
    diagnostics = summary["diagnostics"]
    console.print(
        f"{diagnostics['ess_bulk_min']:.0f} effective samples "
        f"from {diagnostics['evaluations']} evaluations in {diagnostics['seconds']:.1f} s"
    )
    files = ", summary.json and report.html" if report else " and summary.json"
    console.print(f"wrote posterior.nc{files} in {folder}")


def _gates(gates: Sequence[dict[str, Any]]) -> Text:
    """The gates that are passed by name; those that failed with what they say, a line each."""
    from bayes_inertia.report.formatting import typeset

    text = Text()
    for gate in gates:
        if not gate["passed"]:
            text.append("FAILED", "red").append(f" {gate['name']}: {typeset(gate['says'])}\n")
    passed = ", ".join(gate["name"] for gate in gates if gate["passed"])
    return text.append("passed", "green").append(f": {passed or 'no gate'}")


def _parameter_table(console: Console, summary: dict[str, Any]) -> Table:
    from bayes_inertia.report.criteria import criteria_of
    from bayes_inertia.report.formatting import NOT_GIVEN, number, plain, unit_text
    from bayes_inertia.report.uncertainty import (
        contraction,
        contraction_text,
        determination,
        exponents_of,
        sd_in_print,
    )

    criteria, powers = criteria_of(summary), exponents_of(summary["parameters"])
    table = narrow_table(console, "name", *_COLUMNS)
    for name, p in summary["parameters"].items():
        sd, quoted = sd_in_print(p), p["quoted_sd"]
        power = powers[name]
        share = contraction(sd, p["prior_sd"])
        table.add_row(
            plain(name),
            number(p["mean"], sd, power),
            NOT_GIVEN if quoted is None else number(quoted, quoted, power),
            unit_text(p["unit"], power),
            number(p["prior_sd"], p["prior_sd"], power),
            contraction_text(share, criteria),
            _DETERMINED[determination(share, criteria)],
        )
    return table


def show_diagnosis(content: dict[str, Any]) -> None:
    """Print a diagnosis' verdict first, then why, and the best candidates."""
    from bayes_inertia.report.diagnosis_verdict import diagnosis_verdict

    # The parameters stand in the table of the fit, with the sds to quote.
    untold = [candidate | {"parameters": None} for candidate in content["candidates"]]
    console, verdict = plain_console(), diagnosis_verdict(content | {"candidates": untold})
    console.print(headed(verdict.title, style=f"bold {_COLORS[verdict.level]}"))
    for sentence in verdict.sentences:
        console.print(indented(sentence))
    scored = [c for c in content["candidates"] if c["p_value"] is not None]
    table = narrow_table(console, "candidate", "score", "dof", "p", "log Bayes", "")
    for candidate in scored[:_CANDIDATES_SHOWN]:
        table.add_row(*_candidate_cells(candidate, content))
    console.print(table)
    if (more := len(scored) - _CANDIDATES_SHOWN) > 0:
        console.print(f"... and {more} candidates more, in diagnosis.json")


def _candidate_cells(candidate: dict[str, Any], content: dict[str, Any]) -> tuple[str, ...]:
    from bayes_inertia.report.formatting import p_value_text, plain, tenths

    word = "significant" if candidate["p_value"] < content["threshold"] else ""
    if candidate["effect"] in content["named"]:
        word = "named"
    return (
        plain(candidate["effect"]),
        tenths(candidate["score"]),
        str(candidate["dof"]),
        p_value_text(candidate["p_value"]),
        tenths(candidate["log_bayes_factor"]),
        word,
    )
