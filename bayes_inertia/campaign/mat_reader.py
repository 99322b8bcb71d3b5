"""The reader of MAT files of any version; `array_child` runs it in a process of its own."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from bayes_inertia.campaign.array_contents import MAX_DEPTH, ChildError, Contents
from bayes_inertia.campaign.array_readers import read_hdf5
from bayes_inertia.campaign.mat_objects import read_objects


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
    read_objects(path, into)


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
