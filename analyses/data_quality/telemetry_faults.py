"""What dirt in telemetry does to J and K, and whether the package says so.

    python -m analyses.data_quality.telemetry_faults table --work FOLDER [--basilisk FOLDER]
    python -m analyses.data_quality.telemetry_faults random hidden diagnose fit --work FOLDER
    python -m analyses.data_quality.telemetry_faults page

Parts: `table` (every kind of dirt alone, three spacecraft, against the clean twin and the truth),
`random` (200 random combinations), `uncleaned` (the same without cleaning: the negative control),
`hidden` (a missing physical effect, alone and with dirt: does the cleaning hide it?), `throws`
(real bodies thrown by hand, which no model here explains: nothing may be trusted), `diagnose` and
`fit` (the package's own calls on a few). A part goes on where it was stopped; cases that have
rows are not run again. `--label` keeps the rows of another version beside. `page` writes
results/data_quality/telemetry_faults.md.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from analyses import aloud, results_of
from analyses.data_quality import cases
from analyses.data_quality.page import write_page
from bayes_inertia.files import write_atomically
from bayes_inertia.studies.work import Row, Work

RESULTS = results_of(__file__) / "telemetry_faults.json"


def stored() -> dict[str, list[dict]]:
    """All rows so far, by part."""
    return json.loads(RESULTS.read_text()) if RESULTS.is_file() else {}


def store(part: str, rows: list[dict]) -> None:
    """Replace the rows of one part."""
    lines = ",\n".join(
        f" {json.dumps(name)}: [\n  " + ",\n  ".join(json.dumps(row) for row in content) + "\n ]"
        for name, content in sorted((stored() | {part: rows}).items())
    )
    write_atomically(RESULTS, "{\n" + lines + "\n}\n")


@dataclass(frozen=True)
class DirtyCase:
    """The task: one case of a part. Ids are the labels of the cases."""

    part: str
    work: Path
    basilisk: Path | None
    delft: Path | None

    def __call__(self, task_id: str, seed: np.random.SeedSequence) -> Row:
        """Its row; each case has a seed of its own."""
        chosen = cases.cases(self.part, self.basilisk, self.delft)
        case = next(case for case in chosen if case.label == task_id)
        return {"line": json.dumps(cases.row_of(case, self.work))}


def run_part(part: str, options: argparse.Namespace) -> None:
    """Run the cases of a part that have no row yet."""
    name = f"{part}.{options.label}" if options.label else part
    rows = [] if options.again else stored().get(name, [])
    done = {row["case"] for row in rows}
    chosen = cases.cases(part, options.basilisk, options.delft)[: options.count]
    labels = [case.label for case in chosen]
    ids = tuple(x for x in labels if x not in done and options.only in x)
    if not ids:
        return
    task = DirtyCase(part, options.work, options.basilisk, options.delft)
    execution = aloud(options.jobs)
    result = execution.run(Work("cases", task, ids, options={"part": name}), options.work / name)
    store(name, rows + [json.loads(row["line"]) for row in result.rows])


def main() -> None:
    """Run parts of the study."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("parts", nargs="+", choices=[*cases.PARTS, "page"])
    parser.add_argument("--work", type=Path, default=Path("dirt_work"), help="for simulated data")
    parser.add_argument("--basilisk", type=Path, help="folder of Basilisk campaigns")
    parser.add_argument("--delft", type=Path, help="folder of the thrown bodies")
    parser.add_argument("--label", default="", help="kept with the rows, for another version")
    parser.add_argument("--jobs", type=int, default=1, help="worker processes")
    parser.add_argument("--count", type=int, help="so many cases only")
    parser.add_argument("--only", default="", help="cases with this text in their label")
    parser.add_argument("--again", action="store_true", help="forget the part's earlier rows")
    options = parser.parse_args()
    for part in options.parts:
        if part == "page":
            write_page(stored(), RESULTS.with_suffix(".md"))
        else:
            run_part(part, options)


if __name__ == "__main__":
    main()
