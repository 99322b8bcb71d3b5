"""Readers of HDF5 and netCDF files; `array_child` runs them in a process of its own."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayes_inertia.campaign.array_contents import MAX_DEPTH, ChildError, Contents

UNIT_NAMES = ("units", "unit", "Units", "Unit", "UNITS")


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


def check_hdf5(path: str, into: Contents) -> None:
    """Read all that an HDF5 file holds, and keep nothing.

    Parameters
    ----------
    path : str
        The file.
    into : Contents
        Of which only the limit is used.
    """
    import h5py

    def visit(_: str, item: Any) -> None:
        dict(item.attrs)
        if isinstance(item, h5py.Dataset):
            into.check_size(item.name, int(item.nbytes or 0))
            item[()]

    with h5py.File(path, "r") as file:
        dict(file.attrs)
        file.visititems(visit)


def check_tree(path: str, into: Contents) -> None:
    """Open a netCDF file of groups as `Posterior.load` does, and keep nothing.

    Parameters
    ----------
    path : str
        The file.
    into : Contents
        Of which only the limit is used.
    """
    import xarray

    check_hdf5(path, into)
    xarray.open_datatree(path, engine="h5netcdf").load().close()
