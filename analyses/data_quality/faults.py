"""Dirt for the tables of a campaign folder: pure functions of a folder's text, a generator, a size.

A `RawCampaign` is what lies in a campaign folder: the description and the cells of its tables, as
text. An injector returns another one with one kind of dirt in it; the spacecraft and the noise of
all other readings stay the same, so that a clean twin exists for every dirty campaign. Size 1 is
the usual strength; what larger and smaller sizes mean stands at every injector.
"""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd
import tomlkit

Table = pd.DataFrame
# Rows that turn faster than this share of the fastest are "while slewing".
_SLEWING = 0.3


@dataclass(frozen=True)
class RawCampaign:
    """The content of a campaign folder.

    `attitude` is the true attitude (rows, 4) of each table, where the simulation keeps it.
    """

    description: dict
    tables: dict[str, Table]
    attitude: dict[str, np.ndarray] = field(default_factory=dict)

    def names(self, channel: str) -> list[str]:
        """Columns of a channel, named as in [columns]; none where the campaign lacks it."""
        entry = self.description["columns"].get(channel)
        return list(entry["names"]) if entry else []

    def sigma(self, channel: str) -> float:
        """Stated noise of one reading of a channel, in the unit of its columns (SI)."""
        if channel == "rate":
            return float(np.mean(self.description["rate_sensor"]["sigma"]))
        if channel == "wheel_momentum":
            return float(self.description["wheels"][0]["momentum_sigma"])
        return float(self.description["star_tracker"]["sigma_cross"])


Injector = Callable[[RawCampaign, np.random.Generator, float], RawCampaign]


def read_raw(folder: Path) -> RawCampaign:
    """A campaign folder with one CSV a slew, as text."""
    description = tomllib.loads((folder / "campaign.toml").read_text(encoding="utf-8"))
    files = [slew["file"] for slew in description["slews"]]
    tables = {f: pd.read_csv(folder / f, dtype=str, keep_default_na=False) for f in files}
    kept = folder / "attitude.npz"
    attitude = dict(np.load(kept)) if kept.is_file() else {}
    return RawCampaign(description, tables, attitude)


def write_raw(raw: RawCampaign, folder: Path) -> Path:
    """Write the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for file, table in raw.tables.items():
        table.to_csv(folder / file, index=False, lineterminator="\n")
    (folder / "campaign.toml").write_text(tomlkit.dumps(raw.description), encoding="utf-8")
    return folder


def numbers(table: Table, names: list[str]) -> np.ndarray:
    """Cells (rows, names) as floats, NaN where empty.

    >>> numbers(pd.DataFrame({"a": ["1.5", ""]}), ["a"]).ravel().tolist()
    [1.5, nan]
    """
    return table[names].replace("", "nan").astype(float).to_numpy(copy=True)


def with_numbers(table: Table, names: list[str], values: np.ndarray) -> Table:
    """The table with these columns replaced; cells whose number is unchanged keep their text."""
    old, table = numbers(table, names), table.copy()
    for i, name in enumerate(names):
        cells = table[name].to_numpy(dtype=object).copy()
        same = (values[:, i] == old[:, i]) | (np.isnan(values[:, i]) & np.isnan(old[:, i]))
        for row in np.flatnonzero(~same):
            cells[row] = "" if np.isnan(values[row, i]) else repr(float(values[row, i]))
        table[name] = cells
    return table


def slewing(raw: RawCampaign, file: str) -> np.ndarray:
    """Rows of a table in which the spacecraft turns."""
    rates = np.linalg.norm(np.nan_to_num(numbers(raw.tables[file], raw.names("rate"))), axis=1)
    return np.flatnonzero(rates > _SLEWING * np.quantile(rates, 0.98))


def a_file(raw: RawCampaign, rng: np.random.Generator) -> str:
    """One of the tables."""
    return str(rng.choice(list(raw.tables)))


def window(raw: RawCampaign, file: str, rng: np.random.Generator, seconds: float) -> np.ndarray:
    """Rows of so many seconds while slewing, at least two."""
    period = row_period(raw, file)
    rows, n = slewing(raw, file), max(2, round(seconds / period))
    first = int(rng.choice(rows[: max(1, len(rows) - n)]))
    return np.arange(first, min(first + n, len(raw.tables[file])))


def row_period(raw: RawCampaign, file: str) -> float:
    """Time from row to row [s]."""
    return float(np.median(np.diff(numbers(raw.tables[file], raw.names("time"))[:, 0])))


def with_table(raw: RawCampaign, file: str, table: Table) -> RawCampaign:
    """Another table in place of one."""
    return replace(raw, tables=raw.tables | {file: table.reset_index(drop=True)})


def changed(
    raw: RawCampaign, file: str, channel: str, change: Callable[[np.ndarray], np.ndarray]
) -> RawCampaign:
    """One channel of one table, as `change` makes of its numbers."""
    names, table = raw.names(channel), raw.tables[file]
    return with_table(raw, file, with_numbers(table, names, change(numbers(table, names))))


def everywhere(
    raw: RawCampaign, channel: str, change: Callable[[np.ndarray], np.ndarray]
) -> RawCampaign:
    """One channel of all tables."""
    for file in raw.tables:
        raw = changed(raw, file, channel, change)
    return raw


def described(raw: RawCampaign, change: Callable[[dict], None]) -> RawCampaign:
    """Another description."""
    description = copy.deepcopy(raw.description)
    change(description)
    return replace(raw, description=description)
