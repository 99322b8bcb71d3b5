"""The table that remembers: one row of ratios for each run of `benchmark.py`, never a time.

Ratios are taken within one run on one core, so that rows of different machines can be compared.
The check compares the last two rows.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bayes_inertia.files import write_atomically

HEAD = ("version", "date")
# By how much a ratio may become worse from one row to the next.
ALLOWED = 0.2


@dataclass(frozen=True)
class Ratio:
    """One column of the table."""

    name: str  # of the column
    says: str  # what it is
    more_is_better: bool = False  # false: less is


RATIOS = (
    Ratio("evaluation_over_kernel", "an evaluation over the hand-written kernel, 4 Hz"),
    Ratio("evaluation_4khz_over_400hz", "an evaluation at 4 kHz over 400 Hz of the same motion"),
    Ratio("evaluation_8hz_over_2hz", "an evaluation of four times the rows"),
    Ratio("evaluation_20_over_5_slews", "an evaluation of 20 slews over 5 (4: a straight line)"),
    Ratio("evaluation_8_effects_over_none", "an evaluation with eight effects over none"),
    Ratio("ess_per_evaluation", "effective samples an evaluation", more_is_better=True),
    Ratio("ess_per_second_over_nuts", "effective samples a second over NUTS", more_is_better=True),
    Ratio("ess_per_second_over_stretch", "the same over StretchMove", more_is_better=True),
    Ratio("ess_per_second_over_de", "the same over DEMove", more_is_better=True),
    Ratio("check_over_jax", "the command check over importing JAX"),
    Ratio("cold_fit_over_jax", "the command fit over importing JAX, no compiled code kept"),
    Ratio("warm_fit_over_jax", "the same for the second campaign of the same shape"),
    Ratio("two_joblib_workers_over_one", "tasks a second, two workers over one", True),
    Ratio("two_dask_workers_over_one", "the same on a local dask cluster", True),
)


def read_history(path: Path) -> list[dict[str, str]]:
    """The rows of the table, oldest first; none where there is no file."""
    if not path.is_file():
        return []
    return list(csv.DictReader(io.StringIO(path.read_text())))


def append_row(path: Path, version: str, date: str, ratios: Mapping[str, float]) -> None:
    """Add a row. What was not measured stays empty.

    `path`: of the table. `version`, `date`: of the package, and of the run. `ratios`: by the names
    of `RATIOS`.
    """
    names = [ratio.name for ratio in RATIOS]
    unknown = sorted(set(ratios) - set(names))
    if unknown:
        raise ValueError(f"no column {unknown[0]}: add it to RATIOS")
    row = {"version": version, "date": date} | {k: f"{v:.4g}" for k, v in ratios.items()}
    sink = io.StringIO()
    writer = csv.DictWriter(
        sink, [*HEAD, *names], restval="", extrasaction="ignore", lineterminator="\n"
    )
    writer.writeheader()
    writer.writerows([*read_history(path), row])
    write_atomically(path, sink.getvalue())


def worse_ratios(rows: Sequence[Mapping[str, str]]) -> list[str]:
    """What became worse by more than a fifth between the last two rows, in words.

    `rows`: from `read_history`. What one of the two lacks is not compared.
    """
    if len(rows) < 2:
        return []
    before, after = rows[-2:]
    complaints = []
    for ratio in RATIOS:
        old, new = (float(row.get(ratio.name) or "nan") for row in (before, after))
        worse = old / new if ratio.more_is_better else new / old
        if worse > 1.0 + ALLOWED:
            complaints.append(
                f"{ratio.name}: {new:g} after {old:g} ({ratio.says}), {100 * worse - 100:.0f} % "
                "worse"
            )
    return complaints


def history_table(rows: Sequence[Mapping[str, str]], shown: int = 6) -> list[str]:
    """The last rows as Markdown, a line a ratio."""
    last = rows[-shown:]
    heads = [f"{row['version']}, {row['date']}" for row in last]
    lines = [f"| ratio | better | {' | '.join(heads)} |", "|---" * (len(last) + 2) + "|"]
    for ratio in RATIOS:
        better = "more" if ratio.more_is_better else "less"
        cells = " | ".join(row.get(ratio.name) or "" for row in last)
        lines.append(f"| {ratio.says} | {better} | {cells} |")
    return lines
