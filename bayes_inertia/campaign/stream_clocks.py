"""The times of a stream: its stamps, or those of a clock that is better known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_inertia.campaign.schema import ColumnsPart
from bayes_inertia.campaign.sensors import BY_KEY
from bayes_inertia.campaign.streams import Stream
from bayes_inertia.campaign.units import to_si
from bayes_inertia.errors import CampaignError
from bayes_inertia.faults.fault import Dirt
from bayes_inertia.faults.held import HeldReadings, held_readings
from bayes_inertia.faults.stamps import StampSlope, regular_clock, regular_stamps, slope_of_readings
from bayes_inertia.tables.number_table import Table

_READINGS = tuple(key for key, stream in BY_KEY.items() if stream.is_series)


@dataclass(frozen=True)
class StreamRows:
    """The rows of one stream of one slew, in the order of time.

    Parameters
    ----------
    stream : Stream
        What the stream holds, and its clock.
    table : Table
        Its columns, in the file's own units.
    dirt : tuple of Dirt
        What is wrong with its rows and stamps, without slew.
    """

    stream: Stream
    table: Table
    dirt: tuple[Dirt, ...]

    @property
    def stamps(self) -> np.ndarray:
        """The column of its time, in the file's own unit."""
        return self.table.columns[self.stream.time.names[0]]

    def at(self, times: np.ndarray, dirt: Dirt | None) -> StreamRows:
        """The same rows at other times.

        `times` (rows,).
        """
        columns = {**self.table.columns, self.stream.time.names[0]: times}
        records = self.dirt if dirt is None else (*self.dirt, dirt)
        return replace(self, table=replace(self.table, columns=columns), dirt=records)


def on_their_clocks(
    slews: Sequence[Sequence[StreamRows]], columns: ColumnsPart
) -> list[list[StreamRows]]:
    """All streams at the times of their clocks.

    Rounded stamps become those of the regular clock that they were rounded from. Stamps that
    jitter become those of a regular clock where `regular = true` says so, or where the readings of
    all slews show that sampling does not jitter; else they are kept.

    Returns: the same with their times, and with a record of what was done.
    """
    placed = [[_rounded(rows) for rows in streams] for streams in slews]
    uneven: dict[tuple, list[tuple[int, int]]] = {}
    for i, streams in enumerate(placed):
        for k, (rows, record) in enumerate(streams):
            if record is not None and record.treated == "ignored":
                stream = rows.stream
                key = (stream.time.names[0], stream.keys, stream.offset_s)
                uneven.setdefault(key, []).append((i, k))
    result = [[rows.at(rows.stamps, record) for rows, record in streams] for streams in placed]
    for places in uneven.values():
        slope = _slope([placed[i][k][0] for i, k in places], columns)
        for i, k in places:
            rows, record = placed[i][k]
            assert record is not None
            result[i][k] = _of_jitter(rows, record, slope)
    return result


def _rounded(rows: StreamRows) -> tuple[StreamRows, Dirt | None]:
    """Rows at the times of a rounded clock; stamps that are uneven stay, with a record."""
    time = rows.stream.time
    times, record = regular_stamps(rows.stamps, time.unit)
    rounded = record is not None and record.treated == "modelled"
    if not time.regular or rounded:
        return rows.at(times, None), record
    clock, problem = regular_clock(rows.stamps)
    if clock is None:
        raise CampaignError(
            f"regular = true, but no regular clock explains the stamps: {problem} {time.unit}",
            where=f"{rows.table.label}, column {time.names[0]}",
            advice="leave the key out of the time in [columns]; the stamps are then taken as they "
            "are",
        )
    if np.abs(clock - rows.stamps).max() <= 1e-6 * np.median(np.diff(clock)):
        return rows, None
    note = f"{_strays(rows.stamps, clock, time.unit)}; its times are taken, as stated"
    return rows.at(clock, None), Dirt("clock", "time", "", (), "modelled", note)


def _strays(stamps: np.ndarray, clock: np.ndarray, unit: str) -> str:
    rms = float(np.sqrt(np.mean((stamps - clock) ** 2)))
    return f"stamps stray from a regular clock by {rms:.3g} {unit} rms"


def _slope(streams: Sequence[StreamRows], columns: ColumnsPart) -> StampSlope:
    """Whether the readings of a stream move with the jitter of its stamps, over all slews."""
    evidence = []
    for rows in streams:
        names = [name for key in rows.stream.keys if key in _READINGS
                 for name in getattr(columns, key).names]  # fmt: skip
        clock, _ = regular_clock(rows.stamps)
        if names and clock is not None:
            evidence.append((rows.stamps, clock, rows.table.stack(names)))
    return slope_of_readings(evidence)


def _of_jitter(rows: StreamRows, record: Dirt, slope: StampSlope) -> StreamRows:
    """Rows whose stamps jitter, at the times that the readings show."""
    evidence = f"readings follow the jitter by {slope.value:.2f} +- {slope.sd:.2g}"
    clock, _ = regular_clock(rows.stamps)
    if clock is None or slope.sampling_is_uneven:
        kept = f"; sampling is uneven ({evidence})" if slope.sampling_is_uneven else ""
        return rows.at(rows.stamps, replace(record, note=record.note + kept))
    if slope.sampling_is_regular:
        strays = _strays(rows.stamps, clock, rows.stream.time.unit)
        note = f"{strays}, sampling does not ({evidence}); the clock's times are taken"
        return rows.at(clock, replace(record, treated="modelled", note=note))
    advice = (
        "; if the sensor samples at regular times, write regular = true beside the unit of this "
        "time in [columns]"
    )
    return rows.at(rows.stamps, replace(record, note=record.note + advice))


def counted_once(
    slews: Sequence[Sequence[StreamRows]], columns: ColumnsPart
) -> list[list[StreamRows]]:
    """All streams with empty cells where a reading only repeats the one before.

    Returns: the same with a record of kind "duplicate" where readings are held.
    """
    result = [list(streams) for streams in slews]
    for key, sensor in BY_KEY.items():
        places = [(i, k) for i, streams in enumerate(result) for k, rows in enumerate(streams)
                  if key in rows.stream.keys]  # fmt: skip
        if not places:
            continue
        names = getattr(columns, key).names
        series = [(result[i][k].stamps, result[i][k].table.stack(names)) for i, k in places]
        found = held_readings(series, by_axis=sensor.is_series)
        for (i, k), held in zip(places, found, strict=True):
            if held is not None:
                result[i][k] = _without_repeats(result[i][k], names, held, sensor.name)
    return result


def _without_repeats(
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
