"""Arrays of Parquet and NumPy files, whose libraries raise an error where a file is damaged."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from bayes_inertia.errors import CampaignError
from bayes_inertia.tables.array_files import FileArrays

_MAX_WIDTH = 64  # Columns that a list may become.
_LARGEST = 4 * 2**30  # [bytes] of all arrays of a NumPy file together.


def parquet_arrays(path: Path) -> FileArrays:
    """Columns of a Parquet file: structs as a.b, lists of one length as a[0]; null is NaN or ""."""
    from pyarrow import parquet

    label = str(path)
    try:
        with parquet.ParquetFile(path) as file:
            table = file.read()
        held = FileArrays()
        for field, column in zip(table.schema, table.columns, strict=True):
            for name, values in _parts(field.name, column).items():
                if name in held.arrays or name in held.closed:
                    raise CampaignError(
                        f"two columns are named {name!r}",
                        where=label,
                        advice="give each column its own name",
                    )
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
    text = metadata.get(b"units", metadata.get(b"unit", b""))
    return text.decode("utf-8", "replace")


def _parts(name: str, column: Any) -> dict[str, Any]:
    """A column, or the members of a struct or list."""
    import pyarrow
    from pyarrow import compute, types

    kind = column.type
    if types.is_dictionary(kind):
        return _parts(name, column.cast(kind.value_type))
    if types.is_struct(kind):
        parts: dict[str, Any] = {}
        for index, member in enumerate(kind):
            parts |= _parts(f"{name}.{member.name}", compute.struct_field(column, [index]))
        return parts
    if types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind):
        if types.is_fixed_size_list(kind):
            column = column.cast(pyarrow.list_(kind.value_type))
        lengths = compute.list_value_length(column).drop_null().unique().to_pylist()
        if len(lengths) != 1 or not 0 < lengths[0] <= _MAX_WIDTH:
            return {}
        parts = {}
        for index in range(lengths[0]):
            parts |= _parts(f"{name}[{index}]", compute.list_element(column, index))
        return parts
    return {name: column}


def _add_column(held: FileArrays, name: str, values: Any, unit: str) -> None:
    """Keep a plain Arrow column; a type that is no telemetry stays closed."""
    import pyarrow
    from pyarrow import types

    kind = values.type
    if types.is_duration(kind):
        values = values.cast(pyarrow.duration("ns")).cast(pyarrow.int64())
        kind, unit = pyarrow.int64(), "ns"
    array = None
    if types.is_timestamp(kind):
        array = _dates(values, "Z" if kind.tz else "")  # Arrow keeps stamps with a zone in UTC.
    elif (types.is_boolean(kind) or types.is_integer(kind)) and values.null_count == 0:
        array = values.to_numpy()
    elif types.is_string(kind) or types.is_large_string(kind):
        texts = ["" if text is None else text for text in values.to_pylist()]
        array = np.array(texts, dtype=np.dtypes.StringDType())
    elif types.is_boolean(kind):
        array = values.cast(pyarrow.int8()).cast(pyarrow.float64()).to_numpy()
    elif types.is_null(kind) or types.is_decimal(kind) or types.is_primitive(kind):
        array = values.cast(pyarrow.float64(), safe=False).to_numpy()
        if kind in (pyarrow.float32(), pyarrow.float16()):
            array = array.astype(np.float32)
    if array is None:
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
    if total > _LARGEST:
        raise ValueError(f"{total / 2**30:.0f} GiB of arrays")
