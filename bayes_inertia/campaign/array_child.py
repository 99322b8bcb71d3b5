"""Reads the arrays of an HDF5, netCDF or MAT file in a process of its own.

A damaged file of these kinds can crash or hang the libraries that read it, or claim more memory
than there is. `isolated_arrays` runs this file as a program, with a limit of time and memory, and
reads what it leaves.

    python -m bayes_inertia.campaign.array_child KIND PATH OUTPUT.npz BYTES SECONDS MEMORY

The limits count from the moment at which the libraries are loaded, so that a slow machine does
not use them up.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import math
import os
import sys
import time
import warnings
from collections.abc import Callable

import numpy as np

from bayes_inertia.campaign.array_contents import Contents
from bayes_inertia.campaign.array_readers import check_hdf5, check_tree, read_hdf5, read_netcdf
from bayes_inertia.campaign.mat_reader import read_mat

UNKNOWN_ADDRESS_SPACE = 4 * 2**30  # [bytes] of the libraries, where the system does not tell.
READERS: dict[str, Callable[[str, Contents], None]] = {
    "hdf5": read_hdf5,
    "netcdf": read_netcdf,
    "mat": read_mat,
    "check": check_hdf5,
    "check_tree": check_tree,
}
LIBRARIES = {
    "hdf5": ("h5py",),
    "netcdf": ("h5py", "h5netcdf", "scipy.io", "xarray"),
    "mat": ("scipy.io",),
    "check": ("h5py",),
    "check_tree": ("h5py", "h5netcdf", "xarray"),
}


def keep_within(seconds: int, memory: int) -> None:
    """Keep a damaged file from taking the machine's time and memory.

    The child limits itself: a limit set between fork and exec would run code of the parent, whose
    threads the fork does not copy.

    Parameters
    ----------
    seconds : int
        Processor time [s], from now.
    memory : int
        Address space [bytes], beyond what is taken now.
    """
    if os.name != "posix":
        return
    import resource

    seconds += math.ceil(time.process_time())
    memory += _address_space()
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


def _address_space() -> int:
    """Bytes of address space that this process has."""
    try:
        with open("/proc/self/statm", encoding="ascii") as file:
            return int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError):
        return UNKNOWN_ADDRESS_SPACE


def load_libraries(kind: str) -> None:
    """Import what reads a kind of file.

    Parameters
    ----------
    kind : str
        A key of `READERS`.
    """
    for name in LIBRARIES[kind]:
        # Without one of them its reader says so.
        with contextlib.suppress(ImportError):
            importlib.import_module(name)


def main(kind: str, path: str, output: str, limit: str, seconds: str, memory: str) -> int:
    """Read one file and leave its arrays.

    Parameters
    ----------
    kind : str
        A key of `READERS`.
    path : str
        The file.
    output : str
        The .npz file to write.
    limit : str
        The most bytes of all arrays.
    seconds : str
        Limit of processor time [s].
    memory : str
        Limit of memory [bytes].

    Returns
    -------
    int
        0, or 3 with what is wrong on the standard output.
    """
    load_libraries(kind)
    keep_within(int(seconds), int(memory))
    into = Contents(int(limit))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            READERS[kind](path, into)
    except Exception as error:  # The libraries raise whatever they stumble over.
        reason = (str(error).splitlines() or [""])[0][:200] or type(error).__name__
        print(json.dumps({"error": reason}))
        return 3
    if kind in ("check", "check_tree"):
        return 0
    try:
        _leave(into, output)
    except OSError as error:
        print(json.dumps({"error": f"no room for its arrays in {output}: {error.strerror}"}))
        return 3
    return 0


def _leave(contents: Contents, output: str) -> None:
    names = list(contents.arrays)
    index = json.dumps({"names": names, "units": contents.units, "closed": contents.closed})
    arrays = {f"a{i}": contents.arrays[name] for i, name in enumerate(names)}
    with open(output, "wb") as file:
        np.savez(file, allow_pickle=False, index=np.array(index), **arrays)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:7]))
