"""Time stamps: the columns that hold them, and all clocks on one scale.

A gyro stamped in UTC, wheels in GPS seconds and a star tracker in an AEM then line up. 64-bit
floats of seconds since 1958 have steps of 2.4e-7 s; integer nanoseconds lose nothing. UTC has leap
seconds; their table is that of ERFA, and needs no network.

Stamps in plain seconds (or ms, us, ns, min, h) come from a clock with a zero of its own: such a
clock can be lined up with another only where both are of that kind, or by a stated offset.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from bayes_inertia.errors import CampaignError, require
from bayes_inertia.files import by_word, vocabulary
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.tables import time_texts
from bayes_inertia.tables.limits import LIMITS
from bayes_inertia.tables.stamp_parts import (
    SCALES,
    SECOND,
    UNIT_WORDS,
    added_parts,
    exact_ns,
    sizes_of,
    tai_to_utc,
    unit_in_name,
    unit_size,
    utc_to_tai,
    weeks_ns,
    words_of,
)
from bayes_inertia.tables.table import Column, Table, is_empty

# What ends a name, without signs and in small letters -> unit.
_UNITS = by_word(vocabulary("tables")["endings"])
_NAMED = vocabulary("tables")["names_of_times"]
_TIME, _LATER_TIME, _RECEIPT = (re.compile(_NAMED[key]) for key in ("first", "later", "receipt"))
# Units of parts of a stamp, the coarsest first.
_ORDER = ("week", "year", "month", "doy", "day", "h", "min", "s", "ms", "us", "ns")
_FINE = frozenset({"fine", "frac", "fraction", "sub", "subsec", "subsecs", "subseconds", "ticks"})
# Words that say nothing of the clock that a column belongs to.
_NO_STEM = frozenset({*_FINE, "of", "in", "coarse", "utc", "date", "time", "the"})
_OF_DAY = re.compile(r"(\d{1,2}):(\d{2})(?::(\d{2}(?:[.,]\d*)?))?")


def split_unit(name: str) -> tuple[str, str]:
    """A column's name without the unit that it ends with, and that unit, or "".

    >>> split_unit("wx_deg_s"), split_unit("rate x [deg/s]"), split_unit("gyro")
    (('wx', 'deg/s'), ('rate x', 'deg/s'), ('gyro', ''))
    >>> split_unit("speed_rpm[0]")
    ('speed[0]', 'rpm')
    """
    indexed = re.fullmatch(r"(.+?)(\[\d+\])", name)
    if indexed:
        stem, unit = split_unit(indexed[1])
        return stem + indexed[2], unit
    bracket = re.fullmatch(r"(.+?)\s*[\[(](.+)[\])]", name)
    if bracket and not bracket[2].isdigit():
        return bracket[1], _UNITS.get(re.sub(r"[^a-z]", "", bracket[2].lower()), bracket[2])
    words = re.split(r"[_\s.]+", name)
    for count in (3, 2, 1):
        ending = "".join(words[-count:]).lower().replace("/", "")
        # In rx_N_m and Bx_N_T the N is the inertial frame.
        frame = count == 2 and words[-2:-1] == ["N"] and re.match(r"r|pos|b", name.lower())
        if len(words) > count and ending in _UNITS and not frame:
            return "_".join(words[:-count]), _UNITS[ending]
    return name, ""


def time_names(table: Table) -> list[str]:
    """Columns of the time: those that the file states, are so named, or hold dates; [] if none."""
    if table.time_names:
        return list(table.time_names)
    named = [
        name
        for name in table.columns
        if _TIME.fullmatch(re.split(r"[^a-z]+", split_unit(name)[0].lower().strip("_ "))[0])
    ]
    named = named or [n for n in table.columns if _LATER_TIME.fullmatch(n.lower().strip("_ "))]
    # When it was read, before when it was published, before when it was received.
    named.sort(key=lambda x: (bool(_RECEIPT.fullmatch(x.lower())), "sample" not in x.lower()))
    return stamp_columns(table, named or [n for n, c in table.columns.items() if _holds_dates(c)])


def _holds_dates(column: Column) -> bool:
    return column.is_text and len(column.values) > 0 and time_texts.is_date(str(column.values[0]))


def stamp_columns(table: Table, named: Sequence[str]) -> list[str]:
    """Columns that make one stamp together, whole units first; else the first of `named`."""
    weeks = [name for name in named if "week" in name.lower()]
    seconds = [name for name in named if name not in weeks]
    if weeks and seconds:
        return _with_finer(table, [weeks[0], seconds[0]])
    starts = [name for name in table.columns if name in named or _starts_a_stamp(table, name)]
    chains = [_with_finer(table, [name]) for name in starts]
    longest = max(chains, key=len, default=[])
    return longest if len(longest) > 1 else list(named[:1])


def _starts_a_stamp(table: Table, name: str) -> bool:
    """Whether a column may hold the whole units of a stamp."""
    if table.column(name).is_text:
        return _holds_dates(table.column(name))
    return unit_in_name(name) in ("week", "year", "day", "s") or "coarse" in words_of(name)


def _with_finer(table: Table, chain: list[str]) -> list[str]:
    """The columns of a stamp with those that follow it and count parts of its unit."""
    for name in list(table.columns)[list(table.columns).index(chain[-1]) + 1 :]:
        if not _is_part(table, chain, name):
            break
        chain = [*chain, name]
    whole = all(_is_whole(table.column(name)) for name in chain[:-1])
    date = [u for u in stamp_units(table, chain) if u in ("year", "month", "day", "doy")]
    dated = date[:1] != ["year"] or date in (["year", "doy"], ["year", "month", "day"])
    return chain if whole and dated else chain[:1]


def _is_part(table: Table, chain: Sequence[str], name: str) -> bool:
    """Whether a column counts parts of the last unit of a stamp."""
    before, column = table.column(chain[-1]), table.column(name)
    if column.is_text or before.is_text:
        texts = [str(c.values[0]).strip() if len(c.values) else "" for c in (before, column)]
        dated = before.is_text and time_texts.is_date(texts[0]) and ":" not in texts[0]
        units = [unit_in_name(name) for name in (chain[0], chain[-1])]
        dated = dated or (units[0] == "year" and units[1] in ("day", "doy"))
        return dated and (bool(_OF_DAY.match(texts[1])) or unit_in_name(name) in ("s", "ms"))
    units = stamp_units(table, [*chain, name])
    order = [_ORDER.index(unit) if unit in _ORDER else len(_ORDER) for unit in units]
    if units[-1] == "" or order[-1] <= order[-2] or _stem(name) not in ("", _stem(chain[0])):
        return False
    sizes = [unit_size(unit) for unit in units[-2:]]
    most = np.nanmax(column.values, initial=0.0)
    return None in sizes or 0.0 <= most * float(sizes[1] or 0) < float(sizes[0] or 0) * 1.001


def _is_whole(column: Column) -> bool:
    return column.is_text or not np.any(np.nan_to_num(column.values) % 1.0)


def _stem(name: str) -> str:
    """The words of a name that are no units."""
    return " ".join(w for w in words_of(name) if w not in UNIT_WORDS and w not in _NO_STEM)


def stamp_units(table: Table, names: Sequence[str]) -> list[str]:
    """Unit of each column of a stamp, as a mapping writes it: "date" for texts, "" if unknown.

    >>> cuc = {"coarse": np.array([7.0, 7.0]), "fine": np.array([16384.0, 49152.0])}
    >>> stamp_units(Table("a.csv", {k: Column(v) for k, v in cuc.items()}), list(cuc))
    ['s', 's/2^16']
    """
    units: list[str] = []
    for name in names:
        column, words = table.column(name), {*words_of(name)}
        unit = unit_in_name(name) or ("s" if "coarse" in words else "")
        if column.is_text:
            unit = "date"
        elif unit in ("", "s") and words & _FINE:
            most = np.nanmax(column.values, initial=0.0)
            bits = next((n for n in (8, 16, 24, 32) if most < 2.0**n), 0)
            unit = f"s/2^{bits}" if bits and units else ""
        units.append(unit)
    return units


FREE_CLOCKS: Mapping[str, int] = {
    unit: int(unit_size(unit) or 0) for unit in ("ns", "us", "ms", "s", "min", "h", "day")
}
"""Kinds of stamps from a clock's own zero, and their nanoseconds."""

