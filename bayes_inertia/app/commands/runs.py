"""Runs of a campaign: `fit`, `update`, `diagnose`, `resume`, `demo`; `report` and `export` of them.

A finished run is reported again, beside another, or written for another tool.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import typer
from rich.text import Text

from bayes_inertia.app.options import DEMO_FOLDER, FitOptions, FormatName, names_in
from bayes_inertia.app.terminal import (
    headed,
    indented,
    open_in_browser,
    plain_console,
    print_json,
    print_table,
    progress_bar,
    say,
)
from bayes_inertia.errors import SettingsError, require
from bayes_inertia.sealing import SEAL_KEY

if TYPE_CHECKING:
    from bayes_inertia.inference.posterior import Posterior
    from bayes_inertia.report.criteria import Criteria
    from bayes_inertia.report.plan_promise import PlanPromise


def fit_command(
    campaign: Path,
    out: Path,
    asked: FitOptions,
    noise: list[str] | None = None,
    sample_noise: str = "",
    remainder: Literal["torque", "rate", "both"] | None = None,
    prior: Path | None = None,
    inflate: float = 0.0,
) -> None:
    """Estimate J, K and active effects.

    Writes posterior.nc, summary.json and report.html.
    """

    def chosen(names: list[str]) -> dict[str, Any]:
        from bayes_inertia.inference.settings import usual_settings
        from bayes_inertia.physics.channel_noise import noise_model_from_text
        from bayes_inertia.physics.named_effects import effects_named, remainders

        names += [effect.name for effect in remainders(remainder)]
        return {
            "effects": names,
            "settings": usual_settings(effects_named(names), seed=asked.seed),
            "noise": noise_model_from_text(noise or [], names_in(sample_noise)),
            **_known_before(prior, inflate),
        }

    _run(campaign, out, asked, chosen)


def _run(
    campaign: Path,
    out: Path,
    asked: FitOptions,
    chosen: Callable[[list[str]], dict[str, Any]],
) -> None:
    """Start, finish and show a run; `chosen`: what else it is begun with, by the effects named."""
    from bayes_inertia.app.commands.check import refuse_or_warn

    with progress_bar() as progress:
        names = names_in(asked.effects)
        # Before anything heavy is loaded: seconds against minutes.
        if not asked.anyway:
            refuse_or_warn(campaign, progress, names)

        from bayes_inertia.app import run_folder

        how = {"drive": asked.drive, "as_stated": asked.as_stated, **chosen(names)}
        run_folder.start(campaign, out, **how)
        posterior = run_folder.finish(out, report=asked.report, progress=progress)
    show_run(posterior, out, asked.report, as_json=asked.as_json, open_page=asked.open_page)


def _known_before(former: Path | None, inflate: float) -> dict[str, Any]:
    """The prior of a run; none without a former result."""
    if former is not None:
        from bayes_inertia.app.fit_campaign import known_before

        return {"prior": known_before(former, inflate)}
    what = "there is no former result to inflate"
    advice = "add --prior RUN, or state wider sigmas in campaign.toml"
    require(not inflate, "--inflate", what, advice, error=SettingsError)
    return {}


def update_command(
    run: Path, campaign: Path, out: Path, asked: FitOptions, inflate: float = 0.0
) -> None:
    """Add a campaign to a former result, as if both were fitted together.

    The former posterior of J and K is the prior; rate bias, start states and effects of each
    campaign are its own. Writes what `fit` writes.
    """
    fit_command(campaign, out, asked, prior=run, inflate=inflate)


def diagnose_command(campaign: Path, out: Path, asked: FitOptions) -> None:
    """Find which physical effect is missing, and fit it along.

    Writes diagnosis.json, then what `fit` writes.
    """

    def chosen(names: list[str]) -> dict[str, Any]:
        from bayes_inertia.inference.settings import STOCHASTIC_SETTINGS

        settings = replace(STOCHASTIC_SETTINGS, seed=asked.seed)
        return {"effects": names, "settings": settings, "kind": "diagnose"}

    _run(campaign, out, asked, chosen)


def resume_command(
    run: Path, report: bool = True, open_page: bool = False, as_json: bool = False
) -> None:
    """Go on with an interrupted fit or diagnosis.

    The result is bit for bit as if it had never stopped.
    """
    with progress_bar() as progress:
        from bayes_inertia.app import run_folder

        posterior = run_folder.finish(run, report=report, progress=progress)
    show_run(posterior, run, report, as_json=as_json, open_page=open_page)


def demo_command(
    out: Path = DEMO_FOLDER, seed: int = 1, open_page: bool = False, as_json: bool = False
) -> None:
    """Simulate a campaign of five slews, fit it, write the report."""
    with progress_bar() as progress:
        from bayes_inertia.app import run_folder
        from bayes_inertia.flight.mission import most_like_mission
        from bayes_inertia.flight.plan import paper_like_plan
        from bayes_inertia.flight.simulated_campaigns import simulate
        from bayes_inertia.inference.settings import Settings

        progress("flying five slews", 0, 0)
        simulate(paper_like_plan(), most_like_mission(), out / "campaign", seed)
        run_folder.start(out / "campaign", out / "fit", settings=Settings(seed=seed))
        posterior = run_folder.finish(out / "fit", progress=progress)
    show_run(posterior, out / "fit", report=True, as_json=as_json, open_page=open_page)


RUN_FORMAT = "bayes-inertia-run-result/1"
_COLUMNS = ("name", "estimate", "± sd", "unit", "prior sd", "determined")
_DETERMINED = {"determined": "yes", "partly determined": "partly", "not determined": "no"}


def show_run(
    posterior: Posterior,
    folder: Path,
    report: bool,
    *,
    as_json: bool = False,
    open_page: bool = False,
) -> None:
    """Print the result of a finished run, and exit with 3 where it must not be trusted."""
    from bayes_inertia.app.diagnosis_json import blaming_diagnosis, read_diagnosis
    from bayes_inertia.app.run_folder import run_summary

    content, summary = read_diagnosis(folder), run_summary(posterior, folder)
    if as_json:
        print_json(run_result_json(folder, summary, content, posterior.trusted))
    else:
        style = "bold green" if posterior.trusted else "bold red"
        plain_console().print(headed(summary["verdict_sentence"], style=style))
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
    """Content of `fit`, `diagnose`, `resume` and `demo` with --json."""
    if diagnosis is not None:
        left_out = ("pictures", SEAL_KEY)
        diagnosis = {key: value for key, value in diagnosis.items() if key not in left_out}
    return {
        "format": RUN_FORMAT,
        "run": str(folder),
        "trusted": trusted,
        "summary": summary,
        "diagnosis": diagnosis,
    }


def show_summary(summary: dict[str, Any], folder: Path, report: bool = True) -> None:
    """Print a fit's gates first, then its numbers."""
    from bayes_inertia.report.criteria import ratios_told
    from bayes_inertia.report.words import averaged_over, dirt_sentences

    console = plain_console()
    console.print(_gates(summary["gates"], summary["diagnostics"]["ess_bulk_min"]))
    for sentence in dirt_sentences(summary.get("dirt", [])):
        console.print(indented(sentence))
    print_table(_COLUMNS, _parameter_rows(summary))
    told = ratios_told(summary) | summary["parameters"]
    if all(row["quoted_sd"] is None for row in told.values()):
        console.print("sd: none can be quoted, this result is not to be used")
    elif causes := averaged_over(summary):
        console.print(f"estimate and sd: averaged over what may be true ({causes})")
    chi2 = ", ".join(
        f"{key} {value:.3f}"
        for key, value in summary["fit"]["reduced_chi2"].items()
        if value is not None
    )
    console.print(f"reduced χ²: {chi2}")
    files = ", summary.json and report.html" if report else " and summary.json"
    console.print(f"wrote posterior.nc{files} in {folder}")


