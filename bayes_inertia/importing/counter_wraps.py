"""Counters that begin anew at 2^16, 2^32, ... counts: they are counted on, in all streams alike.

A clock that goes back is either a counter that wrapped or a clock that was set back. A wrap leaves
the step between two rows as it is, once the period is added; that decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from bayes_inertia.errors import CampaignError
from bayes_inertia.importing.file_share import ZERO_OF_FILE, FileShare
from bayes_inertia.tables.leap_seconds import SECOND
from bayes_inertia.tables.stamp_parts import unit_size
from bayes_inertia.tables.time_stamps import FREE_CLOCKS

_BITS = (16, 24, 31, 32)
# Counts of these are scaled to other units by ground software; also the unit of the file itself.
_UNITS = ("s", "100 ms", "10 ms", "ms", "100 us", "10 us", "us")
_DAYS = {"86400 s": 86400 * SECOND, "604800 s": 604800 * SECOND}  # Seconds of the day, of the week.
# Across a wrap rows follow each other within this many steps: one may be lost, stamps jitter.
_NEAREST, _FARTHEST = 0.2, 2.5
# A pause longer than this share of the period may hide a whole one; a wrap in it needs a long one.
_PAUSE = 0.1
_LONG_BITS = 24


@dataclass(frozen=True)
class _Period:
    """After how much a counter begins anew: in words, and in nanoseconds."""

    name: str
    ns: int
    own: bool
    """Whether it is of counts of the file itself, of many bits: then a pause may hold the wrap."""


def counted_on(shares: Sequence[FileShare]) -> list[FileShare]:
    """Shares whose counters do not begin anew.

    Returns: the same, with a note where a counter wrapped.
    """
    result = list(shares)
    for group in _groups(shares):
        found = next((w for w in (_wrap(of_stream) for of_stream in _streams(group)) if w), None)
        if found is None:
            continue
        period, centre, span = found
        for share in group:
            place = _placed if 1.25 * span < period.ns else _unwrapped
            result[_index(shares, share)] = place(share, period, centre)
    return result


def _index(shares: Sequence[FileShare], share: FileShare) -> int:
    return next(k for k, other in enumerate(shares) if other is share)


def _groups(shares: Sequence[FileShare]) -> list[list[FileShare]]:
    """Shares whose stamps come from one counter."""
    groups: dict[tuple, list[FileShare]] = {}
    of_stream: dict[int, int] = {}
    for share in shares:
        time = share.stream.time
        k = of_stream[id(share.stream)] = of_stream.get(id(share.stream), -1) + 1
        if time.kind in FREE_CLOCKS or not (time.kind or share.stamps.absolute):
            key = (time.epoch, k if time.epoch == ZERO_OF_FILE else 0)
            groups.setdefault(key, []).append(share)
    return list(groups.values())


def _streams(group: Sequence[FileShare]) -> list[list[FileShare]]:
    """The files of each stream, that with the most rows first."""
    streams: dict[int, list[FileShare]] = {}
    for share in group:
        streams.setdefault(id(share.stream), []).append(share)
    return sorted(streams.values(), key=lambda files: -sum(len(f.values) for f in files))


def _wrap(files: Sequence[FileShare]) -> tuple[_Period, int, int] | None:
    """The period of a counter that wraps in a stream, the middle of its times and their span."""
    counts = np.concatenate([share.counts for share in files])
    steps = np.diff(counts)
    forward = steps[steps > 0]
    if not len(forward) or not np.any(steps < 0):
        return None
    step = float(np.median(forward))
    best: tuple[float, _Period, np.ndarray] | None = None
    for period in _periods(files[0]):
        wraps = _clean_wraps(counts, steps, step, period)
        if wraps.any():
            off = float(np.abs(steps[wraps] + period.ns - step).min())
            best = min(best or (np.inf, period, wraps), (off, period, wraps), key=lambda b: b[0])
    if best is None:
        return None
    _, period, wraps = best
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
        for bits in _BITS:
            ns = int(size * 2**bits)
            name = f"2^{bits} {unit}" if unit.isalpha() else f"2^{bits} counts of {unit}"
            periods.append(_Period(name, ns, whole and bits >= _LONG_BITS))
    return [period for period in periods if period.ns < 2**61]  # Sums stay within 64 bits.


def _clean_wraps(counts: np.ndarray, steps: np.ndarray, step: float, period: _Period) -> np.ndarray:
    """Which steps (rows - 1,) are those of a running clock once the period is added."""
    none = np.zeros(len(steps), dtype=bool)
    lowest, highest = int(counts.min()), int(counts.max())
    signed = -period.ns // 2 <= lowest < 0 and highest < period.ns // 2
    if not (signed or (lowest >= 0 and highest < period.ns)):
        return none
    ahead = steps + period.ns
    clean = (ahead >= _NEAREST * step) & (ahead <= _FARTHEST * step)
    if period.own and not signed:
        # A clock that was set back begins at zero; a counter that wrapped in a pause does not.
        clean |= (ahead > 0) & (ahead <= _PAUSE * period.ns) & (counts[1:] >= step)
    return clean & (steps < 0) & (step < _PAUSE * period.ns)


def _placed(share: FileShare, period: _Period, centre: int) -> FileShare:
    """A share whose stamps lie within half a period of the middle of all."""
    offset = centre - period.ns // 2
    counts = offset + (share.stamps.ns - share.stamps.zero_ns - offset) % period.ns
    return _with_counts(share, counts, period)


def _unwrapped(share: FileShare, period: _Period, centre: int) -> FileShare:
    """A share whose stamps go on from row to row, lined up with the middle of all."""
    present = ~share.stamps.missing
    counts = share.stamps.ns - share.stamps.zero_ns
    ahead = np.unwrap(counts[present], period=period.ns).astype(np.int64)
    steps = np.diff(ahead)
    if len(steps) and np.abs(steps).max() > _PAUSE * period.ns:
        row = int(np.flatnonzero(present)[int(np.argmax(np.abs(steps))) + 1])
        raise CampaignError(
            f"the counter wraps every {period.name} ({period.ns / SECOND:.6g} s): how often it "
            "did in the pause before this row cannot be told",
            where=share.place(row),
            advice="export a counter with more bits, or a date, or the parts between the pauses "
            'as files of their own with epoch = "file"',
        )
    middle = (int(ahead[0]) + int(ahead[-1])) // 2
    turns = round((centre - middle) / period.ns)
    result = counts.copy()
    result[present] = ahead + turns * period.ns
    return _with_counts(share, result, period)


def _with_counts(share: FileShare, counts: np.ndarray, period: _Period) -> FileShare:
    """A share with other counts, and a note that says where they were changed."""
    added = (counts - (share.stamps.ns - share.stamps.zero_ns))[~share.stamps.missing]
    rows = np.flatnonzero(~share.stamps.missing)[1:][np.diff(added) > 0]
    if not added.any():
        return share
    places = ", ".join(share.place(int(row)) for row in rows[:3])
    more = f" and {len(rows) - 3} more" if len(rows) > 3 else ""
    note = (
        f"the counter wrapped at {period.name} ({places}{more}) and is counted on"
        if len(rows)
        else f"{share.file}: counted on, as the counter had wrapped at {period.name}"
    )
    ns = np.where(share.stamps.missing, 0, counts + share.stamps.zero_ns)
    return replace(share, stamps=replace(share.stamps, ns=ns), notes=(*share.notes, note))
