"""What a file of arrays holds, collected in the process that reads it.

It and the readers beside it import nothing heavy of the package, so that the process starts fast.
"""

from __future__ import annotations

from typing import Any

import numpy as np

MAX_DEPTH = 12  # Of groups inside groups.
MAX_ARRAYS = 20000


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
