"""Parquet, HDF5 and MAT tables; their libraries are imported only when such a file is read.

HDF5 and MAT files are read in a process of their own, which a damaged file may crash. Of Parquet
all exceptions of the library are caught here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bayes_inertia.campaign.table import Table, check_columns_present
from bayes_inertia.errors import CampaignError
from bayes_inertia.tables.isolated import ArrayKind, read_arrays


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
        name: _with_quiet_nans(table.column(name).cast(pyarrow.float64(), safe=False).to_numpy())
        for name in names
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
    return _from_arrays(path, "hdf5", names, group)


def _from_arrays(path: Path, kind: ArrayKind, names: Sequence[str], group: str) -> Table:
    """The columns of the one group that holds them all."""
    label = str(path)
    held = read_arrays(path, kind)
    groups: dict[str, list[str]] = {}
    for place in (*held.arrays, *held.closed):
        parent, _, name = place.rpartition("/")
        groups.setdefault(f"/{parent}" if parent else "", []).append(name)
    chosen = _choose(groups, names, group, label) if groups else ""
    if not groups:
        check_columns_present(names, [], label)
    prefix = f"{chosen.removeprefix('/')}/" if chosen else ""
    for name in names:
        if prefix + name in held.closed:
            raise CampaignError(
                held.closed[prefix + name].replace("a link", "links", 1),
                where=f"{label}, column {name}",
                advice="store the numbers in the table itself",
            )
    return _table({name: held.arrays[prefix + name] for name in names}, label)


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
    return _from_arrays(path, "mat", names, group)


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


def _with_quiet_nans(values: np.ndarray) -> np.ndarray:
    """The same numbers; damage can make NaNs that every calculation would warn of."""
    return np.where(np.isnan(values), np.nan, values)


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
        arrays[name] = _with_quiet_nans(values.astype(float).ravel())
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
