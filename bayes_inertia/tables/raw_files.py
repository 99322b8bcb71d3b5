"""The reader of raw logs: the format is told by content and suffix, each has its own file."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from bayes_inertia.errors import CampaignError
from bayes_inertia.tables.aem_file import (
    aem_segments,
    is_aem,
    read_aem,
    refuse_other_messages,
)
from bayes_inertia.tables.array_files import FileArrays
from bayes_inertia.tables.array_tables import array_column, table_of, tables_of
from bayes_inertia.tables.isolated import ArrayKind, read_arrays
from bayes_inertia.tables.json_lines import json_arrays, read_json_lines
from bayes_inertia.tables.long_table import one_row_a_time
from bayes_inertia.tables.nasa_42 import read_42
from bayes_inertia.tables.plain_arrays import numpy_arrays, parquet_arrays
from bayes_inertia.tables.raw_table import RawTable
from bayes_inertia.tables.text_form import TextOptions
from bayes_inertia.tables.text_table import read_text_table

_WORKBOOKS = (".xlsx", ".xlsm", ".xlsb")
_OF_ROS = (
    "`pip install rosbags`; write the stamps and fields of each topic to a CSV, with its AnyReader"
)
_OF_ARDUPILOT = "`pip install pymavlink`, `mavlogdump.py --format csv --types IMU FILE.bin`"
_HEAD = 1024  # Bytes by which a format is told.

FileFormat = Literal["text", "aem", "json", "42", "parquet", "numpy", "hdf5", "netcdf", "mat"]


def file_format(path: Path) -> FileFormat:
    """The format of a file, by its first bytes and else its suffix."""
    head = _head(path)
    suffix = path.suffix.lower()
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
    _refuse_packed(head, path)
    if is_aem(head):
        return "aem"
    refuse_other_messages(head, path)
    by_suffix: dict[str, FileFormat] = {
        ".h5": "hdf5",
        ".hdf5": "hdf5",
        ".nc": "netcdf",
        ".nc4": "netcdf",
        ".parquet": "parquet",
        ".npz": "numpy",
        ".npy": "numpy",
        ".aem": "aem",
        ".xml": "aem",
        ".jsonl": "json",
        ".ndjson": "json",
        ".json": "json",
        ".42": "42",
    }
    if suffix not in by_suffix and head.lstrip(b"\xef\xbb\xbf \r\n\t").startswith(b'{"'):
        return "json"
    return by_suffix.get(suffix, "text")


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(_HEAD)
    except OSError as error:
        raise CampaignError(
            f"cannot be opened ({error.strerror})", where=str(path), advice="check the path"
        ) from error


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
        b"\x1f\x8b": ("a gzip archive", unpack),
        b"\xd0\xcf\x11\xe0": ("an Excel workbook", sheets),
        b"BZh": ("a bzip2 archive", unpack),
        b"\xfd7zXZ": ("an xz archive", unpack),
        b"SQLite format 3": ("a ROS 2 bag", _OF_ROS)
        if suffix == ".db3"
        else ("an SQLite database", unpack),
        b"ULog\x01\x12\x35": ("a ULog of PX4", "`pip install pyulog`, `ulog2csv FILE.ulg`"),
        b"#ROSBAG V": ("a ROS bag", _OF_ROS),
        b"\x89MCAP0\r\n": ("an MCAP file", _OF_ROS),
        b"\xa3\x95\x80\x80": ("a log of ArduPilot", _OF_ARDUPILOT),
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
) -> RawTable:
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
        return one_row_a_time(table_of(held, str(file), table=table, columns=columns))
    if table:
        raise CampaignError(
            f"no table {table!r}", where=str(file), advice="the file is one table: name none"
        )
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
    return [""] if held is None else tables_of(held.arrays)


def _parquet_table(file: Path) -> RawTable:
    held = parquet_arrays(file)
    columns = {name: array_column(a, held.units[name]) for name, a in held.arrays.items()}
    table = RawTable(str(file), columns)
    if not table.rows:
        raise CampaignError("holds no rows of numbers", where=table.label, advice="export it again")
    return table


def _arrays(file: Path, form: str) -> FileArrays | None:
    """What a file of arrays holds; None for a file of another form."""
    if form == "json":
        arrays = json_arrays(file)
        return None if arrays is None else FileArrays(arrays)
    if form == "numpy":
        return numpy_arrays(file)
    kinds: dict[str, ArrayKind] = {"hdf5": "hdf5", "netcdf": "netcdf", "mat": "mat"}
    return read_arrays(file, kinds[form]) if form in kinds else None
