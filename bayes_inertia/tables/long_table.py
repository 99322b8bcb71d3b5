"""Tables with one row a parameter, as YAMCS, InfluxDB and Grafana export: one row a time again."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayes_inertia.tables.raw_table import EMPTY_CELLS, RawColumn, RawTable
from bayes_inertia.tables.text_table import text_column
from bayes_inertia.tables.time_columns import time_names

# Names in small letters, without signs at their ends.
_PARAMETER = re.compile(
    r"(.*[ _.])?(parameter|param|field|metric|mnemonic|channel|signal|variable|series|tag|key|item|"
    r"point|measurand|measurement|sensor|quantity|topic|name|id)([ _]?(name|id))?"
)
_VALUE = re.compile(r"(.*[ _.])?(value|val|reading)s?")
_RAW = re.compile(r"(.*[ _.])?raw[ _.]?.*")
_UNIT = re.compile(r"(.*[ _.])?units?")
_NO_LABEL = re.compile(r".*(valid|flag|status|quality|state|alarm|limit|severity|unit|time|date).*")
_MOST_NAMES = 2000  # More parameters than these are texts of another kind.


def one_row_a_time(table: RawTable) -> RawTable:
    """A table whose rows each hold one parameter, with a column a parameter; others as they are.

    Examples
    --------
    >>> names = np.array(["wx", "wy", "wx"], dtype=np.dtypes.StringDType())
    >>> columns = {"t": [0.0, 0.0, 0.5], "parameter": names, "value": [1.0, 2.0, 3.0]}
    >>> made = {name: RawColumn(np.array(v)) for name, v in columns.items()}
    >>> wide = one_row_a_time(RawTable("a.csv", made))
    >>> wide.stack(["t", "wx", "wy"]).tolist()
    [[0.0, 1.0, 2.0], [0.5, 3.0, nan]]
    """
    bare = {name: name.lower().strip("_ ") for name in table.columns}
    parameters = [name for name in bare if _PARAMETER.fullmatch(bare[name])]
    values = [name for name in bare if _VALUE.fullmatch(bare[name])]
    values.sort(key=lambda name: bool(_RAW.fullmatch(bare[name])))
    times = time_names(table)
    parameters = [name for name in parameters if name not in (*times, *values)]
    if not (parameters and values and times and table.rows):
        return table
    named = _named_by(table, parameters, {*times, *values})
    labels = [".".join(cells) for cells in zip(*map(_texts, _columns(table, named)), strict=True)]
    if len(set(labels)) > _MOST_NAMES or set(labels) & set(times):
        return table
    cells = [c.values if c.exact is None else c.exact for c in _columns(table, times)]
    stamps = list(zip(*(column.tolist() for column in cells), strict=True))
    rows, first = _rows(stamps, labels)
    made = {name: _picked(table.column(name), first) for name in times}
    units = next((_texts(c) for n, c in table.columns.items() if _UNIT.fullmatch(bare[n])), None)
    of_label = np.array(labels)
    for label in dict.fromkeys(labels):
        own = np.flatnonzero(of_label == label)
        made[label] = _spread(
            table.column(values[0]), own, rows[own], len(first), _only_unit(units, own)
        )
    note = f"one row a parameter ({', '.join(named)}): {len(made) - len(times)} became columns"
    lines = None if table.lines is None else table.lines[first]
    return replace(table, columns=made, lines=lines, notes=(*table.notes, note))


def _columns(table: RawTable, names: Sequence[str]) -> list[RawColumn]:
    return [table.column(name) for name in names]


def _texts(column: RawColumn) -> list[str]:
    """The cells of a column as texts."""
    values = column.values if column.exact is None else column.exact
    return [str(cell).strip() for cell in values.tolist()]


def _named_by(table: RawTable, parameters: Sequence[str], others: set[str]) -> list[str]:
    """The columns that together name the parameter of a row; the parameter itself comes last."""
    tags = [
        name
        for name, column in table.columns.items()
        if name not in (*parameters, *others)
        and column.is_text
        and not _NO_LABEL.fullmatch(name.lower())
    ]
    texts = [n for n in parameters if table.column(n).is_text] or list(parameters[:1])
    several = [name for name in (*tags, *texts[::-1]) if len(set(_texts(table.column(name)))) > 1]
    return several or texts[:1]


def _rows(stamps: Sequence[tuple], labels: Sequence[str]) -> tuple[np.ndarray, list[int]]:
    """The new row of each old one, and the first old row of each new one.

    What one parameter reads twice at one time makes two rows, for later steps to judge. Where one
    parameter follows the other the rows are brought into the order of their times, unless the
    times of a parameter go back themselves.
    """
    counts: dict[tuple, int] = {}
    members: dict[tuple, list[int]] = {}
    last: dict[str, tuple] = {}
    forward = True
    for index, (stamp, label) in enumerate(zip(stamps, labels, strict=True)):
        counts[stamp, label] = counts.get((stamp, label), -1) + 1
        members.setdefault((stamp, counts[stamp, label]), []).append(index)
        forward = forward and last.get(label, stamp) <= stamp
        last[label] = stamp
    rows, first = np.zeros(len(labels), dtype=int), []
    for number, key in enumerate(sorted(members) if forward else members):
        rows[members[key]] = number
        first.append(members[key][0])
    return rows, first


def _picked(column: RawColumn, rows: Sequence[int]) -> RawColumn:
    exact = None if column.exact is None else column.exact[rows]
    return replace(column, values=column.values[rows], exact=exact)


def _spread(
    column: RawColumn, own: np.ndarray, rows: np.ndarray, count: int, unit: str
) -> RawColumn:
    """The readings of one parameter in their rows; no reading in the others."""
    if not column.is_text:
        values = np.full(count, np.nan)
        values[rows] = column.values[own]
        return RawColumn(values, unit or column.unit, column.single)
    cells = [""] * count
    for row, cell in zip(rows.tolist(), column.values[own].tolist(), strict=True):
        cells[row] = cell
    return text_column(cells, ",", unit or column.unit)


def _only_unit(units: Sequence[str] | None, own: np.ndarray) -> str:
    """The unit of a parameter; "" where its rows state none, or several."""
    stated = {units[i] for i in own.tolist()} - {""} if units else set()
    stated = {unit for unit in stated if unit.lower() not in EMPTY_CELLS}
    return stated.pop() if len(stated) == 1 else ""
