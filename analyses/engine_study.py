"""The engine of studies under fire: workers and drivers killed, and what tasks and rows cost.

    python analyses/engine_study.py --work FOLDER [--parts fits rows ...]

`kills`: a study of fits on a local dask cluster of two workers. Three times a worker and then the
driver are killed (SIGKILL) at random moments; the same command goes on. Its rows are compared bit
for bit with those of an undisturbed serial run. `throughput`: two workers against one. `tasks`,
`rows`: 2,000 empty tasks and 10,000 rows of fits. `fits`, `diagnoses`: of the example campaign;
`rows` needs a row of `fits`. Writes analyses/results/engine.json, and engine.md, which needs
`tasks` and `kills` and leaves out what else was not measured. Needs the extra `cluster`; a quarter
of an hour of processor time.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from engine_costs import (
    Cost,
    DiagnosisCosts,
    FitCosts,
    costs_of_diagnoses,
    costs_of_fits,
    costs_of_rows,
    costs_of_tasks,
)
from engine_kills import Kill, KilledStudy, drive, study_of_kills
from engine_page import page
from engine_throughput import Throughput, measured_throughput

from bayes_inertia.files import write_atomically

RESULTS = Path(__file__).parent / "results" / "engine.json"
PARTS = ("fits", "diagnoses", "tasks", "rows", "throughput", "kills")
# The page leaves the others out where they were not measured.
NEEDED = ("tasks", "kills")


def stored() -> dict[str, Any]:
    """What earlier runs measured, by part."""
    return json.loads(RESULTS.read_text()) if RESULTS.is_file() else {}


def measured(part: str, options: argparse.Namespace) -> Any:
    """One part, as JSON values."""
    work = options.work.resolve()
    parts: dict[str, Callable[[], Any]] = {
        "fits": lambda: asdict(costs_of_fits(work)),
        "diagnoses": lambda: asdict(costs_of_diagnoses()),
        "tasks": lambda: [asdict(c) for c in costs_of_tasks(options.tasks)],
        "rows": lambda: [
            asdict(c) for c in costs_of_rows(stored()["fits"]["row"], options.rows, work / "rows")
        ],
        "throughput": lambda: [asdict(t) for t in measured_throughput(options.busy)],
        "kills": lambda: asdict(study_of_kills(Path(__file__), options.fits, work)),
    }
    return parts[part]()


def written_page() -> str:
    """The page of all parts."""
    parts = stored()
    kills = parts["kills"] | {"kills": [Kill(**kill) for kill in parts["kills"]["kills"]]}
    return page(
        KilledStudy(**kills),
        [Throughput(**run) for run in parts.get("throughput", ())],
        [Cost(**cost) for part in ("tasks", "rows") for cost in parts.get(part, ())],
        FitCosts(**parts["fits"]) if "fits" in parts else None,
        DiagnosisCosts(**parts["diagnoses"]) if "diagnoses" in parts else None,
    )


def main() -> None:
    """Measure parts, or be one driver of the study that is killed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--work", type=Path, help="folder for the studies")
    parser.add_argument("--parts", nargs="*", choices=PARTS, default=PARTS)
    parser.add_argument("--fits", type=int, default=300)
    parser.add_argument("--tasks", type=int, default=2_000)
    parser.add_argument("--rows", type=int, default=10_000)
    parser.add_argument("--busy", type=int, default=40)
    parser.add_argument("--drive", nargs=3, metavar=("ENGINE", "FITS", "FOLDER"))
    options = parser.parse_args()
    if options.drive:
        engine, fits, folder = options.drive
        drive(engine, int(fits), Path(folder))
        return
    if options.work is None and options.parts:
        parser.error("--work FOLDER is missing")
    for part in sorted(options.parts, key=PARTS.index):
        result = measured(part, options)
        write_atomically(RESULTS, json.dumps(stored() | {part: result}, indent=1) + "\n")
    if set(NEEDED) <= set(stored()):
        write_atomically(RESULTS.with_suffix(".md"), written_page())


if __name__ == "__main__":
    main()
