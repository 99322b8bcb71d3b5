"""Dates and times as text: ISO 8601, day of year (CCSDS 301.0-B-4), and names of months.

GMAT, STK, MATLAB and SPICE write names of months. Any other form is described by a `format` of
the directives of `strptime`: `form_of_format` turns it into the pattern that `text_to_ns` reads.
"""

from __future__ import annotations

import re
import warnings
from calendar import isleap
from collections.abc import Callable, Mapping, Sequence
from datetime import date
from functools import cache

import numpy as np

from bayes_inertia.errors import CampaignError, require
from bayes_inertia.files import vocabulary
from bayes_inertia.tables.limits import LIMITS
from bayes_inertia.tables.stamp_parts import SECOND, has_leap_second, unit_in_name
from bayes_inertia.tables.table import Column, Table, is_empty, shortened

_CLOCK = (
    r"(?:[T ,]+|(?<=\d)-|\s*//\s*)(?P<hour>\d{1,2}):(?P<minute>\d{2})"
    r"(?::(?P<second>\d{2})(?:[.,](?P<part>\d+))?)?"
    r"\s*(?P<zone>Z|z|[A-Z]{2,4}|[+-]\d{2}:?\d{2})?"
)
_FORMS = tuple(
    re.compile(day + _CLOCK)
    for day in (
        r"(?P<year>\d{4})[-/](?:(?P<doy>\d{3})|(?P<month>\d{1,2})[-/](?P<day>\d{1,2}))",
        r"(?P<day>\d{1,2})[-/. ]+(?P<month>[A-Za-z]{3,9})[-/., ]+(?P<year>\d{4})",
        r"(?P<year>\d{4})[-/ ]+(?P<month>[A-Za-z]{3,9})[-/. ]+(?P<day>\d{1,2})",
        r"(?P<month>[A-Za-z]{3,9})[-/. ]+(?P<day>\d{1,2})[-/, ]+(?P<year>\d{4})",
    )
)
_MONTHS = vocabulary("tables")["months"]["names"].split()
# What each directive of a `format` stands for.
_DIRECTIVES: Mapping[str, str] = vocabulary("tables")["directives"]
_CALENDAR = ("year", "month", "day", "doy")
_FIRST_DAY = date(LIMITS.years[0], 1, 1).toordinal()  # From which all times count.
_PLAIN = re.compile(r"\d{4}-\d{2}-\d{2}[T ]\d{2}:\d{2}:\d{2}(\.\d{1,9})?Z?")
_ADVICE = (
    "write times as 2024-05-01T12:34:56.789, with Z or an offset such as +01:00 where it is UTC, "
    "by day of year, 2024-122T12:34:56.789, or as 01 May 2024 12:34:56.789; or add their form to "
    'the mapping, such as time = { ..., format = "%m/%d/%Y %H:%M:%S.%f" }; '
    'times of the day alone are of the kind "s", with their midnight as epoch'
)


def form_of_format(text: str, where: str) -> re.Pattern[str]:
    """The pattern of dates that a `format` of directives of `strptime` describes, for `text_to_ns`.

    >>> form = form_of_format("%d.%m.%Y %H:%M", "m.toml")
    >>> text_to_ns("02.01.1958 00:01", utc=True, place=str, form=form)
    (86460000000000, False)
    """
    parts = re.split(r"%(.)", text)
    written = [re.sub(r"(\\ )+", r"\\s+", re.escape(literal)) for literal in parts[::2]]
    advice = "write " + ", ".join(f"%{key}" for key in _DIRECTIVES)
    for directive in parts[1::2]:
        what = f"the directive %{directive} is unknown"
        require(directive in _DIRECTIVES, where, what, advice)
    # Digits that follow each other without a sign between are two for each.
    tight = [k for k in range(1, len(written) - 1) if not written[k]]
    tight += [k - 1 for k in tight]
    read = [
        _DIRECTIVES[directive].replace("{1,2}", "{2}" if k in tight else "{1,2}")
        for k, directive in enumerate(parts[1::2])
    ]
    pattern = "".join(a + b for a, b in zip(written, [*read, ""], strict=True))
    # A whole second may be written without its fraction.
    pattern = re.sub(r"(\\\.|,)(\(\?P<part>\\d\+\))", r"(?:\1\2)?", pattern)
    groups = re.findall(r"\(\?P<(\w+)>", pattern)
    day = {"year", "doy"} <= set(groups) or {"year", "month", "day"} <= set(groups)
    what = f"{text!r} gives " + ("no day" if not day else "something twice")
    advice = 'write year, month and day, or year and day of year (%j), such as "%Y-%j"'
    require(day and len(set(groups)) == len(groups), where, what, advice)
    return re.compile(pattern)


