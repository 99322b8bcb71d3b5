"""Compiled code kept between runs: JAX's persistent cache in the user's cache folder.

Compiling a model takes longer than sampling it. The commands keep what was compiled, so that the
next campaign of the same shape begins at once. JAX writes and evicts entries under a lock, and
finds them by a digest of the program; here stands where, how much, and what happens when the
folder fails. A library leaves JAX's cache as its user set it: only the commands, and who calls
`keep_compiled_code`, change it.
"""

from __future__ import annotations

import os
import platform
import re
import sys
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from glob import escape
from pathlib import Path
from time import time

from bayes_inertia.app.layout import LAYOUT
from bayes_inertia.app.terminal import say
from bayes_inertia.errors import OutputError
from bayes_inertia.files import path_of, refused_by_system
from bayes_inertia.sealing import sha256_of
from bayes_inertia.version import __version__

# "off", or the folder to keep compiled code in.
VARIABLE = "BAYES_INERTIA_CACHE"
_OFF = ("off", "0", "no", "false")
# Who sets this has a cache of his own.
_OF_JAX = "JAX_COMPILATION_CACHE_DIR"
_FAILURE = re.compile(
    r"Error (?:reading|writing) persistent compilation cache entry for '(?P<program>[^']+)'"
)
_ENTRIES = ("*-cache", "*-atime", ".lockfile")
_OF_A_VERSION = re.compile(r"\d.*-[0-9a-f]{8}")


def keep_compiled_code(folder: str | Path | None = None) -> Path | None:
    """Keep compiled code between runs of a Python program too, as the commands do.

    It sets JAX's persistent compilation cache, for all code of this process.

    Parameters
    ----------
    folder : str or Path, optional
        Where; by default a folder of this version, Python and processor in the user's cache
        folder, or what the environment variable BAYES_INERTIA_CACHE says.

    Returns
    -------
    Path or None
        The folder; None where BAYES_INERTIA_CACHE is "off".

    Raises
    ------
    OutputError
        If the folder cannot be written, or belongs to someone else.

    Examples
    --------
    At the beginning of a program (no doctest: it would change JAX for what follows)::

        import bayes_inertia as bi
        bi.keep_compiled_code()
    """
    place = cache_folder() if folder is None else path_of(folder, "folder")
    if place is None:
        return None
    _prepare(place)
    import jax
    from jax.experimental.compilation_cache import compilation_cache

    for name, value in _settings(place).items():
        jax.config.update(name, value)
    compilation_cache.reset_cache()
    return place


def cache_folder() -> Path | None:
    """Folder of compiled code, of this version, Python and processor.

    Code of another processor may use instructions that this one lacks: on a cluster with one home
    each kind of machine has its own. JAX compresses entries in ways that differ between versions
    of Python, and cannot read one in the other.
    """
    wanted = os.environ.get(VARIABLE, "")
    if wanted.lower() in _OFF:
        return None
    from platformdirs import user_cache_path

    root = Path(wanted).expanduser() if wanted else user_cache_path("bayes-inertia") / "compiled"
    made_for = f"{sys.version_info[:2]} {_processor()}"
    digest = sha256_of(made_for)
    return root.absolute() / f"{__version__}-{digest[:8]}"


@contextmanager
def compiled_code_kept(wanted: bool = True) -> Iterator[None]:
    """Keep compiled code while the context lasts, in this process and those it starts.

    To be entered before JAX is imported; a process that has done so keeps its own configuration.
    Where the folder fails, work goes on without, and one sentence says so.
    """
    if not wanted:
        os.environ["JAX_ENABLE_COMPILATION_CACHE"] = "false"
    folder = cache_folder() if wanted else None
    if folder is None or "jax" in sys.modules or _OF_JAX in os.environ:
        yield
        return
    try:
        _prepare(folder)
    except OutputError as error:
        say(f"compiled code is not kept between runs: {error}")
        yield
        return
    os.environ.update({name.upper(): str(v) for name, v in _settings(folder).items()})
    # The loader logs at length what it thinks of code that it then compiles again.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    with _mended_after_failures(folder):
        yield


@contextmanager
def _mended_after_failures(folder: Path) -> Iterator[None]:
    """Say once that kept code failed, and delete afterwards what did.

    A kill or a full disk leaves an incomplete entry, which JAX would never replace.
    """
    shown, failed = warnings.showwarning, set[str]()

    def show(message, category, *place, **more):
        failure = _FAILURE.match(str(message))
        if failure is None:
            shown(message, category, *place, **more)
            return
        if not failed:
            say("some compiled code that was kept cannot be used; it is compiled again")
        failed.add(failure["program"])

    warnings.showwarning = show
    try:
        yield
    finally:
        warnings.showwarning = shown
        for program in failed:
            _delete(folder.glob(f"{escape(program)}-*"))


def _delete(files: Iterable[Path]) -> None:
    for file in files:
        with suppress(OSError):
            file.unlink()


def size_of(folder: Path) -> int:
    """Size of a folder [bytes]."""
    return sum(entry.stat().st_size for entry in folder.glob("*-cache"))


def _settings(folder: Path) -> dict[str, str | int | float]:
    """JAX's configuration; as environment variables the names are in capitals."""
    return {
        "jax_compilation_cache_dir": str(folder),
        "jax_compilation_cache_max_size": LAYOUT.largest_cache_bytes,
        "jax_persistent_cache_min_compile_time_secs": LAYOUT.least_compile_seconds,
        "jax_persistent_cache_min_entry_size_bytes": -1,
    }


def _prepare(folder: Path) -> None:
    """Make the folder, for its owner alone: who can write there can have his code run."""
    what = "cannot be used for compiled code"
    advice = f"set {VARIABLE} to a folder of your own, or to off"
    with refused_by_system(OutputError, what, folder, advice):
        new = not folder.exists()
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError("not writable")
        if hasattr(os, "getuid"):
            status = folder.stat()
            if status.st_uid != os.getuid() or status.st_mode & 0o022:
                raise PermissionError("others may write there")
    if new:
        _remove_unused(folder)


def _remove_unused(folder: Path) -> None:
    """Delete the code of other versions that was not used for a month."""
    oldest = time() - LAYOUT.unused_after_s
    for other in folder.parent.iterdir():
        if other == folder or not _OF_A_VERSION.fullmatch(other.name):
            continue
        with suppress(OSError):
            files = [file for pattern in _ENTRIES for file in other.glob(pattern)]
            if all(file.stat().st_mtime < oldest for file in files):
                _delete(files)
                other.rmdir()


def _processor() -> str:
    """The instructions that compiled code may use."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith(("flags", "Features")):
                return f"{platform.machine()} {line}"
    return f"{platform.machine()} {platform.processor()}"
