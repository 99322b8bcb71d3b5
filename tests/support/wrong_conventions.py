"""Campaign folders with a wrong convention, made from a right one by editing campaign.toml."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import tomlkit


def part_of(document: Any, key: str) -> tuple[Any, str]:
    """The table that holds a key such as `wheels.wheel_x.axis`, and the key's last part."""
    *path, last = key.split(".")
    for name in path:
        if isinstance(document, list):
            document = next(entry for entry in document if entry["name"] == name)
        else:
            document = document[name]
    return document, last


def value_of(folder: Path, key: str) -> Any:
    part, last = part_of(tomlkit.parse((folder / "campaign.toml").read_text()), key)
    value = part[last]
    return value.unwrap() if hasattr(value, "unwrap") else value


def with_keys(source: Path, folder: Path, changes: dict[str, Any]) -> Path:
    """A copy of a campaign with other values under some keys; None takes a key away."""
    shutil.copytree(source, folder)
    path = folder / "campaign.toml"
    document = tomlkit.parse(path.read_text())
    for key, value in changes.items():
        part, last = part_of(document, key)
        if value is None:
            del part[last]
        else:
            part[last] = value
    path.write_text(tomlkit.dumps(document))
    return folder
