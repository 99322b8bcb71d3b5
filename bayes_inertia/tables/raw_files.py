"""The reader of raw logs: the format is told by content and suffix, each has its own file."""

from __future__ import annotations

import re
import zipfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np

from bayes_inertia.errors import CampaignError, require
from bayes_inertia.files import by_word, vocabulary
from bayes_inertia.tables import array_tables
from bayes_inertia.tables.aem_file import aem_segments, is_aem, read_aem, refuse_other_messages
from bayes_inertia.tables.array_files import FileArrays
from bayes_inertia.tables.isolated import ArrayKind, read_arrays
from bayes_inertia.tables.json_lines import json_arrays, read_json_lines
from bayes_inertia.tables.limits import LIMITS
from bayes_inertia.tables.table import Column, Table, is_empty
from bayes_inertia.tables.text_cells import TextOptions, content, packing
from bayes_inertia.tables.text_table import logged_column, read_42, read_text_table
from bayes_inertia.tables.time_stamps import time_names

_NAMES = {key: re.compile(name) for key, name in vocabulary("tables")["one_row_a_time"].items()}


def one_row_a_time(table: Table) -> Table:
    """A table whose rows each hold one parameter, with a column a parameter; others as they are."""
    bare = {name: name.lower().strip("_ ") for name in table.columns}
    parameters = [name for name in bare if _NAMES["parameter"].fullmatch(bare[name])]
    values = [name for name in bare if _NAMES["value"].fullmatch(bare[name])]
    values.sort(key=lambda name: bool(_NAMES["raw"].fullmatch(bare[name])))
    times = time_names(table)
    parameters = [name for name in parameters if name not in (*times, *values)]
    if not (parameters and values and times and table.rows):
        return table
    named = _named_by(table, parameters, {*times, *values})
    tags = [table.column(name).texts for name in named]
    of_units = [name for name in bare if _NAMES["unit"].fullmatch(bare[name])]
    units = table.column(of_units[0]).texts if of_units else []
    labels = _with_units([".".join(cells) for cells in zip(*tags, strict=True)], units)
    if len(set(labels)) > LIMITS.most_parameters or set(labels) & set(times):
        return table
    columns = [table.column(name) for name in times]
    cells = [c.values if c.exact is None else c.exact for c in columns]
    stamps = list(zip(*(column.tolist() for column in cells), strict=True))
    rows, first = _rows(stamps, labels)
    made = {name: table.column(name).only(first) for name in times}
    of_label = np.array(labels)
    for label in dict.fromkeys(labels):
        own = np.flatnonzero(of_label == label)
        unit = next((units[i] for i in own.tolist() if units and not is_empty(units[i])), "")
        made[label] = _spread(table.column(values[0]), own, rows[own], len(first), unit)
    note = f"one row a parameter ({', '.join(named)}): {len(made) - len(times)} became columns"
    return replace(table.taking(first), columns=made, notes=(*table.notes, note))


def _named_by(table: Table, parameters: Sequence[str], others: set[str]) -> list[str]:
    """The columns that together name the parameter of a row; the parameter itself comes last."""
    tags = [
        name
        for name, column in table.columns.items()
        if name not in (*parameters, *others)
        and column.is_text
        and not _NAMES["no_label"].fullmatch(name.lower())
    ]
    texts = [n for n in parameters if table.column(n).is_text] or list(parameters[:1])
    several = [name for name in (*tags, *texts[::-1]) if len(set(table.column(name).texts)) > 1]
    return several or texts[:1]


def _rows(stamps: Sequence[tuple], labels: Sequence[str]) -> tuple[np.ndarray, list[int]]:
    """The new row of each old one, and the first old row of each new one.

    What one parameter reads twice at one time makes two rows, for later steps to judge. Where one
    parameter follows the other the rows are brought into the order of their times, unless the
    times of a parameter go back themselves.
    """
    counts: Counter[tuple] = Counter()
    members: dict[tuple, list[int]] = {}
    last: dict[str, tuple] = {}
    forward = True
    for index, (stamp, label) in enumerate(zip(stamps, labels, strict=True)):
        members.setdefault((stamp, counts[stamp, label]), []).append(index)
        counts[stamp, label] += 1
        forward = forward and last.get(label, stamp) <= stamp
        last[label] = stamp
    rows, first = np.zeros(len(labels), dtype=int), []
    for number, key in enumerate(sorted(members) if forward else members):
        rows[members[key]] = number
        first.append(members[key][0])
    return rows, first


def _spread(column: Column, own: np.ndarray, rows: np.ndarray, count: int, unit: str) -> Column:
    """The readings of one parameter in their rows; no reading in the others."""
    if not column.is_text:
        values = np.full(count, np.nan)
        values[rows] = column.values[own]
        return Column(values, unit or column.unit, column.single)
    cells = np.full(count, "", dtype=np.dtypes.StringDType())
    cells[rows] = column.values[own]
    return logged_column(cells.tolist(), ",", unit or column.unit)


def _with_units(labels: Sequence[str], units: Sequence[str]) -> list[str]:
    """Labels of rows, with the unit of the row where one parameter has several."""
    stated = {both for both in zip(labels, units, strict=False) if not is_empty(both[1])}
    counts = Counter(label for label, _ in stated)
    return [
        f"{label} [{units[k]}]" if counts[label] > 1 else label for k, label in enumerate(labels)
    ]