# Nanoseconds a unit, zero of the clock, whether leap seconds are to be added.
_NUMBERS: Mapping[str, tuple[int, int, bool]] = {
    f"{clock}_{unit}": (FREE_CLOCKS[unit], zero, leaps)
    for clock, zero, leaps in (
        ("gps", SCALES.gps_1980, False),
        ("tai", 0, False),
        ("unix", SCALES.tai_1970, True),
    )
    for unit in ("s", "ms", "us", "ns")
}
COUNTED_CLOCKS = tuple(_NUMBERS)
"""Kinds of stamps that count from a date that everybody knows."""

# Day of 1958-01-01, what TAI is ahead by [ns], whether leap seconds are to be added.
_DAYS: Mapping[str, tuple[float, int, bool]] = {
    f"{count}_{scale}": (day, -SCALES.tt_minus_tai if scale == "tt" else 0, scale == "utc")
    for count, day in (("mjd", SCALES.mjd_1958), ("jd", SCALES.jd_1958))
    for scale in ("utc", "tai", "tt")
} | {"cds": (0, 0, True), "excel": (21186, 0, True), "datenum": (715146, 0, True)}
# What is to be added to the text's clock [ns]; None: leap seconds.
_TEXTS: Mapping[str, int | None] = {
    "utc": None,
    "tai": 0,
    "gps": 19 * SECOND,
    "tt": -SCALES.tt_minus_tai,
}
TIME_KINDS = (*FREE_CLOCKS, *_TEXTS, *_NUMBERS, "gps_week", *_DAYS)
"""Kinds of time stamps that `times_to_seconds` reads."""


