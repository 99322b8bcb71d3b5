"""Dates and times as text: ISO 8601, and the day-of-year form of CCSDS 301.0-B-4."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Sequence
from datetime import date

import numpy as np

from bayes_inertia.errors import CampaignError
from bayes_inertia.importing.leap_seconds import SECOND, has_leap_second
from bayes_inertia.importing.raw_table import EMPTY_CELLS

_FORM = re.compile(
    r"(?P<year>\d{4})[-/](?:(?P<doy>\d{3})|(?P<month>\d{1,2})[-/](?P<day>\d{1,2}))"
    r"(?:[T ]+|(?<=\d)-)(?P<hour>\d{1,2}):(?P<minute>\d{2})"
    r"(?::(?P<second>\d{2})(?:[.,](?P<part>\d+))?)?"
    r"\s*(?P<zone>Z|z|UTC|[+-]\d{2}:?\d{2})?"
)
_PLAIN = re.compile(r"\d{4}-\d{2}-\d{2}[T ]\d{2}:\d{2}:\d{2}(\.\d{1,9})?Z?")
_FIRST_DAY = date(1958, 1, 1).toordinal()
_YEARS = (1958, 2199)  # Nanoseconds of other years may not fit 64 bits.
_ADVICE = (
    "write times as 2024-05-01T12:34:56.789, with Z or an offset such as +01:00 where it is UTC, "
    "or by day of year, 2024-122T12:34:56.789"
)


def text_to_ns(cell: str, *, utc: bool, place: Callable[[], str]) -> tuple[int, bool] | None:
    """Nanoseconds since 1958 of a date, a day counted as 86400 s.

    Parameters
    ----------
    cell : str
        The text.
    utc : bool
        Whether the clock is UTC: only there are zones and leap seconds.
    place : callable
        Gives where the cell is, for messages.

    Returns
    -------
    tuple of int and bool, or None
        Nanoseconds, and whether the second is a leap second, 23:59:60, which is then given as
        23:59:59; None for an empty cell.

    Raises
    ------
    CampaignError
        If the cell is no time.

    Examples
    --------
    >>> text_to_ns("2016-12-31T23:59:60.5Z", utc=True, place=str)
    (1861919999500000000, True)
    """
    text = cell.strip().strip("\"'")
    if text.lower() in EMPTY_CELLS or text == "NaT":
        return None
    match = _FORM.fullmatch(text)
    if match is None:
        shown = text if len(text) <= 40 else text[:37] + "..."
        raise CampaignError(f"{shown!r} is not a date and time", where=place(), advice=_ADVICE)
    try:
        day = _day_number(match)
    except ValueError as error:
        raise CampaignError(
            f"{text!r} is no day of the calendar", where=place(), advice=_ADVICE
        ) from error
    hour, minute = int(match["hour"]), int(match["minute"])
    second = int(match["second"] or 0)
    leap = second == 60
    seconds = day * 86400 + hour * 3600 + minute * 60 + (59 if leap else second)
    seconds -= _zone_seconds(match["zone"] or "", utc, text, place)
    within = hour < 24 and minute < 60 and second <= 60
    if not within or (leap and not (utc and _is_leap(seconds))):
        raise CampaignError(
            f"{text!r} is no time of the day"
            + (": that day has no leap second" if leap and utc and within else ""),
            where=place(),
            advice=_ADVICE,
        )
    digits = (match["part"] or "")[:9].ljust(9, "0")
    return seconds * SECOND + int(digits), leap


def plain_dates(cells: Sequence[str]) -> np.ndarray | None:
    """Nanoseconds since 1958 of dates that are all written alike, at once.

    Parameters
    ----------
    cells : sequence of str
        The texts.

    Returns
    -------
    (rows,) array of int, or None
        None where one is empty, by day of year, a leap second, with an offset, or damaged:
        `text_to_ns` then reads each by itself.

    Examples
    --------
    >>> plain_dates(["1958-01-01T00:00:01Z", "1958-01-01T00:00:02Z"]) // SECOND
    array([1, 2])
    """
    if not cells or not _PLAIN.fullmatch(cells[0]):
        return None
    size, zone = len(cells[0]), cells[0].endswith("Z")
    if any(len(cell) != size or cell.endswith("Z") != zone for cell in cells):
        return None
    try:
        with warnings.catch_warnings():
            # numpy only warns of what it takes for an offset, and then drops it.
            warnings.simplefilter("error")
            stamps = np.array([cell.rstrip("Z") for cell in cells], dtype="datetime64[ns]")
    except (ValueError, UserWarning):
        return None
    first, last = (np.datetime64(f"{year}-01-01", "ns") for year in (_YEARS[0], _YEARS[1]))
    if np.isnat(stamps).any() or stamps.min() < first or stamps.max() > last:
        return None
    return (stamps - first).astype(np.int64)


def _day_number(match: re.Match[str]) -> int:
    """Days since 1958-01-01."""
    year = int(match["year"])
    if not _YEARS[0] <= year <= _YEARS[1]:
        raise ValueError("no year of space flight")
    if match["doy"]:
        count = int(match["doy"])
        last = date(year, 12, 31).timetuple().tm_yday
        if not 1 <= count <= last:
            raise ValueError("no such day")
        return date(year, 1, 1).toordinal() + count - 1 - _FIRST_DAY
    return date(year, int(match["month"]), int(match["day"])).toordinal() - _FIRST_DAY


def _zone_seconds(zone: str, utc: bool, text: str, place: Callable[[], str]) -> int:
    if not zone:
        return 0
    if not utc:
        raise CampaignError(
            f"{text!r} has the zone {zone!r}, but its clock is not UTC",
            where=place(),
            advice='state the kind of time "utc"',
        )
    if zone in ("Z", "z", "UTC"):
        return 0
    digits = zone[1:].replace(":", "")
    size = int(digits[:2]) * 3600 + int(digits[2:]) * 60
    return size if zone[0] == "+" else -size


def _is_leap(seconds: int) -> bool:
    """Whether the second before a leap second is that of a UTC day that has one."""
    return seconds % 86400 == 86399 and has_leap_second((seconds + 1) * SECOND)
