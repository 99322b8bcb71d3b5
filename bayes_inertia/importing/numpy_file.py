"""NumPy files: .npz of several arrays, such as those of Basilisk recorders, and .npy of one."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import BinaryIO

import numpy as np

from bayes_inertia.errors import CampaignError

_LARGEST = 4 * 2**30  # [bytes] of all arrays together.


def numpy_arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays of a NumPy file; nothing in it is ever executed.

    Parameters
    ----------
    path : Path
        A .npz or .npy file.

    Returns
    -------
    dict of str to array
        By name, with "/" before the fields of records; "array" for a .npy file.

    Raises
    ------
    CampaignError
        If the file is damaged, too large, or holds Python objects.
    """
    try:
        # Opened here: of a damaged archive numpy forgets to close the file.
        with path.open("rb") as file:
            if zipfile.is_zipfile(file):
                _check_size(file)
                file.seek(0)
                with np.load(file, allow_pickle=False) as stored:
                    arrays = {name: stored[name] for name in stored.files}
            else:
                file.seek(0)
                arrays = {"array": np.load(file, allow_pickle=False)}
        return _fields(arrays)
    except Exception as error:  # Of a damaged file numpy and zipfile raise whatever they meet.
        reason = (str(error).splitlines() or [""])[0][:200] or type(error).__name__
        advice = "save it again with numpy.savez and plain arrays"
        if "allow_pickle" in reason:
            reason = "it holds Python objects, which could run a program when read"
            advice = "save each quantity as an array of numbers"
        raise CampaignError(
            f"cannot be read as a NumPy file ({reason})", where=str(path), advice=advice
        ) from error


def _check_size(file: BinaryIO) -> None:
    with zipfile.ZipFile(file) as members:
        total = sum(member.file_size for member in members.infolist())
    if total > _LARGEST:
        raise ValueError(f"{total / 2**30:.0f} GiB of arrays")


def _fields(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Records taken apart, and dates as text."""
    plain: dict[str, np.ndarray] = {}
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray):
            continue
        if array.dtype.names:
            parts = {f"{name}/{field}": array[field] for field in array.dtype.names}
            plain.update(_fields(parts))
        elif array.dtype.kind == "M":
            plain[name] = np.datetime_as_string(array.astype("datetime64[ns]"))
        elif array.dtype.kind in "iufbUS":
            plain[name] = array if array.dtype.kind != "S" else np.char.decode(array, "latin-1")
    return plain
