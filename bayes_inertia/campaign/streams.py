"""Streams of a slew: rows with their clocks, from columns to channels, on one list of times.

Each reading keeps its own time. Nothing is interpolated: where a stream has no reading at a time,
NaN stands there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_inertia.campaign import schema
from bayes_inertia.campaign.description import Description, Entry
from bayes_inertia.campaign.format_2 import FieldVector, PositionVector, SlewPart, WheelTorque
from bayes_inertia.campaign.inputs import InputStream
from bayes_inertia.campaign.limits import LIMITS
from bayes_inertia.campaign.sensors import BY_KEY, KINDS_BY_KEY
from bayes_inertia.campaign.sensors.sensor_stream import (
    SensorStream,
    all_empty,
    refuse_empty_columns,
    refuse_half_empty_rows,
)
from bayes_inertia.campaign.slew_parts import INPUTS, MORE
from bayes_inertia.errors import CampaignError, require
from bayes_inertia.faults.fault import Dirt
from bayes_inertia.faults.gaps import is_regular
from bayes_inertia.faults.held import HeldReadings, held_readings
from bayes_inertia.faults.limits import LIMITS as FAULTS
from bayes_inertia.faults.stamps import StampSlope, regular_clock, regular_stamps, slope_of_readings
from bayes_inertia.tables.table import Table


@dataclass(frozen=True)
class Stream:
    """Entries of the description that share a table and a clock."""

    file: str  # The table, as the description names it
    time: schema.TimeColumn  # The column of stamps
    offset_s: float  # True time minus stamp [s]
    entries: tuple[Entry, ...]  # What the columns hold

    @property
    def columns(self) -> list[str]:
        """The columns of the table, time first."""
        return [self.time.names[0], *(n for entry in self.entries for n in entry.columns.names)]

    @property
    def is_input(self) -> bool:
        """Whether it only tells what devices did."""
        return all(entry.field.startswith(INPUTS) for entry in self.entries)


def streams_of(slew: SlewPart, description: Description) -> list[Stream]:
    """The streams of a slew, in the order of the description."""
    found: dict[tuple[str, str, str, bool, float], tuple[schema.TimeColumn, list[Entry]]] = {}
    for entry in description.entries:
        file = slew.file_of(entry.columns)
        if file is None:
            continue
        time = description.clock(entry)
        offset = time.offset_s + entry.columns.offset_s
        clock = (file, time.names[0], time.unit, time.regular, offset)
        found.setdefault(clock, (time, []))[1].append(entry)
    return [Stream(file, t, offset, tuple(e)) for (file, *_, offset), (t, e) in found.items()]


def union(streams: Sequence[dict[str, np.ndarray]], label: str) -> dict[str, np.ndarray]:
    """Channels (n, width) of streams on the list of all their times [s], NaN between readings.

    Times closer than a nanosecond, or than the rounding of large times, are one time.
    """
    if len(streams) == 1:
        return dict(streams[0])
    streams = [_without_empty_rows(stream) for stream in streams]
    times = np.concatenate([stream["time"] for stream in streams])
    advice = "export it again, or leave the slew out"
    require(len(times) > 0, label, "no sensor has a reading", advice)
    order = np.argsort(times, kind="stable")
    resolution = max(LIMITS.same_time, 4.0 * float(np.spacing(np.abs(times).max())))
    is_new = np.concatenate([[True], np.diff(times[order]) > resolution])
    row = np.empty(len(times), dtype=int)
    row[order] = np.cumsum(is_new) - 1
    joined: dict[str, np.ndarray] = {"time": times[order][is_new]}
    ends = np.cumsum([len(stream["time"]) for stream in streams])
    for stream, rows in zip(streams, np.split(row, ends[:-1]), strict=True):
        if np.any(np.diff(rows) == 0):
            at = float(stream["time"][int(np.argmin(np.diff(rows)))])
            what = f"two rows near the time {at!r} s are closer than {resolution:.1g} s"
            advice = "count time from the start of the slew, so that its digits suffice"
            raise CampaignError(what, where=label, advice=advice)
        for name, values in stream.items():
            if name != "time":
                empty = np.full((len(joined["time"]), values.shape[1]), np.nan)
                channel = joined.setdefault(name, empty)
                # Wheels may have tachometers in several tables.
                channel[rows] = np.where(np.isnan(values), channel[rows], values)
    return joined


def _without_empty_rows(stream: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """A stream without rows that hold no reading, such as those of a tracker that has no fix."""
    readings = [values for name, values in stream.items() if name != "time"]
    if not readings:
        return {"time": stream["time"][:0]}
    filled = np.isfinite(np.concatenate(readings, axis=1)).any(axis=1)
    return {name: values[filled] for name, values in stream.items()}


_READINGS = tuple(key for key, stream in BY_KEY.items() if stream.is_series)


@dataclass(frozen=True)
class StreamRows:
    """The rows of one stream of one slew, in the order of time."""

    slew: int  # Which, counted from 0
    stream: Stream  # What the stream holds, and its clock
    table: Table  # Its columns, in the file's own units
    dirt: tuple[Dirt, ...]  # What is wrong with its rows and stamps, without slew

    @property
    def stamps(self) -> np.ndarray:
        """The column of its time, in the file's own unit."""
        return self.table.numbers(self.stream.time.names[0])

    @property
    def span(self) -> tuple[float, float]:
        """Its first and last time on the slew's clock [s]."""
        ends = schema.to_si(self.stamps[[0, -1]], "time", self.stream.time.unit)
        first, last = (ends + self.stream.offset_s).tolist()
        return first, last

    def at(self, times: np.ndarray, dirt: Dirt | None) -> StreamRows:
        """The same rows at other times (rows,), with one more record."""
        records = self.dirt if dirt is None else (*self.dirt, dirt)
        return replace(
            self, table=self.table.changed({self.stream.time.names[0]: times}), dirt=records
        )


