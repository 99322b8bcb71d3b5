"""Chains on disk, in emcee's own HDF5 format, replaced whole.

A kill at any moment leaves a file that can be read.

emcee's `HDFBackend` writes into the same file at every step. A kill while it does leaves, now and
then, a file that cannot be opened or a random state that belongs to another step. Chains are kept
in memory instead, and their file is replaced from time to time; steps since then are computed
again, to the same bits.
"""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import emcee
import numpy as np
from emcee.backends import Backend, HDFBackend

from bayes_inertia.errors import CampaignError, OutputError
from bayes_inertia.sealing import is_sealed, write_sealed
from bayes_inertia.tables.isolated import check_readable

_ADVICE = "delete it, and this ensemble begins again"


def load_chain(path: Path, walkers: int, d: int) -> Backend:
    """The chain that a file holds, in memory.

    Examples
    --------
    >>> load_chain(Path("no/such/file.h5"), 8, 2).shape
    (8, 2)
    """
    chain = Backend()
    chain.reset(walkers, d)
    if not path.exists():
        return chain
    try:
        if not is_sealed(path, _ADVICE):
            # Of an earlier version, or damaged: then it could end this process.
            check_readable(path, "check", _ADVICE)
        _load(path, chain, walkers, d)
    except CampaignError as error:
        raise OutputError(error.what, where=error.where, advice=error.advice) from error
    except OutputError:
        raise
    except Exception as error:  # The libraries raise whatever they stumble over.
        raise OutputError(f"not a chain ({error})", where=str(path), advice=_ADVICE) from error
    return chain


def _load(path: Path, chain: Backend, walkers: int, d: int) -> None:
    """Put what a file holds into an empty chain."""
    kept = HDFBackend(str(path), read_only=True)
    shape = tuple(map(int, kept.shape))
    if shape != (walkers, d):
        what = f"holds an ensemble of shape {shape}, wanted is {(walkers, d)}"
        raise OutputError(what, where=str(path), advice=_ADVICE)
    steps = int(kept.iteration)
    if steps <= 0:
        return
    chain.chain, chain.log_prob = kept.get_chain(), kept.get_log_prob()
    chain.accepted, chain.random_state = kept.accepted, kept.random_state
    chain.iteration = steps
    whole = chain.chain.shape == (steps, walkers, d) and chain.log_prob.shape == (steps, walkers)
    if not (whole and chain.accepted.shape == (walkers,) and np.isfinite(chain.chain).all()):
        raise OutputError("not a chain (incomplete)", where=str(path), advice=_ADVICE)
    np.random.RandomState().set_state(chain.random_state)  # Or an exception.


def save_chain(chain: Backend, path: Path) -> None:
    """Replace a file by what a chain holds now; emcee's `HDFBackend` reads it.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder, "a.h5")
    ...     save_chain(load_chain(path, 8, 2), path)
    ...     int(HDFBackend(str(path)).iteration)
    0
    """
    import h5py

    walkers, d = chain.shape
    steps = chain.iteration
    arrays = {
        "accepted": chain.accepted,
        "chain": chain.get_chain() if steps else np.zeros((0, walkers, d)),
        "log_prob": chain.get_log_prob() if steps else np.zeros((0, walkers)),
    }
    # In memory: HDF5 can end the process where the disk has no room.
    content = BytesIO()
    with h5py.File(content, "w") as file:
        group = file.create_group(HDFBackend("").name)
        for name, values in arrays.items():
            group[name] = values
        sizes = {"nwalkers": walkers, "ndim": d, "iteration": steps}
        group.attrs.update({"version": emcee.__version__, "has_blobs": False, **sizes})
        for i, part in enumerate(chain.random_state or ()):
            group.attrs[f"random_state_{i}"] = part
    write_sealed(path, content.getbuffer())
