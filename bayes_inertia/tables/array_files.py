"""Arrays of HDF5, netCDF and MAT files; `isolated` reads them in a process of its own.

MATLAB objects of MAT files: timeseries, tables, timetables, texts, dates and durations.

A timeseries keeps its readings in `Data_`. Its times lie in `Time_` of its `TimeInfo`, or, where
they are regular, as `Start_`, `Increment_` and `Length`, in the unit `Units` (seconds where it is
not stored, which is MATLAB's default).

This file imports nothing heavy, so that the process starts fast.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bayes_inertia.tables.limits import LIMITS

Part = tuple[str, np.ndarray, str]
"""Path, values and unit of one array."""

_INDEXED = re.compile(r"(.*)\((\d+)\)")


def opened_objects(path: str, places: Sequence[str]) -> dict[str, list[Part]]:
    """Arrays of the objects at some places of a MAT file; unknown classes are absent."""
    names = list({re.sub(r"\(\d+\)$", "", place.split("/")[0]) for place in places})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # The import sets an option that pandas 3 no longer needs.
        import matio

        try:
            content = matio.load_from_mat(path, variable_names=names, add_table_attrs=True)
        except Exception:  # A damaged object: the rest of the file was read.
            return {}
    opened = {place: _parts(_at(content, place), place) for place in places}
    return {place: parts for place, parts in opened.items() if parts is not None}


def _at(content: Any, place: str) -> Any:
    """Value at a path of structs; None where there is none."""
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
        parts.append(_series(table.index.to_series(), f"{place}/{table.index.name or 'Time'}"))
    for name, unit in zip(table.columns, units, strict=False):
        parts.append(_series(table[name], f"{place}/{name}", unit))
    return parts


def _series(column: Any, place: str, unit: str = "") -> Part:
    """A column of a table; dates with a time zone in UTC."""
    if getattr(column.dtype, "tz", None) is None:
        return _column(column.to_numpy(), place, unit)
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
    from bayes_inertia.tables.stamp_parts import SECOND, UNIT_WORDS, unit_size

    stated = _text(np.asarray(details.get("Units")).ravel()[:1])
    unit = unit_size(UNIT_WORDS.get(stated or "seconds", ""))
    if unit is None:
        return None
    size = float(unit) / SECOND
    keys = ("Time_", "Start_", "Increment_", "Length")
    stored, start, step, length = (np.ravel(details.get(key, [])) for key in keys)
    if stored.size:
        return stored.astype(float) * size
    if not step.size or not length.size or not np.isfinite(step[0]):
        return None
    first = float(start[0]) if start.size else 0.0
    return (first + float(step[0]) * np.arange(int(length[0]))) * size


_UNIT_NAMES = ("units", "unit", "Units", "Unit", "UNITS")
_CALENDARS = ("standard", "gregorian", "proleptic_gregorian")
_OPAQUE = ("MatlabOpaque", "MatlabFunction", "MatlabObject")


class FileError(Exception):
    """Fault of a file, in words for its user."""


@dataclass(eq=False)
class FileArrays:
    """Arrays of a file by path ("/" between groups or structs), their units, and what is closed."""

    arrays: dict[str, np.ndarray] = field(default_factory=dict)  # Numbers and texts
    units: dict[str, str] = field(default_factory=dict)  # Units that the file states
    closed: dict[str, str] = field(default_factory=dict)  # What could not be read, and what it is
    # How to write what is closed.
    advice: str = (
        "save it as a struct: s = struct('Time', ts.Time, 'Data', ts.Data); save('log.mat', 's')"
    )
    left: float = float("inf")  # Bytes that further arrays may have

    def check_size(self, path: str, size: int) -> None:
        """Refuse an array of `size` bytes, before it is read, that no such file can hold."""
        self.left -= size
        if self.left < 0 or len(self.arrays) > LIMITS.most_arrays:
            raise FileError(f"{path} claims more data than such a file can hold")

    def add(self, path: str, value: Any, unit: str = "") -> None:
        """Keep an array of numbers, dates or texts, fields of records apart; leave others out."""
        array = np.asarray(value)
        if array.dtype.names:
            for name in array.dtype.names:
                self.add(f"{path}/{name}", array[name], unit)
            return
        if array.dtype.kind == "O":
            array = _texts(array)
        if array.dtype.kind == "S":
            array = np.char.decode(array, "utf-8", "replace")
        if array.dtype.kind == "M":
            array = np.datetime_as_string(array.astype("datetime64[ns]"))
        if array.dtype.kind in "iufbU":
            self.arrays[path] = array
            if unit:
                self.units[path] = unit


def _texts(array: np.ndarray) -> np.ndarray:
    """An array of objects as texts, or as it is where they are something else."""
    raw = array.ravel().tolist()
    items = [x.decode("utf-8", "replace") if isinstance(x, bytes) else x for x in raw]
    if not items or not all(isinstance(item, str) for item in items):
        return array
    return np.array(items, dtype=str).reshape(array.shape)


def _text(value: Any) -> str:
    value = value.item() if isinstance(value, np.ndarray) and value.size == 1 else value
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace").strip()
    return value.strip() if isinstance(value, str) else ""


def _unit(attributes: Any) -> str:
    return next((_text(attributes[name]) for name in _UNIT_NAMES if name in attributes), "")


def read_hdf5(path: str, into: FileArrays, *, load: bool = True) -> None:
    """Add the arrays of an HDF5 file; with `load` false only check its links and sizes."""
    import h5py

    def visit(node: Any, place: str, above: tuple[Any, ...]) -> None:
        if len(above) > LIMITS.deepest:
            raise FileError(f"{place} is nested too deeply")
        for name in node:
            inner = f"{place}/{name}" if place else name
            link = node.get(name, getlink=True)
            if not isinstance(link, h5py.HardLink) and not load:
                raise FileError(f"{inner} is a link, which a MAT or netCDF file has not")
            external = isinstance(link, h5py.ExternalLink)
            item = None if external else node.get(name)
            if external or (item is not None and item.file.filename != node.file.filename):
                into.closed[inner] = "a link to another file"
            elif isinstance(item, h5py.Group):
                number = h5py.h5o.get_info(item.id).addr
                if number in above:
                    raise FileError(f"the group {inner} contains itself")
                if not name.startswith("#"):
                    visit(item, inner, (*above, number))
            elif isinstance(item, h5py.Dataset):
                _visit_dataset(item, inner, into, load)

    with h5py.File(path, "r") as file:
        visit(file, "", (h5py.h5o.get_info(file["/"].id).addr,))


def _visit_dataset(item: Any, place: str, into: FileArrays, load: bool) -> None:
    into.check_size(place, int(item.nbytes or 0))
    matlab = _text(item.attrs.get("MATLAB_class", b""))
    if item.is_virtual or item.external:
        into.closed[place] = "a link to another file"
    elif "MATLAB_object_decode" in item.attrs or matlab in ("string", "table", "timetable"):
        into.closed[place] = f"a MATLAB {matlab} object"
    elif load and "ref" not in (item.dtype.metadata or {}):
        texts = "vlen" in (item.dtype.metadata or {})
        into.add(place, (item.asstr() if texts else item)[()], _unit(item.attrs))


def read_netcdf(path: str, into: FileArrays) -> None:
    """Add the variables of a netCDF file, masked and scaled as it says."""
    import xarray

    with open(path, "rb") as file:
        modern = file.read(4) == b"\x89HDF"
    options: dict[str, Any] = {"decode_times": False, "decode_coords": False}
    if modern:
        read_hdf5(path, FileArrays(left=into.left), load=False)
        groups = xarray.open_groups(path, engine="h5netcdf", **options)
    else:
        groups = {"/": xarray.open_dataset(path, engine="scipy", **options)}
    for place, data in groups.items():
        with data:
            for name, variable in data.variables.items():
                inner = f"{place.strip('/')}/{name}".strip("/")
                into.check_size(inner, int(variable.nbytes))
                calendar = str(variable.attrs.get("calendar", "standard"))
                if calendar.lower() not in _CALENDARS:
                    into.closed[inner] = f"in the calendar {calendar!r}"
                    continue
                into.add(inner, variable.values, _unit(variable.attrs))


def check_hdf5(path: str, into: FileArrays) -> None:
    """Read all that an HDF5 file holds, and keep nothing."""
    import h5py

    def visit(_: str, item: Any) -> None:
        dict(item.attrs)
        if isinstance(item, h5py.Dataset):
            into.check_size(item.name, int(item.nbytes or 0))
            item[()]

    with h5py.File(path, "r") as file:
        dict(file.attrs)
        file.visititems(visit)


def check_tree(path: str, into: FileArrays) -> None:
    """Open a netCDF file of groups as `Posterior.load` does, and keep nothing."""
    import xarray

    check_hdf5(path, into)
    xarray.open_datatree(path, engine="h5netcdf").load().close()


def read_mat(path: str, into: FileArrays) -> None:
    """Add the variables of a MAT file of any version; fields of structs as nested names."""
    with open(path, "rb") as file:
        head = file.read(520)
    if b"\x89HDF\r\n\x1a\n" in (head[:8], head[512:]):
        if head[124:126] not in (b"\x00\x02", b"\x02\x00"):
            read_hdf5(path, into)  # Written by another program than MATLAB.
            return
        import pymatreader

        checked = FileArrays(left=into.left)
        read_hdf5(path, checked, load=False)
        into.closed.update(checked.closed)
        content = pymatreader.read_mat(path)
    else:
        import scipy.io

        # The reader only warns of a doubled variable, and drops one of the two.
        warnings.filterwarnings("error", message="Duplicate variable name")
        content = scipy.io.loadmat(path, appendmat=False, simplify_cells=True)
    _add_struct(content, "", into, 0)
    _open_objects(path, into)


def _add_struct(struct: dict[str, Any], place: str, into: FileArrays, depth: int) -> None:
    if depth > LIMITS.deepest:
        raise FileError(f"{place} is nested too deeply")
    for name, value in struct.items():
        inner = f"{place}/{name}" if place else name
        if name.startswith(("__", "#")) or inner in into.closed:
            continue
        if isinstance(value, dict):
            _add_struct(value, inner, into, depth + 1)
        elif type(value).__name__ in _OPAQUE:
            into.closed[inner] = f"a MATLAB {_class_of(value)} object"
        elif isinstance(value, list | np.ndarray):
            _add_value(value, inner, into, depth)
        elif isinstance(value, str):
            into.add(inner, np.array([value]))
    _add_units(struct, place, into)


def _add_value(value: Any, place: str, into: FileArrays, depth: int) -> None:
    """Add a list of structs as place(1), place(2), ...; any other list or array as it is."""
    items = value.ravel().tolist() if isinstance(value, np.ndarray) else value
    if isinstance(value, list) or value.dtype.kind == "O":
        if items and all(isinstance(item, dict) for item in items):
            for number, item in enumerate(items, start=1):
                _add_struct(item, f"{place}({number})", into, depth + 1)
            return
        try:
            value = np.array(items)
        except ValueError:  # Cells of different sizes.
            return
    if value.dtype.kind in "iufbUS":
        into.add(place, value)


def _class_of(value: Any) -> str:
    try:
        return str(np.asarray(value)["_Class"].item())
    except Exception:
        return "closed"


def _add_units(struct: dict[str, Any], place: str, into: FileArrays) -> None:
    """Add the units of a timeseries that was saved as a struct."""
    for name, info in (("Data", "DataInfo"), ("Time", "TimeInfo")):
        details = struct.get(info)
        unit = details.get("Units") if isinstance(details, dict) else None
        path = f"{place}/{name}" if place else name
        if isinstance(unit, str) and unit and path in into.arrays:
            into.units[path] = unit


def _open_objects(path: str, into: FileArrays) -> None:
    """Add MATLAB objects that the other readers left closed; unknown classes stay closed."""
    places = [place for place, what in into.closed.items() if what.startswith("a MATLAB ")]
    if not places:
        return
    try:
        opened = opened_objects(path, places)
    except ImportError:  # The extra is not installed; for Python 3.14 it has no wheel yet.
        for place in places:
            into.closed[place] += " (pip install 'bayes-inertia[matlab]' may open it)"
        return
    for place, parts in opened.items():
        del into.closed[place]
        for inner, values, unit in parts:
            into.check_size(inner, int(values.nbytes))
            into.add(inner, values, unit)
