"""One process at a time in a folder of results."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from bayes_inertia.errors import OutputError
from bayes_inertia.files import make_folder

LOCK_FILE = ".bayes-inertia.lock"


@contextmanager
def working_in(folder: Path) -> Iterator[None]:
    """Keep other processes from writing in a folder while the context lasts.

    The system lifts the lock when the process ends, however it ends: nobody has to delete a file.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder, working_in(Path(folder)):
    ...     with working_in(Path(folder)):
    ...         pass
    Traceback (most recent call last):
    bayes_inertia.errors.OutputError: ...: another process works in this folder; wait for its end...
    """
    make_folder(folder)
    lock = FileLock(folder / LOCK_FILE)
    try:
        lock.acquire(timeout=0)
    except Timeout as error:
        raise OutputError(
            "another process works in this folder",
            where=str(folder),
            advice="wait for its end, or choose another folder",
        ) from error
    except NotImplementedError:
        # A file system without locks: as before, two processes write the same bytes.
        yield
        return
    except OSError as error:
        raise OutputError(
            f"cannot be written ({error.strerror or error})",
            where=str(folder),
            advice="check that the folder is writable and has space",
        ) from error
    try:
        yield
    finally:
        lock.release()
