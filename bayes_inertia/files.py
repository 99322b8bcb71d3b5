"""Files: written all or nothing, and read only from inside the campaign's own folder."""

from __future__ import annotations

import contextlib
import os
import reprlib
import secrets
import tomllib
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path, PureWindowsPath
from typing import Any

from bayes_inertia.errors import BayesInertiaError, CampaignError, OutputError


@contextlib.contextmanager
def refused_by_system(
    kind: type[BayesInertiaError], what: str, where: Any, advice: str
) -> Iterator[None]:
    """Let an error say what the system refused, in place of the system's own.

    Examples
    --------
    >>> with refused_by_system(CampaignError, "cannot be read", "a.csv", "check the file"):
    ...     open("no/such/a.csv")
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: a.csv: cannot be read (No such file or directory); check ...
    """
    try:
        yield
    except OSError as error:
        reason = error.strerror or error
        raise kind(f"{what} ({reason})", where=str(where), advice=advice) from error


def _temporary(path: Path, tag: str) -> Path:
    """The file beside `path` in which its next content is written."""
    return path.with_name(f".{path.name}.{tag}.tmp{path.suffix}")


def remove_leftovers(path: Path) -> None:
    """Delete what a kill in the middle of `write_atomically` left beside a file.

    Not to be called while another process may write the file.

    Examples
    --------
    >>> remove_leftovers(Path("no/such/folder/a.h5"))
    """
    for left in path.parent.glob(_temporary(path, "*").name):
        left.unlink(missing_ok=True)


def write_atomically(path: str | Path, content: bytes | str | Callable[[Path], object]) -> Path:
    """Write a file all or nothing: it holds the old content or the new one, whatever happens.

    The content goes to a temporary file beside it, to the disk, and then takes the file's name;
    `pathlib` alone would leave half a file after a kill.

    `content`: the content (text is stored as UTF-8), or a function that writes the file whose path
    it is given: a temporary one with the same suffix, as netCDF and Parquet writers need.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     write_atomically(Path(folder, "a.txt"), "done").read_bytes()
    b'done'
    """
    path = path_of(path, "path")
    temporary = _temporary(path, secrets.token_hex(6))
    advice = "check that the folder exists, is writable and has space"
    try:
        with refused_by_system(OutputError, "cannot be written", path, advice):
            if callable(content):
                content(temporary)
            else:
                data = content.encode("utf-8") if isinstance(content, str) else content
                temporary.write_bytes(data)
            _to_disk(temporary)
            os.replace(temporary, path)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()
    # The rename survives a power cut only once the folder is on disk. Some file systems cannot.
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


def write_new_files(folder: str | Path, content: Mapping[str, bytes], *, holds: str) -> Path:
    """Write files to a folder, of which none may replace another content.

    `folder`: where to; made if absent. Identical files may be there already. `content`: what each
    file holds, by name, in the order in which they are written. `holds`: what the folder holds, as
    messages call it, such as "campaign".

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as path:
    ...     write_new_files(path, {"a.txt": b"1"}, holds="note")
    ...     write_new_files(path, {"a.txt": b"2"}, holds="note")
    Traceback (most recent call last):
    bayes_inertia.errors.OutputError: ...a.txt: would overwrite another note; write to a new folder
    """
    folder = path_of(folder, "folder")
    advice = "name a folder that can be made or written to"
    with refused_by_system(OutputError, "cannot be used", folder, advice):
        folder.mkdir(parents=True, exist_ok=True)
        present = {
            name: (folder / name).read_bytes() for name in content if (folder / name).exists()
        }
    in_the_way = [name for name in content if name in present and present[name] != content[name]]
    if in_the_way:
        raise OutputError(
            f"would overwrite another {holds}",
            where=str(folder / in_the_way[0]),
            advice="write to a new folder",
        )
    for name, data in content.items():
        if name not in present:
            make_folder((folder / name).parent)
            write_atomically(folder / name, data)
    return folder


def check_folder(folder: str | Path) -> None:
    """Raise an error unless a folder can be written, or made.

    To be called before hours of computing, not after them.

    Examples
    --------
    >>> check_folder(".")
    >>> check_folder(Path(__file__) / "run")
    Traceback (most recent call last):
    bayes_inertia.errors.OutputError: ...files.py: is a file, not a folder; choose another folder
    """
    folder = path_of(folder, "folder")
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
    """Make a folder, with all above it, if it is absent.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     make_folder(Path(folder, "a", "b")).is_dir()
    True
    """
    folder = path_of(folder, "folder")
    check_folder(folder)
    with refused_by_system(OutputError, "cannot be made", folder, "choose another folder"):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


def path_of(given: Any, where: str) -> Path:
    """A path, or `CampaignError` for what is none.

    Examples
    --------
    >>> path_of(None, "campaign")
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: campaign: None is no path; give a text or a pathlib.Path
    """
    try:
        return Path(given)
    except TypeError:
        what, advice = f"{given!r} is no path", "give a text or a pathlib.Path"
        raise CampaignError(what, where=where, advice=advice) from None


def description_path(campaign: str | Path) -> Path:
    """The description of a campaign: the file itself, or `campaign.toml` in the folder.

    `campaign`: A campaign folder, or the path of a description.

    Examples
    --------
    >>> description_path("no/such/folder")
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: no/such/folder: does not exist; ...
    """
    path = path_of(campaign, "campaign")
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
    """The table of a slew, refused if it lies (or links) outside the campaign's folder.

    `where`: the file and key that name it, for messages.
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
        exists, regular = path.exists(), path.is_file()
    except (OSError, RuntimeError) as error:
        raise CampaignError(
            f"the table {shown} cannot be found ({getattr(error, 'strerror', None) or error})",
            where=where,
            advice=advice,
        ) from error
    add = "correct the name, or add the file to the campaign folder"
    for wrong, what, then in (
        (outside, f"the table {shown} links to a place outside the campaign folder", advice),
        (not exists, f"the table {shown} does not exist", add),
        (not regular, f"{shown} is not a file", "name a table of telemetry"),
    ):
        if wrong:
            raise CampaignError(what, where=where, advice=then)
    return path


def read_bytes(path: Path) -> bytes:
    """The content of a file of a campaign."""
    advice = "check that it is a readable file"
    with refused_by_system(CampaignError, "cannot be read", path, advice):
        return path.read_bytes()


def text_of(data: bytes, label: str) -> str:
    """Bytes as UTF-8 text, without a byte-order mark.

    Examples
    --------
    >>> text_of(b"a,b", "slew_01.csv")
    'a,b'
    """
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise CampaignError(
            "is not UTF-8 text", where=f"{label}, line {line}", advice="save it as plain UTF-8 text"
        ) from error


@cache
def vocabulary(wing: str) -> dict[str, Any]:
    """The words of a wing: the content of its `vocabulary.toml`.

    Examples
    --------
    >>> vocabulary("tables")["nasa_42"]["wbn"]
    [3, 'rad/s']
    """
    path = Path(__file__).parent / wing / "vocabulary.toml"
    return tomllib.loads(path.read_text(encoding="utf-8"))


def by_word(words_of: Mapping[str, str]) -> dict[str, str]:
    """Each word by what it means, of words in one text by their meaning.

    Examples
    --------
    >>> by_word({"deg": "deg degree"})
    {'deg': 'deg', 'degree': 'deg'}
    """
    return {word: meaning for meaning, words in words_of.items() for word in words.split()}
