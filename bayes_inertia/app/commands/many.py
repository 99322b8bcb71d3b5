"""Many fits: `fit-many`, whether uncertainties hold (`study`), and what a series tells of J and K:
over campaigns (`history`), over sister spacecraft (`fleet`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from bayes_inertia.app.layout import LAYOUT
from bayes_inertia.app.options import DriveName, EngineOptions, names_in
from bayes_inertia.app.terminal import (
    headed,
    plain_console,
    print_or_show,
    print_table,
    progress_bar,
    show_result,
)
from bayes_inertia.errors import SettingsError, require

if TYPE_CHECKING:
    from bayes_inertia.app.study_folder import Study
    from bayes_inertia.report.section import Table
    from bayes_inertia.studies.calibration import Calibration
    from bayes_inertia.studies.work import WorkResult


def fit_many_command(
    folder: Path,
    out: Path,
    engine: EngineOptions,
    effects: str = "",
    drive: DriveName | None = None,
    seed: int = 0,
    anyway: bool = False,
    as_stated: bool = False,
    as_json: bool = False,
) -> None:
    """Fit every campaign in a folder: a fleet, or a mission's years.

    Writes fits.parquet (a row a campaign) and fit_many.json. Goes on where it was killed, and fits
    what was added or changed, with the same command. Exit code 3 if a campaign failed or its result
    must not be used.
    """
    with progress_bar() as progress:
        progress("checking the campaigns and fitting the first", 0, 0)
        from bayes_inertia.app.many_folder import fit_many, fits_json

        result = fit_many(
            folder,
            out,
            effects=names_in(effects),
            drive=drive,
            seed=seed,
            as_stated=as_stated,
            anyway=anyway,
            **vars(engine.execution(progress)),
        )
    print_or_show(fits_json(result), as_json, show_fits, result, out)
    if result.failures or not all(row["trusted"] for row in result.rows):
        raise typer.Exit(3)


def show_fits(result: WorkResult, folder: Path) -> None:
    """Print a row a campaign."""
    from bayes_inertia.report.formatting import kind_of

    console, told = plain_console(), ("moment of inertia", "K")
    # Of a spacecraft without a rate sensor no K, and where nothing ties the size of J its ratios.
    quoted = (key for row in result.rows for key, sd in row.items() if sd and key.endswith(_SD))
    names = [key.removesuffix(_SD) for key in dict.fromkeys(quoted)]
    names = [name for name in names if kind_of(name) in told]
    cells = (
        (
            row["campaign"],
            "yes" if row["trusted"] else "NO",
            *(_cell(row, name) for name in names),
            f"{row['reduced_chi2_total']:.3f}",
        )
        for row in result.rows
    )
    print_table(("campaign", "use", *names, "χ²"), cells)
    for row in result.rows:
        if not row["trusted"]:
            console.print(f"{row['campaign']}: {row['reasons']}")
    for failure in result.failures:
        console.print(f"{failure.name} could not be fitted: {failure.reason}")
    trusted = sum(row["trusted"] for row in result.rows)
    console.print(
        f"{trusted} of {len(result.rows) + len(result.failures)} campaigns give a result that can "
        "be used; J in kg m², ±: the quoted sd"
    )
    files = "fits.parquet and fit_many.json" if result.rows else "fit_many.json"
    console.print(f"wrote {files} in {folder}")


def _cell(row: dict[str, Any], name: str) -> str:
    from bayes_inertia.report.formatting import NOT_GIVEN, exponent, number, unit_text

    sd = row.get(f"{name}{_SD}")  # None of K that the gyro does not have
    if sd is None:
        return NOT_GIVEN
    power = exponent(row[name], sd)
    scale = f" {unit_text('', power)}" if power else ""
    return f"{number(row[name], sd, power)}\n± {number(sd, sd, power)}{scale}"


_SD = "_quoted_sd"  # behind a parameter's name, in a row
_CALIBRATION = "calibration"


def study_command(
    what: Path,
    out: Path,
    plan: str | None = None,
    campaigns: int | None = None,
    fits: int | None = None,
    cases: str = "",
    *,
    engine: EngineOptions,
    seed: int = 0,
    as_json: bool = False,
) -> None:
    """Do stated uncertainties hold in simulated campaigns?

    `study CAMPAIGN` flies a plan many times, each time with another J, K and bias, and fits each
    flight. Writes study.json and study.png.

    `study calibration` draws the truth from the prior, flies and fits it, with and without weak
    data, sensors and effects, and looks where the truth lies among the draws of each posterior.
    Writes calibration.json and calibration.png.

    A study that was killed goes on with the same command. Exit code 3 if uncertainties do not hold.
    """
    from bayes_inertia.app.plan_folder import PAPER
    from bayes_inertia.app.study_folder import run_calibration, run_study

    run: Callable[..., Any]
    show: Callable[[Any, Path], None]
    if what == Path(_CALIBRATION) and not (what / "campaign.toml").is_file():
        name, show, wrong = "calibration", show_calibration, attrgetter("rejected")
        count = fits or LAYOUT.fits_of_calibration
        run = partial(run_calibration, out, fits=count, cases=names_in(cases), seed=seed)
        foreign: dict[str, Any] = {"--plan": plan, "--campaigns": campaigns}
    else:
        name, show, wrong = "study", show_study, attrgetter("too_small")
        count = campaigns or LAYOUT.campaigns_of_study
        run = partial(run_study, what, out, plan or PAPER, campaigns=count, seed=seed)
        foreign = {"--fits": fits, "--cases": cases}
    _refuse_given(foreign)
    with progress_bar() as progress:
        progress("flying and fitting the first campaigns", 0, 0)
        found: Any = run(execution=engine.execution(progress))
    show_result(out / f"{name}.json", as_json, False, show, found, out)
    if wrong(found) or found.failures:
        raise typer.Exit(3)


def _refuse_given(foreign: dict[str, Any]) -> None:
    """Refuse options of the other study."""
    given = ", ".join(option for option, value in foreign.items() if value)
    what = "the study that is asked for does not take it"
    advice = "leave it out; `study --help` says which study takes it"
    require(not given, given, what, advice, error=SettingsError)


def show_study(study: Study, folder: Path) -> None:
    """Print achieved beside stated sds, and how often intervals held the truth."""
    from bayes_inertia.physics.parameters import base_units
    from bayes_inertia.report.formatting import number, unit_powers, unit_text

    console, achieved = plain_console(), study.achieved
    verdict = ("Stated sds hold.", "bold green")
    if study.too_small:
        verdict = (f"Stated sds are TOO SMALL for {', '.join(study.too_small)}.", "bold red")
    flown = f" {len(achieved.errors)} campaigns of {study.plan.name}."
    console.print(headed(verdict[0], flown, style=verdict[1]))
    rows = []
    units = base_units(len(study.names))
    powers = unit_powers(zip(units, achieved.sd, strict=True))
    coverages = zip(study.coverage(0.68), study.coverage(0.95), strict=True)
    for i, (name, coverage) in enumerate(zip(study.names, coverages, strict=True)):
        shares = [
            f"{100 * share:.1f} % ({100 * low:.0f} to {100 * high:.0f})"
            for share, low, high in coverage
        ]
        sd, error, unit = achieved.sd[i], achieved.sd_error[i], units[i]
        power = powers[unit]
        sds = f"{number(sd, error, power)} ± {number(error, error, power)}"
        stated = number(achieved.stated_sd[i], error, power)
        rows.append((name, sds, stated, unit_text(unit, power), *shares))
    print_table(("", "achieved sd", "stated sd", "unit", "in 68 %", "in 95 %"), rows)
    if study.failures:
        first = study.failures[0]
        console.print(
            f"{len(study.failures)} more could not be fitted and count in nothing above; "
            f"campaign {first.task}: {first.reason}"
        )
    console.print(f"wrote study.json and study.png in {folder}")


def show_calibration(calibration: Calibration, folder: Path) -> None:
    """Print coverage and p-values of every case and quantity."""
    from bayes_inertia.report.formatting import p_value_text
    from bayes_inertia.studies.calibration import QUANTITIES

    console = plain_console()
    names = ", ".join(f"{name} ({case})" for case, name in calibration.rejected)
    verdict = f"Posteriors are WRONG in {names}." if names else "No quantity is rejected."
    rule = f" {calibration.fits} fits, p below {p_value_text(calibration.limit)} would reject."
    console.print(headed(verdict, rule, style="bold red" if names else "bold green"))
    for case in calibration.cases:
        console.print(f"{case.name} ({case.says}): {len(case.ranks)} fits")
        rows = []
        for k, name in enumerate(QUANTITIES):
            shares = [f"{100.0 * coverage.share:.1f} %" for coverage in case.coverage(k)]
            z, p = case.z[:, k], case.p_values[k]
            mark = " !" if p < calibration.limit else ""
            cells = [f"{z.mean():+.3f}", f"{(z**2).mean():.3f}", f"{p_value_text(p)}{mark}"]
            rows.append((name, *shares, *cells))
        print_table(("", "in 50 %", "in 90 %", "in 95 %", "mean z", "mean z²", "p of ranks"), rows)
    if calibration.failures:
        first = calibration.failures[0]
        console.print(f"{len(calibration.failures)} more failed; {first.task}: {first.reason}")
    console.print(f"wrote calibration.json and calibration.png in {folder}")


def history_command(
    sources: list[Path],
    out: Path,
    seed: int = 0,
    open_page: bool = False,
    as_json: bool = False,
) -> None:
    """Say whether J and K changed from campaign to campaign: when, by how much, how probable.

    Writes history.json and history.html.
    """
    with progress_bar() as progress:
        from bayes_inertia.app.many_folder import HISTORY, run_history

        history = run_history(sources, out, seed=seed, progress=progress)
    from bayes_inertia.report.series_sections import history_answer, history_table, series_notes

    notes = series_notes(history)
    told = history_answer(history), history_table(history), notes, HISTORY, out
    show_result(out / HISTORY[0], as_json, open_page, _show, *told)


def fleet_command(
    fits: Path, out: Path, seed: int = 0, open_page: bool = False, as_json: bool = False
) -> None:
    """Say what sister spacecraft have in common, and know each better by it.

    Writes fleet.json and fleet.html.
    """
    with progress_bar() as progress:
        from bayes_inertia.app.many_folder import FLEET, run_fleet

        fleet = run_fleet(fits, out, seed=seed, progress=progress)
    from bayes_inertia.report.series_sections import fleet_answer, fleet_table, series_notes

    told = fleet_answer(fleet), fleet_table(fleet), series_notes(fleet), FLEET, out
    show_result(out / FLEET[0], as_json, open_page, _show, *told)
    if fleet.disagree:
        raise typer.Exit(3)


def _show(
    answer: str, table: Table, notes: tuple[str, ...], files: tuple[str, str], folder: Path
) -> None:
    """Print the answer, a row a parameter, what must be known of it, and what was written.

    What gives way in a narrow terminal is the interval of the spread.
    """
    from bayes_inertia.report.formatting import typeset

    console = plain_console()
    console.print(headed(typeset(answer)))
    print_table(table.columns, table.rows, list(table.columns)[5:6])
    for note in notes:
        console.print(note)
    console.print(f"wrote {' and '.join(files)} in {folder}")
