"""Tables of telemetry: CSV, Parquet, HDF5 and MAT files read into columns of numbers.

CSV is parsed here with the standard library and not with pandas: pandas pads short lines, shifts
the data when a line is long, renames doubled columns and cannot say which line of the file a bad
cell is on; it also takes half a second to import.
"""

from __future__ import annotations

import csv
import io
import math
import re
from array import array
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from bayes_inertia.campaign import binary_tables
from bayes_inertia.campaign.table import Table, check_columns_present
from bayes_inertia.errors import CampaignError
from bayes_inertia.files import read_bytes, text_of


def read_table(path: Path, names: Sequence[str], group: str = "") -> Table:
    """The columns of a table whose format its suffix tells.

    Parameters
    ----------
    path : Path
        A .csv, .parquet, .h5, .hdf5 or .mat file.
    names : sequence of str
        The columns.
    group : str, optional
        Where several groups of an HDF5 or MAT file hold the columns, the one of this name is read.

    Returns
    -------
    Table
        The columns, in the file's own units.

    Raises
    ------
    CampaignError
        If the file is no rectangular table of finite numbers and empty cells; the error names the
        line.
    """
    readers: dict[str, Callable[[], Table]] = {
        ".csv": lambda: parse_csv(text_of(read_bytes(path), str(path)), names, str(path)),
        ".parquet": lambda: binary_tables.read_parquet(path, names),
        ".h5": lambda: binary_tables.read_hdf5(path, names, group),
        ".hdf5": lambda: binary_tables.read_hdf5(path, names, group),
        ".mat": lambda: binary_tables.read_mat(path, names, group),
    }
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise CampaignError(
            f"the suffix {path.suffix!r} is not that of a table",
            where=str(path),
            advice=f"export it as one of {', '.join(readers)}",
        )
    table = reader()
    for name, values in table.columns.items():
        if np.isinf(values).any():
            row = int(np.argmax(np.isinf(values)))
            raise CampaignError(
                "an infinite value",
                where=table.place(row, name),
                advice="leave the cell empty, or remove the row",
            )
    return table


def _rows(text: str, label: str) -> Iterator[tuple[int, list[str]]]:
    """The rows of CSV text that are not empty, each with the line where it starts."""
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    first = 1
    try:
        for cells in reader:
            # A quoted cell may span lines: the row is where it starts.
            line, first = first, reader.line_num + 1
            if cells:
                yield line, cells
    except csv.Error as error:
        raise CampaignError(
            f"not CSV ({error})",
            where=f"{label}, line {first}",
            advice="close every quote, or remove the quotes",
        ) from error


def parse_csv(text: str, names: Sequence[str], label: str) -> Table:
    """The columns of CSV text: a header, commas between cells, decimal points.

    An empty cell is NaN. Empty lines are skipped. Text is welcome in columns that are not wanted.

    Parameters
    ----------
    text : str
        The content of the file.
    names : sequence of str
        The columns.
    label : str
        The file, as messages name it.

    Returns
    -------
    Table
        The columns, in the file's own units.

    Raises
    ------
    CampaignError
        If a line has too few or too many cells, or a cell is no number; the error names the line.

    Examples
    --------
    >>> text = "t,mode,w\\n0,idle,1\\n1,slew,\\n"
    >>> parse_csv(text, ["t", "w"], "a.csv").stack(["t", "w"]).tolist()
    [[0.0, 1.0], [1.0, nan]]
    """
    rows = _rows(text, label)
    header_line, cells = next(rows, (1, None))
    if cells is None:
        raise CampaignError(
            "the file is empty",
            where=f"{label}, line 1",
            advice="give a header line and the telemetry below it",
        )
    header = _header(cells, names, f"{label}, line {header_line}")
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
    data = (
        np.frombuffer(values, dtype=float).reshape(len(lines), len(picked))
        if lines
        else np.zeros((0, len(picked)))
    )
    return Table(
        label, {name: data[:, i].copy() for i, name in enumerate(names)}, np.array(lines, dtype=int)
    )


def _header(cells: list[str], names: Sequence[str], place: str) -> list[str]:
    header = [cell.strip() for cell in cells]
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
    check_columns_present(names, header, place)
    return header


def _number(cell: str, label: str, line: int, column: str) -> float:
    if not cell or cell.isspace():
        return math.nan
    try:
        # Python reads 1_000 as a number; in telemetry it is a damaged cell.
        if "_" not in cell:
            return float(cell)
    except ValueError:
        pass
    advice = "write a number, or leave the cell empty"
    if re.fullmatch(r"\s*[-+]?\d*,\d+([eE][-+]?\d+)?\s*", cell):
        advice = "write a decimal point, not a comma"
    elif re.search(r"\d[-/:T]\d", cell):
        advice = "write times as seconds (or another unit of [columns]) from an epoch, not as dates"
    shown = cell if len(cell) <= 40 else cell[:37] + "..."
    raise CampaignError(
        f"{shown!r} is not a number", where=f"{label}, line {line}, column {column}", advice=advice
    )
