"""Tables of a campaign: the wanted columns as floats, by a reader that guesses nothing.

It reads what the readers of raw logs read, but refuses a text without a header, commas and decimal
points, and columns that are no numbers. pandas would pad short lines, shift the data when a line is
long, rename doubled columns, and not say which line of the file a bad cell is on.
"""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bayes_inertia.errors import CampaignError
from bayes_inertia.files import read_bytes, text_of
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.tables.array_files import FileArrays
from bayes_inertia.tables.array_tables import parquet_arrays
from bayes_inertia.tables.isolated import read_arrays
from bayes_inertia.tables.raw_table import no_column, row_name, shortened
from bayes_inertia.tables.text_cells import content_lines, split_rows

_VECTORS = "store each column as a vector of plain numbers"


@array_dataclass
class Table:
    """Some columns of a table, as 64-bit floats with NaN for empty cells.

    >>> Table("a.csv", {"t": np.zeros(2)}, np.array([2, 4])).place(1, "t")
    'a.csv, line 4, column t'
    """

    label: str  # The file, as messages name it
    columns: dict[str, np.ndarray]  # Values by column name, in the file's own units
    # (rows,) of int: line numbers as a text editor shows them; None for files without lines
    lines: np.ndarray | None = None
    single: frozenset[str] = frozenset()  # Columns that the file stores as 32-bit floats

    def place(self, row: int, column: str | None = None) -> str:
        """File, line (or row from 1) and column of a cell, for a message."""
        return f"{self.label}, {self.row(row)}{f', column {column}' if column else ''}"

    def row(self, row: int) -> str:
        """A row as people count: "line 12" of a text file, else "row 11"."""
        return row_name(self.lines, row)

    def stack(self, names: Sequence[str]) -> np.ndarray:
        """(rows, len(names)) array of columns, in the file's own units."""
        return np.stack([self.columns[name] for name in names], axis=1)

    def only(self, names: Sequence[str]) -> Table:
        """The table with some of its columns, refused if a number is infinite."""
        return replace(self, columns={name: self.columns[name] for name in names}).checked()

    def checked(self) -> Table:
        """The table itself, refused if a number is infinite."""
        for name, values in self.columns.items():
            if np.isinf(values).any():
                raise CampaignError(
                    "an infinite value",
                    where=self.place(int(np.argmax(np.isinf(values))), name),
                    advice="leave the cell empty, or remove the row",
                )
        return self

    def csv(self) -> str:
        """Text of CSV with all digits; NaN becomes an empty cell."""
        cells = np.stack(list(self.columns.values()), axis=1).tolist()
        rows = [["" if math.isnan(cell) else repr(cell) for cell in row] for row in cells]
        return "".join(",".join(row) + "\n" for row in [list(self.columns), *rows])


def read_table(path: Path, names: Sequence[str], group: str = "") -> Table:
    """The columns of a .csv, .parquet, .h5, .hdf5 or .mat file, in the file's own units.

    Where several groups of an HDF5 or MAT file hold the columns, the one called `group` is read.
    """
    label = str(path)
    readers: dict[str, Callable[[], Table]] = {
        ".csv": lambda: parse_csv(text_of(read_bytes(path), label), names, label),
        ".parquet": lambda: _columns(parquet_arrays(path), names, label),
        ".h5": lambda: _of_group(read_arrays(path, "hdf5"), names, group, label),
        ".hdf5": lambda: _of_group(read_arrays(path, "hdf5"), names, group, label),
        ".mat": lambda: _of_group(read_arrays(path, "mat"), names, group, label),
    }
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise CampaignError(
            f"the suffix {path.suffix!r} is not that of a table",
            where=label,
            advice=f"export it as one of {', '.join(readers)}",
        )
    return reader().checked()


def parse_csv(text: str, names: Sequence[str], label: str) -> Table:
    """The columns of CSV text: a header, commas between cells, decimal points.

    An empty cell is NaN. Empty lines are skipped. Text is welcome in columns that are not wanted.

    >>> text = "t,mode,w\\n0,idle,1\\n1,slew,\\n"
    >>> parse_csv(text, ["t", "w"], "a.csv").stack(["t", "w"]).tolist()
    [[0.0, 1.0], [1.0, nan]]
    """
    rows = split_rows(content_lines(text, ())[0], ",", label)
    head = next(rows, None)
    if head is None:
        raise CampaignError(
            "the file is empty",
            where=f"{label}, line 1",
            advice="give a header line and the telemetry below it",
        )
    header = list(head.cells)
    _check_header(header, names, f"{label}, line {head.line}")
    picked = [header.index(name) for name in names]
    values, lines = array("d"), array("q")
    for line, cells in rows:
        if len(cells) != len(header):
            raise CampaignError(
                f"{len(cells)} cells, but the header has {len(header)}",
                where=f"{label}, line {line}",
                advice="give every line as many cells as the header; "
                "write decimal points, not commas",
            )
        values.extend([_number(cells[i], label, line, header[i]) for i in picked])
        lines.append(line)
    data = np.array(values).reshape(len(lines), len(picked))
    return Table(label, dict(zip(names, data.T, strict=True)), np.array(lines, dtype=int))


