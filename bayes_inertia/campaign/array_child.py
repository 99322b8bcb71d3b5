"""Reads the arrays of an HDF5, netCDF or MAT file in a process of its own.

A damaged file of these kinds can crash or hang the libraries that read it, or claim more memory
than there is. `isolated_arrays` runs this file as a script, with a limit of time and memory, and
reads what it leaves. It imports nothing of the package, so that it starts fast.

    python array_child.py KIND PATH OUTPUT.npz BYTES SECONDS MEMORY
"""

from __future__ import annotations

import json
import os
import sys
import warnings
from typing import Any

import numpy as np

MAX_DEPTH = 12  # Of groups inside groups.
MAX_ARRAYS = 20000
UNIT_NAMES = ("units", "unit", "Units", "Unit", "UNITS")
TEXT_CLASSES = ("char", "cell", "struct", "logical", "single", "double")


class ChildError(Exception):
    """What is wrong with the file, in words for its user."""


class Contents:
    """The arrays of a file by path, with their units and what could not be read.

    Parameters
    ----------
    limit : int
        The most bytes that all arrays together may have.
    """

    def __init__(self, limit: int):
        self.arrays: dict[str, np.ndarray] = {}
        self.units: dict[str, str] = {}
        self.closed: dict[str, str] = {}
        self.left = limit

    def check_size(self, path: str, size: int) -> None:
        """Refuse an array before it is read.

        Parameters
        ----------
        path : str
            The array.
        size : int
            Its bytes.
        """
        self.left -= size
        if self.left < 0 or len(self.arrays) > MAX_ARRAYS:
            raise ChildError(f"{path} claims more data than such a file can hold")

    def add(self, path: str, value: Any, unit: str = "") -> None:
        """Keep an array of numbers or texts; anything else is left out.

        Parameters
        ----------
        path : str
            Its name, with "/" between groups.
        value : object
            The array.
        unit : str, optional
            Its unit.
        """
        array: np.ndarray | None = np.asarray(value)
        assert array is not None
        if array.dtype.names:
            for name in array.dtype.names:
                self.add(f"{path}/{name}", array[name], unit)
            return
        if array.dtype.kind == "O":
            array = _texts(array)
        if array is not None and array.dtype.kind in "iufbUSM":
            if array.dtype.kind == "S":
                array = np.char.decode(array, "utf-8", "replace")
            if array.dtype.kind == "M":
                array = np.datetime_as_string(array.astype("datetime64[ns]"))
            self.arrays[path] = array
            if unit:
                self.units[path] = unit


def _texts(array: np.ndarray) -> np.ndarray | None:
    """An array of objects as texts, or None where they are something else."""
    items = [
        item.decode("utf-8", "replace") if isinstance(item, bytes) else item
        for item in array.ravel().tolist()
    ]
    if not items or not all(isinstance(item, str) for item in items):
        return None
    return np.array(items, dtype=str).reshape(array.shape)


def _text(value: Any) -> str:
    value = value.item() if isinstance(value, np.ndarray) and value.size == 1 else value
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace").strip()
    return value.strip() if isinstance(value, str) else ""


def _unit(attributes: Any) -> str:
    return next((_text(attributes[name]) for name in UNIT_NAMES if name in attributes), "")


def read_hdf5(path: str, into: Contents, *, load: bool = True) -> None:
    """Arrays of an HDF5 file; with `load` false only its links and sizes are checked.

    Parameters
    ----------
    path : str
        The file.
    into : Contents
        Where they go.
    load : bool, optional
        Whether to read the arrays.
    """
    import h5py

    def visit(node: Any, place: str, above: tuple[Any, ...]) -> None:
        if len(above) > MAX_DEPTH:
            raise ChildError(f"{place} is nested too deeply")
        for name in node:
            inner = f"{place}/{name}" if place else name
            link = node.get(name, getlink=True)
            if not isinstance(link, h5py.HardLink) and not load:
                raise ChildError(f"{inner} is a link, which a MAT or netCDF file has not")
            if isinstance(link, h5py.ExternalLink):
                into.closed[inner] = "a link to another file"
                continue
            item = node.get(name)
            if item is not None and item.file.filename != node.file.filename:
                into.closed[inner] = "a link to another file"
                continue
            if isinstance(item, h5py.Group):
                number = h5py.h5o.get_info(item.id).addr
                if number in above:
                    raise ChildError(f"the group {inner} contains itself")
                if not name.startswith("#"):
                    visit(item, inner, (*above, number))
            elif isinstance(item, h5py.Dataset):
                _visit_dataset(item, inner, into, load)

    with h5py.File(path, "r") as file:
        visit(file, "", (h5py.h5o.get_info(file["/"].id).addr,))


def _visit_dataset(item: Any, place: str, into: Contents, load: bool) -> None:
    into.check_size(place, int(item.nbytes or 0))
    matlab = _text(item.attrs.get("MATLAB_class", b""))
    if item.is_virtual or item.external:
        into.closed[place] = "a link to another file"
    elif "MATLAB_object_decode" in item.attrs or matlab in ("string", "table", "timetable"):
        into.closed[place] = f"a MATLAB {matlab} object"
    elif load:
        if item.dtype.kind == "O" and item.dtype.metadata and "ref" in item.dtype.metadata:
            return
        value = item.asstr()[()] if item.dtype.metadata and "vlen" in item.dtype.metadata else None
        into.add(place, item[()] if value is None else value, _unit(item.attrs))


