"""Chains on disk, in emcee's own HDF5 format, replaced whole: a kill at any moment leaves a file that can be read.

emcee's `HDFBackend` writes into the same file at every step. A kill while it does leaves, now and then, a file that cannot be opened
or a random state that belongs to another step. Chains are kept in memory instead, and their file is replaced from time to time;
steps since then are computed again, to the same bits.
"""

from __future__ import annotations

from pathlib import Path

from emcee.backends import Backend, HDFBackend

from bayes_inertia.errors import OutputError
from bayes_inertia.files import write_atomically


def load_chain(path: Path, walkers: int, d: int) -> Backend:
    """The chain that a file holds, in memory; an empty one for an ensemble of `walkers` in `d` dimensions if there is no file.

    Raises `OutputError` for a file that cannot be read, or that holds an ensemble of another shape.

    >>> load_chain(Path("no/such/file.h5"), 8, 2).shape
    (8, 2)
    """
    chain = Backend()
    chain.reset(walkers, d)
    if not path.exists():
        return chain
    advice = "delete it, and this ensemble begins again"
    try:
        kept = HDFBackend(str(path), read_only=True)
        shape = tuple(map(int, kept.shape))
        if shape != (walkers, d):
            raise OutputError(
                f"holds an ensemble of shape {shape}, wanted is {(walkers, d)}",
                where=str(path),
                advice=advice,
            )
        if kept.iteration > 0:
            chain.chain, chain.log_prob, chain.accepted = (
                kept.get_chain(),
                kept.get_log_prob(),
                kept.accepted,
            )
            chain.iteration, chain.random_state = int(kept.iteration), kept.random_state
    except (OSError, KeyError, AttributeError) as error:
        raise OutputError(f"not a chain ({error})", where=str(path), advice=advice) from error
    return chain


def save_chain(chain: Backend, path: Path) -> None:
    """Replace a file by what a chain holds now; emcee's `HDFBackend` reads it. Raises `OutputError` if it cannot be written.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     save_chain(load_chain(Path(folder, "a.h5"), 8, 2), Path(folder, "a.h5")); int(HDFBackend(str(Path(folder, "a.h5"))).iteration)
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
                group["chain"][...], group["log_prob"][...] = (
                    chain.get_chain(),
                    chain.get_log_prob(),
                )
            for i, part in enumerate(chain.random_state or ()):
                group.attrs[f"random_state_{i}"] = part
            group.attrs["iteration"] = chain.iteration

    write_atomically(path, write)
