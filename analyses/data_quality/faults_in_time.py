"""Injectors of dirt in rows, times and commands: gaps, duplicates, clock, order, lost commands."""

from __future__ import annotations

import numpy as np
import pandas as pd

from analyses.data_quality.faults import (
    Injector,
    RawCampaign,
    a_file,
    numbers,
    row_period,
    window,
    with_numbers,
    with_table,
)

# A gap, or commands not recorded, at size 1 [s].
_GAP_SECONDS = 5.0


def dropped_rows(raw: RawCampaign, rng: np.random.Generator, size: float) -> RawCampaign:
    """2 % of all rows are absent (times size)."""
    for file, table in raw.tables.items():
        n = len(table)
        lost = rng.choice(np.arange(1, n - 1), max(1, round(0.02 * size * n)), replace=False)
        raw = with_table(raw, file, table.drop(index=lost))
    return raw


def gap(raw: RawCampaign, rng: np.random.Generator, size: float) -> RawCampaign:
    """The rows of 5 s (times size) while slewing are absent."""
    file = a_file(raw, rng)
    return with_table(
        raw, file, raw.tables[file].drop(index=window(raw, file, rng, size * _GAP_SECONDS))
    )


def duplicated_rows(conflicting: bool) -> Injector:
    """2 % of the rows stand twice (times size); `conflicting`: with other noise the second time."""

    def inject(raw: RawCampaign, rng: np.random.Generator, size: float) -> RawCampaign:
        for file, table in raw.tables.items():
            twice = rng.choice(len(table), max(1, round(0.02 * size * len(table))), replace=False)
            second = table.iloc[np.sort(twice)].copy()
            if conflicting:
                names = raw.names("rate")
                values = numbers(second.reset_index(drop=True), names)
                values = values + raw.sigma("rate") * rng.normal(size=values.shape)
                second[names] = [[repr(float(x)) for x in row] for row in values]
            order = np.argsort(np.r_[np.arange(len(table)), np.sort(twice)], kind="stable")
            raw = with_table(raw, file, pd.concat([table, second]).iloc[order])
        return raw

    return inject


def clock_jump(seconds: float) -> Injector:
    """From a row on while slewing all stamps of one slew are off by `seconds` (times size)."""

    def inject(raw: RawCampaign, rng: np.random.Generator, size: float) -> RawCampaign:
        file, names = a_file(raw, rng), raw.names("time")
        time = numbers(raw.tables[file], names)
        time[window(raw, file, rng, 1.0)[0] :] += seconds * size
        return with_table(raw, file, with_numbers(raw.tables[file], names, time))

    return inject


def clock_glitch(raw: RawCampaign, rng: np.random.Generator, size: float) -> RawCampaign:
    """Single stamps far off (one a slew, 1000 s times size)."""
    for file, table in raw.tables.items():
        names = raw.names("time")
        time = numbers(table, names)
        time[rng.integers(2, len(time) - 2)] += 1000.0 * size * rng.choice([-1.0, 1.0])
        raw = with_table(raw, file, with_numbers(table, names, time))
    return raw


def float32_times(offset: float) -> Injector:
    """Stamps counted from `offset` s before, stored with 32 bits."""

    def inject(raw: RawCampaign, rng: np.random.Generator, size: float) -> RawCampaign:
        for file, table in raw.tables.items():
            names = raw.names("time")
            time = (numbers(table, names) + offset).astype(np.float32).astype(float)
            raw = with_table(raw, file, with_numbers(table, names, time))
        return raw

    return inject


def out_of_order(raw: RawCampaign, rng: np.random.Generator, size: float) -> RawCampaign:
    """Packets of ten rows change places with the next (2 a slew, times size)."""
    for file, table in raw.tables.items():
        order = np.arange(len(table))
        for _ in range(max(1, round(2 * size))):
            k = 10 * int(rng.integers(len(table) // 10 - 2))
            order[k : k + 20] = np.roll(order[k : k + 20], 10)
        raw = with_table(raw, file, table.iloc[order])
    return raw


def lost_commands(raw: RawCampaign, rng: np.random.Generator, size: float) -> RawCampaign:
    """The torque commands of 5 s (times size) are empty cells while slewing."""
    return _emptied(raw, rng, size, "wheel_torque")


def lost_tachometer(raw: RawCampaign, rng: np.random.Generator, size: float) -> RawCampaign:
    """The tachometer readings of 5 s (times size) are empty cells while slewing."""
    return _emptied(raw, rng, size, "wheel_momentum")


def _emptied(raw, rng, size, channel) -> RawCampaign:
    file, names = a_file(raw, rng), raw.names(channel)
    values = numbers(raw.tables[file], names)
    values[window(raw, file, rng, size * _GAP_SECONDS)] = np.nan
    return with_table(raw, file, with_numbers(raw.tables[file], names, values))


def late_row_period(raw: RawCampaign, rng: np.random.Generator, size: float) -> RawCampaign:
    """Stamps jitter by 5 % of the row's period (times size)."""
    for file, table in raw.tables.items():
        names = raw.names("time")
        time = numbers(table, names)
        time += 0.05 * size * row_period(raw, file) * rng.uniform(-1.0, 1.0, time.shape)
        raw = with_table(raw, file, with_numbers(table, names, time))
    return raw
