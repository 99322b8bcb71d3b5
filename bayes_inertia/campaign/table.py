"""What every reader of tables returns: named columns of numbers that know their lines."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence

import numpy as np

from bayes_inertia.errors import CampaignError
from bayes_inertia.maths.values import array_dataclass

# Names of columns that a message lists, and the characters of one.
_MOST_NAMES, _LONGEST_NAME = 60, 60


@array_dataclass
class Table:
    """Some columns of a table, as 64-bit floats with NaN for empty cells.

    Parameters
    ----------
    label : str
        The file, as messages name it.
    columns : dict of str to (rows,) array
        Values by column name, in the file's own units.
    lines : (rows,) array of int, optional
        Line numbers as a text editor shows them; None for files without lines.
    single : frozenset of str, optional
        Columns that the file stores as 32-bit floats.

    Examples
    --------
    >>> Table("a.csv", {"t": np.zeros(2)}, np.array([2, 4])).place(1, "t")
    'a.csv, line 4, column t'
    """

    label: str
    columns: dict[str, np.ndarray]
    lines: np.ndarray | None = None
    single: frozenset[str] = frozenset()

    def place(self, row: int, column: str | None = None) -> str:
        """Where a cell is, for a message: file, line (or row from 1) and column.

        Parameters
        ----------
        row : int
            The row, counted from 0.
        column : str, optional
            The column; None for the whole row.

        Returns
        -------
        str
            Such as "a.csv, line 4, column t".
        """
        return f"{self.label}, {self.row(row)}{f', column {column}' if column else ''}"

    def row(self, row: int) -> str:
        """A row as people count: "line 12" of a text file, else "row 11".

        Parameters
        ----------
        row : int
            The row, counted from 0.

        Returns
        -------
        str
            The line or the row.
        """
        return f"row {row + 1}" if self.lines is None else f"line {int(self.lines[row])}"

    def stack(self, names: Sequence[str]) -> np.ndarray:
        """Columns side by side.

        Parameters
        ----------
        names : sequence of str
            The columns.

        Returns
        -------
        (rows, len(names)) array
            Their values, in the file's own units.
        """
        return np.stack([self.columns[name] for name in names], axis=1)


def check_columns_present(names: Iterable[str], available: Sequence[str], place: str) -> None:
    """Raise an error that names the nearest column if one is absent.

    Parameters
    ----------
    names : iterable of str
        The columns that are wanted.
    available : sequence of str
        The columns that the table has.
    place : str
        File and line of the header, for the message.

    Raises
    ------
    CampaignError
        If a column is absent.

    Examples
    --------
    >>> check_columns_present(["wx"], ["t", "w_x"], "a.csv, line 1")
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: a.csv, line 1: no column 'wx' (named in [columns]); ...
    """
    for name in names:
        if name not in available:
            near = difflib.get_close_matches(name, available, 1)
            hint = f"did you mean {near[0]!r}? " if near else ""
            raise CampaignError(
                f"no column {name!r} (named in [columns])",
                where=place,
                advice=f"{hint}The table has: {listed_names(available)}",
            )


def listed_names(names: Sequence[str]) -> str:
    """Names of columns for a message: one line, whatever a damaged header holds.

    Parameters
    ----------
    names : sequence of str
        In the order of the table.

    Returns
    -------
    str
        At most sixty names of at most sixty characters.

    Examples
    --------
    >>> listed_names(["t_s", "w\\n0.0,1.0"])
    't_s, w\\\\n0.0,1.0'
    """
    plain = [name if name.isprintable() else ascii(name)[1:-1] for name in names[:_MOST_NAMES]]
    short = [name if len(name) <= _LONGEST_NAME else f"{name[:_LONGEST_NAME]}..." for name in plain]
    return ", ".join([*short, *["..."] * (len(names) > _MOST_NAMES)]) or "no column"
