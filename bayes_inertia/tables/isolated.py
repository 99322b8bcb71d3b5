"""Arrays of HDF5, netCDF and MAT files, read in a process of their own with limits.

The libraries behind these formats can crash or hang on a damaged file, or claim more memory than
there is; the process then dies, and the user gets one message. It is a program of its own, run by
`subprocess`: a pool of processes runs the user's script again in each, and keeps what a damaged
file left in one. It costs 0.3 to 0.8 s a file; the last files are kept, so that the next slew or
stream of the same file, and the next reading of a campaign, cost nothing.

    python -m bayes_inertia.tables.isolated KIND PATH BYTES SECONDS MEMORY
"""

from __future__ import annotations

import contextlib
import importlib
import math
import os
import pickle
import signal
import subprocess
import sys
import time
import warnings
from functools import lru_cache
from pathlib import Path
from typing import Literal

from bayes_inertia.errors import CampaignError
from bayes_inertia.tables import array_files
from bayes_inertia.tables.array_files import FileArrays
from bayes_inertia.tables.limits import LIMITS

# One thread: the process computes nothing, and each thread takes memory.
_ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
_OUT_OF_TIME = getattr(signal, "SIGXCPU", None)

ArrayKind = Literal["hdf5", "netcdf", "mat"]
CheckKind = Literal["check", "check_tree"]
# Reader, libraries and name of each kind.
_KINDS = {
    "hdf5": (array_files.read_hdf5, ("h5py",), "an HDF5 file"),
    "netcdf": (
        array_files.read_netcdf,
        ("h5py", "h5netcdf", "scipy.io", "xarray"),
        "a netCDF file",
    ),
    "mat": (array_files.read_mat, ("scipy.io",), "a MAT file"),
    "check": (array_files.check_hdf5, ("h5py",), "an HDF5 file"),
    "check_tree": (array_files.check_tree, ("h5py", "h5netcdf", "xarray"), "a netCDF file"),
}
_EXPORT = "export it again, or use CSV"
_HELD = (
    "close it there, take a copy, or set HDF5_USE_FILE_LOCKING=FALSE in the environment to read "
    "what is written so far"
)
_NOT_CLOSED = (
    "close it where it is written; if nothing writes it any more, run h5clear -s on a copy"
)


def read_arrays(path: Path, kind: ArrayKind) -> FileArrays:
    """All arrays of a file; processor time is limited to 3 s and one for every 5 MB."""
    return _run(kind, str(path.resolve()), *_size_and_change(path), str(path), _EXPORT)


def check_readable(path: Path, kind: CheckKind, advice: str) -> None:
    """Raise an error unless an HDF5 file can be read to its end, by a process of its own.

    To be called before a library of this process opens a file that may be damaged.
    """
    _run(kind, str(path.resolve()), *_size_and_change(path), str(path), advice)


def _size_and_change(path: Path) -> tuple[int, int]:
    """Bytes of a file, and when it was changed [ns]."""
    try:
        state = path.stat()
    except OSError as error:
        what, advice = f"cannot be opened ({error.strerror})", "check the path"
        raise CampaignError(what, where=str(path), advice=advice) from error
    return state.st_size, state.st_mtime_ns


@lru_cache(maxsize=LIMITS.files_kept)
def _run(kind: str, path: str, size: int, _: int, label: str, advice: str) -> FileArrays:
    """Arrays that the process reads from a file of a size and time of change, or its error."""
    limit = LIMITS.processor_seconds + size / LIMITS.bytes_per_second
    content = min(LIMITS.least_content + LIMITS.largest_compression * size, LIMITS.most_content)
    memory = LIMITS.room_beside_arrays + LIMITS.copies_of_arrays * content
    limits = [str(content), str(math.ceil(limit)), str(memory)]
    paths = dict.fromkeys(p for p in (str(Path(__file__).parents[2]), *sys.path) if p)
    what = f"cannot be read within {limit:.0f} s as {_KINDS[kind][2]}"
    hangs = CampaignError(what, where=label, advice=f"the file is damaged: {_EXPORT}")
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-m", __name__, kind, path, *limits],
            capture_output=True,
            timeout=LIMITS.clock_seconds * max(1.0, limit / LIMITS.processor_seconds),
            env={**os.environ, **_ENVIRONMENT, "PYTHONPATH": os.pathsep.join(paths)},
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise hangs from error
    if _OUT_OF_TIME and done.returncode == -_OUT_OF_TIME:
        raise hangs
    found = f"its library ends with status {done.returncode}"
    if done.returncode == 0:
        try:
            found = pickle.loads(done.stdout)
        except (pickle.UnpicklingError, EOFError):
            found = "its process left nothing"
    if isinstance(found, FileArrays):
        return found
    raise _refusal(found, kind, label, advice)


def _refusal(reason: str, kind: str, label: str, advice: str) -> CampaignError:
    """Message on a file that could not be read."""
    what = f"cannot be read as {_KINDS[kind][2]} ({reason})"
    if "unable to lock file" in reason:
        what, advice = "another program holds the file", _HELD
    elif "already open for write" in reason:
        what, advice = "is open for writing, or its writer died", _NOT_CLOSED
    return CampaignError(what, where=label, advice=advice)


def load_libraries(kind: str) -> None:
    """Import what reads a kind of file, before the limits count: a slow machine takes its time."""
    for name in _KINDS[kind][1]:
        # Without one of them its reader says so.
        with contextlib.suppress(ImportError):
            importlib.import_module(name)


def answer(kind: str, path: str, content: str, seconds: str, memory: str) -> FileArrays | str:
    """The arrays of a file, or what is wrong with it; the calling process is limited for good.

    Limits are bytes of all arrays, processor time [s] and memory [bytes].
    """
    load_libraries(kind)
    _keep_within(int(seconds), int(memory))
    found = FileArrays(left=int(content))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            _KINDS[kind][0](path, found)
    except Exception as error:  # The libraries raise whatever they stumble over.
        return (str(error).splitlines() or [""])[0][:200] or type(error).__name__
    return found


def _keep_within(seconds: int, memory: int) -> None:
    """Limit the processor time [s] and address space [bytes] that this process takes from now on.

    A limit set between fork and exec would run code of the parent, whose threads no fork copies.
    """
    if os.name != "posix":
        return
    import resource

    import psutil

    seconds += math.ceil(time.process_time())
    memory += psutil.Process().memory_info().vms
    limits = {
        resource.RLIMIT_AS: (memory, memory),
        resource.RLIMIT_CORE: (0, 0),
        resource.RLIMIT_CPU: (seconds, seconds + 1),
    }
    for kind, (soft, hard) in limits.items():
        most = resource.getrlimit(kind)[1]
        if most != resource.RLIM_INFINITY:  # The user's own limit, which only a root may raise.
            soft, hard = min(soft, most), min(hard, most)
        resource.setrlimit(kind, (soft, hard))


if __name__ == "__main__":
    # What a library prints must not stand in the answer.
    with os.fdopen(os.dup(1), "wb") as output:
        os.dup2(2, 1)
        pickle.dump(answer(*sys.argv[1:6]), output, protocol=5)