def require_beside_rates(streams: Sequence[StreamRows]) -> None:
    """Raise `CampaignError` where a table lies far from its slew's rates, as no other slew's does.

    Where those of all slews do, their clock has an offset, which the check of conventions tells.
    """
    away: dict[str, list[tuple[float, StreamRows]]] = {}
    given = [rows for rows in streams if rows.table.rows]
    rated = (rows for rows in given if any(e.field == "rate" for e in rows.stream.entries))
    rates = {rows.slew: rows.span for rows in rated}
    for rows in given:
        first, last = rates.get(rows.slew, rows.span)
        distance = max(first - rows.span[1], rows.span[0] - last) / (last - first or 1.0)
        for entry in rows.stream.entries:
            away.setdefault(entry.key, []).append((distance, rows))
    for of_slews in away.values():
        far = [rows for distance, rows in of_slews if distance > LIMITS.spans_apart]
        if far and len(far) < len(of_slews):
            (begin, end), (first, last) = far[0].span, rates[far[0].slew]
            where = f"{begin:.6g} to {end:.6g} s, those of the rates {first:.6g} to {last:.6g} s"
            advice = "mend them, or leave the table out of this slew"
            what = f"its times are {where}, and in other slews they meet"
            raise CampaignError(what, where=far[0].table.label, advice=advice)


def on_their_clocks(streams: Sequence[StreamRows]) -> list[StreamRows]:
    """All streams of all slews at the times of their clocks.

    Rounded stamps become those of the regular clock that they were rounded from. Stamps that
    jitter become those of a regular clock where `regular = true` says so, or where the readings of
    all slews show that sampling does not jitter; else they are kept.

    Returns: the same with their times, and with a record of what was done.
    """
    placed = [_rounded(rows) for rows in streams]
    result = [rows.at(rows.stamps, record) for rows, record in placed]
    uneven: dict[tuple, list[tuple[int, StreamRows, Dirt]]] = {}
    for k, (rows, record) in enumerate(placed):
        if record is not None and record.treated == "ignored":
            stream = rows.stream
            paths = tuple(entry.path for entry in stream.entries)
            clock = (stream.time.names[0], paths, stream.offset_s)
            uneven.setdefault(clock, []).append((k, rows, record))
    for alike in uneven.values():
        slope = _slope([rows for _, rows, _ in alike])
        for k, rows, record in alike:
            result[k] = _of_jitter(rows, record, slope)
    return result


