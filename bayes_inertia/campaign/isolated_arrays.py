"""Arrays of HDF5, netCDF and MAT files, read in a process of their own with limits.

The libraries behind these formats can crash or hang on a damaged file; the process then dies, and
the user gets one message. It costs 0.3 to 0.8 s a file; the last files are kept, so that the next
slew or stream of the same file, and the next reading of a campaign, cost nothing.
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

_SECONDS = 3.0  # Processor time for any file, once its library is loaded; more for a large one.
_PATIENCE = 60.0  # [s] on the clock, and as many times more: other programs want the processor too.
_BYTES_PER_SECOND = 5e6
_LEAST_CONTENT = 10**8  # [bytes] that even a small, compressed file may hold.
_COMPRESSION = 300  # Bytes of arrays a byte of file.
_MOST_CONTENT = 2 * 2**30  # [bytes]
# What a reader takes beside its libraries: some copies of the arrays, and room for its own.
_COPIES, _ROOM = 4, 2**28  # [bytes]
_FILES_KEPT = 16
# One thread: the child computes nothing, and each thread takes memory.
_ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}

_OUT_OF_TIME = int(getattr(signal, "SIGXCPU", 0))

ArrayKind = Literal["hdf5", "netcdf", "mat"]
CheckKind = Literal["check", "check_tree"]


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
        Limit of processor time [s]; None for 3 s and one for every 5 MB.

    Returns
    -------
    FileArrays
        Its arrays.

    Raises
    ------
    CampaignError
        If the file is damaged, too large for what it is, or its library crashes or hangs on it.
    """
    size, changed = _size_and_change(path)
    limit = seconds if seconds is not None else _SECONDS + size / _BYTES_PER_SECOND
    return _read(str(path), str(path.resolve()), kind, limit, size, changed)


def check_readable(path: Path, kind: CheckKind, advice: str) -> None:
    """Raise an error unless a file can be read to its end, found out in a process of its own.

    To be called before a library of this process opens a file that may be damaged.

    Parameters
    ----------
    path : Path
        An HDF5 file.
    kind : {"check", "check_tree"}
        Whether to read it as HDF5 alone, or as a netCDF file of groups too.
    advice : str
        What to do about a damaged one.

    Raises
    ------
    CampaignError
        If the file is damaged.

    Examples
    --------
    >>> check_readable(Path("no/such/file.h5"), "check", "")
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: no/such/file.h5: cannot be opened (...
    """
    size, _ = _size_and_change(path)
    limit = _SECONDS + size / _BYTES_PER_SECOND
    _run([kind, str(path), os.devnull], size, limit, str(path), advice)


def _size_and_change(path: Path) -> tuple[int, int]:
    """Bytes of a file, and when it was changed [ns]."""
    try:
        state = path.stat()
    except OSError as error:
        raise CampaignError(
            f"cannot be opened ({error.strerror})", where=str(path), advice="check the path"
        ) from error
    return state.st_size, state.st_mtime_ns


@lru_cache(maxsize=_FILES_KEPT)
def _read(label: str, path: str, kind: ArrayKind, limit: float, size: int, _: int) -> FileArrays:
    """The arrays of a file of a size and time of change."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "arrays.npz"
        _run([kind, path, str(output)], size, limit, label, "export it again, or use CSV")
        return _contents(output, label)


def _run(task: list[str], size: int, limit: float, label: str, advice: str) -> None:
    """Let the child do a task on a file of this size, or say what is wrong with the file."""
    content = min(_LEAST_CONTENT + _COMPRESSION * size, _MOST_CONTENT)
    limits = [str(content), str(math.ceil(limit)), str(_ROOM + _COPIES * content)]
    paths = dict.fromkeys(p for p in (str(Path(__file__).parents[2]), *sys.path) if p)
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-m", f"{__package__}.array_child", *task, *limits],
            capture_output=True,
            timeout=_PATIENCE * max(1.0, limit / _SECONDS),
            env={**os.environ, **_ENVIRONMENT, "PYTHONPATH": os.pathsep.join(paths)},
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise _hangs(limit, label, task[0]) from error
    if done.returncode == 0:
        return
    if done.returncode == -_OUT_OF_TIME:
        raise _hangs(limit, label, task[0])
    try:
        reason = json.loads(done.stdout)["error"]
    except (ValueError, KeyError, TypeError):
        reason = f"its library ends with status {done.returncode}"
    what = f"cannot be read as {_NAMES[task[0]]} ({reason})"
    if "unable to lock file" in reason:
        what, advice = "another program holds the file", _HELD
    elif "already open for write" in reason:
        what, advice = "is open for writing, or its writer died", _NOT_CLOSED
    raise CampaignError(what, where=label, advice=advice)


_HELD = (
    "close it there, take a copy, or set HDF5_USE_FILE_LOCKING=FALSE in the environment to read "
    "what is written so far"
)
_NOT_CLOSED = (
    "close it where it is written; if nothing writes it any more, run h5clear -s on a copy"
)
_NAMES = {
    "hdf5": "an HDF5 file",
    "netcdf": "a netCDF file",
    "mat": "a MAT file",
    "check": "an HDF5 file",
    "check_tree": "a netCDF file",
}


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
