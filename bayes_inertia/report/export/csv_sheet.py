"""The sheet for an upload of control parameters: old, new, change, correction slew, as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator

from bayes_inertia.report.export.content import (
    ExportedCorrection,
    ExportedParameter,
    ExportedResult,
    comment_lines,
    one_line,
    rounded,
)
from bayes_inertia.report.formatting import arcsec

_COLUMNS = (
    "parameter",
    "unit",
    "old",
    "new",
    "sd",
    "change",
    "change_in_old_sd",
    "change_in_new_sd",
    "low_90",
    "high_90",
    "determined",
)


def csv_text(result: ExportedResult) -> str:
    """A row a parameter, rounded where its sd has its second digit; comments begin with `#`."""
    kind = "with" if result.includes_wheel_spin else "without"
    more = [
        f"old: known before flight; sd: the quoted one; J {kind} the wheels' spin inertia, "
        "elements of the tensor"
    ]
    if result.correction is not None:
        more.append(f"correction slew: {result.correction.says}")
    file = io.StringIO()
    for line in comment_lines(result, *more):
        file.write(f"# {line}\n")
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(_COLUMNS)
    writer.writerows(_parameter_cells(p) for p in result.parameters)
    if result.correction is not None:
        writer.writerows(_correction_rows(result.correction))
    return file.getvalue()


def _parameter_cells(p: ExportedParameter) -> list[str]:
    numbers = [rounded(x, p.sd) for x in (p.old, p.new, p.sd, p.change)]
    return [
        one_line(p.name),
        p.unit,
        *numbers,
        *(f"{p.change / sd:+.2f}" if sd > 0.0 else "" for sd in (p.old_sd, p.sd)),
        rounded(p.low, p.sd),
        rounded(p.high, p.sd),
        p.determined,
    ]


def _correction_rows(correction: ExportedCorrection) -> Iterator[list[str]]:
    """Rows "old" before and "new" after the upload."""
    pairs = zip(("median", "q95"), correction.before, correction.after, strict=True)
    for key, before, after in pairs:
        cells = [f"{arcsec(angle):.3g}" for angle in (before, after, after - before)]
        name = f"correction_slew_{correction.axis}_{key}"
        yield [name, "arcsec", cells[0], cells[1], "", cells[2], *[""] * 5]