def _rounded(rows: StreamRows) -> tuple[StreamRows, Dirt | None]:
    """Rows at the times of a rounded clock; stamps that are uneven stay, with a record."""
    time = rows.stream.time
    times, record = regular_stamps(rows.stamps, time.unit)
    rounded = record is not None and record.treated == "modelled"
    if not time.regular or rounded:
        return rows.at(times, None), record
    if len(times) < FAULTS.fewest_stamps:
        note = f"{len(times)} rows are too few for a regular clock; their stamps are taken"
        return rows, Dirt("clock", "time", "", (), "ignored", note)
    clock = stated_clock(rows.stamps, time.unit, f"{rows.table.label}, column {time.names[0]}")
    if np.abs(clock - rows.stamps).max() <= FAULTS.exact_stamp * np.median(np.diff(clock)):
        return rows, None
    note = f"{_strays(rows.stamps, clock, time.unit)}; its times are taken, as stated"
    return rows.at(clock, None), Dirt("clock", "time", "", (), "modelled", note)


def stated_clock(stamps: np.ndarray, unit: str, where: str) -> np.ndarray:
    """Times (n,) of the regular clock of stamps of which regular = true is stated, or an error."""
    clock, problem = regular_clock(stamps)
    if clock is None:
        what = f"regular = true, but no regular clock explains the stamps: {problem} {unit}"
        advice = "leave the key out of this time; the stamps are then taken as they are"
        raise CampaignError(what, where=where, advice=advice)
    return clock


def _strays(stamps: np.ndarray, clock: np.ndarray, unit: str) -> str:
    rms = float(np.sqrt(np.mean((stamps - clock) ** 2)))
    return f"stamps stray from a regular clock by {rms:.3g} {unit} rms"


def _slope(streams: Sequence[StreamRows]) -> StampSlope:
    """Whether the readings of a stream move with the jitter of its stamps, over all slews."""
    evidence = []
    for rows in streams:
        read = [entry for entry in rows.stream.entries if entry.key in _READINGS]
        names = [name for entry in read for name in entry.columns.names]
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
    advice = "; if the sensor samples at regular times, write regular = true beside the unit of "
    advice += "this time in [columns]"
    return rows.at(rows.stamps, replace(record, note=record.note + advice))


def sensor_of(entry: Entry) -> SensorStream | None:
    """The sensor whose readings an entry holds, if there is one."""
    if entry.field.startswith(MORE):
        return KINDS_BY_KEY[entry.key](entry.field.removeprefix(MORE))
    return None if entry.field.startswith(INPUTS) else BY_KEY.get(entry.key)


def counted_once(streams: Sequence[StreamRows]) -> list[StreamRows]:
    """All streams with empty cells, and a record, where a reading only repeats the one before."""
    result = list(streams)
    entries = {entry.path: entry for rows in streams for entry in rows.stream.entries}
    kinds = list({**BY_KEY, **KINDS_BY_KEY})
    read = [(sensor, entry) for entry in entries.values() if (sensor := sensor_of(entry))]
    for sensor, entry in sorted(read, key=lambda pair: kinds.index(pair[1].key)):
        names, path = entry.columns.names, entry.path
        places = [k for k, r in enumerate(result) if path in [e.path for e in r.stream.entries]]
        series = [(result[k].stamps, result[k].table.stack(names)) for k in places]
        # A vector is whole or missing.
        by_axis = sensor.is_series and entry.key != "direction"
        for k, held in zip(places, held_readings(series, by_axis=by_axis), strict=True):
            if held is not None:
                result[k] = _without_repeats(result[k], names, held, sensor.name)
    return result


