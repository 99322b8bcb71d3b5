"""Parquet, HDF5 and MAT tables; their libraries are imported only when such a file is read.

On a damaged file these libraries raise whatever they stumble over, so all exceptions of theirs are
caught here.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bayes_inertia.campaign.table import Table, check_columns_present
from bayes_inertia.errors import CampaignError

_MAX_GROUP_DEPTH = 4  # of groups inside groups; a group may contain itself


def read_parquet(path: Path, names: Sequence[str]) -> Table:
    """The columns of a Parquet file; null becomes NaN.

    Parameters
    ----------
    path : Path
        The file.
    names : sequence of str
        The columns.

    Returns
    -------
    Table
        The columns, in the file's own units.

    Raises
    ------
    CampaignError
        If the file is damaged, or a column is absent or holds no numbers.
    """
    from pyarrow import parquet

    label = str(path)
    try:
        with parquet.ParquetFile(path) as file:
            available = list(file.schema_arrow.names)
            doubled = sorted({name for name in available if available.count(name) > 1})
            if doubled:
                raise CampaignError(
                    f"two columns are named {doubled[0]!r}",
                    where=label,
                    advice="give each column its own name",
                )
            check_columns_present(names, available, label)
            # Whole columns at once, so that a name with a dot is not taken for a nested one.
            table = file.read()
    except CampaignError:
        raise
    except Exception as error:
        raise _unreadable(label, "a Parquet file", error) from error
    return _parquet_columns(table, names, label)


def _parquet_columns(table: Any, names: Sequence[str], label: str) -> Table:
    """Columns of an Arrow table as floats, or `CampaignError` where one holds no numbers."""
    import pyarrow
    from pyarrow import types

    kinds = {name: table.schema.field(name).type for name in names}
    numeric = (types.is_integer, types.is_floating, types.is_decimal, types.is_null)
    for name, kind in kinds.items():
        if not any(holds(kind) for holds in numeric):
            what = f"holds {kind}, not numbers"
            raise CampaignError(what, where=f"{label}, column {name}", advice=_ADVICE)
    arrays = {
        name: table.column(name).cast(pyarrow.float64(), safe=False).to_numpy() for name in names
    }
    single = frozenset(name for name, kind in kinds.items() if kind == pyarrow.float32())
    return Table(label, arrays, single=single)


def read_hdf5(path: Path, names: Sequence[str], group: str = "") -> Table:
    """The columns of an HDF5 file (also MAT v7.3): one dataset a column, in one group.

    Parameters
    ----------
    path : Path
        The file.
    names : sequence of str
        The columns.
    group : str, optional
        Where several groups hold all columns, the one of this name is read.

    Returns
    -------
    Table
        The columns, in the file's own units.

    Raises
    ------
    CampaignError
        If the file is damaged, or a column is absent, links elsewhere, or holds no numbers.
    """
    import h5py

    label = str(path)
    try:
        with h5py.File(path, "r") as file:
            groups = _hdf5_groups(file, h5py)
            chosen = _choose(groups, names, group, label)
            return _table(
                {name: _hdf5_dataset(file, f"{chosen}/{name}", h5py, label) for name in names},
                label,
            )
    except CampaignError:
        raise
    except Exception as error:
        raise _unreadable(label, "an HDF5 file", error) from error


def _hdf5_groups(file: Any, h5py: Any) -> dict[str, list[str]]:
    groups: dict[str, list[str]] = {}

    def visit(node: Any, path: str, depth: int) -> None:
        members = list(node)
        groups[path] = members
        for name in members:
            hard = isinstance(node.get(name, getlink=True), h5py.HardLink)
            if (
                hard
                and depth < _MAX_GROUP_DEPTH
                and isinstance(node[name], h5py.Group)
                and not name.startswith("#")
            ):
                visit(node[name], f"{path}/{name}", depth + 1)

    visit(file, "", 0)
    return groups


def _hdf5_dataset(file: Any, path: str, h5py: Any, label: str) -> np.ndarray:
    column = path.rsplit("/", 1)[-1]
    dataset = None if isinstance(file.get(path, getlink=True), h5py.ExternalLink) else file[path]
    if dataset is None or (
        isinstance(dataset, h5py.Dataset)
        and (dataset.is_virtual or dataset.external or dataset.file.filename != file.filename)
    ):
        raise CampaignError(
            "links to another file",
            where=f"{label}, column {column}",
            advice="store the numbers in the table itself",
        )
    if (
        not isinstance(dataset, h5py.Dataset)
        or dataset.dtype.kind not in "iuf"
        or dataset.attrs.get("MATLAB_class") in (b"char", b"cell")
    ):
        raise CampaignError(
            "does not hold numbers", where=f"{label}, column {column}", advice=_ADVICE
        )
    return dataset[()]


def read_mat(path: Path, names: Sequence[str], group: str = "") -> Table:
    """The columns of a MAT file of any version: vectors, or the fields of one struct.

    Parameters
    ----------
    path : Path
        The file.
    names : sequence of str
        The columns.
    group : str, optional
        Where several structs hold all columns, the one of this name is read.

    Returns
    -------
    Table
        The columns, in the file's own units.

    Raises
    ------
    CampaignError
        If the file is damaged, or a column is absent or holds no numbers.
    """
    import h5py
    import scipy.io

    label = str(path)
    if h5py.is_hdf5(path):
        return read_hdf5(path, names, group)
    try:
        with warnings.catch_warnings():
            # The reader only warns of a doubled variable, and drops one of the two.
            warnings.simplefilter("error")
            content = scipy.io.loadmat(path, appendmat=False, simplify_cells=True)
    except Exception as error:
        raise _unreadable(label, "a MAT file", error) from error
    groups: dict[str, Mapping[str, Any]] = {}

    def visit(node: Mapping[str, Any], place: str, depth: int) -> None:
        groups[place] = {name: value for name, value in node.items() if not name.startswith("__")}
        for name, value in groups[place].items():
            if isinstance(value, dict) and depth < _MAX_GROUP_DEPTH:
                visit(value, f"{place}/{name}", depth + 1)

    visit(content, "", 0)
    chosen = groups[_choose(groups, names, group, label)]
    return _table({name: np.asarray(chosen[name]) for name in names}, label)


_ADVICE = "store each column as a vector of plain numbers"


def _choose(groups: Mapping[str, Any], names: Sequence[str], requested: str, label: str) -> str:
    """The group that holds all columns: the only one, or the one called `requested`."""
    full = [path for path, members in groups.items() if set(names) <= set(members)]
    if not full:
        best = max(groups, key=lambda path: len(set(names) & set(groups[path])))
        check_columns_present(names, list(groups[best]), f"{label}, group {best or '/'}")
    if len(full) == 1:
        return full[0]
    named = [path for path in full if path.rsplit("/", 1)[-1] == requested]
    if len(named) != 1:
        listed = ", ".join(path or "/" for path in full)
        raise CampaignError(
            f"several groups hold the columns: {listed}",
            where=label,
            advice="name one group as the slew, or give each slew its own file",
        )
    return named[0]


def _table(columns: dict[str, np.ndarray], label: str) -> Table:
    arrays: dict[str, np.ndarray] = {}
    rows: int | None = None
    for name, values in columns.items():
        where = f"{label}, column {name}"
        if values.dtype.kind not in "iuf":
            raise CampaignError("does not hold numbers", where=where, advice=_ADVICE)
        # MATLAB vectors are matrices of one row or one column.
        if values.size != max(values.shape, default=1):
            raise CampaignError(
                f"has shape {values.shape}, not that of one column", where=where, advice=_ADVICE
            )
        rows = values.size if rows is None else rows
        if values.size != rows:
            raise CampaignError(
                f"has {values.size} rows, but {next(iter(columns))} has {rows}",
                where=where,
                advice="give all columns one length",
            )
        arrays[name] = values.astype(float).ravel()
    return Table(
        label,
        arrays,
        single=frozenset(name for name, values in columns.items() if values.dtype == np.float32),
    )


def _unreadable(label: str, kind: str, error: Exception) -> CampaignError:
    reason = (str(error).splitlines() or [""])[0][:200] or type(error).__name__
    return CampaignError(
        f"cannot be read as {kind} ({reason})",
        where=label,
        advice="export the table again, or use CSV",
    )