@array_dataclass
class TimeStamps:
    """The times of one stream."""

    # (rows,) of int: nanoseconds since 1958-01-01T00:00:00 TAI where `absolute`, else since the
    # clock's own zero; 0 where a stamp is missing
    ns: np.ndarray
    missing: np.ndarray  # (rows,) of bool: rows without a stamp
    absolute: bool  # Whether other absolute clocks share the scale
    resolution_s: float  # The step in which the file can write a stamp [s]
    zero_ns: int = 0  # The stamp of the clock's own zero

    @property
    def first_ns(self) -> int:
        """The earliest stamp [ns]; 0 where there is none."""
        present = self.ns[~self.missing]
        return int(present.min()) if present.size else 0

    def seconds_since(self, epoch_ns: int) -> np.ndarray:
        """(rows,) array of seconds since an epoch [ns] on the same scale; NaN for no stamp."""
        return np.where(self.missing, math.nan, (self.ns - epoch_ns) / SECOND)


def times_to_seconds(
    table: Table,
    names: Sequence[str],
    kind: str,
    *,
    units: Sequence[str] = (),
    form: str = "",
    gps_rollovers: int | None = None,
    first_day: int = 0,
) -> TimeStamps:
    """The stamps of a table on the common scale.

    `names`: the column of the stamps, or columns that are added: date and time of the day, seconds
    and nanoseconds, week and seconds of the week, day and milliseconds of the day. `kind`: one of
    `TIME_KINDS`: "s", "ms", "us", "ns", "min", "h", "day" (a clock's own zero; "s" also of times of
    the day, 23:59:58.5); "utc", "tai", "gps", "tt" (texts, calendar or day of year); "gps_s" to
    "gps_ns", "gps_week", "tai_s" to "tai_ns" (since 1958), "unix_s" to "unix_ns"; "mjd_utc",
    "jd_utc" and these with tai, tt; "cds" (days of UTC since 1958); "excel", "datenum" (days of
    UTC, as Excel and MATLAB count them). `units`: what each column counts, such as "s/65536";
    empty: kind and names say it. `form`: how dates are written, in directives of `strptime`; ""
    for the forms that are told. `gps_rollovers`: for weeks that are cut to ten bits: how often they
    began anew, such as 2 from 2019-04-07. `first_day`: for "cds": the days from 1958-01-01 to the
    day that it calls 0.

    >>> from bayes_inertia.tables.table import Column
    >>> week = Table("w.csv", {"w": Column(np.array([2086])), "s": Column(np.array([18]))})
    >>> text = Table("t.csv", {"t": Column(np.array(["2019-12-29T00:00:00Z"]))})
    >>> gps = times_to_seconds(week, ["w", "s"], "gps_week")
    >>> gps.ns - times_to_seconds(text, ["t"], "utc").ns
    array([0])
    """
    _check_kind(table, names, kind, units)
    if kind in _TEXTS:
        ns, missing = _from_texts(table, names, kind, units, form)
        resolution = 1.0 / SECOND
    else:
        ns, missing, resolution = _from_counts(table, names, kind, units, gps_rollovers, first_day)
    stamps = TimeStamps(np.where(missing, 0, ns), missing, kind not in FREE_CLOCKS, resolution)
    _check_years(table, names, kind, stamps)
    _check_steps(table, names, stamps)
    return stamps


