"""Campaign folders as plain data: the description as a dictionary, the tables as columns."""

from __future__ import annotations

import copy
import csv
import fnmatch
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.writer import content_of

Table = dict[str, np.ndarray]


@dataclass(frozen=True)
class RawCampaign:
    """`campaign.toml` as a dictionary, and {file: {column: (n,) array}}; NaN is an empty cell."""

    description: Mapping[str, Any]
    tables: Mapping[str, Table]

    def names(self, channel: str) -> list[str]:
        """The columns of an entry of `[columns]`; empty where there is none."""
        return list(self.description["columns"].get(channel, {}).get("names", []))

    def has(self, channel: str) -> bool:
        """Whether `[columns]` has this entry."""
        return channel in self.description["columns"]

    @property
    def wheels(self) -> list[dict[str, Any]]:
        """The `[[wheels]]`."""
        return list(self.description.get("wheels", []))

    @property
    def momentum_channel(self) -> str:
        """The entry of `[columns]` that tachometers have."""
        return "wheel_speed" if self.has("wheel_speed") else "wheel_momentum"

    def stacked(self, channel: str) -> list[np.ndarray]:
        """The columns of an entry, (rows, columns) for each table."""
        names = self.names(channel)
        return [np.stack([t[n] for n in names], axis=1) for t in self.tables.values()]


def stated(raw: RawCampaign, **values: Any) -> RawCampaign:
    """The campaign with other values in its description; dots of a key are written `__`.

    None takes the key away. A wheel is named by its place: `wheels__0__axis`.
    """
    description = copy.deepcopy(dict(raw.description))
    for path, value in values.items():
        *parents, last = path.split("__")
        part: Any = description
        for parent in parents:
            part = part[int(parent)] if isinstance(part, list) else part.setdefault(parent, {})
        if value is None:
            part.pop(last, None)
        else:
            part[last] = value
    return RawCampaign(description, raw.tables)


def changed(
    raw: RawCampaign, channel: str, change: Callable[[np.ndarray], np.ndarray]
) -> RawCampaign:
    """The campaign with other numbers (rows, columns) in the columns of an entry."""
    names = raw.names(channel)
    tables = {}
    for file, table in raw.tables.items():
        values = change(np.stack([table[n] for n in names], axis=1))
        tables[file] = table | {n: values[:, i] for i, n in enumerate(names)}
    return RawCampaign(raw.description, tables)


def later(raw: RawCampaign, channel: str, delay: float) -> RawCampaign:
    """The campaign with the stamps of a channel late by a time [s], to whole rows.

    Rows without a reading that was taken before the table began are left out.
    """
    names, tables = raw.names(channel), {}
    time = raw.names("time")[0]
    for file, table in raw.tables.items():
        k = max(1, round(delay / float(np.median(np.diff(table[time])))))
        cropped = {name: column[k:] for name, column in table.items()}
        tables[file] = cropped | {name: table[name][:-k] for name in names}
    return RawCampaign(raw.description, tables)


def without(raw: RawCampaign, channel: str) -> RawCampaign:
    """The campaign without an entry of `[columns]`, and without the sensor that goes with it."""
    names, description = set(raw.names(channel)), copy.deepcopy(dict(raw.description))
    description["columns"].pop(channel, None)
    if channel == "attitude":
        description.pop("star_tracker", None)
    if channel == raw.momentum_channel:
        for wheel in description.get("wheels", []):
            wheel.pop("momentum_sigma", None)
    tables = {
        file: {name: column for name, column in table.items() if name not in names}
        for file, table in raw.tables.items()
    }
    return RawCampaign(description, tables)


def of_slews(raw: RawCampaign, which: Sequence[int]) -> RawCampaign:
    """The campaign with some of its slews only."""
    slews = [raw.description["slews"][i] for i in which]
    tables = {slew["file"]: raw.tables[slew["file"]] for slew in slews}
    return RawCampaign({**raw.description, "slews": slews}, tables)


def raw_of(campaign: Campaign) -> RawCampaign:
    """A campaign in memory as plain data, without environment columns and the axes of its slews."""
    text, tables = content_of(campaign)
    columns = {
        file: {name: column.values for name, column in table.columns.items()}
        for file, table in tables.items()
    }
    raw = _plain_data(text, columns.__getitem__)
    for slew in raw.description["slews"]:
        for told in ("axis", "angle_deg"):
            slew.pop(told, None)
    return raw


def read_raw(folder: Path) -> RawCampaign:
    """A campaign folder of CSV tables as plain data, without environment columns."""
    text = (folder / "campaign.toml").read_text(encoding="utf-8")
    return _plain_data(text, lambda file: _read_table(folder / file))


def _plain_data(text: str, table_of: Callable[[str], Table]) -> RawCampaign:
    description = tomllib.loads(text)
    for environment in ("magnetic_field", "position"):
        description["columns"].pop(environment, None)
    wanted = [name for entry in description["columns"].values() for name in entry["names"]]
    tables = {slew["file"]: table_of(slew["file"]) for slew in description["slews"]}
    kept = {file: {name: table[name] for name in wanted} for file, table in tables.items()}
    return RawCampaign(description, kept)


def _read_table(path: Path) -> Table:
    with path.open(newline="", encoding="utf-8") as stream:
        header = next(csv.reader(stream))
        values = np.genfromtxt(stream, delimiter=",")
    return {name: values[:, i] for i, name in enumerate(header)}


def write_raw(raw: RawCampaign, folder: Path) -> Path:
    """Write the campaign's folder; all digits are kept."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "campaign.toml").write_text(tomlkit.dumps(raw.description), encoding="utf-8")
    for file, table in raw.tables.items():
        rows = np.stack(list(table.values()), axis=1).tolist()
        text = "\n".join([",".join(table), *(",".join(map(repr, row)) for row in rows)])
        (folder / file).write_text(text.replace("nan", "") + "\n", encoding="utf-8")
    return folder


@dataclass(frozen=True)
class Mend:
    """A key of `campaign.toml` and the value that mends it; None where any value will do.

    `key` is a pattern of `fnmatch`. `needs` says how many changes must stand beside each other:
    a mend that takes two keys needs both.
    """

    key: str
    to: Any = None
    tolerance: float = 1e-3
    needs: int = 1

    def names(self, changes: Sequence[Mapping[str, Any]]) -> bool:
        """Whether the first of the changes names the key."""
        return len(changes) >= self.needs and fnmatch.fnmatch(_plain(changes[0]["key"]), self.key)

    def fits(self, changes: Sequence[Mapping[str, Any]]) -> bool:
        """Whether the first of the changes names the key and the value."""
        return self.names(changes) and (self.to is None or self._equal(changes[0].get("to")))

    def _equal(self, value: Any) -> bool:
        if isinstance(self.to, str) or (isinstance(self.to, list) and isinstance(self.to[0], str)):
            return value == self.to
        try:
            given, wanted = np.asarray(value, dtype=float), np.asarray(self.to, dtype=float)
        except (TypeError, ValueError):
            return False
        if given.shape != wanted.shape:
            return False
        return bool(np.max(np.abs(given - wanted)) <= self.tolerance * np.max(np.abs(wanted)))


def _plain(key: str) -> str:
    """A key without quotation marks and brackets, which a wheel's name may have."""
    return re.sub(r"[\"'\[\]]", "", key)
