"""What every reader of tables returns: named columns of numbers that know which line they came from."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence

import numpy as np

from bayes_inertia.errors import CampaignError
from bayes_inertia.maths.values import array_dataclass


@array_dataclass
class Table:
    """Some columns of a table, as 64-bit floats with NaN for empty cells.

    Parameters
    ----------
    label : the file, as messages name it.
    columns : name -> (rows,) values in the file's own units.
    lines : (rows,) line numbers as a text editor shows them, None for files without lines.
    single : names of the columns that the file stores as 32-bit floats.

    >>> Table("a.csv", {"t": np.zeros(2)}, np.array([2, 4])).place(1, "t")
    'a.csv, line 4, column t'
    """

    label: str
    columns: dict[str, np.ndarray]
    lines: np.ndarray | None = None
    single: frozenset[str] = frozenset()

    def place(self, row: int, column: str | None = None) -> str:
        """Where row `row` (from 0) is, for a message: file, line (or row from 1) and column."""
        return f"{self.label}, {self.row(row)}{f', column {column}' if column else ''}"

    def row(self, row: int) -> str:
        """Row `row` (from 0) as people count: "line 12" of a text file, else "row 11"."""
        return f"row {row + 1}" if self.lines is None else f"line {int(self.lines[row])}"

    def stack(self, names: Sequence[str]) -> np.ndarray:
        """The columns `names` side by side (rows, len(names))."""
        return np.stack([self.columns[name] for name in names], axis=1)


def check_columns_present(names: Iterable[str], available: Sequence[str], place: str) -> None:
    """Raise `CampaignError` at `place`, with the nearest and all available names, if a column is absent.

    >>> check_columns_present(["wx"], ["t", "w_x"], "a.csv, line 1")
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: a.csv, line 1: no column 'wx' (named in [columns]); did you mean 'w_x'? The table has: t, w_x
    """
    for name in names:
        if name not in available:
            near = difflib.get_close_matches(name, available, 1)
            hint = f"did you mean {near[0]!r}? " if near else ""
            listed = ", ".join(available[:60]) + (", ..." if len(available) > 60 else "")
            raise CampaignError(
                f"no column {name!r} (named in [columns])",
                where=place,
                advice=f"{hint}The table has: {listed or 'no column'}",
            )
