"""`fit`, `update`, `diagnose`, `resume` and `demo`: runs of one campaign."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import typer
from rich.text import Text

from bayes_inertia.app.options import DEMO_FOLDER, FitOptions, names_in
from bayes_inertia.app.terminal import (
    headed,
    indented,
    open_in_browser,
    plain_console,
    print_json,
    print_table,
    progress_bar,
)
from bayes_inertia.errors import SettingsError, require
from bayes_inertia.sealing import SEAL_KEY

if TYPE_CHECKING:
    from bayes_inertia.inference.posterior import Posterior
    from bayes_inertia.report.criteria import Criteria


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
    """The prior of a run, and the campaigns that it holds; none without a former result."""
    from bayes_inertia.app.run_folder import campaigns_in
    from bayes_inertia.campaign.prior import prior_in

    if former is not None:
        return {"prior": prior_in(former).inflated(inflate), "former": campaigns_in(former)}
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


FORMAT = "bayes-inertia-run-result/1"
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
    """Content of `fit`, `diagnose`, `resume` and `demo` with --json."""
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
    plain_console().print(headed(sentence, style="bold green" if trusted else "bold red"))


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
