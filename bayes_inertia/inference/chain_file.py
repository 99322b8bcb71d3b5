"""Chains on disk, in emcee's own HDF5 format, replaced whole.

A kill at any moment leaves a file that can be read.

emcee's `HDFBackend` writes into the same file at every step. A kill while it does leaves, now and
then, a file that cannot be opened or a random state that belongs to another step. Chains are kept
in memory instead, and their file is replaced from time to time; steps since then are computed
again, to the same bits.
"""

from __future__ import annotations

from pathlib import Path

from emcee.backends import Backend, HDFBackend

from bayes_inertia.errors import OutputError
from bayes_inertia.files import write_atomically

_ADVICE = "delete it, and this ensemble begins again"


def load_chain(path: Path, walkers: int, d: int) -> Backend:
    """The chain that a file holds, in memory.

    Parameters
    ----------
    path : Path
        Need not exist: the chain is then empty.
    walkers : int
        Of the ensemble.
    d : int
        Its dimensions.

    Returns
    -------
    emcee.backends.Backend

    Raises
    ------
    OutputError
        If the file cannot be read, or holds an ensemble of another shape.

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
        kept = HDFBackend(str(path), read_only=True)
        shape = tuple(map(int, kept.shape))
        if shape != (walkers, d):
            what = f"holds an ensemble of shape {shape}, wanted is {(walkers, d)}"
            raise OutputError(what, where=str(path), advice=_ADVICE)
        if kept.iteration > 0:
            chain.chain, chain.log_prob = kept.get_chain(), kept.get_log_prob()
            chain.accepted, chain.random_state = kept.accepted, kept.random_state
            chain.iteration = int(kept.iteration)
    except (OSError, KeyError, AttributeError) as error:
        raise OutputError(f"not a chain ({error})", where=str(path), advice=_ADVICE) from error
    return chain


def save_chain(chain: Backend, path: Path) -> None:
    """Replace a file by what a chain holds now; emcee's `HDFBackend` reads it.

    Parameters
    ----------
    chain : emcee.backends.Backend
    path : Path
        Replaced whole.

    Raises
    ------
    OutputError
        If the file cannot be written.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder, "a.h5")
    ...     save_chain(load_chain(path, 8, 2), path)
    ...     int(HDFBackend(str(path)).iteration)
    0
    """

    def write(temporary: Path) -> None:
        kept = HDFBackend(str(temporary))
        kept.reset(*chain.shape)
        kept.grow(chain.iteration, None)
        with kept.open("a") as file:
            group = file[kept.name]
            group["accepted"][...] = chain.accepted
            if chain.iteration > 0:
                group["chain"][...] = chain.get_chain()
                group["log_prob"][...] = chain.get_log_prob()
            for i, part in enumerate(chain.random_state or ()):
                group.attrs[f"random_state_{i}"] = part
            group.attrs["iteration"] = chain.iteration

    write_atomically(path, write)
