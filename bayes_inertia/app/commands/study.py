"""`study`: do the uncertainties hold that fits of a plan's campaigns state?"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bayes_inertia.app.commands.options import (
    PAPER_HELP,
    AsJson,
    EngineName,
    Jobs,
    OutputFolder,
    SchedulerAddress,
    Seed,
    names_in,
)
from bayes_inertia.app.terminal import (
    headed,
    plain_console,
    print_json_file,
    print_table,
    progress_bar,
    say,
    unit_powers,
)

if TYPE_CHECKING:
    from bayes_inertia.app.study_folder import Study
    from bayes_inertia.studies.calibration import Calibration


_CALIBRATION = "calibration"


def study_command(
    what: Annotated[
        Path, typer.Argument(metavar="CAMPAIGN|calibration", help="Campaign folder, or a word.")
    ],
    out: OutputFolder,
    plan: Annotated[str, typer.Option(help=f"Plan file, {PAPER_HELP}.")] = "paper",
    campaigns: Annotated[int, typer.Option(help="Campaigns to simulate and fit.", min=2)] = 200,
    fits: Annotated[int, typer.Option(help="Fits of a calibration, of all cases.", min=1)] = 1000,
    cases: Annotated[
        str, typer.Option(help="Cases of a calibration, separated by commas; all without it.")
    ] = "",
    engine: EngineName = None,
    scheduler: SchedulerAddress = None,
    jobs: Jobs = 1,
    seed: Seed = 0,
    as_json: AsJson = False,
) -> None:
    """Do stated uncertainties hold in simulated campaigns?

    `study CAMPAIGN` flies a plan many times, each time with another J, K and bias, and fits each
    flight. Writes study.json and study.png.

    `study calibration` draws the truth from the prior, flies and fits it, with and without weak
    data, sensors and effects, and looks where the truth lies among the draws of each posterior.
    Writes calibration.json and calibration.png.

    A study that was killed goes on with the same command. Exit code 3 if uncertainties do not hold.
    """
    from bayes_inertia.app.study_folder import run_calibration, run_study
    from bayes_inertia.studies.engine import Execution

    run: Callable[..., Any]
    show: Callable[[Any, Path], None]
    if what == Path(_CALIBRATION) and not (what / "campaign.toml").is_file():
        name, show, wrong = "calibration", show_calibration, attrgetter("rejected")
        run = partial(run_calibration, out, fits=fits, cases=names_in(cases), seed=seed)
    else:
        name, show, wrong = "study", show_study, attrgetter("too_small")
        run = partial(run_study, what, out, plan, campaigns=campaigns, seed=seed)
    with progress_bar() as progress:
        progress("flying and fitting the first campaigns", 0, 0)
        found: Any = run(execution=Execution(engine, jobs, scheduler, progress, say))
    if as_json:
        print_json_file(out / f"{name}.json")
    else:
        show(found, out)
    if wrong(found) or found.failures:
        raise typer.Exit(3)


def show_study(study: Study, folder: Path) -> None:
    """Print achieved beside stated sds, and how often intervals held the truth."""
    from bayes_inertia.physics.parameters import BASE_NAMES, BASE_UNITS
    from bayes_inertia.report.formatting import number, unit_text

    console, achieved = plain_console(), study.achieved
    verdict = ("Stated sds hold.", "bold green")
    if study.too_small:
        verdict = (f"Stated sds are TOO SMALL for {', '.join(study.too_small)}.", "bold red")
    flown = f" {len(achieved.errors)} campaigns of {study.plan.name}."
    console.print(headed(verdict[0], flown, style=verdict[1]))
    rows = []
    stated_sd = (achieved.stated**2).mean(0) ** 0.5
    powers = unit_powers(zip(BASE_UNITS, achieved.sd, strict=True))
    coverages = zip(study.coverage(0.68), study.coverage(0.95), strict=True)
    for i, (name, coverage) in enumerate(zip(BASE_NAMES, coverages, strict=True)):
        shares = [
            f"{100 * share:.1f} % ({100 * low:.0f} to {100 * high:.0f})"
            for share, low, high in coverage
        ]
        sd, error, unit = achieved.sd[i], achieved.sd_error[i], BASE_UNITS[i]
        power = powers[unit]
        sds = f"{number(sd, error, power)} ± {number(error, error, power)}"
        stated = number(stated_sd[i], error, power)
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
    from bayes_inertia.studies.calibration import QUANTITIES

    console = plain_console()
    names = ", ".join(f"{name} ({case})" for case, name in calibration.rejected)
    verdict = f"Posteriors are WRONG in {names}." if names else "No quantity is rejected."
    rule = f" {calibration.fits} fits, p below {calibration.limit:.1g} would reject."
    console.print(headed(verdict, rule, style="bold red" if names else "bold green"))
    for case in calibration.cases:
        console.print(f"{case.name} ({case.says}): {len(case.ranks)} fits")
        rows = []
        for k, name in enumerate(QUANTITIES):
            shares = [f"{100.0 * coverage.share:.1f} %" for coverage in case.coverage(k)]
            z, p = case.z[:, k], case.p_values[k]
            mark = " !" if p < calibration.limit else ""
            cells = [f"{z.mean():+.3f}", f"{(z**2).mean():.3f}", f"{p:.2g}{mark}"]
            rows.append((name, *shares, *cells))
        print_table(("", "in 50 %", "in 90 %", "in 95 %", "mean z", "mean z²", "p of ranks"), rows)
    if calibration.failures:
        first = calibration.failures[0]
        console.print(f"{len(calibration.failures)} more failed; {first.task}: {first.reason}")
    console.print(f"wrote calibration.json and calibration.png in {folder}")
