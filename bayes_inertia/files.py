"""Files: written all or nothing, and read only from inside the campaign's own folder."""

from __future__ import annotations

import contextlib
import os
import reprlib
import secrets
from collections.abc import Callable
from pathlib import Path, PureWindowsPath

from bayes_inertia.errors import CampaignError, OutputError


def _temporary(path: Path, tag: str) -> Path:
    """The file beside `path` in which its next content is written."""
    return path.with_name(f".{path.name}.{tag}.tmp{path.suffix}")


def remove_leftovers(path: Path) -> None:
    """Delete what a kill in the middle of `write_atomically` left beside `path`; not while another process may write it.

    >>> remove_leftovers(Path("no/such/folder/a.h5"))
    """
    for left in path.parent.glob(_temporary(path, "*").name):
        left.unlink(missing_ok=True)


def write_atomically(path: str | Path, content: bytes | str | Callable[[Path], object]) -> Path:
    """Write a file so that, whatever happens meanwhile, `path` holds either the old content or all of the new one.

    Parameters
    ----------
    path : the file; its folder must exist.
    content : bytes, text (stored as UTF-8), or a function that writes the file whose path it is given (a
        temporary one beside `path`, with the same suffix), as netCDF and Parquet writers need.

    Returns `path`. Raises `OutputError` if the system refuses; what a function raises otherwise passes through.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder: write_atomically(Path(folder, "a.txt"), "done").read_bytes()
    b'done'
    """
    path = Path(path)
    temporary = _temporary(path, secrets.token_hex(6))
    try:
        if callable(content):
            content(temporary)
        else:
            temporary.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
        _to_disk(temporary)
        os.replace(temporary, path)
    except OSError as error:
        raise OutputError(
            f"cannot be written ({error.strerror or error})",
            where=str(path),
            advice="check that the folder exists, is writable and has space",
        ) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()
    # The rename itself survives a power cut only once the folder is on disk; some file systems cannot do that.
    with contextlib.suppress(OSError):
        _to_disk(path.parent)
    return path


def _to_disk(path: Path) -> None:
    # Windows syncs only what is open for writing, POSIX opens a folder only for reading.
    descriptor = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def check_folder(folder: str | Path) -> None:
    """Raise `OutputError` unless a folder can be written, or made: before hours of computing, not after them.

    >>> check_folder(".")
    >>> check_folder(Path(__file__) / "run")
    Traceback (most recent call last):
    bayes_inertia.errors.OutputError: ...files.py: is a file, not a folder; choose another folder
    """
    folder = Path(folder)
    nearest = next((p for p in (folder, *folder.parents) if p.exists()), folder)
    if not nearest.is_dir():
        raise OutputError(
            "is a file, not a folder", where=str(nearest), advice="choose another folder"
        )
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise OutputError(
            "cannot be written", where=str(nearest), advice="choose a folder that is yours"
        )


def make_folder(folder: str | Path) -> Path:
    """The folder, made if absent with all above it. Raises `OutputError` if the system refuses.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder: make_folder(Path(folder, "a", "b")).is_dir()
    True
    """
    folder = Path(folder)
    check_folder(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"cannot be made ({error.strerror or error})",
            where=str(folder),
            advice="choose another folder",
        ) from error
    return folder


def description_path(campaign: str | Path) -> Path:
    """The campaign's description: `campaign` itself, or `campaign.toml` inside it if it is a folder.

    Raises `CampaignError` if there is none.

    >>> description_path("no/such/folder")
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: no/such/folder: does not exist; give a campaign folder or its campaign.toml
    """
    path = Path(campaign)
    if path.is_dir():
        path = path / "campaign.toml"
        if not path.is_file():
            raise CampaignError(
                "the folder has no campaign.toml",
                where=str(path.parent),
                advice="give a folder that holds one",
            )
    if not path.exists():
        raise CampaignError(
            "does not exist", where=str(path), advice="give a campaign folder or its campaign.toml"
        )
    return path


def table_path(folder: Path, file: str, where: str) -> Path:
    """The table `file` of a campaign in `folder`, refused if it lies (or links) outside it.

    `where` is the file and key that name it. Raises `CampaignError` if it is missing, no file, or outside.
    """
    advice = "put the table in the campaign folder and name it relative to that folder"
    shown = reprlib.repr(file)
    windows = PureWindowsPath(file)
    absolute = file.startswith(("/", "\\")) or bool(windows.drive)
    if absolute or ".." in windows.parts or "\0" in file:
        raise CampaignError(
            f"the table {shown} lies outside the campaign folder", where=where, advice=advice
        )
    path = folder / file
    try:
        outside = not path.resolve().is_relative_to(folder.resolve())
        found, regular = path.exists(), path.is_file()
    except (OSError, RuntimeError) as error:
        raise CampaignError(
            f"the table {shown} cannot be found ({getattr(error, 'strerror', None) or error})",
            where=where,
            advice=advice,
        ) from error
    if outside:
        raise CampaignError(
            f"the table {shown} links to a place outside the campaign folder",
            where=where,
            advice=advice,
        )
    if not found:
        raise CampaignError(
            f"the table {shown} does not exist",
            where=where,
            advice="correct the name, or add the file to the campaign folder",
        )
    if not regular:
        raise CampaignError(
            f"{shown} is not a file", where=where, advice="name a table of telemetry"
        )
    return path


def read_bytes(path: Path) -> bytes:
    """The content of a file of the campaign; raises `CampaignError` where the system refuses."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise CampaignError(
            f"cannot be read ({error.strerror or error})",
            where=str(path),
            advice="check that it is a readable file",
        ) from error


def text_of(data: bytes, label: str) -> str:
    """`data` as UTF-8 text (a byte-order mark is dropped); raises `CampaignError` naming the line otherwise."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise CampaignError(
            "is not UTF-8 text", where=f"{label}, line {line}", advice="save it as plain UTF-8 text"
        ) from error
