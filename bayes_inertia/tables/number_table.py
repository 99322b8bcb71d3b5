"""Tables of a campaign: the wanted columns as numbers, by a reader that guesses nothing.

It reads what the readers of raw logs read, but refuses a text without a header, commas and decimal
points, and columns that are no numbers. pandas would pad short lines, shift the data when a line is
long, rename doubled columns, and not say which line of the file a bad cell is on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import itemgetter
from pathlib import Path

import numpy as np

from bayes_inertia.errors import CampaignError, require
from bayes_inertia.files import read_bytes, text_of
from bayes_inertia.tables.array_files import FileArrays
from bayes_inertia.tables.array_tables import array_column, parquet_arrays
from bayes_inertia.tables.isolated import ArrayKind, read_arrays
from bayes_inertia.tables.table import Column, Table, no_column
from bayes_inertia.tables.text_cells import content_lines, split_rows
from bayes_inertia.tables.text_table import text_column

_WITH_GROUPS: Mapping[str, ArrayKind] = {".h5": "hdf5", ".hdf5": "hdf5", ".mat": "mat"}


_AS_MANY = "give every line as many cells as the header; write decimal points, not commas"


def read_table(path: Path, names: Sequence[str], group: str = "") -> Table:
    """The columns of a .csv, .parquet, .h5, .hdf5 or .mat file, in the file's own units.

    A name with a minus before it is that column with the other sign. Where several groups of an
    HDF5 or MAT file hold the columns, the one called `group` is read.
    """
    stored = list(dict.fromkeys(name.removeprefix("-") for name in names))
    return _stored_table(path, stored, group).signed(names)


def _stored_table(path: Path, names: Sequence[str], group: str) -> Table:
    """The columns as the file has them."""
    label, suffix = str(path), path.suffix.lower()
    if suffix == ".csv":
        return parse_csv(text_of(read_bytes(path), label), names, label)
    if suffix == ".parquet":
        return _columns(parquet_arrays(path), names, label)
    if suffix in _WITH_GROUPS:
        held = read_arrays(path, _WITH_GROUPS[suffix])
        return _columns(held, names, label, _group(held, names, group, label))
    what = f"the suffix {path.suffix!r} is not that of a table"
    advice = f"export it as one of .csv, .parquet, {', '.join(_WITH_GROUPS)}"
    raise CampaignError(what, where=label, advice=advice)


def parse_csv(text: str, names: Sequence[str], label: str) -> Table:
    """The columns of CSV text: a header, commas between cells, decimal points; no comments."""
    written = split_rows(content_lines(text, ())[0], ",", label)
    head = next(written, None)
    if head is None:
        what = "the file is empty"
        advice = "give a header line and the telemetry below it"
        raise CampaignError(what, where=f"{label}, line 1", advice=advice)
    header = head.cells
    _check_header(header, names, f"{label}, line {head.line}")
    wanted = itemgetter(*(header.index(name) for name in names), 0)  # Always a tuple.
    lines, rows = list[int](), list[tuple[str, ...]]()
    for line, cells in written:
        if len(cells) != len(header):
            what = f"{len(cells)} cells, but the header has {len(header)}"
            raise CampaignError(what, where=f"{label}, line {line}", advice=_AS_MANY)
        lines.append(line)
        rows.append(wanted(cells))
    columns = {name: text_column([row[k] for row in rows], ".") for k, name in enumerate(names)}
    return Table(label, columns, np.array(lines, dtype=int)).only(names)


def _check_header(header: Sequence[str], names: Sequence[str], place: str) -> None:
    for separator, word in ((";", "semicolons"), ("\t", "tabs")):
        other = len(header) == 1 and separator in header[0]
        advice = "export with commas between cells and decimal points"
        require(not other, place, f"the cells are separated by {word}", advice)
    doubled = min((name for name in header if name and header.count(name) > 1), default="")
    what = f"two columns are named {doubled!r}"
    require(not doubled, place, what, "give each column its own name")
    _check_present(names, header, place)


def _check_present(names: Sequence[str], available: Sequence[str], place: str) -> None:
    for name in names:
        if name not in available:
            raise no_column(name, available, place, " (named in campaign.toml)")


def _group(held: FileArrays, names: Sequence[str], group: str, label: str) -> str:
    """The path of the group that holds all columns: the only one, or the one called `group`."""
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
    what = f"several groups hold the columns: {', '.join(f'/{path}' for path in full)}"
    advice = "name one group as the slew, or give each slew its own file"
    require(len(full) == 1 or len(named) == 1, label, what, advice)
    return (full if len(full) == 1 else named)[0]


def _columns(held: FileArrays, names: Sequence[str], label: str, group: str = "") -> Table:
    """Arrays of a group of a file as columns of numbers."""
    below = f"{group}/" if group else ""
    if not group:
        _check_present(names, [*held.arrays, *held.closed], label)
    columns: dict[str, Column] = {}
    for name in names:
        where, closed = f"{label}, column {name}", held.closed.get(below + name)
        if closed is not None:
            advice = "store the numbers in the table itself"
            raise CampaignError(closed.replace("a link", "links", 1), where=where, advice=advice)
        values = held.arrays[below + name]
        # MATLAB vectors are matrices of one row or one column.
        one = values.size == max(values.shape, default=1)
        what = "truth values, not numbers" if one else f"shape {values.shape}, no column"
        advice = "store each column as a vector of plain numbers"
        require(one and values.dtype.kind != "b", where, f"has {what}", advice)
        columns[name] = array_column(values.ravel())
        rows = columns[names[0]].values.size
        what = f"has {values.size} rows, but {names[0]} has {rows}"
        require(values.size == rows, where, what, "give all columns one length")
    return Table(label, columns).only(names)