def _without_repeats(
    rows: StreamRows, names: Sequence[str], held: HeldReadings, channel: str
) -> StreamRows:
    """Rows of a stream without the repeats in some of its columns, and with a record of them."""
    repeated = np.flatnonzero(held.repeats.any(axis=1))
    values = np.where(held.repeats, np.nan, rows.table.stack(names))
    poll = float(schema.to_si(np.median(np.diff(rows.stamps)), "time", rows.stream.time.unit))
    note = f"{held}: {len(repeated)} of {len(values)} rows repeat the one before and do not count; "
    note += f"a reading may be up to {poll:.3g} s older than its stamp"
    record = Dirt("duplicate", channel, "", tuple(repeated.tolist()), "masked", note)
    table = rows.table.changed(dict(zip(names, values.T, strict=True)))
    return replace(rows, table=table, dirt=(*rows.dirt, record))


def stream_from_table(
    table: Table, stream: Stream, spin_inertias: np.ndarray
) -> dict[str, np.ndarray]:
    """The channels (rows, width) of a stream, in SI units, with the package's signs and senses.

    A star tracker or an environment whose columns are all empty is left out. `spin_inertias`
    (wheels,) [kg m^2] are for tachometers that tell speeds.
    """
    time = schema.to_si(table.numbers(stream.time.names[0]), "time", stream.time.unit)
    # Adding nothing would make a zero of -0.0.
    channels = {"time": time + stream.offset_s if stream.offset_s else time}
    for entry in stream.entries:
        if entry.field.startswith(INPUTS):
            continue
        sensor = sensor_of(entry)
        wheels = list(entry.wheels)
        if sensor is not None:
            values = sensor.read(table, entry.columns, spin_inertias[wheels])
        elif entry.key == "wheel_torque":
            values = _torque(table, entry.columns, time)
        else:
            values = _environment(table, entry.columns, entry.key)
        if values is None:
            continue
        if entry.wheels:
            none = np.full((len(time), len(spin_inertias)), np.nan)
            channels.setdefault(entry.field, none)[:, wheels] = values
        else:
            channels[entry.field] = values
    return channels


def inputs_of(streams: Sequence[StreamRows]) -> dict[str, InputStream]:
    """What devices were told to do in a slew, under their names, in SI units."""
    every = ((rows, entry) for rows in streams for entry in rows.stream.entries)
    given = ((rows, entry) for rows, entry in every if entry.field.startswith(INPUTS))
    return {e.field.removeprefix(INPUTS): _input(rows.table, rows.stream, e) for rows, e in given}


def _input(table: Table, stream: Stream, entry: Entry) -> InputStream:
    time = schema.to_si(table.numbers(stream.time.names[0]), "time", stream.time.unit)
    names = entry.columns.names
    refuse_half_empty_rows(table, names, "fill the row, or leave all its cells empty")
    values = table.stack(names)
    # A direction has no unit.
    values = schema.to_si(values, entry.key, entry.columns.unit) if entry.columns.unit else values
    given = np.isfinite(values).all(axis=1)
    try:
        return InputStream(time[given] + stream.offset_s, values[given], entry.columns.between)
    except CampaignError as error:
        where = f"{table.label}, columns {', '.join(names)}"
        raise CampaignError(error.what, where=where, advice=error.advice) from None


def _torque(table: Table, entry: WheelTorque, time: np.ndarray) -> np.ndarray:
    refuse_empty_columns(table, entry.names)
    values = schema.to_si(table.stack(entry.names), "wheel_torque", entry.unit)
    missing = np.isnan(values).any(axis=1)
    if not is_regular(time[~missing]):
        # A log of changes does not show that a command is missing.
        advice = "repair the row: commands that come at no regular step need every wheel"
        refuse_half_empty_rows(table, entry.names, advice)
    # Without one wheel's command, what all wheels did is unknown.
    values = np.where(missing[:, None], np.nan, values)
    # 0 - values, because -values would make zeros negative.
    return 0.0 - values if entry.acts_on == "body" else values


def _environment(table: Table, entry: FieldVector | PositionVector, key: str) -> np.ndarray | None:
    if all_empty(table, entry.names):
        return None
    refuse_half_empty_rows(table, entry.names, "fill all three cells, or leave all three empty")
    return schema.to_si(table.stack(entry.names), key, entry.unit)
