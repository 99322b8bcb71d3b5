"""Arrays of a file as tables, and those of files whose libraries raise an error where damaged.

These are Parquet, NumPy, and, by the libraries of the extra `logs`, the logs of flight software:
ULog of PX4, bags of ROS 1 and 2, MCAP files of ROS messages. A topic is a table, a field of its
messages a column.

Arrays of a file as tables: vectors become columns, matrices name[0], name[1], ...

HDF5, netCDF, MAT and NumPy files are trees of arrays. A table is what lies below one group (or
struct), with the names of inner groups joined with dots. Arrays of one table may differ in length,
as streams at different rates do; then the wanted columns, or "group [1000 rows]", choose.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from bayes_inertia.errors import CampaignError, library_of_extra, require
from bayes_inertia.tables.array_files import FileArrays
from bayes_inertia.tables.limits import LIMITS
from bayes_inertia.tables.stamp_parts import UNIT_WORDS, unit_size
from bayes_inertia.tables.table import Column, Table
from bayes_inertia.tables.time_texts import text_to_ns


def parquet_arrays(path: Path) -> FileArrays:
    """Columns of a Parquet file: structs as a.b, lists of one length as a[0]; null is NaN or ""."""
    label = str(path)
    parquet = library_of_extra(
        "pyarrow.parquet", "parquet", where=label, otherwise="export it as CSV"
    )
    try:
        with parquet.ParquetFile(path) as file:
            table = file.read()
        held = FileArrays()
        for field, column in zip(table.schema, table.columns, strict=True):
            for name, values in _parts(field.name, column).items():
                new = name not in held.arrays and name not in held.closed
                what = f"two columns are named {name!r}"
                require(new, label, what, "give each column its own name")
                _add_column(held, name, values, _unit(field))
    except CampaignError:
        raise
    except Exception as error:  # Arrow raises whatever it stumbles over.
        raise _unreadable(error, "a Parquet file", label, "export it again, or use CSV") from error
    return held


def _unreadable(error: Exception, what: str, label: str, advice: str) -> CampaignError:
    reason = (str(error).splitlines() or [""])[0][:200] or type(error).__name__
    return CampaignError(f"cannot be read as {what} ({reason})", where=label, advice=advice)


def _unit(field: Any) -> str:
    metadata = field.metadata or {}
    return metadata.get(b"units", metadata.get(b"unit", b"")).decode("utf-8", "replace")


def _parts(name: str, column: Any) -> dict[str, Any]:
    """A column, or the members of a struct or list."""
    import pyarrow
    from pyarrow import compute, types

    kind = column.type
    if types.is_dictionary(kind):
        return _parts(name, column.cast(kind.value_type))
    if types.is_struct(kind):
        fields = [compute.struct_field(column, [k]) for k in range(kind.num_fields)]
        members = [(f"{name}.{f.name}", x) for f, x in zip(kind, fields, strict=True)]
    elif types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind):
        if types.is_fixed_size_list(kind):
            column = column.cast(pyarrow.list_(kind.value_type))
        lengths = compute.list_value_length(column).drop_null().unique().to_pylist()
        if len(lengths) != 1 or not 0 < lengths[0] <= LIMITS.most_columns:
            return {}
        members = [(f"{name}[{k}]", compute.list_element(column, k)) for k in range(lengths[0])]
    else:
        return {name: column}
    return {part: x for inner, own in members for part, x in _parts(inner, own).items()}


def _add_column(held: FileArrays, name: str, values: Any, unit: str) -> None:
    """Keep a plain Arrow column; a type that is no telemetry stays closed."""
    import pyarrow
    from pyarrow import types

    kind = values.type
    if types.is_duration(kind):
        values = values.cast(pyarrow.duration("ns")).cast(pyarrow.int64())
        kind, unit = pyarrow.int64(), "ns"
    if types.is_timestamp(kind):
        array = _dates(values, "Z" if kind.tz else "")  # Arrow keeps stamps with a zone in UTC.
    elif (types.is_boolean(kind) or types.is_integer(kind)) and values.null_count == 0:
        array = values.to_numpy()
    elif types.is_string(kind) or types.is_large_string(kind):
        array = np.array(values.fill_null("").to_pylist(), dtype=np.dtypes.StringDType())
    elif types.is_null(kind) or types.is_decimal(kind) or types.is_primitive(kind):
        array = values.cast(pyarrow.float64(), safe=False).to_numpy()
        if kind in (pyarrow.float32(), pyarrow.float16()):
            array = array.astype(np.float32)
    else:
        held.closed[name] = f"{kind}, no numbers"
        return
    held.arrays[name] = array
    held.units[name] = unit


def _dates(values: Any, zone: str) -> np.ndarray:
    import pyarrow

    dates = values.cast(pyarrow.timestamp("ns")).to_numpy(zero_copy_only=False)
    dates = dates.astype("datetime64[ns]")
    texts = np.char.add(np.datetime_as_string(dates), zone)
    return np.where(np.isnat(dates), "", texts).astype(np.dtypes.StringDType())


def numpy_arrays(path: Path) -> FileArrays:
    """Arrays of a .npz or .npy file ("array"); nothing in it is ever executed."""
    try:
        # Opened here: of a damaged archive numpy forgets to close the file.
        with path.open("rb") as file:
            if zipfile.is_zipfile(file):
                _check_size(file)
                file.seek(0)
                with np.load(file, allow_pickle=False) as stored:
                    arrays = {name: stored[name] for name in stored.files}
            else:
                file.seek(0)
                arrays = {"array": np.load(file, allow_pickle=False)}
        held = FileArrays()
        for name, array in arrays.items():
            if isinstance(array, np.ndarray):
                held.add(name, array)
        return held
    except Exception as error:  # Of a damaged file numpy and zipfile raise whatever they meet.
        advice = "save it again with numpy.savez and plain arrays"
        if "allow_pickle" in str(error):
            error = ValueError("it holds Python objects, which could run a program when read")
            advice = "save each quantity as an array of numbers"
        raise _unreadable(error, "a NumPy file", str(path), advice) from error


def _check_size(file: BinaryIO) -> None:
    with zipfile.ZipFile(file) as members:
        total = sum(member.file_size for member in members.infolist())
    if total > LIMITS.largest_arrays:
        raise ValueError(f"{total / 2**30:.0f} GiB of arrays")


def ulog_arrays(path: Path) -> FileArrays:
    """Topics of a ULog; time stamps in microseconds since boot."""
    core = library_of_extra("pyulog.core", "logs", where=str(path), otherwise="run ulog2csv on it")
    held = FileArrays()
    try:
        with path.open("rb") as file:
            topics = core.ULog(file).data_list
    except Exception as error:  # pyulog raises whatever it stumbles over.
        raise _unreadable(error, "a ULog of PX4", str(path), "download it again") from error
    for topic in topics:
        name = topic.name if topic.multi_id == 0 else f"{topic.name}_{topic.multi_id}"
        for field, values in topic.data.items():
            held.add(f"{name}/{field}", values, "us" if field.startswith("timestamp") else "")
    return held


def bag_arrays(path: Path) -> FileArrays:
    """Topics of a ROS bag or an MCAP file; `received` is when a message was logged [ns]."""
    highlevel = library_of_extra("rosbags.highlevel", "logs", where=str(path))
    stores = import_module("rosbags.typesys")
    columns: dict[str, dict[str, list[Any]]] = {}
    held = FileArrays()
    try:
        # Standard messages, for bags that do not hold their own definitions.
        known = stores.get_typestore(stores.Stores.LATEST)
        with highlevel.AnyReader([path], default_typestore=known) as bag:
            for connection, received, data in bag.messages():
                topic = columns.setdefault(connection.topic.strip("/"), {"received": []})
                try:
                    message = bag.deserialize(data, connection.msgtype)
                except Exception:  # A message of an unknown type closes its topic, not the bag.
                    held.closed[connection.topic] = f"messages of type {connection.msgtype}"
                    held.advice = _OTHER_MESSAGES
                    continue
                topic["received"].append(received)
                for field, value in _fields(message, ""):
                    topic.setdefault(field, []).append(value)
    except Exception as error:  # rosbags raises whatever it stumbles over.
        advice = "download it again; `rosbag reindex` mends one whose recording was killed"
        raise _unreadable(error, "a ROS bag", str(path), advice) from error
    flat = [topic.replace("/", "_") for topic in columns]
    for (path_of_topic, fields), name in zip(columns.items(), flat, strict=True):
        # Of /imu/data and /imu_data the first keeps its slash, as a dot.
        name = name if flat.count(name) == 1 else path_of_topic.replace("/", ".")
        rows = len(fields["received"])
        for field, values in _measured(fields, f"/{path_of_topic}", held).items():
            if len(values) == rows:
                unit = "ns" if field == "received" else ""
                held.add(f"{name}/{field}", np.array(values), unit)
    return held


def _measured(
    fields: Mapping[str, list[Any]], topic: str, held: FileArrays
) -> dict[str, list[Any]]:
    """Fields of a topic without those that nothing measures.

    A covariance of -1 says so (sensor_msgs/Imu).
    """
    end = "_covariance[0]"
    none = [
        name.removesuffix(end)
        for name, values in fields.items()
        if name.endswith(end) and set(values) == {-1.0}
    ]
    for name in none:
        held.closed[f"{topic}/{name}"] = "without a reading (its covariance is -1)"
    gone = tuple(f"{name}{sign}" for name in none for sign in (".", "[", "_covariance"))
    return {name: values for name, values in fields.items() if not name.startswith(gone)}


def _fields(message: Any, prefix: str) -> Iterator[tuple[str, float | int | str]]:
    """Numbers and texts of a message, with the names of inner messages joined with dots."""
    for name in message.__dataclass_fields__:
        if name.startswith("__"):
            continue
        value, inner = getattr(message, name), f"{prefix}{name}"
        if hasattr(value, "__dataclass_fields__"):
            yield from _fields(value, f"{inner}.")
        elif isinstance(value, int | float | str):
            yield inner, value
        # An array of more numbers is a picture.
        elif isinstance(value, np.ndarray) and value.size <= LIMITS.most_columns:
            numbers = value.tolist() if value.dtype.kind in "iufb" else []
            yield from ((f"{inner}[{k}]", number) for k, number in enumerate(numbers))


_WITH_ROWS = re.compile(r"(.*?)\s*\[(\d+) rows\]")
_SINCE = re.compile(r"\s*([A-Za-z]+)\s+since\s+(\d{4}-\d{1,2}-\d{1,2}(?:[T ]\S+)?)\s*.*")
_OTHER_MESSAGES = (
    "where messages are compressed, `ros2 bag convert` writes them plain; else let the bag hold "
    "their definitions, as MCAP does"
)


def tables_of(arrays: Mapping[str, np.ndarray]) -> list[str]:
    """Names of the tables in a file of arrays: its groups with dots, and rows where lengths differ.

    >>> tables_of({"gyro/t": np.zeros(5), "gyro/w": np.zeros((5, 3)), "st/t": np.zeros(2)})
    ['gyro', 'st']
    """
    groups: dict[str, dict[str, np.ndarray]] = {}
    for path, array in arrays.items():
        group = path.rpartition("/")[0].replace("/", ".")
        groups.setdefault(group, {})[path] = array
    names = []
    for group, members in groups.items():
        lengths = sorted(set(_row_counts(members).values()), reverse=True)
        if len(lengths) > 1:
            names += [f"{group} [{rows} rows]".strip() for rows in lengths]
        elif lengths:
            names.append(group)
    return names


def table_of(
    held: FileArrays, label: str, *, table: str = "", columns: Sequence[str] = ()
) -> Table:
    """The columns of one group of a file of arrays; the group "" is the whole file."""
    match = _WITH_ROWS.fullmatch(table)
    group, rows = (match[1], int(match[2])) if match else (table, 0)
    prefix = f"{group.replace('/', '.').strip('.')}.".lstrip(".")
    below = {p: x for p, x in held.arrays.items() if p.replace("/", ".").startswith(prefix)}
    counts = _row_counts(below)
    _check_any(counts, held, table, label)
    named = {path: path.replace("/", ".").removeprefix(prefix) for path in counts}
    wanted = {
        path
        for path, name in named.items()
        if not columns or name in columns or any(c.startswith(name + "[") for c in columns)
    }
    chosen = {path: n for path, n in counts.items() if path in wanted and rows in (0, n)}
    _check_one_length(chosen, named, table, tables_of(below), label)
    made: dict[str, Column] = {}
    for path, count in chosen.items():
        made |= _columns(named[path], below[path], count, held.units.get(path, ""))
    notes = tuple(f"{path} is {what} and was not read" for path, what in held.closed.items())
    where = f"{label}, {table}" if table else label
    return Table(where, made, notes=notes)


def _check_any(counts: Mapping[str, int], held: FileArrays, table: str, label: str) -> None:
    if counts:
        return
    what = f"no table {table!r}" if table else "no array of numbers"
    names = ", ".join(name or "(the file itself)" for name in tables_of(held.arrays)[:30])
    advice = f"the file has {names}" if names else "store each column as a vector of numbers"
    if held.closed and not names:
        path, kind = next(iter(held.closed.items()))
        what, advice = f"{path} is {kind} and was not read", held.advice
    raise CampaignError(what, where=label, advice=advice)


def _check_one_length(
    chosen: Mapping[str, int], named: Mapping[str, str], table: str, groups: list[str], label: str
) -> None:
    lengths = sorted(set(chosen.values()), reverse=True)
    if len(lengths) == 1:
        return
    advice = f"it has {', '.join(named.values())}"
    require(bool(lengths), label, "none of the columns is here", advice)
    first = {rows: path for path, rows in reversed([*chosen.items()])}
    examples = ", ".join(f"{named[first[rows]]} has {rows}" for rows in lengths[:4])
    prefix = f"{table} " if table else ""
    advice = f'name the table of one stream, such as "{prefix}[{lengths[0]} rows]"'
    advice += "".join(f' or "{group}"' for group in groups if group and group != table)
    raise CampaignError(f"columns differ in length: {examples} rows", where=label, advice=advice)


def _row_counts(arrays: Mapping[str, np.ndarray]) -> dict[str, int]:
    """Rows of each array that is a column or a matrix of columns."""
    # MATLAB vectors are matrices of one row or one column.
    squeezed = {path: np.squeeze(array) for path, array in arrays.items()}
    vectors = {a.shape[0] for a in squeezed.values() if a.ndim == 1 and a.size > 1}
    long = {path: array for path, array in squeezed.items() if array.size > 1}
    counts = {path: _rows(array.shape, vectors) for path, array in long.items()}
    return {path: n for path, n in counts.items() if long[path].size // n <= LIMITS.most_columns}


def _rows(shape: Sequence[int], vectors: set[int]) -> int:
    """Length of the axis of the rows: one that a vector beside it shares, else the longer."""
    is_last = shape[-1] in vectors or shape[-1] > shape[0]
    return shape[-1] if is_last and shape[0] not in vectors else shape[0]


def _columns(name: str, array: np.ndarray, rows: int, unit: str) -> dict[str, Column]:
    """The columns of an array."""
    squeezed = np.squeeze(array)
    if squeezed.ndim == 1:
        return {name: array_column(squeezed, unit)}
    if squeezed.shape[0] != rows:
        squeezed = np.moveaxis(squeezed, -1, 0)
    inner = squeezed.shape[1:]
    flat = squeezed.reshape(rows, -1)
    return {
        f"{name}[{','.join(map(str, index))}]": array_column(flat[:, k], unit)
        for k, index in enumerate(np.ndindex(*inner))
    }


def array_column(values: np.ndarray, unit: str = "") -> Column:
    """A vector of a file as a column; the unit "seconds since 2024-01-01" makes dates of numbers.

    >>> array_column(np.array([0.5]), "seconds since 2024-01-01").values.tolist()
    ['2024-01-01T00:00:00.500000000']
    """
    kind = values.dtype.kind
    if kind in "UST":
        return Column(values.astype(np.dtypes.StringDType()), unit)
    since = _SINCE.fullmatch(unit)
    size = unit_size(UNIT_WORDS.get(since[1].lower(), "")) if since else None
    if since and size and kind in "iuf":
        return Column(_dates_since(values, int(size), since[2]))
    if kind in "bi" or (kind == "u" and values.max(initial=0) < 2**63):
        return Column(values.astype(np.int64), unit)
    return Column(values.astype(float), unit, single=values.dtype.itemsize <= 4)


def _dates_since(values: np.ndarray, unit: int, epoch: str) -> np.ndarray:
    """Numbers since an epoch as dates of the same clock, as CF conventions write time."""
    stamp = epoch if ":" in epoch else f"{epoch}T00:00:00"
    start = text_to_ns(stamp, utc=True, place=lambda: f"units {epoch!r}") or (0, False)
    finite = np.isfinite(values)
    numbers = np.where(finite, values, 0)
    whole = np.floor(numbers)
    rest = np.rint((numbers - whole).astype(float) * unit).astype(np.int64)
    ns = whole.astype(np.int64) * unit + rest + start[0]
    dates = np.datetime_as_string(np.datetime64("1958-01-01", "ns") + ns.astype("m8[ns]"))
    return np.where(finite, dates, "").astype(np.dtypes.StringDType())