def _gates(gates: Sequence[dict[str, Any]], samples: float) -> Text:
    """The gates that are passed by name; those that failed with what they say, a line each."""
    from bayes_inertia.report.formatting import typeset

    text = Text()
    for gate in gates:
        if not gate["passed"]:
            text.append("FAILED", "red").append(f" {gate['name']}: {typeset(gate['says'])}\n")
    counted = {"converged": f" ({samples:.0f} effective samples)"}
    names = [gate["name"] for gate in gates if gate["passed"]]
    passed = ", ".join(name + counted.get(name, "") for name in names)
    return text.append("passed", "green").append(f": {passed or 'no gate'}")


def _parameter_rows(summary: dict[str, Any]) -> Iterator[tuple[str, ...]]:
    from bayes_inertia.report.criteria import (
        criteria_of,
        exponents_of,
        ratios_told,
        sd_in_print,
    )
    from bayes_inertia.report.formatting import NOT_GIVEN, number, plain, unit_text

    # Size and time of a free shape are for the page.
    shown = {n: p for n, p in summary["parameters"].items() if "_remainder." not in n}
    shown = ratios_told(summary) | shown
    criteria, powers = criteria_of(summary), exponents_of(shown)
    for name, p in shown.items():
        sd, quoted = sd_in_print(p), p["quoted_sd"]
        power = powers[name]
        yield (
            plain(name),
            number(p["mean"], sd, power),
            NOT_GIVEN if quoted is None else number(quoted, quoted, power),
            unit_text(p["unit"], power),
            number(p["prior_sd"], p["prior_sd"], power),
            _told(p, f"{name}/trace" in shown, criteria),
        )


def _told(row: dict[str, Any], by_ratio: bool, criteria: Criteria) -> str:
    """How far a parameter is determined; what is wrong with a refused fit may pass for that."""
    from bayes_inertia.report.criteria import determination_of
    from bayes_inertia.report.formatting import NOT_GIVEN

    if by_ratio:
        return "its ratio"
    return NOT_GIVEN if row["quoted_sd"] is None else _DETERMINED[determination_of(row, criteria)]


def show_diagnosis(content: dict[str, Any]) -> None:
    """Print a diagnosis' verdict, then why, in brief: the page lists all candidates."""
    from bayes_inertia.report.verdict import headline, in_brief

    console = plain_console()
    # The sentence above says what was found, or that nothing was.
    if content["verdict"] not in ("consistent", "named", "unknown"):
        console.print(headed(headline(content), style="bold"))
    # The parameters stand in the table of the fit, with the sds to quote.
    untold = [candidate | {"parameters": None} for candidate in content["candidates"]]
    for sentence in in_brief(content | {"candidates": untold}):
        console.print(indented(sentence))


REPORT_FORMAT = "bayes-inertia-report/1"
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
    _say({"format": REPORT_FORMAT} | document, sentence, path, as_json)
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