def _check_header(header: list[str], names: Sequence[str], place: str) -> None:
    for separator, word in ((";", "semicolons"), ("\t", "tabs")):
        if len(header) == 1 and separator in header[0]:
            raise CampaignError(
                f"the cells are separated by {word}",
                where=place,
                advice="export with commas between cells and decimal points",
            )
    doubled = sorted({name for name in header if name and header.count(name) > 1})
    if doubled:
        raise CampaignError(
            f"two columns are named {doubled[0]!r}",
            where=place,
            advice="give each column its own name",
        )
    _check_present(names, header, place)


def _check_present(names: Sequence[str], available: Sequence[str], place: str) -> None:
    for name in names:
        if name not in available:
            raise no_column(name, available, place, " (named in [columns])")


def _number(cell: str, label: str, line: int, column: str) -> float:
    if not cell:
        return math.nan
    try:
        # Python reads 1_000 as a number; in telemetry it is a damaged cell.
        if "_" not in cell:
            return float(cell)
    except ValueError:
        pass
    advice = "write a number, or leave the cell empty"
    if re.fullmatch(r"[-+]?\d*,\d+([eE][-+]?\d+)?", cell):
        advice = "write a decimal point, not a comma"
    elif re.search(r"\d[-/:T]\d", cell):
        advice = "write times as seconds (or another unit of [columns]) from an epoch, not as dates"
    raise CampaignError(
        f"{shortened(cell)!r} is not a number",
        where=f"{label}, line {line}, column {column}",
        advice=advice,
    )


def _of_group(held: FileArrays, names: Sequence[str], group: str, label: str) -> Table:
    """The columns of the group that holds them all: the only one, or the one called `group`."""
    groups: dict[str, list[str]] = {}
    for place in (*held.arrays, *held.closed):
        parent, _, name = place.rpartition("/")
        groups.setdefault(parent, []).append(name)
    full = [path for path, members in groups.items() if set(names) <= set(members)]
    if not full:
        best = max(groups, key=lambda path: len(set(names) & set(groups[path])), default="")
        where = f"{label}, group /{best}" if groups else label
        _check_present(names, groups.get(best, []), where)
    named = [path for path in full if path.rpartition("/")[2] == group]
    if len(full) > 1 and len(named) != 1:
        raise CampaignError(
            f"several groups hold the columns: {', '.join(f'/{path}' for path in full)}",
            where=label,
            advice="name one group as the slew, or give each slew its own file",
        )
    chosen = (full if len(full) == 1 else named)[0]
    return _columns(held, names, label, f"{chosen}/" if chosen else "")


def _columns(held: FileArrays, names: Sequence[str], label: str, prefix: str = "") -> Table:
    """Arrays of a file as columns of numbers."""
    _check_present(names, [*held.arrays, *held.closed] if not prefix else names, label)
    columns: dict[str, np.ndarray] = {}
    for name in names:
        where = f"{label}, column {name}"
        if prefix + name in held.closed:
            raise CampaignError(
                held.closed[prefix + name].replace("a link", "links", 1),
                where=where,
                advice="store the numbers in the table itself",
            )
        values = held.arrays[prefix + name]
        if values.dtype.kind not in "iuf":
            raise CampaignError("does not hold numbers", where=where, advice=_VECTORS)
        # MATLAB vectors are matrices of one row or one column.
        if values.size != max(values.shape, default=1):
            raise CampaignError(
                f"has shape {values.shape}, not that of one column", where=where, advice=_VECTORS
            )
        columns[name] = values.ravel()
        rows = columns[names[0]].size
        if values.size != rows:
            raise CampaignError(
                f"has {values.size} rows, but {names[0]} has {rows}",
                where=where,
                advice="give all columns one length",
            )
    single = frozenset(name for name, values in columns.items() if values.dtype == np.float32)
    numbers = {name: values.astype(float) for name, values in columns.items()}
    # Damage can make NaNs of which every calculation would warn.
    quiet = {name: np.where(np.isnan(v), np.nan, v) for name, v in numbers.items()}
    return Table(label, quiet, single=single)
