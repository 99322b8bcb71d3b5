"""Only one run works in a folder of shards at a time."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bayes_inertia.errors import StudyError
from bayes_inertia.files import make_folder

_LOCK = ".running"


@contextmanager
def study_lock(folder: Path | None) -> Iterator[None]:
    """Hold a folder while the context lasts; the system frees it when the process ends.

    Parameters
    ----------
    folder : Path or None
        Made if absent. None: nothing is held.

    Yields
    ------
    None

    Raises
    ------
    StudyError
        If another run holds it.
    """
    try:
        import fcntl
    except ImportError:  # Windows: two runs in one folder are not told there.
        yield
        return
    if folder is None:
        yield
        return
    make_folder(folder)
    descriptor = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise StudyError(
                "another run works in this folder",
                where=str(folder),
                advice="wait until it ends, or choose another folder",
            ) from None
        yield
    finally:
        os.close(descriptor)