def text_to_ns(
    cell: str, *, utc: bool, place: Callable[[], str], form: re.Pattern[str] | None = None
) -> tuple[int, bool] | None:
    """Nanoseconds since 1958 of a date, and whether it is a leap second; None for an empty cell.

    A day has 86400 s, and 23:59:60 is given as 23:59:59. Only a clock in UTC has zones and leap
    seconds.

    >>> text_to_ns("2016-12-31T23:59:60.5Z", utc=True, place=str)
    (1861919999500000000, True)
    """
    text = cell.strip().strip("\"'")
    if is_empty(text) or text == "NaT":
        return None
    matches = (pattern.fullmatch(text) for pattern in ((form,) if form else _FORMS))
    match = next((match for match in matches if match), None)
    if match is None:
        what = f"is not written as {form.pattern!r}" if form else "is not a date and time"
        raise CampaignError(f"{shortened(text)!r} {what}", where=place(), advice=_ADVICE)
    given = {key: value for key, value in match.groupdict().items() if value}
    try:
        day = _day_number(given)
    except ValueError as error:
        what = f"{text!r} is no day of the calendar"
        raise CampaignError(what, where=place(), advice=_ADVICE) from error
    hour, minute, second = (int(given.get(key, 0)) for key in ("hour", "minute", "second"))
    if "half" in given:
        hour = hour % 12 + 12 * (given["half"] in "Pp") if 1 <= hour <= 12 else 24
    leap = second == 60
    seconds = day * 86400 + hour * 3600 + minute * 60 + (59 if leap else second)
    seconds -= _zone_seconds(given.get("zone", ""), utc, text, place)
    within = hour < 24 and minute < 60 and second <= 60
    # The second before a leap second is the last of a UTC day that has one.
    last = seconds % 86400 == 86399 and has_leap_second((seconds + 1) * SECOND)
    if not within or (leap and not (utc and last)):
        why = ": that day has no leap second" if leap and utc and within else ""
        what = f"{text!r} is no time of the day{why}"
        raise CampaignError(what, where=place(), advice=_ADVICE)
    return seconds * SECOND + int(given.get("part", "")[:9].ljust(9, "0")), leap


def is_date(cell: str) -> bool:
    """Whether a cell holds a date, with or without time of day, that needs no `format`.

    >>> [is_date(cell) for cell in ("1 Mar 2026 12:00", "2026-03-01", "01/03/2026 12:00", "5 Nms")]
    [True, True, False, False]
    """
    text = cell.strip()
    return any(form.fullmatch(text) or form.fullmatch(f"{text} 00:00") for form in _FORMS)


def plain_dates(cells: Sequence[str]) -> np.ndarray | None:
    """Nanoseconds since 1958 (rows,) of dates that are all written alike; None where not."""
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
    first, last = (np.datetime64(f"{year}-01-01", "ns") for year in LIMITS.years)
    if np.isnat(stamps).any() or stamps.min() < first or stamps.max() > last:
        return None
    return (stamps - first).astype(np.int64)


def _day_number(given: Mapping[str, str]) -> int:
    """Days since 1958-01-01."""
    year = int(given["year"])
    if len(given["year"]) == 2:  # As strptime reads them.
        year += 1900 if year >= 69 else 2000
    if not LIMITS.years[0] <= year <= LIMITS.years[1]:
        raise ValueError("no year of space flight")
    if "doy" in given:
        count = int(given["doy"])
        if not 1 <= count <= 365 + isleap(year):
            raise ValueError("no such day")
        return date(year, 1, 1).toordinal() + count - 1 - _FIRST_DAY
    return date(year, _month(given["month"]), int(given["day"])).toordinal() - _FIRST_DAY


