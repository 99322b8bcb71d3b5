"""`fit-many`: fit every campaign in a folder."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bayes_inertia.app.commands.options import (
    Anyway,
    AsJson,
    AsStated,
    DriveName,
    EffectNames,
    EngineName,
    Jobs,
    OutputFolder,
    SchedulerAddress,
    Seed,
    names_in,
)
from bayes_inertia.app.terminal import plain_console, print_json, print_table, progress_bar, say

if TYPE_CHECKING:
    from bayes_inertia.studies.work import WorkResult

_SHOWN = ("Jxx", "Jyy", "Jzz", "K1", "K2", "K3")


def fit_many_command(
    folder: Annotated[Path, typer.Argument(help="Folder of campaign folders, at any depth.")],
    out: OutputFolder,
    engine: EngineName = None,
    scheduler: SchedulerAddress = None,
    jobs: Jobs = 1,
    effects: EffectNames = "",
    drive: DriveName = None,
    seed: Seed = 0,
    anyway: Anyway = False,
    as_stated: AsStated = False,
    as_json: AsJson = False,
) -> None:
    """Fit every campaign in a folder: a fleet, or a mission's years.

    Writes fits.parquet (a row a campaign) and fit_many.json. Goes on where it was killed, and fits
    what was added or changed, with the same command. Exit code 3 if a campaign failed or its result
    must not be used.
    """
    with progress_bar() as progress:
        progress("checking the campaigns and fitting the first", 0, 0)
        from bayes_inertia.app.fit_many_folder import fit_many, fits_json

        result = fit_many(
            folder,
            out,
            effects=names_in(effects),
            drive=drive,
            seed=seed,
            as_stated=as_stated,
            anyway=anyway,
            engine=engine,
            jobs=jobs,
            scheduler=scheduler,
            progress=progress,
            notice=say,
        )
    if as_json:
        print_json(fits_json(result))
    else:
        show_fits(result, out)
    if result.failures or not all(row["trusted"] for row in result.rows):
        raise typer.Exit(3)


def show_fits(result: WorkResult, folder: Path) -> None:
    """Print a row a campaign."""
    from bayes_inertia.app.fit_many_folder import campaign_of

    console = plain_console()
    cells = (
        (
            row["campaign"],
            "yes" if row["trusted"] else "NO",
            *(_cell(row, name) for name in _SHOWN),
            f"{row['reduced_chi2_total']:.3f}",
        )
        for row in result.rows
    )
    print_table(("campaign", "use", *_SHOWN, "χ²"), cells)
    for row in result.rows:
        if not row["trusted"]:
            console.print(f"{row['campaign']}: {row['reasons']}")
    for failure in result.failures:
        console.print(f"{campaign_of(failure)} could not be fitted: {failure.reason}")
    trusted = sum(row["trusted"] for row in result.rows)
    console.print(
        f"{trusted} of {len(result.rows) + len(result.failures)} campaigns give a result that can "
        "be used; J in kg m², ±: the quoted sd"
    )
    files = "fits.parquet and fit_many.json" if result.rows else "fit_many.json"
    console.print(f"wrote {files} in {folder}")


def _cell(row: dict[str, Any], name: str) -> str:
    from bayes_inertia.report.formatting import NOT_GIVEN, exponent, number, unit_text

    sd = row.get(f"{name}_quoted_sd")  # None of K that the gyro does not have
    if sd is None:
        return NOT_GIVEN
    power = exponent(row[name], sd)
    scale = f" {unit_text('', power)}" if power else ""
    return f"{number(row[name], sd, power)}\n± {number(sd, sd, power)}{scale}"
