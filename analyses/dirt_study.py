"""What dirt in telemetry does to J and K, and whether the package says so.

    python analyses/dirt_study.py table --work FOLDER [--basilisk FOLDER]
    python analyses/dirt_study.py random hidden diagnose fit --work FOLDER
    python analyses/dirt_study.py page

Parts: `table` (every kind of dirt alone, three spacecraft, against the clean twin and the truth),
`random` (200 random combinations), `uncleaned` (the same without cleaning: the negative control),
`hidden` (a missing physical effect, alone and with dirt: does the cleaning hide it?), `throws`
(real bodies thrown by hand, which no model here explains: nothing may be trusted), `diagnose` and
`fit` (the package's own calls on a few). A part goes on where it was stopped; `--label` keeps
the rows of another version beside. `page` writes results/dirt_study.md.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import dirt_cases
from dirt_page import write_page

from bayes_inertia.files import write_atomically

RESULTS = Path(__file__).parent / "results" / "dirt_study.json"


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


def run_part(part: str, options: argparse.Namespace) -> None:
    """Run the cases of a part that have no row yet."""
    name = f"{part}.{options.label}" if options.label else part
    rows = [] if options.again else stored().get(name, [])
    twins: dict = {}
    done, end = {row["case"] for row in rows}, time.time() + 60.0 * options.minutes
    for case in dirt_cases.cases(part, options.basilisk, options.delft)[: options.count]:
        if case.label in done or options.only not in case.label:
            continue
        if time.time() > end:
            print("time is up; run again to go on")
            break
        row = dirt_cases.row_of(case, options.work, twins)
        rows.append(row)
        store(name, rows)
        keys = ("status", "policy", "shift", "z", "verdict", "named", "says", "seconds")
        shown = [row[k] if not isinstance(row[k], float) else round(row[k], 2) for k in keys]
        print(case.label, *[str(x)[:110] for x in shown], sep=" | ", flush=True)


def main() -> None:
    """Run parts of the study."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("parts", nargs="+", choices=[*dirt_cases.PARTS, "page"])
    parser.add_argument("--work", type=Path, default=Path("dirt_work"), help="for simulated data")
    parser.add_argument("--basilisk", type=Path, help="folder of Basilisk campaigns")
    parser.add_argument("--delft", type=Path, help="folder of the thrown bodies")
    parser.add_argument("--label", default="", help="kept with the rows, for another version")
    parser.add_argument("--minutes", type=float, default=60.0, help="stop after this time")
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
