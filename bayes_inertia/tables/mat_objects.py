"""MATLAB objects of MAT files: timeseries, tables, timetables, texts, dates and durations.

A timeseries keeps its readings in `Data_`. Its times lie in `Time_` of its `TimeInfo`, or, where
they are regular, as `Start_`, `Increment_` and `Length`, in the unit `Units` (seconds where it is
not stored, which is MATLAB's default).
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

Part = tuple[str, np.ndarray, str]
"""Path, values and unit of one array."""

_INDEXED = re.compile(r"(.*)\((\d+)\)")
_UNITS = {
    "weeks": 604800.0,
    "days": 86400.0,
    "hours": 3600.0,
    "minutes": 60.0,
    "seconds": 1.0,
    "milliseconds": 1e-3,
    "microseconds": 1e-6,
    "nanoseconds": 1e-9,
}


def opened_objects(path: str, places: Sequence[str]) -> dict[str, list[Part]]:
    """Arrays of the objects at some places of a MAT file; unknown classes are absent."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # It sets an option that pandas 3 no longer needs.
        import matio
    names = list({re.sub(r"\(\d+\)$", "", place.split("/")[0]) for place in places})
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            content = matio.load_from_mat(path, variable_names=names, add_table_attrs=True)
    except Exception:  # A damaged object: the rest of the file was read.
        return {}
    opened = {place: _parts(_at(content, place), place) for place in places}
    return {place: parts for place, parts in opened.items() if parts is not None}


def _at(content: Any, place: str) -> Any:
    """What lies at a path of structs; None where that cannot be told."""
    value = content
    for part in place.split("/"):
        match = _INDEXED.fullmatch(part)
        name, index = (match[1], int(match[2]) - 1) if match else (part, 0)
        if isinstance(value, dict):
            value = value.get(name)
        elif isinstance(value, np.ndarray) and value.dtype.names and name in value.dtype.names:
            value = value[name].ravel()[0]
        else:
            return None
        if match and isinstance(value, np.ndarray) and value.size > index:
            value = value.ravel()[index : index + 1]
    return value


def _parts(value: Any, place: str) -> list[Part] | None:
    """Arrays of an object; None for a class that is not known."""
    kind = type(value).__name__
    if kind == "DataFrame":
        return _table(value, place)
    if kind == "MatlabOpaque" and value.classname == "timeseries":
        return _timeseries(value.properties, place)
    if isinstance(value, np.ndarray) and value.dtype.kind in "UMm":
        return [_column(value, place)]
    return None


def _column(values: np.ndarray, place: str, unit: str = "") -> Part:
    """An array as it is; durations in seconds."""
    if values.dtype.kind == "m":
        return place, values / np.timedelta64(1, "s"), "s"
    return place, values, unit


def _table(table: Any, place: str) -> list[Part]:
    """Columns of a table; the row times of a timetable are a column before them."""
    units = [str(unit) for unit in np.ravel(table.attrs.get("varUnits", []))]
    units += [""] * (len(table.columns) - len(units))
    parts = []
    if table.index.dtype.kind in "mM" or getattr(table.index, "tz", None) is not None:
        parts.append(_dates(table.index.to_series(), f"{place}/{table.index.name or 'Time'}"))
    for name, unit in zip(table.columns, units, strict=False):
        column, inner = table[name], f"{place}/{name}"
        dated = getattr(column.dtype, "tz", None) is not None
        parts.append(_dates(column, inner) if dated else _column(column.to_numpy(), inner, unit))
    return parts


def _dates(column: Any, place: str) -> Part:
    """Dates and durations; those with a time zone as dates in UTC."""
    if getattr(column.dtype, "tz", None) is None:
        return _column(column.to_numpy(), place)
    dates = np.datetime_as_string(column.dt.tz_convert("UTC").dt.tz_localize(None).to_numpy())
    return place, np.char.add(dates.astype(str), "Z"), ""


def _timeseries(properties: dict[str, Any], place: str) -> list[Part] | None:
    """Time [s] and readings of a timeseries."""
    details, data = properties.get("TimeInfo"), properties.get("Data_")
    if not isinstance(data, np.ndarray):
        return None
    time = _times(_properties(details))
    if time is None or len(time) not in data.shape:
        return None
    unit = _text(_properties(properties.get("DataInfo")).get("Units"))
    return [_column(time, f"{place}/Time", "s"), _column(data, f"{place}/Data", unit)]


def _properties(value: Any) -> dict[str, Any]:
    return getattr(value, "properties", None) or {}


def _times(details: dict[str, Any]) -> np.ndarray | None:
    """Times of a timeseries [s]; None where they count from a date or cannot be told."""
    size = _UNITS.get(_text(details.get("Units")) or "seconds")
    if size is None:
        return None
    stored = np.asarray(details.get("Time_", [])).ravel()
    if stored.size:
        return stored.astype(float) * size
    numbers = [np.asarray(details.get(key, [])).ravel() for key in ("Start_", "Increment_")]
    start = float(numbers[0][0]) if numbers[0].size else 0.0
    length = np.asarray(details.get("Length", [])).ravel()
    if not numbers[1].size or not length.size or not np.isfinite(numbers[1][0]):
        return None
    return (start + float(numbers[1][0]) * np.arange(int(length[0]))) * size


def _text(value: Any) -> str:
    flat = np.ravel(np.asarray(value if value is not None else ""))
    return str(flat[0]) if flat.size and isinstance(flat[0], str) else ""