@cache
def _month(text: str) -> int:
    """The number of a month that is given by number or by name, such as "3", "MAR" or "Sept"."""
    if text.isdigit():
        return int(text)
    named = [k for k, name in enumerate(_MONTHS, 1) if name.startswith(text.lower())]
    if not named:
        raise ValueError("no such month")
    return named[0]


def _zone_seconds(zone: str, utc: bool, text: str, place: Callable[[], str]) -> int:
    if not zone:
        return 0
    # A log has a million stamps: nothing is said of those that are right.
    if not utc:
        what = f"{text!r} has the zone {zone!r}, but its clock is not UTC"
        raise CampaignError(what, where=place(), advice='state the kind of time "utc"')
    if zone in ("Z", "z", "UTC", "UTCG", "GMT"):
        return 0
    if zone.isalpha():
        what = f"{text!r} has the zone {zone!r}, which is not read"
        raise CampaignError(what, where=place(), advice="write UTC, or an offset such as +01:00")
    digits = zone[1:].replace(":", "")
    size = int(digits[:2]) * 3600 + int(digits[2:]) * 60
    return size if zone[0] == "+" else -size


def written_dates(
    table: Table, names: Sequence[str], units: Sequence[str], form: str = ""
) -> tuple[list[str], list[str]]:
    """The date that columns hold together, one a row, and columns of hours and less to add."""
    columns = [table.column(name) for name in names]
    if form:
        pieces = form.split() if len(form.split()) == len(names) else [""] * len(names)
        return _joined([_texts(c, p) for c, p in zip(columns, pieces, strict=True)]), []
    said = dict(zip(names, units or [unit_in_name(name) for name in names], strict=True))
    counted = [n for n in names if not table.column(n).is_text and said[n] not in _CALENDAR]
    calendar = {said[n]: n for n in names if not table.column(n).is_text and n not in counted}
    parts = [_texts(table.column(n)) for n in names if table.column(n).is_text]
    if calendar:
        parts.insert(0, _calendar_dates(table, calendar))
    cells = _joined(parts) if parts else [""] * table.rows
    if not any(":" in cell for cell in cells[:1]):
        cells = [f"{cell} 00:00:00" if cell else "" for cell in cells]
    return cells, counted


def _texts(column: Column, form: str = "") -> list[str]:
    """Cells as the file writes them, "" for an empty one; `form` says what zeros a number lost."""
    if column.is_text or column.exact is not None:
        return column.texts
    digits = form.removesuffix("%f").rstrip(".,")
    only = re.fullmatch("(%[YymdjHIMS])+", digits)
    width = sum({"Y": 4, "j": 3}.get(key, 2) for key in digits[1::2]) if only else 0
    texts = (
        "" if value != value else np.format_float_positional(value, trim="-")
        for value in column.values.astype(float).tolist()
    )
    wholes = (text.partition(".") for text in texts)
    return [f"{whole.zfill(width) if whole else ''}{dot}{rest}" for whole, dot, rest in wholes]


def _joined(parts: Sequence[Sequence[str]]) -> list[str]:
    """One text a row; "" where a part is empty."""
    return [" ".join(cells) if all(cells) else "" for cells in zip(*parts, strict=True)]


def _calendar_dates(table: Table, calendar: Mapping[str, str]) -> list[str]:
    """Dates (rows) from columns of year, month and day, or year and day of year."""
    # Beside a year alone, "day" is that of the year.
    keys = ("year", "month", "day") if "month" in calendar else ("year", "doy")
    columns = [calendar.get(key) or calendar.get("day" if key == "doy" else key) for key in keys]
    what = f"{', '.join(calendar.values())} give no date"
    advice = "name the columns of year, month and day, or of year and day of year"
    require(None not in columns, table.label, what, advice)
    numbers = table.stack([name for name in columns if name])
    form = "{:.0f}-{:02.0f}-{:02.0f}" if len(keys) == 3 else "{:.0f}-{:03.0f}"
    return ["" if any(cell != cell for cell in row) else form.format(*row) for row in numbers]
