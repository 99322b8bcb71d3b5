"""Arrays of HDF5, netCDF and MAT files, read in a process of their own with limits.

The libraries behind these formats can crash or hang on a damaged file; the process then dies, and
the user gets one message. It costs 0.3 to 0.8 s a file; the last files are kept, so that the next
slew or stream of the same file costs nothing.
"""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np

from bayes_inertia.errors import CampaignError
from bayes_inertia.maths.values import array_dataclass

_SECONDS = 10.0  # Processor time for any file; more for a large one.
_PATIENCE = 6.0  # Of that time on the clock: other programs want the processor too.
_BYTES_PER_SECOND = 5e6
_MEMORY = 8 * 2**30  # [bytes]
_LEAST_CONTENT = 10**8  # [bytes] that even a small, compressed file may hold.
_COMPRESSION = 300  # Bytes of arrays a byte of file.

_OUT_OF_TIME = int(getattr(signal, "SIGXCPU", 0))

ArrayKind = Literal["hdf5", "netcdf", "mat"]


@array_dataclass
class FileArrays:
    """What a file of arrays holds.

    Parameters
    ----------
    arrays : dict of str to array
        Numbers and texts by path, with "/" between groups or structs.
    units : dict of str to str
        Units that the file states.
    closed : dict of str to str
        What could not be read, and what it is.
    """

    arrays: dict[str, np.ndarray]
    units: dict[str, str]
    closed: dict[str, str]


def read_arrays(path: Path, kind: ArrayKind, *, seconds: float | None = None) -> FileArrays:
    """All arrays of a file.

    Parameters
    ----------
    path : Path
        The file.
    kind : {"hdf5", "netcdf", "mat"}
        Its format.
    seconds : float, optional
        Limit of processor time [s]; None for 10 s and one for every 5 MB.

    Returns
    -------
    FileArrays
        Its arrays.

    Raises
    ------
    CampaignError
        If the file is damaged, too large for what it is, or its library crashes or hangs on it.
    """
    try:
        state = path.stat()
    except OSError as error:
        raise CampaignError(
            f"cannot be opened ({error.strerror})", where=str(path), advice="check the path"
        ) from error
    size = state.st_size
    limit = seconds if seconds is not None else _SECONDS + size / _BYTES_PER_SECOND
    return _read(str(path), str(path.resolve()), kind, limit, size, state.st_mtime_ns)


@lru_cache(maxsize=4)
def _read(label: str, path: str, kind: ArrayKind, limit: float, size: int, _: int) -> FileArrays:
    """The arrays of a file of a size and time of change."""
    content = min(_LEAST_CONTENT + _COMPRESSION * size, _MEMORY // 2)
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "arrays.npz"
        child = str(Path(__file__).with_name("array_child.py"))
        limits = [str(content), str(math.ceil(limit)), str(_MEMORY)]
        _run([sys.executable, child, kind, path, str(output), *limits], limit, label, kind)
        return _contents(output, label)


def _run(command: list[str], limit: float, label: str, kind: str) -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            timeout=_PATIENCE * limit,
            env=environment,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise _hangs(limit, label, kind) from error
    if done.returncode == 0:
        return
    if done.returncode == -_OUT_OF_TIME:
        raise _hangs(limit, label, kind)
    try:
        reason = json.loads(done.stdout)["error"]
    except (ValueError, KeyError, TypeError):
        reason = f"its library ends with status {done.returncode}"
    raise CampaignError(
        f"cannot be read as {_NAMES[kind]} ({reason})",
        where=label,
        advice="export it again, or use CSV",
    )


_NAMES = {"hdf5": "an HDF5 file", "netcdf": "a netCDF file", "mat": "a MAT file"}


def _hangs(limit: float, label: str, kind: str) -> CampaignError:
    return CampaignError(
        f"cannot be read within {limit:.0f} s as {_NAMES[kind]}",
        where=label,
        advice="the file is damaged: export it again, or use CSV",
    )


def _contents(output: Path, label: str) -> FileArrays:
    try:
        with np.load(output, allow_pickle=False) as stored:
            index = json.loads(str(stored["index"]))
            arrays = {name: stored[f"a{i}"] for i, name in enumerate(index["names"])}
    except (OSError, ValueError, KeyError) as error:
        raise CampaignError(
            "cannot be read: its process left nothing",
            where=label,
            advice="export it again, or use CSV",
        ) from error
    return FileArrays(arrays, index["units"], index["closed"])