def dates_of(number: float, kind: str) -> np.datetime64 | None:
    """The date in UTC of a count of one of `COUNTED_CLOCKS`; None outside the years that are read.

    >>> str(dates_of(1456401618.0, "gps_s"))[:19]
    '2026-03-01T12:00:00'
    """
    unit, start, leaps = _NUMBERS[kind]
    if not SCALES.first <= number * unit + start < SCALES.last:
        return None
    ns = round(number * unit) + start
    return np.datetime64("1958-01-01", "ns") + np.timedelta64(ns if leaps else tai_to_utc(ns), "ns")


def moved_s(stamp_ns: int, kind: str, other: str) -> float:
    """By how much a stamp moves [s] if its count is of another of `COUNTED_CLOCKS`.

    `stamp_ns`: as it was read by `kind`, of TAI since 1958.

    >>> moved_s(2_151_144_037_250_000_000, "gps_s", "unix_s")  # ten years, 17 leap seconds
    -315964783.0
    """
    (unit, start, leaps), (size, zero, has_leaps) = _NUMBERS[kind], _NUMBERS[other]
    since_start = (tai_to_utc(stamp_ns) if leaps else stamp_ns) - start
    moved = since_start * size // unit + zero
    return ((int(utc_to_tai(np.array(moved))) if has_leaps else moved) - stamp_ns) / SECOND


def _check_kind(table: Table, names: Sequence[str], kind: str, units: Sequence[str]) -> None:
    advice = f"write one of {', '.join(TIME_KINDS)}"
    require(kind in TIME_KINDS, table.label, f"{kind!r} is no kind of time stamp", advice)
    of_week = kind == "gps_week"
    what = f"{len(names)} columns are named for stamps of the kind {kind!r}"
    wanted = "two columns, the week and the seconds of the week" if of_week else "one column"
    require(len(names) >= 1 + of_week, table.label, what, f"name {wanted}")
    what = f"{len(units)} units for {len(names)} columns of the time"
    advice = 'give one a column, such as names = ["sec", "nanosec"], units = ["s", "ns"]'
    require(len(units) in (0, len(names)), table.label, what, advice)