def read_netcdf(path: str, into: Contents) -> None:
    """Variables of a netCDF file, masked and scaled as it says.

    Parameters
    ----------
    path : str
        The file.
    into : Contents
        Where they go.
    """
    import xarray

    with open(path, "rb") as file:
        modern = file.read(4) == b"\x89HDF"
    options: dict[str, Any] = {
        "decode_times": False,
        "mask_and_scale": True,
        "decode_coords": False,
    }
    if modern:
        read_hdf5(path, Contents(into.left), load=False)
        groups = xarray.open_groups(path, engine="h5netcdf", **options)
    else:
        groups = {"/": xarray.open_dataset(path, engine="scipy", **options)}
    for place, data in groups.items():
        with data:
            for name, variable in data.variables.items():
                inner = f"{place.strip('/')}/{name}".strip("/")
                into.check_size(inner, int(variable.nbytes))
                calendar = str(variable.attrs.get("calendar", "standard"))
                if calendar.lower() not in ("standard", "gregorian", "proleptic_gregorian"):
                    into.closed[inner] = f"in the calendar {calendar!r}"
                    continue
                into.add(inner, variable.values, _unit(variable.attrs))


def read_mat(path: str, into: Contents) -> None:
    """Variables of a MAT file of any version; fields of structs as nested names.

    Parameters
    ----------
    path : str
        The file.
    into : Contents
        Where they go.
    """
    with open(path, "rb") as file:
        head = file.read(520)
    if b"\x89HDF\r\n\x1a\n" in (head[:8], head[512:]):
        if head[124:126] not in (b"\x00\x02", b"\x02\x00"):
            read_hdf5(path, into)  # Written by another program than MATLAB.
            return
        import pymatreader

        checked = Contents(into.left)
        read_hdf5(path, checked, load=False)
        into.closed.update(checked.closed)
        content = pymatreader.read_mat(path)
    else:
        import scipy.io

        # The reader only warns of a doubled variable, and drops one of the two.
        warnings.filterwarnings("error", message="Duplicate variable name")
        content = scipy.io.loadmat(path, appendmat=False, simplify_cells=True)
    _add_struct(content, "", into, 0)


def _add_struct(struct: dict[str, Any], place: str, into: Contents, depth: int) -> None:
    if depth > MAX_DEPTH:
        raise ChildError(f"{place} is nested too deeply")
    for name, value in struct.items():
        if name.startswith(("__", "#")):
            continue
        inner = f"{place}/{name}" if place else name
        if inner in into.closed:
            continue
        if isinstance(value, dict):
            _add_struct(value, inner, into, depth + 1)
        elif type(value).__name__ in ("MatlabOpaque", "MatlabFunction", "MatlabObject"):
            into.closed[inner] = f"a MATLAB {_class_of(value)} object"
        elif isinstance(value, list | np.ndarray):
            _add_value(value, inner, into, depth)
        elif isinstance(value, str):
            into.add(inner, np.array([value]))
    _add_units(struct, place, into)


def _add_value(value: Any, place: str, into: Contents, depth: int) -> None:
    """A list of structs as place(1), place(2), ...; any other list or array as it is."""
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


def _add_units(struct: dict[str, Any], place: str, into: Contents) -> None:
    """Units of a timeseries that was saved as a struct."""
    for name, info in (("Data", "DataInfo"), ("Time", "TimeInfo")):
        details = struct.get(info)
        unit = details.get("Units") if isinstance(details, dict) else None
        path = f"{place}/{name}" if place else name
        if isinstance(unit, str) and unit and path in into.arrays:
            into.units[path] = unit


def keep_within(seconds: int, memory: int) -> None:
    """Keep a damaged file from taking the machine's time and memory.

    The child limits itself: a limit set between fork and exec would run code of the parent, whose
    threads the fork does not copy.

    Parameters
    ----------
    seconds : int
        Processor time [s].
    memory : int
        Address space [bytes].
    """
    if os.name != "posix":
        return
    import resource

    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))


def main(kind: str, path: str, output: str, limit: str, seconds: str, memory: str) -> int:
    """Read one file and leave its arrays.

    Parameters
    ----------
    kind : str
        "hdf5", "netcdf" or "mat".
    path : str
        The file.
    output : str
        The .npz file to write.
    limit : str
        The most bytes of all arrays.
    seconds : str
        Limit of processor time [s].
    memory : str
        Limit of memory [bytes].

    Returns
    -------
    int
        0, or 3 with what is wrong on the standard output.
    """
    keep_within(int(seconds), int(memory))
    into = Contents(int(limit))
    readers = {"hdf5": read_hdf5, "netcdf": read_netcdf, "mat": read_mat}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            readers[kind](path, into)
    except Exception as error:  # The libraries raise whatever they stumble over.
        reason = (str(error).splitlines() or [""])[0][:200] or type(error).__name__
        print(json.dumps({"error": reason}))
        return 3
    names = list(into.arrays)
    index = json.dumps({"names": names, "units": into.units, "closed": into.closed})
    arrays = {f"a{i}": into.arrays[name] for i, name in enumerate(names)}
    with open(output, "wb") as file:
        np.savez(file, allow_pickle=False, index=np.array(index), **arrays)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:7]))
