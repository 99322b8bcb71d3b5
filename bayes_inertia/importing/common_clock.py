"""Streams of several clocks on one; counters that wrap are counted on.

A clock that goes back is either a counter that wrapped or a clock that was set back. A wrap leaves
the step between two rows as it is, once the period is added; that decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise

import numpy as np

from bayes_inertia.errors import CampaignError, require
from bayes_inertia.faults.row_order import set_back_row
from bayes_inertia.importing.limits import LIMITS
from bayes_inertia.importing.logged_stream import (
    ZERO_OF_FILE,
    FileShare,
    LoggedStream,
    held,
    in_order,
    joined,
    left_out,
)
from bayes_inertia.importing.mapping import rate_sensor_axes, streams_that_hold
from bayes_inertia.importing.mapping_schema import MappingPart
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.tables.stamp_parts import SECOND, unit_size
from bayes_inertia.tables.time_stamps import FREE_CLOCKS

# Counts of these are scaled to other units by ground software; also the unit of the file itself.
_UNITS = ("s", "100 ms", "10 ms", "ms", "100 us", "10 us", "us")
_DAYS = {"86400 s": 86400 * SECOND, "604800 s": 604800 * SECOND}  # Seconds of the day, of the week.


@dataclass(frozen=True)
class _Period:
    """After how much a counter begins anew: in words, and in nanoseconds."""

    name: str
    ns: int
    own: bool
    """Whether it is of counts of the file itself, of many bits: then a pause may hold the wrap."""


def counted_on(shares: Sequence[FileShare]) -> list[FileShare]:
    """Shares whose counters do not begin anew, with a note where one wrapped."""
    placed: dict[int, FileShare] = {}
    for group in _groups(shares):
        # The stream with the most rows shows a wrap best.
        streams = sorted(_streams(group), key=lambda files: -sum(len(f.values) for f in files))
        found = next((w for w in map(_wrap, streams) if w), None)
        if found is None:
            continue
        period, centre, span = found
        counted = _placed if 1.25 * span < period.ns else _unwrapped
        for share in group:
            placed[id(share)] = _with_counts(share, counted(share, period, centre), period)
    return [placed.get(id(share), share) for share in shares]


def _groups(shares: Sequence[FileShare]) -> list[list[FileShare]]:
    """Shares whose stamps come from one counter."""
    groups: dict[tuple, list[FileShare]] = {}
    for files in _streams(shares):
        time = files[0].stream.time
        for k, share in enumerate(files):
            if time.kind in FREE_CLOCKS or not (time.kind or share.stamps.absolute):
                key = (time.epoch, k if time.epoch == ZERO_OF_FILE else 0)
                groups.setdefault(key, []).append(share)
    return list(groups.values())


def _streams(shares: Sequence[FileShare]) -> list[list[FileShare]]:
    """The files of each stream."""
    streams: dict[int, list[FileShare]] = {}
    for share in shares:
        streams.setdefault(id(share.stream), []).append(share)
    return list(streams.values())


def _wrap(files: Sequence[FileShare]) -> tuple[_Period, int, int] | None:
    """The period of a counter that wraps in a stream, the middle of its times and their span."""
    counts = np.concatenate([share.counts for share in files])
    steps = np.diff(counts)
    forward = steps[steps > 0]
    if not len(forward) or not np.any(steps < 0):
        return None
    step = float(np.median(forward))
    tried = [(period, _clean_wraps(counts, steps, step, period)) for period in _periods(files[0])]
    found = [(period, wraps) for period, wraps in tried if wraps.any()]
    if not found:
        return None
    misfits = [np.abs(steps[wraps] + period.ns - step).min() for period, wraps in found]
    period, wraps = found[int(np.argmin(misfits))]
    last = int(counts[-1]) + period.ns * int(wraps.sum())
    return period, (int(counts[0]) + last) // 2, last - int(counts[0])


def _periods(share: FileShare) -> list[_Period]:
    """Periods that counters have."""
    time = share.stream.time
    own = (time.units or [time.kind or "ns"])[0]
    sizes = {unit: unit_size(unit) or Fraction(SECOND) for unit in dict.fromkeys((own, *_UNITS))}
    periods = [_Period(name, ns, True) for name, ns in _DAYS.items()]
    for unit, size in sizes.items():
        whole = unit == own and not np.any(share.counts % max(int(size), 1))
        for bits in LIMITS.counter_bits:
            ns = int(size * 2**bits)
            name = f"2^{bits} {unit}" if unit.isalpha() else f"2^{bits} counts of {unit}"
            periods.append(_Period(name, ns, whole and bits >= LIMITS.long_counter_bits))
    return [period for period in periods if period.ns < 2**61]  # Sums stay within 64 bits.


def _clean_wraps(counts: np.ndarray, steps: np.ndarray, step: float, period: _Period) -> np.ndarray:
    """Which steps (rows - 1,) are those of a running clock once the period is added."""
    none = np.zeros(len(steps), dtype=bool)
    lowest, highest = int(counts.min()), int(counts.max())
    signed = -period.ns // 2 <= lowest < 0 and highest < period.ns // 2
    if not (signed or (lowest >= 0 and highest < period.ns)):
        return none
    ahead = steps + period.ns
    clean = (ahead >= LIMITS.wrap_nearest * step) & (ahead <= LIMITS.wrap_farthest * step)
    if period.own and not signed:
        # A clock that was set back begins at zero; a counter that wrapped in a pause does not.
        clean |= (ahead > 0) & (ahead <= LIMITS.wrap_pause * period.ns) & (counts[1:] >= step)
    return clean & (steps < 0) & (step < LIMITS.wrap_pause * period.ns)


def _placed(share: FileShare, period: _Period, centre: int) -> np.ndarray:
    """Counts (rows,) within half a period of the middle of all."""
    offset = centre - period.ns // 2
    return offset + (share.stamps.ns - share.stamps.zero_ns - offset) % period.ns


def _unwrapped(share: FileShare, period: _Period, centre: int) -> np.ndarray:
    """Counts (rows,) that go on from row to row, lined up with the middle of all."""
    present = ~share.stamps.missing
    counts = share.stamps.ns - share.stamps.zero_ns
    ahead = np.unwrap(counts[present], period=period.ns).astype(np.int64)
    steps = np.diff(ahead)
    if len(steps) and np.abs(steps).max() > LIMITS.wrap_pause * period.ns:
        row = int(np.flatnonzero(present)[int(np.argmax(np.abs(steps))) + 1])
        what = f"the counter wraps every {period.name} ({period.ns / SECOND:.6g} s): how often it "
        what += "did in the pause before this row cannot be told"
        advice = "export a counter with more bits, or a date, or the parts between the pauses "
        advice += 'as files of their own with epoch = "file"'
        raise CampaignError(what, where=share.place(row), advice=advice)
    middle = (int(ahead[0]) + int(ahead[-1])) // 2
    counts[present] = ahead + round((centre - middle) / period.ns) * period.ns
    return counts


def _with_counts(share: FileShare, counts: np.ndarray, period: _Period) -> FileShare:
    """A share with other counts, and a note that says where they were changed."""
    added = (counts - (share.stamps.ns - share.stamps.zero_ns))[~share.stamps.missing]
    rows = np.flatnonzero(~share.stamps.missing)[1:][np.diff(added) > 0]
    if not added.any():
        return share
    places = ", ".join(share.place(int(row)) for row in rows[:3])
    more = f" and {len(rows) - 3} more" if len(rows) > 3 else ""
    note = f"{share.file}: counted on, as the counter had wrapped at {period.name}"
    if len(rows):
        note = f"the counter wrapped at {period.name} ({places}{more}) and is counted on"
    ns = np.where(share.stamps.missing, 0, counts + share.stamps.zero_ns)
    return replace(share, stamps=replace(share.stamps, ns=ns), notes=(*share.notes, note))


@array_dataclass
class Logs:
    """All that was logged, on one clock."""

    streams: dict[str, LoggedStream]  # By what they hold; times in seconds since `epoch_ns`
    epoch_ns: int  # Zero of the clock: nanoseconds of TAI since 1958 where `absolute`
    absolute: bool  # Whether the zero is a known date
    unused: tuple[str, ...] = ()  # Files that no stream names


def on_one_clock(
    shares: Sequence[FileShare], mapping: MappingPart, label: str, unused: Sequence[str] = ()
) -> Logs:
    """Streams on a clock that starts with the first reading."""
    shares = counted_on(shares)
    of_files = [share.stream.time.epoch == ZERO_OF_FILE for share in shares]
    absolute = [share.stamps.absolute for share in shares]
    if len(set(absolute)) > 1 or len(set(of_files)) > 1:
        raise _different_clocks(shares, label)
    starts = _starts_of_files(shares, mapping, label) if of_files[0] else {}
    # The true time of the first reading of each.
    firsts = [s.stamps.first_ns + round(s.stream.offset_s * SECOND) for s in shares]
    epoch_ns = 0 if of_files[0] else min(firsts)
    streams: dict[str, LoggedStream] = {}
    for holds in dict.fromkeys(share.stream.holds for share in shares):
        own = [share for share in shares if share.stream.holds == holds]
        logged = [_logged(share, starts.get(id(share), epoch_ns)) for share in own]
        if holds == "rate":
            _refuse_second_session(logged)
        stream = in_order(joined(logged))
        streams[holds] = held(stream) if holds == "wheel_torque" else stream
    return Logs(relative_to_body(streams, mapping), epoch_ns, absolute[0], tuple(unused))


def _refuse_second_session(files: Sequence[LoggedStream]) -> None:
    """Refuse files of one gyro that overlap with other readings: their clocks start anew."""
    ordered = sorted((file for file in files if len(file.time)), key=lambda file: file.time[0])
    for before, after in pairwise(ordered):
        late = after.time <= before.time[-1]
        time = np.concatenate([before.time, after.time[late]])
        row = set_back_row(time, np.concatenate([before.values, after.values[late]]))
        late_s = before.time[-1] - after.time[0]
        what = f"the times overlap with those of {before.files[0]}, which ends {late_s:.6g} s "
        what += "after this file begins"
        advice = 'write epoch = "file" for every stream if each file starts its own clock; '
        advice += "else name the files of one gyro only, or correct the kind of their clocks"
        require(row is None, after.files[0], what, advice)


def _different_clocks(shares: Sequence[FileShare], label: str) -> CampaignError:
    kinds = {
        share.stream.holds: "a known date"
        if share.stamps.absolute
        else f"a zero called {share.stream.time.epoch!r}"
        for share in shares
    }
    odd = next(share for share in shares if not share.stamps.absolute)
    listed = "; ".join(f"{holds}: {kind}" for holds, kind in kinds.items())
    what = f"the clocks cannot be brought together ({listed})"
    where = f"{label}, key streams.{odd.stream.holds}.time.epoch"
    advice = "write the UTC date at which this clock was zero"
    return CampaignError(what, where=where, advice=advice)


def _starts_of_files(
    shares: Sequence[FileShare], mapping: MappingPart, label: str
) -> dict[int, int]:
    """For each share the stamp [ns] that becomes zero: k-th files of all streams go together."""
    pause = mapping.cut.between_files_s
    if pause is None:
        where = f"{label}, key cut.between_files_s"
        advice = "add the seconds that passed between the end of one file and the start of the "
        advice += f'next, as each file has a clock of its own (epoch = "{ZERO_OF_FILE}")'
        raise CampaignError("missing key", where=where, advice=advice)
    by_stream = _streams(shares)
    alike = len({len(of_stream) for of_stream in by_stream}) == 1
    counts = ", ".join(f"{v[0].stream.holds}: {len(v)}" for v in by_stream)
    what = f"streams have different numbers of files ({counts})"
    advice = "with a clock in each file, every stream needs one file a slew"
    require(alike, f"{label}, key streams", what, advice)
    starts, cursor = {}, 0
    for together in zip(*by_stream, strict=True):
        first = min(share.stamps.first_ns for share in together)
        starts.update({id(share): first - cursor for share in together})
        cursor += max(int(share.stamps.ns.max()) for share in together) - first
        cursor += round(pause * SECOND)
    return starts


def _logged(share: FileShare, epoch_ns: int) -> LoggedStream:
    """The readings of a file in the order of their times."""
    time = share.stamps.seconds_since(epoch_ns)
    time = time + share.stream.offset_s if share.stream.offset_s else time
    full = np.isfinite(share.values).any(axis=1)
    keep = np.flatnonzero(np.isfinite(time) & full)
    notes = list(share.notes)
    lost = np.flatnonzero(share.stamps.missing & full)
    if len(lost):
        where, why = share.place(int(lost[0])), "hold readings without a time"
        advice = "name the column that has a time in every row, or remove the rows"
        notes.append(left_out(len(lost), int(full.sum()), why, where=where, advice=advice))
    holds, file = share.stream.holds, np.zeros(len(keep), dtype=int)
    readings = time[keep], share.values[keep], file
    stream = LoggedStream(holds, *readings, (share.file,), tuple(notes), share.rounding)
    return in_order(stream, lambda row: share.place(int(keep[row])))


def relative_to_body(
    streams: dict[str, LoggedStream], mapping: MappingPart
) -> dict[str, LoggedStream]:
    """Streams in which wheel momenta and speeds are relative to the body.

    The speed of a wheel in inertial space is that relative to the body plus g.w; its momentum Js
    times that. The rates come between their own readings on straight lines: this is a small term of
    a reading, not a reading.
    """
    result = dict(streams)
    for holds in ("wheel_momentum", "wheel_speed"):
        # Wheels whose readings hold the body's turning.
        inertial = {
            name
            for stream in streams_that_hold(mapping, holds)
            if getattr(stream, "relative_to", "") == "inertial"
            for name in mapping.wheels_of(stream)
        }
        if not inertial:
            continue
        stream, rate = streams[holds], streams["rate"]
        axes_read = [(axis, np.isfinite(axis)) for axis in rate.values.T]
        between = [np.interp(stream.time, rate.time[given], x[given]) for x, given in axes_read]
        sensor = mapping.rate_sensor
        K, bias = sensor.scale_factor or 1.0, sensor.bias or 0.0
        rate_S = np.stack(between, axis=1) * np.array(K) - np.array(bias)
        rate_B = rate_S @ np.linalg.inv(np.array(rate_sensor_axes(mapping))).T
        axes = np.array([wheel.axis for wheel in mapping.wheels])
        inertias = np.array([wheel.spin_inertia for wheel in mapping.wheels])
        taken = np.array([float(name in inertial) for name in mapping.wheels_of()])
        size = taken * (inertias if holds == "wheel_momentum" else 1.0)
        turning = rate_B @ axes.T * size
        largest = float(np.abs(turning).max())
        unit = "N m s" if holds == "wheel_momentum" else "rad/s"
        note = f"the body's turning was taken out, at most {largest:.2g} {unit}"
        result[holds] = replace(stream, values=stream.values - turning, notes=(*stream.notes, note))
    return result
