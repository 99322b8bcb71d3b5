"""Stamps in several columns, and leap seconds.

ROS 2 writes seconds and nanoseconds; CCSDS unsegmented codes (CUC) seconds and a binary fraction,
segmented ones (CDS) days, milliseconds and microseconds; loggers a date and a time of the day.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from decimal import Decimal, InvalidOperation
from fractions import Fraction
from functools import cache

import numpy as np

from bayes_inertia.errors import CampaignError
from bayes_inertia.files import by_word, vocabulary
from bayes_inertia.tables.table import Column, Table

SECOND = 10**9


@dataclass(frozen=True)
class TimeScales:
    """Zeros of clocks, and what scales are apart; in ns since 1958-01-01 of TAI but for days."""

    day: int = 86400 * SECOND
    mjd_1958: int = 36204  # [day]
    jd_1958: float = 2436204.5  # [day]
    tai_1970: int = 4383 * day
    gps_1980: int = 8040 * day + 19 * SECOND
    tt_minus_tai: int = 32_184_000_000
    first: int = 5113 * day  # 1972-01-01: before, UTC had no whole leap seconds.
    last: int = 51865 * day  # 2100-01-01


SCALES = TimeScales()


@cache
def leap_table() -> tuple[np.ndarray, np.ndarray]:
    """UTC [ns since 1958] at each change of TAI - UTC, (changes,), and that [ns] between, of ERFA.

    Before the first change and after the last too: (changes + 1,).
    """
    import erfa

    # Before 1972 UTC had no whole leap seconds.
    table = [row for row in erfa.leap_seconds.get().tolist() if row[0] >= 1972]
    starts = [date(year, month, 1) - date(1958, 1, 1) for year, month, _ in table]
    days = np.array([start.days for start in starts], np.int64)
    return days * SCALES.day, np.array([0, *(row[2] for row in table)], np.int64) * SECOND


def utc_to_tai(utc_ns: np.ndarray) -> np.ndarray:
    """TAI of UTC from 1972 on, (rows,) array of ns since 1958 each; a day of UTC has 86400 s.

    >>> new_year = np.array([21550 * 86400 * SECOND])  # 2017-01-01
    >>> ((utc_to_tai(new_year) - utc_to_tai(new_year - 1)) / SECOND).round(6).tolist()
    [1.0]
    """
    start, offset = leap_table()
    return utc_ns + offset[np.searchsorted(start, utc_ns, side="right")]


def tai_to_utc(tai_ns: int) -> int:
    """UTC of TAI [ns since 1958]; a day of UTC has 86400 s.

    >>> moment = 21550 * 86400 * SECOND
    >>> tai_to_utc(int(utc_to_tai(np.array(moment)))) == moment
    True
    """
    start, offset = leap_table()
    return tai_ns - int(offset[np.searchsorted(start + offset[1:], tai_ns, side="right")])


def has_leap_second(day_end_ns: int) -> bool:
    """Whether the UTC day before this midnight [ns since 1958] ends with a second 23:59:60."""
    start, _ = leap_table()
    return bool(np.isin(day_end_ns, start[1:]))


UNIT_WORDS = by_word(vocabulary("tables")["units_of_time"])
"""Words in the names of columns, and the unit of time that each says."""

_SIZES: Mapping[str, int] = {
    "ns": 1, "us": 1000, "ms": 10**6, "s": SECOND, "min": 60 * SECOND, "h": 3600 * SECOND,
    "day": SCALES.day, "week": 7 * SCALES.day,
}  # fmt: skip
_UNIT = re.compile(
    r"(?P<count>\d+(?:\.\d+)?)?\s*(?P<unit>week|day|h|min|s|ms|us|ns)?"
    r"(?:\s*/\s*(?P<divisor>2\^\d+|\d+)\s*(?P<later>s|ms|us)?)?"
)
_WORDS = re.compile(r"[A-Z]?[a-zµμ]+|[A-Z]+(?![a-z])")


def words_of(name: str) -> list[str]:
    """The words of a column's name in their order, in small letters.

    >>> words_of("unixMs"), words_of("GPS_time [s]")
    (['unix', 'ms'], ['gps', 'time', 's'])
    """
    return [word.lower() for word in _WORDS.findall(name)]


def unit_in_name(name: str) -> str:
    """The first unit of time that the name of a column says; "" where it says none.

    >>> [unit_in_name(name) for name in ("nanosec", "us_of_ms", "dayOfYear", "iTOW", "fine")]
    ['ns', 'us', 'doy', 'ms', '']
    """
    words = words_of(name)
    squeezed = "".join(words)
    if "dayofyear" in squeezed:
        return "doy"
    units = [UNIT_WORDS[word] for word in (squeezed, *words) if word in UNIT_WORDS]
    return next(iter(units), "")


def unit_size(text: str) -> Fraction | None:
    """The nanoseconds of a unit of time such as "10 us" or "s/65536"; None where it is none.

    >>> unit_size("10 us"), unit_size("s/2^16") == unit_size("1/65536 s"), unit_size("m")
    (Fraction(10000, 1), True, None)
    """
    match = _UNIT.fullmatch(text.strip())
    if match is None or not (match["unit"] or match["divisor"]):
        return None
    divisor = match["divisor"] or "1"
    base, _, power = divisor.partition("^")
    whole = int(base) ** int(power or 1)
    unit = match["unit"] or match["later"] or "s"
    return Fraction(match["count"] or 1) * _SIZES[unit] / whole if whole else None


def sizes_of(
    table: Table, names: Sequence[str], units: Sequence[str], first: str
) -> list[Fraction]:
    """The nanoseconds of one of each column, as mapping, name or kind of stamp (`first`) says."""
    sizes = []
    for k, name in enumerate(names):
        unit = units[k] if units else (unit_in_name(name) if k else first)
        # Seconds of the week have many names.
        unit = unit or ("s" if first == "week" else "")
        size = unit_size(unit)
        if size is None:
            what = f"{unit!r} is no unit of time" if unit else "which unit it counts is not known"
            advice = 'add units = [...] to `time`, one a column, such as units = ["s", "ns"], '
            advice += '["s", "s/65536"] (CUC) or ["day", "ms", "us"] (CDS)'
            raise CampaignError(what, where=f"{table.label}, column {name}", advice=advice)
        sizes.append(size)
    return sizes


def added_parts(
    table: Table, names: Sequence[str], sizes: Sequence[Fraction], *, of_date: bool = False
) -> tuple[np.ndarray, np.ndarray, float]:
    """Time that the columns after the first add to a stamp.

    Returns (rows,) ns, (rows,) whether a cell is empty, and the step of the last column [s]. Sizes
    are the ns that one of each column counts; with `of_date` the first column holds dates.
    """
    ns = np.zeros(table.rows, dtype=np.int64)
    missing = np.zeros(table.rows, dtype=bool)
    resolution = 1e-9
    for k, name in enumerate(names):
        if k == 0 and of_date:
            continue
        values = np.nan_to_num(table.numbers(name))
        advice = f"name whole units first and check `units`; named are {', '.join(names)}"
        broken = (values % 1.0 > 0.0) & (k < len(names) - 1)
        what = "{:.12g} is not whole, and the next column adds to it"
        table.refuse(broken, name, what, advice)
        if k == 0:
            continue
        # A day with a leap second holds one more.
        most = sizes[k - 1] + (SECOND if sizes[k - 1] >= _SIZES["day"] else 0)
        wrong = (values < 0.0) | (values * float(sizes[k]) >= float(most))
        table.refuse(wrong, name, "{:.12g} is no part of one of the column before it", advice)
        part, empty, resolution = exact_ns(table, name, sizes[k])
        ns, missing = ns + part, missing | empty
    return ns, missing, resolution


def exact_ns(
    table: Table, name: str, unit: Fraction, zero: float = 0.0
) -> tuple[np.ndarray, np.ndarray, float]:
    """A column in whole ns (rows,), `zero` of its units becoming 0; empty rows; step [s]."""
    column = table.column(name)
    values = table.numbers(name)
    missing = np.isnan(values)
    numbers = np.where(missing, 0.0, values)
    sizes = np.abs(numbers)
    size = float(np.max(sizes, initial=0.0))
    too_large = sizes >= max(size, 2.0**62 / float(unit) + zero)
    advice = "state the kind and unit that the column has"
    table.refuse(too_large & ~missing, name, "{:g} is no time of this kind", advice)
    if unit.denominator != 1:
        return _rounded(numbers, unit), missing, 1e-9
    one = int(unit)
    if column.exact is not None:
        return _decimal_ns(column, one, zero), missing, max(one * 1e-18, 1e-9)
    if column.values.dtype.kind in "iu":
        ns = (column.values.astype(np.int64) - math.floor(zero)) * one
        return ns - round((zero % 1.0) * one), missing, 1e-9
    spacing = np.spacing(np.float32(size)) if column.single else np.spacing(size)
    # Whole units and the rest apart: each is exact, the sum of floats would not be.
    whole = np.floor(numbers)
    rest = numbers - whole - zero % 1.0
    ns = (whole.astype(np.int64) - math.floor(zero)) * one
    return ns + np.rint(rest * one).astype(np.int64), missing, float(spacing) * one / SECOND


def _decimal_ns(column: Column, unit: int, zero: float) -> np.ndarray:
    """Cells with more digits than a float holds, in whole nanoseconds."""
    assert column.exact is not None
    start = Decimal(zero)
    ns = np.zeros(column.exact.size, dtype=np.int64)
    for row, cell in enumerate(column.exact.tolist()):
        try:
            number = Decimal(cell.strip().replace(",", "."))
        except InvalidOperation:
            number = Decimal(str(column.values[row]))
        if number.is_finite():
            ns[row] = int(((number - start) * unit).to_integral_value())
    return ns


def _rounded(values: np.ndarray, size: Fraction) -> np.ndarray:
    """Counts (rows,) in whole nanoseconds; whole counts without the rounding of floats."""
    product = 2.0 * np.abs(values).max(initial=0.0) * size.numerator
    if not np.any(values % 1.0) and product + size.denominator < 2.0**63:
        doubled = 2 * values.astype(np.int64) * size.numerator + size.denominator
        return doubled // (2 * size.denominator)
    return np.rint(values * float(size)).astype(np.int64)


def weeks_ns(table: Table, name: str, rollovers: int | None) -> tuple[np.ndarray, np.ndarray]:
    """Starts of GPS weeks [ns since week 0], (rows,), and (rows,) whether the cell is empty."""
    numbers = table.numbers(name)
    missing = np.isnan(numbers)
    numbers = np.where(missing, 0.0, numbers)
    wrong = (numbers != np.floor(numbers)) | (numbers < 0) | (numbers > 99999)
    advice = "name the column of whole weeks first, then that of the seconds of the week "
    advice += "(0 to 604800)"
    table.refuse(wrong, name, "week {:g} is no GPS time", advice)
    week = numbers.astype(np.int64)
    cut = (week > 0) & (rollovers is None and week.max(initial=0) < 1024)
    year = int(1980 + week[np.argmax(week > 0)] * 7 / 365.25)
    what = f"week {{:.0f}} lies in {year}, or is cut to ten bits, which begin anew every 1024 weeks"
    advice = "add gps_rollovers to `time`: 2 for a log from 2019-04-07 to 2038, "
    advice += "1 from 1999-08-22, 0 before"
    table.refuse(cut, name, what, advice)
    return (week + 1024 * (rollovers or 0)) * _SIZES["week"], missing
