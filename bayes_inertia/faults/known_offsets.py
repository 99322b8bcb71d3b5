"""Known offsets between clocks, by which a stream beside its slews finds back."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from bayes_inertia.faults.limits import LIMITS

KNOWN_OFFSETS: Mapping[float, str] = {
    18.0: "GPS time is ahead of UTC",
    37.0: "TAI is ahead of UTC",
    19.0: "TAI is ahead of GPS time",
    32.184: "TT is ahead of TAI",
    51.184: "TT is ahead of GPS time",
    69.184: "TT is ahead of UTC",
    64.184: "TT was ahead of UTC until 2005",
}
"""What clocks of different scales differ by [s], the most common first, and why."""


def known_offset(
    readings: Sequence[tuple[np.ndarray, Sequence[tuple[float, float]]]],
    offsets: Iterable[tuple[float, str]] | None = None,
) -> tuple[float, str, int] | None:
    """The known offset [s] that puts readings beside slews which they all miss, why, and how many.

    `readings`: for each clock the times of the readings, and the spans of its slews [s]; `offsets`:
    to try, None for `likely_offsets` of both signs.

    >>> known_offset([(np.array([3605.0, 3690.0]), [(0.0, 99.0)])])
    (-3600.0, '1 h, as of a time zone', 2)
    """
    best, most = None, LIMITS.meant_offset_share * sum(len(times) for times, _ in readings)
    likely = ((sign * size, why) for size, why in likely_offsets() for sign in (-1.0, 1.0))
    for seconds, why in likely if offsets is None else offsets:
        # Several scales may do, of which the best is meant; zones come after them.
        if best is not None and abs(seconds) not in (*KNOWN_OFFSETS, abs(best[0])):
            break
        moved = [(times + seconds, spans) for times, spans in readings]
        inside = sum(int(((t >= a) & (t <= b)).sum()) for t, spans in moved for a, b in spans)
        if inside > most:
            best, most = (seconds, why, inside), inside
    return best


def likely_offsets() -> Iterator[tuple[float, str]]:
    """Known offsets of clocks [s], the most common first: scales, time zones, and both."""
    yield from KNOWN_OFFSETS.items()
    hours = range(LIMITS.largest_time_zone_h + 1)
    zones = [part + k for part in LIMITS.parts_of_hour for k in hours if part + k]
    yield from ((LIMITS.hour * zone, f"{zone:g} h, as of a time zone") for zone in zones)
    for zone in zones:
        for small, of in KNOWN_OFFSETS.items():
            yield LIMITS.hour * zone - small, f"{zone:g} h, and {of}"
            yield LIMITS.hour * zone + small, f"{zone:g} h, and {of}"
