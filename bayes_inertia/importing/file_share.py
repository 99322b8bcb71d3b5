"""What one file holds of one stream, before the clocks are brought together."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.tables.raw_table import row_name
from bayes_inertia.tables.time_stamps import TimeStamps

SHARED_ZERO = "campaign"
"""The `epoch` of clocks that share one unknown zero."""
ZERO_OF_FILE = "file"
"""The `epoch` of clocks that start anew in each file."""


@array_dataclass
class FileShare:
    """One file's share of a stream, its stamps not yet on the common clock.

    Parameters
    ----------
    stream : pydantic model
        The `[[streams]]` of the mapping.
    file : str
        The file, as messages name it.
    stamps : TimeStamps
        The stamp of each row.
    values : (rows, width) array
        Readings in SI units and the package's senses; NaN where there is none.
    rounding : tuple of float
        Standard deviation of the rounding in the file, as of `LoggedStream`.
    notes : tuple of str, optional
        What a user should know of the file.
    lines : (rows,) array of int, optional
        Lines as a text editor shows them; None for files without lines.
    """

    stream: Any
    file: str
    stamps: TimeStamps
    values: np.ndarray
    rounding: tuple[float, ...]
    notes: tuple[str, ...] = ()
    lines: np.ndarray | None = None

    @property
    def counts(self) -> np.ndarray:
        """Stamps of the rows that have one, from the clock's own zero [ns]."""
        return self.stamps.ns[~self.stamps.missing] - self.stamps.zero_ns

    def place(self, row: int) -> str:
        """Where a row is, for a message."""
        return f"{self.file}, {row_name(self.lines, row)}"