_WORKBOOKS = (".xlsx", ".xlsm", ".xlsb")
_OF_ARDUPILOT = "`pip install pymavlink`, `mavlogdump.py --format csv --types IMU FILE.bin`"

_TEXT_FORMATS = ("text", "json", "aem", "42")
_BY_SUFFIX = by_word(vocabulary("tables")["suffixes"])


def file_format(path: Path) -> str:
    """The format of a file, by its first bytes and else its suffix."""
    packed = packing(path)
    head, named = content(path, LIMITS.head_bytes), Path(path.stem) if packed else path
    form = _form_of(head, path, named.suffix.lower())
    what = f"is packed by {packed}, and what it holds is read only as a file of its own"
    require(not packed or form in _TEXT_FORMATS, str(path), what, "unpack it")
    return form


def _form_of(head: bytes, path: Path, suffix: str) -> str:
    if head.startswith(b"MATLAB ") or suffix == ".mat":
        return "mat"
    if head.startswith(b"\x89HDF\r\n\x1a\n"):
        return "netcdf" if suffix in (".nc", ".nc4", ".cdf", ".netcdf") else "hdf5"
    if head.startswith((b"CDF\x01", b"CDF\x02", b"CDF\x05")):
        return "netcdf"
    if head.startswith(b"PAR1"):
        return "parquet"
    if head.startswith(b"\x93NUMPY") or (head.startswith(b"PK") and _is_npz(path)):
        return "numpy"
    if head.startswith(b"ULog\x01\x12\x35"):
        return "ulog"
    is_bag = head.startswith((b"#ROSBAG V", b"\x89MCAP0\r\n"))
    if is_bag or (suffix == ".db3" and head.startswith(b"SQLite format 3")):
        return "bag"
    _refuse_packed(head, path)
    if is_aem(head):
        return "aem"
    refuse_other_messages(head, path)
    if suffix not in _BY_SUFFIX and head.lstrip(b"\xef\xbb\xbf \r\n\t").startswith(b'{"'):
        return "json"
    return _BY_SUFFIX.get(suffix, "text")


def _is_npz(path: Path) -> bool:
    try:
        with zipfile.ZipFile(path) as members:
            return any(name.endswith(".npy") for name in members.namelist())
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        return path.suffix.lower() == ".npz"


def _refuse_packed(head: bytes, path: Path) -> None:
    """Refuse a format that nobody reads here, and say what makes a table of it."""
    sheets = "save each of its sheets as CSV"
    unpack = "unpack it, or save its table as CSV"
    suffix = path.suffix.lower()
    marks = {
        b"PK": ("an Excel workbook", sheets) if suffix in _WORKBOOKS else ("a ZIP archive", unpack),
        b"\xd0\xcf\x11\xe0": ("an Excel workbook", sheets),
        b"SQLite format 3": ("an SQLite database", unpack),
        b"\xa3\x95\x80\x80": ("a log of ArduPilot", _OF_ARDUPILOT),
        b"\x28\xb5\x2f\xfd": ("packed by zstd", "unpack it: zstd -d FILE"),
        b"DAF/": (
            "a kernel of SPICE",
            "docs/how_to/spice_ck.py makes an AEM of a CK, which is read",
        ),
    }
    for mark, (what, advice) in marks.items():
        if head.startswith(mark) and suffix != ".npz":
            raise CampaignError(f"is {what}", where=str(path), advice=advice)


def read_raw(
    path: str | Path,
    *,
    table: str = "",
    columns: Sequence[str] = (),
    options: TextOptions | None = None,
) -> Table:
    """One table of a raw log; `table` is a name of `tables_in`, or "" for the whole file.

    The wanted columns choose where those of one table differ in length; () are all. Options say how
    a text file is written, where its content cannot tell.
    """
    file = Path(path)
    form = file_format(file)
    if form == "aem":
        return read_aem(file, table)
    held = _arrays(file, form)
    if held is not None:
        return one_row_a_time(array_tables.table_of(held, str(file), table=table, columns=columns))
    require(not table, str(file), f"no table {table!r}", "the file is one table: name none")
    if form == "42":
        return read_42(file)
    if form == "json":
        return one_row_a_time(read_json_lines(file))
    if form == "parquet":
        return one_row_a_time(_parquet_table(file))
    return one_row_a_time(read_text_table(file, options or TextOptions()))


def tables_in(path: str | Path) -> list[str]:
    """Names of the tables of a raw log; one empty name where the file is one table."""
    file = Path(path)
    form = file_format(file)
    if form == "aem":
        return aem_segments(file)
    held = _arrays(file, form)
    return [""] if held is None else array_tables.tables_of(held.arrays)


def _parquet_table(file: Path) -> Table:
    held = array_tables.parquet_arrays(file)
    columns = {
        name: array_tables.array_column(a, held.units[name]) for name, a in held.arrays.items()
    }
    table = Table(str(file), columns)
    require(table.rows > 0, table.label, "holds no rows of numbers", "export it again")
    return table


def _arrays(file: Path, form: str) -> FileArrays | None:
    """Arrays of a file; None for a file of another form."""
    if form == "json":
        arrays = json_arrays(file)
        return None if arrays is None else FileArrays(arrays)
    readers = {
        "numpy": array_tables.numpy_arrays,
        "ulog": array_tables.ulog_arrays,
        "bag": array_tables.bag_arrays,
    }
    if form in readers:
        return readers[form](file)
    kind = next((kind for kind in get_args(ArrayKind) if kind == form), None)
    return None if kind is None else read_arrays(file, kind)