def _from_texts(
    table: Table, names: Sequence[str], kind: str, units: Sequence[str], form: str
) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (rows,) written as dates, on the TAI scale, and the rows without one."""
    name, column = names[0], table.column(names[0])
    counted: list[str] = []
    if len(names) > 1 or form:
        cells, counted = time_texts.written_dates(table, names, units, form)
    elif column.is_text:
        cells = column.values.tolist()
    elif column.values.dtype.kind == "f" and np.isnan(column.values).all():
        return np.zeros(table.rows, dtype=np.int64), np.ones(table.rows, dtype=bool)
    else:
        what = f"holds numbers, not the dates that {kind!r} means"
        advice = f"state another kind of stamp: one of {', '.join(TIME_KINDS)}; "
        advice += 'or add how they are written, such as format = "%Y%m%d%H%M%S"'
        raise CampaignError(what, where=f"{table.label}, column {name}", advice=advice)
    ns, missing = _dates_in_tai(table, name, kind, cells, form)
    if counted:
        # Of hours, minutes and seconds none divides a day.
        of_day = ["day", *(units[names.index(n)] if units else unit_in_name(n) for n in counted)]
        sizes = sizes_of(table, [name, *counted], of_day, "day")
        parts, empty, _ = added_parts(table, [name, *counted], sizes, of_date=True)
        ns, missing = ns + parts, missing | empty
    return ns, missing


def _dates_in_tai(
    table: Table, name: str, kind: str, cells: list[str], form: str
) -> tuple[np.ndarray, np.ndarray]:
    """Dates (rows,) on the TAI scale, and the rows without one."""
    pattern = time_texts.form_of_format(form, f"{table.label}, format") if form else None
    ns = np.zeros(table.rows, dtype=np.int64)
    leap = np.zeros(table.rows, dtype=bool)
    missing = np.zeros(table.rows, dtype=bool)
    # A clock that is not UTC has no zone: text_to_ns refuses it by its row.
    zoned = cells[0].endswith("Z") if cells else False
    alike = time_texts.plain_dates(cells) if not form and (kind == "utc" or not zoned) else None
    if alike is not None:
        ns, cells = alike, []
    for row, cell in enumerate(cells):
        place = partial(table.place, row, name)
        text = cell.strip().removesuffix(kind.upper()) if kind != "utc" else cell
        read = time_texts.text_to_ns(text, utc=kind == "utc", place=place, form=pattern)
        if read is None:
            missing[row] = True
        else:
            ns[row], leap[row] = read
    ahead = _TEXTS[kind]
    if ahead is not None:
        return ns + ahead, missing
    # The second 23:59:60 is written as 23:59:59 with a mark: it still counts the old offset.
    return utc_to_tai(ns) + leap * SECOND, missing


def _from_counts(
    table: Table,
    names: Sequence[str],
    kind: str,
    units: Sequence[str],
    rollovers: int | None,
    first_day: int,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Stamps (rows,) that count from a moment, rows without one, and their resolution [s]."""
    size, start, leaps = _NUMBERS.get(kind, (FREE_CLOCKS.get(kind, SCALES.day), 0, False))
    first = next(unit for unit, value in FREE_CLOCKS.items() if value == size)
    if kind == "gps_week":
        first, start = "week", SCALES.gps_1980
    table = _counting_times_of_day(table, names[0]) if kind == "s" else table
    sizes = sizes_of(table, names, units, first)
    zero, ahead, leaps_of_day = _DAYS.get(kind, (0, 0, False))
    if kind == "gps_week":
        ns, missing, resolution = *weeks_ns(table, names[0], rollovers), 1e-9
    else:
        ns, missing, resolution = exact_ns(table, names[0], sizes[0], zero - first_day)
    # A day is counted on at its start: what a leap second adds comes after.
    ns = (utc_to_tai(ns) if leaps_of_day else ns) + ahead
    if len(names) > 1:
        parts, empty, resolution = added_parts(table, names, sizes)
        ns, missing = ns + parts, missing | empty
    ns = ns + start
    return (utc_to_tai(ns) if leaps else ns), missing, resolution


def _counting_times_of_day(table: Table, name: str) -> Table:
    """A table whose column of times of the day, such as 23:59:58.5, counts their seconds."""
    cells = table.column(name).texts if table.column(name).is_text else []
    parts = [_OF_DAY.fullmatch(cell) for cell in cells]
    if not any(parts) or not all(p or is_empty(c) for p, c in zip(parts, cells, strict=True)):
        return table
    # Whole seconds first: the sum is exact to less than a nanosecond.
    seconds = [
        int(p[1]) * 3600 + int(p[2]) * 60 + float((p[3] or "0").replace(",", "."))
        if p
        else math.nan
        for p in parts
    ]
    return table.changed({name: np.array(seconds)})


def _check_years(table: Table, names: Sequence[str], kind: str, stamps: TimeStamps) -> None:
    wrong = ((stamps.ns < SCALES.first) | (stamps.ns >= SCALES.last)) & ~stamps.missing
    if stamps.absolute and wrong.any():
        row = int(np.argmax(wrong))
        year = 1958 + stamps.ns[row] / (365.25 * SCALES.day)
        what = f"as {kind!r} the stamp lies in the year {year:.0f}"
        advice = "state the kind and unit that the column has; stamps from 1972 to 2099 are read"
        raise CampaignError(what, where=table.place(row, names[0]), advice=advice)


def _check_steps(table: Table, names: Sequence[str], stamps: TimeStamps) -> None:
    """Refuse stamps that are rounded so coarsely that their steps are lost."""
    present = np.sort(stamps.ns[~stamps.missing])
    if present.size < 3:
        return
    step = float(present[-1] - present[0]) / SECOND / (present.size - 1)
    single = table.column(names[-1]).single
    coarse = stamps.resolution_s > LIMITS.coarsest_stamp * step and (step > 0.0 or single)
    bits = "32-bit floats" if single else "this kind of number"
    what = f"{bits} can write these stamps only every {stamps.resolution_s:.2g} s, "
    what += f"but rows follow each other every {step:.2g} s"
    advice = "export the times as 64-bit floats, integers or text, or as seconds from the first row"
    require(not coarse, f"{table.label}, column {names[-1]}", what, advice)
