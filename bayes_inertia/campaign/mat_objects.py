"""MATLAB objects of MAT files: timeseries, tables, timetables, texts, dates and durations.

A timeseries keeps its readings in `Data_`. Its times lie in `Time_` of its `TimeInfo`, or, where
they are regular, as `Start_`, `Increment_` and `Length`, in the unit `Units` (seconds where it is
not stored, which is MATLAB's default).
"""

from __future__ import annotations

import re
import warnings
from typing import Any

import numpy as np

from bayes_inertia.campaign.array_contents import Contents

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


def read_objects(path: str, into: Contents) -> None:
    """Read objects of a MAT file that other readers left closed; unknown classes stay closed.

    Parameters
    ----------
    path : str
        The file.
    into : Contents
        Its closed paths name the objects; what is read goes there.
    """
    places = [place for place, what in into.closed.items() if what.startswith("a MATLAB ")]
    if not places:
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # It sets an option that pandas 3 no longer needs.
        try:
            import matio
        except ImportError:  # It has no wheel for Python 3.14 yet, so is no dependency there.
            for place in places:
                into.closed[place] += " (mat-io may open it: pip install mat-io)"
            return

    names = list({re.sub(r"\(\d+\)$", "", place.split("/")[0]) for place in places})
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            content = matio.load_from_mat(path, variable_names=names, add_table_attrs=True)
    except Exception:  # A damaged object: the rest of the file was read.
        return
    for place in places:
        if _add_object(_at(content, place), place, into):
            del into.closed[place]


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


def _add_object(value: Any, place: str, into: Contents) -> bool:
    """Keep what an object holds; whether it is of a class that is known."""
    kind = type(value).__name__
    if kind == "DataFrame":
        _add_table(value, place, into)
        return True
    if kind == "MatlabOpaque" and value.classname == "timeseries":
        return _add_timeseries(value.properties, place, into)
    if isinstance(value, np.ndarray) and value.dtype.kind in "UMm":
        _add_column(value, place, "", into)
        return True
    return False


def _add_column(values: np.ndarray, place: str, unit: str, into: Contents) -> None:
    into.check_size(place, int(values.nbytes))
    if values.dtype.kind == "m":
        values, unit = values / np.timedelta64(1, "s"), "s"
    into.add(place, values, unit)


def _add_table(table: Any, place: str, into: Contents) -> None:
    """Columns of a table; the row times of a timetable are a column before them."""
    units = [str(unit) for unit in np.ravel(table.attrs.get("varUnits", []))]
    units += [""] * (len(table.columns) - len(units))
    if table.index.dtype.kind in "mM" or getattr(table.index, "tz", None) is not None:
        _add_dates(table.index.to_series(), f"{place}/{table.index.name or 'Time'}", into)
    for name, unit in zip(table.columns, units, strict=False):
        column = table[name]
        if getattr(column.dtype, "tz", None) is not None:
            _add_dates(column, f"{place}/{name}", into)
        else:
            _add_column(column.to_numpy(), f"{place}/{name}", unit, into)


def _add_dates(column: Any, place: str, into: Contents) -> None:
    """Dates and durations; those with a time zone as dates in UTC."""
    if getattr(column.dtype, "tz", None) is None:
        _add_column(column.to_numpy(), place, "", into)
        return
    dates = np.datetime_as_string(column.dt.tz_convert("UTC").dt.tz_localize(None).to_numpy())
    _add_column(np.char.add(dates.astype(str), "Z"), place, "", into)


def _add_timeseries(properties: dict[str, Any], place: str, into: Contents) -> bool:
    """Time [s] and readings of a timeseries."""
    details, data = properties.get("TimeInfo"), properties.get("Data_")
    if not isinstance(data, np.ndarray):
        return False
    time = _times(_properties(details))
    if time is None or len(time) not in data.shape:
        return False
    _add_column(time, f"{place}/Time", "s", into)
    units = _text(_properties(properties.get("DataInfo")).get("Units"))
    _add_column(data, f"{place}/Data", units, into)
    return True


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
