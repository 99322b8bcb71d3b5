"""Seals: what a run wrote is told from what was damaged or changed since.

A sealed file states the SHA-256 of its content: a JSON document, or each line of many, under
`content_sha256`, any other file in its last bytes, which the libraries of HDF5 and netCDF skip.
Whoever reads it checks the seal before a library takes the content apart, which for a damaged HDF5
file may end the process. Files of earlier versions have no seal.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from bayes_inertia.errors import BayesInertiaError, CampaignError
from bayes_inertia.files import read_bytes, refused_by_system, text_of, write_atomically

SEAL_KEY = "content_sha256"
_MARK = b"\nbayes-inertia sha256 "


def sha256_of(*parts: bytes | memoryview | str) -> str:
    """The SHA-256 of parts one after another, text as UTF-8: every digest of this package.

    Examples
    --------
    >>> sha256_of("ab", b"c")[:8]
    'ba7816bf'
    """
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part.encode() if isinstance(part, str) else part)
    return digest.hexdigest()


def write_sealed(path: str | Path, content: bytes | memoryview) -> Path:
    """Write a file with the digest of its content behind it, atomically.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     is_sealed(write_sealed(Path(folder, "a.h5"), b"content"), "")
    True
    """
    seal = _MARK + sha256_of(content).encode() + b"\n"

    def write(temporary: Path) -> None:
        with temporary.open("wb") as file:
            file.write(content)
            file.write(seal)

    return write_atomically(path, write)


def is_sealed(path: Path, advice: str) -> bool:
    """Whether a file carries the seal of its content.

    Returns: false for a file without a seal: of an earlier version, or cut off.
    """
    length = len(_MARK) + 2 * hashlib.sha256().digest_size + len("\n")
    with refused_by_system(CampaignError, "cannot be read", path, "check the file"):
        size = path.stat().st_size
        with path.open("rb") as file:
            file.seek(max(0, size - length))
            seal = file.read()
        if not (len(seal) == length and seal.startswith(_MARK)):
            return False
        intact = _digest(path, size - length).encode() == seal[len(_MARK) : -1]
    if not intact:
        raise CampaignError(
            "is damaged: its content is not what was written", where=str(path), advice=advice
        )
    return True


def _digest(path: Path, size: int, block_bytes: int = 2**20) -> str:
    """SHA-256 of the first bytes of a file, of which so many are read at once."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while size > 0 and (block := file.read(min(size, block_bytes))):
            digest.update(block)
            size -= len(block)
    return digest.hexdigest()


def sealed(content: Mapping[str, Any]) -> dict[str, Any]:
    """A JSON document with its digest.

    Examples
    --------
    >>> sealed({"seed": 1})["content_sha256"][:8]
    'fbe47f6d'
    """
    bare = {key: value for key, value in content.items() if key != SEAL_KEY}
    return {**bare, SEAL_KEY: _json_digest(bare)}


def _json_digest(content: Mapping[str, Any]) -> str:
    """The same for every layout and order of keys."""
    plain = json.loads(json.dumps(content))
    text = json.dumps(plain, sort_keys=True, separators=(",", ":"))
    return sha256_of(text)


def read_sealed_json(path: Path, advice: str) -> dict[str, Any]:
    """A JSON document that this package wrote.

    Examples
    --------
    >>> read_sealed_json(Path("no/such/run.json"), "")
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: no/such/run.json: cannot be read ...
    """
    text = text_of(read_bytes(path), str(path))
    try:
        content = json.loads(text)
        if not isinstance(content, dict):
            raise ValueError("no object in braces")
        bare = {key: value for key, value in content.items() if key != SEAL_KEY}
        intact = SEAL_KEY not in content or content[SEAL_KEY] == _json_digest(bare)
    except (ValueError, RecursionError) as error:
        reason = str(error) or type(error).__name__
        raise CampaignError(
            f"is damaged: not the JSON that was written ({reason})", where=str(path), advice=advice
        ) from error
    if not intact:
        raise CampaignError("was changed since it was written", where=str(path), advice=advice)
    return content


@contextmanager
def blaming(path: Path, *, intact: bool, advice: str) -> Iterator[None]:
    """Take any exception for damage of a file without a seal.

    A file whose seal holds is what this package wrote: then an exception is a fault of the program
    and passes through.

    Examples
    --------
    >>> with blaming(Path("diagnosis.json"), intact=False, advice="delete it"):
    ...     {}["verdict"]
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: diagnosis.json: is damaged, or of a version that ...
    """
    try:
        yield
    except (BayesInertiaError, MemoryError):
        raise
    except Exception as error:
        if intact:
            raise
        reason = (str(error).splitlines() or [""])[0][:200]
        raise CampaignError(
            f"is damaged, or of a version that cannot be read ({type(error).__name__}: {reason})",
            where=str(path),
            advice=advice,
        ) from error
