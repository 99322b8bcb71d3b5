"""Parquet files: columns of any plain type, structs with dots, lists of one length as name[0]."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bayes_inertia.errors import CampaignError
from bayes_inertia.importing.raw_table import RawColumn, RawTable

_MAX_WIDTH = 64  # Columns that a list may become.


def read_parquet_file(path: Path) -> RawTable:
    """The columns of a Parquet file.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    RawTable
        Its columns; null is NaN or an empty text, time stamps are texts of ISO 8601.

    Raises
    ------
    CampaignError
        If the file is damaged, or two columns have one name.
    """
    from pyarrow import parquet

    label = str(path)
    try:
        with parquet.ParquetFile(path) as file:
            table = file.read()
        columns: dict[str, RawColumn] = {}
        for field, column in zip(table.schema, table.columns, strict=True):
            unit = _unit(field)
            for name, values in _parts(field.name, column).items():
                made = _column(values, unit)
                if made is None:
                    continue
                if name in columns:
                    raise CampaignError(
                        f"two columns are named {name!r}",
                        where=label,
                        advice="give each column its own name",
                    )
                columns[name] = made
    except CampaignError:
        raise
    except Exception as error:  # Arrow raises whatever it stumbles over.
        reason = (str(error).splitlines() or [""])[0][:200] or type(error).__name__
        raise CampaignError(
            f"cannot be read as a Parquet file ({reason})",
            where=label,
            advice="export it again, or use CSV",
        ) from error
    if not columns or table.num_rows == 0:
        raise CampaignError("holds no rows of numbers", where=label, advice="export it again")
    return RawTable(label, columns)


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


def _column(values: Any, unit: str) -> RawColumn | None:
    """A plain Arrow column; None for a type that is no telemetry."""
    import pyarrow
    from pyarrow import types

    kind = values.type
    if types.is_boolean(kind):
        values, kind = values.cast(pyarrow.int8()), pyarrow.int8()
    if types.is_timestamp(kind):
        zone = "Z" if kind.tz else ""  # Arrow keeps stamps with a zone in UTC.
        dates = values.cast(pyarrow.timestamp("ns")).to_numpy(zero_copy_only=False)
        texts = [
            "" if np.isnat(date) else f"{np.datetime_as_string(date)}{zone}"
            for date in dates.astype("datetime64[ns]")
        ]
        return RawColumn(np.array(texts, dtype=np.dtypes.StringDType()), unit)
    if types.is_duration(kind):
        values = values.cast(pyarrow.duration("ns")).cast(pyarrow.int64())
        kind, unit = pyarrow.int64(), "ns"
    if types.is_integer(kind) and values.null_count == 0:
        exact = values.to_numpy()
        if exact.dtype.kind == "i" or exact.max(initial=0) < 2**63:
            return RawColumn(exact.astype(np.int64), unit)
    numeric = (types.is_integer, types.is_floating, types.is_decimal, types.is_null)
    if any(holds(kind) for holds in numeric):
        floats = values.cast(pyarrow.float64(), safe=False).to_numpy()
        return RawColumn(floats, unit, single=kind in (pyarrow.float32(), pyarrow.float16()))
    if types.is_string(kind) or types.is_large_string(kind):
        texts = ["" if text is None else text for text in values.to_pylist()]
        return RawColumn(np.array(texts, dtype=np.dtypes.StringDType()), unit)
    return None
