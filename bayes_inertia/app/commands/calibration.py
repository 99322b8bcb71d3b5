"""`study calibration`: are posteriors right over campaigns drawn from the prior?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from bayes_inertia.app.terminal import (
    headed,
    narrow_table,
    plain_console,
    print_json_file,
    progress_bar,
    say,
)

if TYPE_CHECKING:
    from bayes_inertia.studies.calibration import Calibration
    from bayes_inertia.studies.workers import Engine


def calibrate(
    out: Path,
    *,
    fits: int,
    cases: list[str],
    seed: int,
    engine: Engine | None,
    jobs: int,
    scheduler: str | None,
    as_json: bool = False,
) -> None:
    """Run a calibration, print it, and exit with 3 if it is rejected or fits failed."""
    from bayes_inertia.app.calibration_folder import run_calibration
    from bayes_inertia.studies.engine import Execution

    with progress_bar() as progress:
        progress("flying and fitting the first campaigns", 0, 0)
        execution = Execution(engine, jobs, scheduler, progress, say)
        calibration = run_calibration(out, fits=fits, cases=cases, seed=seed, execution=execution)
    if as_json:
        print_json_file(out / "calibration.json")
    else:
        show_calibration(calibration, out)
    if calibration.rejected or calibration.failures:
        raise typer.Exit(3)


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
        headings = ("in 50 %", "in 90 %", "in 95 %", "mean z", "mean z²", "p of ranks")
        table = narrow_table(console, "", *headings)
        for k, name in enumerate(QUANTITIES):
            shares = [f"{100.0 * coverage.share:.1f} %" for coverage in case.coverage(k)]
            z, p = case.z[:, k], case.p_values[k]
            mark = " !" if p < calibration.limit else ""
            cells = [f"{z.mean():+.3f}", f"{(z**2).mean():.3f}", f"{p:.2g}{mark}"]
            table.add_row(name, *shares, *cells)
        console.print(table)
    if calibration.failures:
        first = calibration.failures[0]
        console.print(f"{len(calibration.failures)} more failed; {first.task}: {first.reason}")
    console.print(f"wrote calibration.json and calibration.png in {folder}")
