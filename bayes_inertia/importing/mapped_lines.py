"""Lines of a mapping behind the keys of an imported campaign."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bayes_inertia.sealing import sha256_of

RECORD_FILE = "import.json"
"""The record of an import, in the folder of its campaign."""

BESIDE_RATES = "lie where no rate was logged"
OFFSET_OF = "streams.{}.offset_s"
"""How the record says that readings lie beside all rates, and which offset explains it."""

_TABLE = re.compile(r"\s*\[\[?\s*([\w-]+)\s*\]\]?\s*(#.*)?$")
_ENTRY = re.compile(r"""\s*([\w-]+)\s*=\s*(?:["']([^"']*)["'])?""")
# What else a mapping may call a key.
_OTHER_KEYS = {"axes": ("mounting", "body_from_sensor", "frame")}


def mapped_lines(folder: Path, key: str) -> list[str]:
    """The lines of the mapping that a key such as "columns.rate.unit" comes from."""
    name, text = _of_record(
        folder, lambda r: (r["mapping"]["name"], r["mapping"]["text"]), ("", "")
    )
    return [f"{name}, line {number}: {line}" for number, line in lines_of(text, key)]


def other_mapping(folder: Path, data: bytes) -> bool:
    """Whether a folder holds an import by a mapping other than this text."""
    return _of_record(folder, lambda r: bool(r["mapping"]["sha256"] != sha256_of(data)), False)


def streams_beside(folder: Path) -> list[str]:
    """Notes on streams that a known offset would put into the slews; none without an import."""
    return _of_record(
        folder,
        lambda record: [
            f"{key}: {note}"
            for key, stream in record["streams"].items()
            for note in stream["notes"]
            if BESIDE_RATES in note and OFFSET_OF.format(key) in note
        ],
        [],
    )


def _of_record[T](folder: Path, read: Callable[[Any], T], otherwise: T) -> T:
    """What the record of an import says; else for a folder that was not imported."""
    try:
        return read(json.loads((folder / RECORD_FILE).read_text(encoding="utf-8")))
    except (OSError, ValueError, KeyError, TypeError):
        return otherwise


def lines_of(text: str, key: str) -> list[tuple[int, str]]:
    """Number and text of the lines of a mapping that state a key of campaign.toml; [] if none."""
    first, *middle, last = key.split(".")
    wanted = "streams" if first == "columns" else first
    label = "holds" if first == "columns" else "name"
    keys = (last, *_OTHER_KEYS.get(last, ()))
    lines = []
    for table, entries in _tables(text):
        stated = {name: value for name, value, _, _ in entries}
        mounting = first == "rate_sensor" and table == "streams" and stated.get("holds") == "rate"
        named = table == wanted and (not middle or stated.get(label) == middle[0])
        if named or mounting:
            lines += [(number, line) for name, _, number, line in entries if name in keys]
    return lines


def _tables(text: str) -> list[tuple[str, list[tuple[str, str | None, int, str]]]]:
    """Each table of a TOML text with its entries: key, text in quotes, number of line, line."""
    tables: list[tuple[str, list[tuple[str, str | None, int, str]]]] = [("", [])]
    for number, line in enumerate(text.splitlines(), 1):
        if table := _TABLE.match(line):
            tables.append((table[1], []))
        elif entry := _ENTRY.match(line):
            tables[-1][1].append((entry[1], entry[2], number, line.strip()))
    return tables
