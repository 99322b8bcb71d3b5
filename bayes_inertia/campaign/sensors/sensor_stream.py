"""A sensor's stream of readings, as a campaign knows it: its column, words and stated noise.

Empty cells of columns: which are refused, and where.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import CorrelatedNoise
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.errors import require
from bayes_inertia.faults.fault import Series
from bayes_inertia.tables.table import Table


@dataclass(frozen=True)
class SensorStream(ABC):
    """One sensor's readings; a class for each kind of sensor, an instance for each sensor."""

    name: str  # Of the channel, as files and messages say it
    field: str = ""  # Of `Slew`, which holds the readings; empty for one of `Campaign.more_sensors`

    # In words; in tables and pictures; of the readings.
    sensor: ClassVar[str]
    title: ClassVar[str]
    unit: ClassVar[str]
    # The `Channel` of a kind that is not the package's own.
    channel: ClassVar[Any] = None
    # Entries of [columns] that may hold them.
    keys: ClassVar[tuple[str, ...]] = ()
    # How they are written: entry of [columns], its unit and sense, columns (a text: one a wheel).
    written: ClassVar[tuple[str, Mapping[str, str], str | Sequence[str]]]
    # The field of `Campaign` that holds the first sensor of the kind; the noise in its record.
    first: ClassVar[str] = ""
    noise: ClassVar[tuple[str, ...]] = ("sigma",)
    # Whether every row of a slew may hold a reading; else there are fixes here and there.
    is_series: ClassVar[bool] = True
    # Whether its hardware has a field for noise that is correlated in time.
    may_be_correlated: ClassVar[bool] = False

    def of(self, slew: Slew) -> np.ndarray | None:
        """Readings (n, columns) of a slew, None where it has none."""
        return getattr(slew, self.field) if self.field else (slew.more or {}).get(self.name)

    def masked(self, slew: Slew, mask: np.ndarray) -> Slew:
        """The slew without some readings: `mask` (n, columns)."""
        return self.with_values(slew, np.where(mask, np.nan, self.values(slew)))

    def with_values(self, slew: Slew, values: np.ndarray) -> Slew:
        """The slew with other readings (n, columns)."""
        changed: dict[str, Any] = {self.field: values}
        if not self.field:
            changed = {"more": {**(slew.more or {}), self.name: values}}
        return replace(slew, **changed)

    def spacings(self, slews: Sequence[Slew]) -> np.ndarray:
        """Times (m,) from one reading to the next [s], of all slews together."""
        read = ((slew.time, self.of(slew)) for slew in slews)
        times = (time[np.isfinite(x).any(axis=1)] for time, x in read if x is not None)
        return np.concatenate([np.zeros(0), *map(np.diff, times)])

    def values(self, slew: Slew) -> np.ndarray:
        """Readings (n, columns) of a slew that has them."""
        values = self.of(slew)
        assert values is not None
        return values

    def hardware(self, campaign: Campaign) -> Any:
        """The sensor, None where the campaign has none."""
        if self.field:
            return getattr(campaign, self.first)
        return dict(campaign.more_sensors)[self.name]

    def with_hardware(self, campaign: Campaign, hardware: Any) -> Campaign:
        """The campaign with another sensor in its place."""
        if self.field:
            return replace(campaign, **{self.first: hardware})
        sensors = dict(campaign.more_sensors) | {self.name: hardware}
        return replace(campaign, more_sensors=tuple(sensors.items()))

    def read(self, table: Table, entry: Any, spin_inertias: np.ndarray) -> np.ndarray | None:
        """Readings (n, columns) from a table, None where its columns are empty for good.

        `entry`: of [columns], one of `keys`. `spin_inertias` (wheels,): of the wheels [kg m^2].
        """
        raise NotImplementedError(f"{self.name} in a table")

    def valid(self, campaign: Campaign, slew: Slew) -> np.ndarray:
        """Which readings (n, columns) count."""
        return np.isfinite(self.values(slew))

    def unattainable(self, campaign: Campaign) -> float | np.ndarray:
        """Sizes of a reading (columns,) that nothing can pass."""
        return np.inf

    def series(self, campaign: Campaign, slew: Slew) -> Series:
        """Readings of a slew that has them, as the detectors of faults take them."""
        return Series(
            slew.time,
            self.values(slew),
            self.valid(campaign, slew),
            self.sigma(campaign),
            self.unattainable(campaign),
            self.unit,
            f"{getattr(self.hardware(campaign), 'range', None) or np.inf:.4g} {self.unit}",
            whole=not self.is_series,
        )

    def exchangeable(self, entry: Any) -> Sequence[int]:
        """Which of the columns of an entry may stand in another order by mistake: all."""
        return range(len(entry.names))

    @abstractmethod
    def components(self, campaign: Campaign) -> tuple[str, ...]:
        """Names of the components of a residual."""

    @abstractmethod
    def sigma(self, campaign: Campaign) -> Sequence[float | None]:
        """Stated noise of each column or axis, None where it is not stated."""

    def correlated(self, campaign: Campaign) -> CorrelatedNoise | None:
        """How a diagnosis measured the noise to be correlated in time; None: it is white."""
        sensor = self.hardware(campaign) if self.may_be_correlated else None
        return sensor.correlated_noise if sensor else None

    def louder(self, campaign: Campaign, factor: float) -> Campaign:
        """The campaign with this sensor's stated noise multiplied."""
        sensor = self.hardware(campaign)
        if sensor is None:
            return campaign
        stated = {key: getattr(sensor, key) for key in self.noise}
        louder = {
            key: tuple(factor * x for x in sigma) if isinstance(sigma, tuple) else factor * sigma
            for key, sigma in stated.items()
        }
        return self.with_hardware(campaign, replace(sensor, **louder))


def all_empty(table: Table, names: Sequence[str]) -> bool:
    """Whether columns hold no number."""
    return bool(np.isnan(table.stack(names)).all())


def refuse_empty_columns(table: Table, names: Sequence[str]) -> None:
    """Refuse a column that holds no number."""
    for name in names:
        filled = not np.isnan(table.numbers(name)).all()
        advice = "export it again, or leave the slew out"
        require(filled, f"{table.label}, column {name}", "every cell is empty", advice)


def refuse_half_empty_rows(table: Table, names: Sequence[str], advice: str) -> None:
    """Refuse columns that are empty everywhere, and rows of which some cells are given."""
    refuse_empty_columns(table, names)
    empty = np.isnan(table.stack(names))
    empty &= ~empty.all(axis=1, keepdims=True)
    row = int(np.argmax(empty.any(axis=1)))
    where = table.place(row, names[int(np.argmax(empty[row]))])
    require(not empty.any(), where, "the cell is empty", advice)
