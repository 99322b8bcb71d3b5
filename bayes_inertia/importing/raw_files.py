"""The reader of raw logs: the format is told by content and suffix, each has its own file.

    read_raw(path, *, table="", options=TextOptions()) -> RawTable
    tables_in(path, *, options=TextOptions()) -> list of str

`time_stamps.times_to_seconds(table, names, kind) -> TimeStamps` with
`TimeStamps(ns, missing, absolute, resolution_s)` puts the stamps of every clock on one scale of
integer nanoseconds (TAI since 1958 where `absolute`, else since the clock's own zero), and
`unit_factors.unit_factor(quantity, unit)`, `unit_factors.to_si_with(values, unit, quantity)` do so
with units.
"""

from __future__ import annotations

from pathlib import Path

from bayes_inertia.errors import CampaignError
from bayes_inertia.importing.raw_table import RawTable
from bayes_inertia.importing.text_options import TextOptions


def read_raw(path: str | Path, *, table: str = "", options: TextOptions | None = None) -> RawTable:
    """One table of a raw log.

    Parameters
    ----------
    path : str or Path
        The file.
    table : str, optional
        The group, struct or segment, as `tables_in` names it, where the file holds several.
    options : TextOptions, optional
        How a text file is written, where it cannot be told from its content.

    Returns
    -------
    RawTable
        Its columns.

    Raises
    ------
    CampaignError
        If the file cannot be read, or holds several tables and none is named.
    """
    raise CampaignError("no reader", where=str(path))


def tables_in(path: str | Path, *, options: TextOptions | None = None) -> list[str]:
    """The tables that a raw log holds.

    Parameters
    ----------
    path : str or Path
        The file.
    options : TextOptions, optional
        How a text file is written.

    Returns
    -------
    list of str
        Names for `read_raw`; one empty name where the file is one table.
    """
    raise CampaignError("no reader", where=str(path))
