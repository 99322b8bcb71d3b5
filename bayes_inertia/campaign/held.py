"""Readings that stand more than once: a slow sensor that was polled faster (sample and hold).

A row that repeats the one before to the last digit is no new reading. Rounding makes such rows,
too: while a reading hardly changes, it stays within one step. So rows count as repeats only where
readings beside them differ by many steps, or by more than one after stays of one regular length; a
steady drift that is rounded moves by one step at a time, and noise stays for irregular times.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from bayes_inertia.campaign.dirt import Dirt
from bayes_inertia.campaign.schema import ColumnsPart
from bayes_inertia.campaign.stream_clocks import StreamRows
from bayes_inertia.campaign.stuck import resolution
from bayes_inertia.campaign.units import to_si
from bayes_inertia.maths.values import array_dataclass

# Where fewer readings than this share stand twice, sds are wrong by less than 5 %.
_FEWEST_HELD = 0.1
_FEWEST_RUNS = 5
# Between neighbours that are so many steps apart, rounding repeats less than one row in twenty:
# where this share of them stands twice, they are held.
_MANY_STEPS, _NO_CHANCE = 20.0, 0.2
# A steady drift moves by one step, never by the next whole number.
_DRIFT = 1.5
# Regular lengths are within one row of the usual one, or this share of it; all but a few are.
_JITTER, _REGULAR, _FEW_SINGLE = 0.3, 0.8, 0.05
# A run may miss readings. What stands longer than so many usual lengths are equal readings.
_LONGEST = 3.0
# A break in time is longer than so many steps.
_BREAK = 5.0
_CHANNELS = {
    "rate": "rate",
    "attitude": "attitude",
    "wheel_momentum": "momentum",
    "wheel_speed": "momentum",
}
_WORDS = ("once", "twice", "three", "four", "five", "six", "seven", "eight", "nine", "ten")


@array_dataclass
class HeldReadings:
    """Which readings of a channel only repeat those before them, in one slew.

    Parameters
    ----------
    repeats : (n, k) array of bool
        True where a reading repeats the one before, False at the first of each run.
    lengths : (runs,) array of int
        How often each reading stands.
    """

    repeats: np.ndarray
    lengths: np.ndarray

    def __str__(self) -> str:
        low, high = (int(q) for q in np.quantile(self.lengths, [0.1, 0.9], method="nearest"))
        if low == high:
            times = _WORDS[low - 1] if low <= len(_WORDS) else str(low)
            return f"each reading stands {times}{' times' if low > 2 else ''}"
        return f"each reading stands {low} to {high} times"


def held_readings(
    series: Sequence[tuple[np.ndarray, np.ndarray]], *, by_axis: bool = True
) -> list[HeldReadings | None]:
    """Repeated readings of a channel whose sensor was polled faster than it measures.

    `series`: times (n,) and readings (n, k), NaN where there is none; of each slew, in any unit.
    `by_axis`: whether axes may be held each by itself; if not, only whole rows are. Returns: for
    each slew; None where readings are not held. The first of equal readings counts as read. In runs
    that are much longer than usual there is one in each usual length: whether they are stuck is for
    `stuck_readings` to tell.

    Examples
    --------
    >>> rate = np.random.default_rng(1).normal(size=(50, 3)).repeat(4, axis=0)
    >>> (held,) = held_readings([(0.25 * np.arange(200.0), rate)])
    >>> str(held), int(held.repeats.any(axis=1).sum())
    ('each reading stands four times', 150)
    """
    found = _found(series)
    if by_axis and not any(found):
        axes = [_found([(t, v[:, [k]]) for t, v in series]) for k in range(series[0][1].shape[1])]
        found = [_beside(of_axes) for of_axes in zip(*axes, strict=True)]
    return found


def _found(series: Sequence[tuple[np.ndarray, np.ndarray]]) -> list[HeldReadings | None]:
    """Whole rows that are held, in each series by its own evidence, or that of the others too."""
    found = [_held_rows([one])[0] for one in series]
    rest = [i for i, held in enumerate(found) if held is None]
    for i, held in zip(rest, _held_rows([series[i] for i in rest]), strict=True):
        found[i] = held
    for i, ((_, before), (_, values)) in enumerate(pairwise(series), 1):
        held = found[i]
        rows, earlier = (np.flatnonzero(np.isfinite(v).any(axis=1)) for v in (values, before))
        # What a slew begins with may stand since the one before it.
        if held and len(earlier) and np.array_equal(before[earlier[-1]], values[rows[0]]):
            repeats = held.repeats.copy()
            repeats[rows[0]] = True
            found[i] = replace(held, repeats=repeats)
    return found


def _beside(axes: Sequence[HeldReadings | None]) -> HeldReadings | None:
    """What is held in some of the axes (each (n, 1)) of one slew."""
    held = [axis for axis in axes if axis is not None]
    if not held:
        return None
    none = np.zeros_like(held[0].repeats)
    repeats = [none if axis is None else axis.repeats for axis in axes]
    return HeldReadings(np.hstack(repeats), np.concatenate([axis.lengths for axis in held]))


def counted_once(
    slews: Sequence[Sequence[StreamRows]], columns: ColumnsPart
) -> list[list[StreamRows]]:
    """All streams with empty cells where a reading only repeats the one before.

    Returns: the same with a record of kind "duplicate" where readings are held.
    """
    result = [list(streams) for streams in slews]
    for key, channel in _CHANNELS.items():
        places = [(i, k) for i, streams in enumerate(result) for k, rows in enumerate(streams)
                  if key in rows.stream.keys]  # fmt: skip
        if not places:
            continue
        names = getattr(columns, key).names
        series = [(result[i][k].stamps, result[i][k].table.stack(names)) for i, k in places]
        found = held_readings(series, by_axis=key != "attitude")
        for (i, k), held in zip(places, found, strict=True):
            if held is not None:
                result[i][k] = _without(result[i][k], names, held, channel)
    return result


def _without(
    rows: StreamRows, names: Sequence[str], held: HeldReadings, channel: str
) -> StreamRows:
    """Rows of a stream without the repeats in some of its columns, and with a record of them."""
    repeated = np.flatnonzero(held.repeats.any(axis=1))
    values = np.where(held.repeats, np.nan, rows.table.stack(names))
    columns = {**rows.table.columns, **dict(zip(names, values.T, strict=True))}
    poll = float(to_si(np.median(np.diff(rows.stamps)), "time", rows.stream.time.unit))
    note = (
        f"{held}: {len(repeated)} of {len(values)} rows repeat the one before and do not count; "
        f"a reading may be up to {poll:.3g} s older than its stamp"
    )
    record = Dirt("duplicate", channel, "", tuple(repeated.tolist()), "masked", note)
    table = replace(rows.table, columns=columns)
    return replace(rows, table=table, dirt=(*rows.dirt, record))


def _held_rows(
    series: Sequence[tuple[np.ndarray, np.ndarray]],
) -> list[HeldReadings | None]:
    """What is held in each series by the evidence of all; None where no row repeats another."""
    given = [np.flatnonzero(np.isfinite(values).any(axis=1)) for _, values in series]
    runs = [
        _run_starts(time[rows], values[rows])
        for (time, values), rows in zip(series, given, strict=True)
    ]
    counts = [np.diff(np.append(f, len(r))) for (f, _), r in zip(runs, given, strict=True)]
    lengths = np.concatenate([np.zeros(0, dtype=int), *counts])
    held = lengths > 1
    if held.sum() < max(_FEWEST_RUNS, _FEWEST_HELD * len(lengths)):
        return [None] * len(series)
    usual = float(np.median(lengths[held]))
    firsts = [rows[first] for rows, (first, _) in zip(given, runs, strict=True)]
    readings = np.concatenate([v[rows] for (_, v), rows in zip(series, firsts, strict=True)])
    moved = _moved(readings, np.concatenate([joins for _, joins in runs]))
    if not _beyond_rounding(lengths, moved, usual):
        return [None] * len(series)
    found: list[HeldReadings | None] = []
    for (_, values), rows, first, count in zip(series, given, firsts, counts, strict=True):
        short = np.repeat(count <= _LONGEST * usual, count)
        since = np.arange(len(rows)) - np.repeat(np.searchsorted(rows, first), count)
        repeats = np.zeros(values.shape, dtype=bool)
        repeats[rows] = ((since > 0) & (short | (since % round(usual) > 0)))[:, None]
        lasting = count[count <= _LONGEST * usual]
        found.append(HeldReadings(repeats, lasting) if repeats.any() and len(lasting) else None)
    return found


def _beyond_rounding(lengths: np.ndarray, moved: np.ndarray, usual: float) -> bool:
    """Whether rounding cannot explain runs of these lengths with so many steps beside them."""
    held, far = lengths > 1, moved >= _MANY_STEPS
    if (held & far).sum() >= max(_FEWEST_RUNS, _NO_CHANCE * far.sum()):
        return True
    drifts = np.nanmedian(np.append(moved[held], 0.0)) < _DRIFT
    regular = np.abs(lengths - usual) <= max(1.0, _JITTER * usual)
    return bool(not drifts and regular.mean() >= _REGULAR and np.mean(lengths == 1) <= _FEW_SINGLE)


def _run_starts(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First row of each run of equal rows (n, k), and whether the row before it is near in time."""
    if not len(time):
        return np.zeros(0, dtype=int), np.zeros(0, dtype=bool)
    same = (values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
    first = np.flatnonzero(np.append(True, ~same.all(axis=1)))
    steps = np.diff(time, prepend=-np.inf)
    return first, (steps <= _BREAK * np.median(steps))[first]


def _moved(readings: np.ndarray, joins: np.ndarray) -> np.ndarray:
    """Steps of rounding from each reading (runs, k) to the nearer of its neighbours, NaN without.

    The axis counts that moves most; `joins` (runs,) says which follow the one before at once.
    """
    count = np.zeros(len(readings) - 1)
    for axis in readings.T:
        larger = np.fmax(np.abs(axis[1:]), np.abs(axis[:-1]))
        count = np.fmax(count, np.abs(np.diff(axis)) / _steps_of_rounding(axis, larger))
    count = np.where(joins[1:], count, np.nan)
    return np.fmin(np.append(np.nan, count), np.append(count, np.nan))


def _steps_of_rounding(axis: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Smallest steps between readings (n,) of these sizes (m,); digits may be those of the size."""
    decades, at = (np.floor(np.log10(np.fmax(np.abs(v), 1e-300))) for v in (axis, sizes))
    steps = np.full(len(sizes), np.inf)
    for decade in np.unique(at[np.isfinite(at)]):
        steps[at == decade] = resolution(axis[decades == decade]) or np.inf
    return steps
