"""Columns that hold the time of a table, told from their names, units and cells."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from bayes_inertia.tables.raw_table import RawColumn, RawTable
from bayes_inertia.tables.stamp_parts import UNIT_WORDS, unit_in_name, unit_size, words_of
from bayes_inertia.tables.time_texts import is_date

# What ends a name, without signs and in small letters -> unit.
_UNITS: Mapping[str, str] = MappingProxyType(
    {
        "radps": "rad/s", "radpers": "rad/s", "rads": "rad/s", "radpersec": "rad/s",
        "mradps": "mrad/s", "mrads": "mrad/s",
        "dps": "deg/s", "degps": "deg/s", "degs": "deg/s", "degpers": "deg/s",
        "degpersec": "deg/s", "degsec": "deg/s", "degh": "deg/h", "dph": "deg/h",
        "rpm": "rpm",
        "mnms": "mN m s", "unms": "uN m s", "nms": "N m s",
        "mnm": "mN m", "unm": "uN m", "nm": "N m",
        "nt": "nT", "ut": "uT", "km": "km", "m": "m", "t": "T",
        "deg": "deg", "rad": "rad",
    }
)  # fmt: skip
_TIME = re.compile(
    r"(t|time|times|utc|tai|gps|epoch|timestamps?|tow|week|met|sclk|unix|posix|mjd|jd|date|datetime|"
    r"(unix|gps|posix|time)(time|stamp)[a-z]*|sec|s)"
)
# Where no column is called a time, one that ends so: RECEIVED_TIMESECONDS, generation_time.
_LATER_TIME = re.compile(r".*(time|stamp)(seconds|formatted|[_ ]?(utc|tai|gps|[mun]?s))?")
# Units of parts of a stamp, the coarsest first.
_ORDER = ("week", "year", "month", "doy", "day", "h", "min", "s", "ms", "us", "ns")
_FINE = frozenset({"fine", "frac", "fraction", "sub", "subsec", "subsecs", "subseconds", "ticks"})
# Words that say nothing of the clock that a column belongs to.
_NO_STEM = frozenset({*_FINE, "of", "in", "coarse", "utc", "date", "time", "the"})
_OF_DAY = re.compile(r"\d{1,2}:\d{2}")


def split_unit(name: str) -> tuple[str, str]:
    """A column's name without the unit that it ends with, and that unit, or "".

    Examples
    --------
    >>> split_unit("wx_deg_s"), split_unit("rate x [deg/s]"), split_unit("gyro")
    (('wx', 'deg/s'), ('rate x', 'deg/s'), ('gyro', ''))
    """
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


def time_names(table: RawTable) -> list[str]:
    """Columns of the time: those that the file states, are so named, or hold dates; [] if none."""
    if table.time_names:
        return list(table.time_names)
    named = [
        name
        for name in table.columns
        if _TIME.fullmatch(re.split(r"[^a-z]+", split_unit(name)[0].lower().strip("_ "))[0])
    ]
    named = named or [n for n in table.columns if _LATER_TIME.fullmatch(n.lower().strip("_ "))]
    return stamp_columns(table, named or [n for n, c in table.columns.items() if _holds_dates(c)])


def _holds_dates(column: RawColumn) -> bool:
    return column.is_text and len(column.values) > 0 and is_date(str(column.values[0]))


def stamp_columns(table: RawTable, named: Sequence[str]) -> list[str]:
    """Columns that make one stamp together, whole units first; the first of `named` if it is alone.

    Examples
    --------
    >>> ros = {"sec": RawColumn(np.array([7.0, 7.0])), "nanosec": RawColumn(np.array([0.0, 5e8]))}
    >>> stamp_columns(RawTable("a.csv", ros), ["sec"])
    ['sec', 'nanosec']
    """
    weeks = [name for name in named if "week" in name.lower()]
    seconds = [name for name in named if name not in weeks]
    if weeks and seconds:
        return _with_finer(table, [weeks[0], seconds[0]])
    starts = [name for name in table.columns if name in named or _starts_a_stamp(table, name)]
    chains = [_with_finer(table, [name]) for name in starts]
    longest = max(chains, key=len, default=[])
    return longest if len(longest) > 1 else list(named[:1])


def _starts_a_stamp(table: RawTable, name: str) -> bool:
    """Whether a column may hold the whole units of a stamp."""
    column = table.column(name)
    if column.is_text:
        return len(column.values) > 0 and is_date(str(column.values[0]))
    return unit_in_name(name) in ("week", "year", "day", "s") or bool(
        {"coarse"} & {*words_of(name)}
    )


def _with_finer(table: RawTable, chain: list[str]) -> list[str]:
    """The columns of a stamp with those that follow it and count parts of its unit."""
    for name in list(table.columns)[list(table.columns).index(chain[-1]) + 1 :]:
        if not _is_part(table, chain, name):
            break
        chain = [*chain, name]
    whole = all(_is_whole(table.column(name)) for name in chain[:-1])
    date = [u for u in stamp_units(table, chain) if u in ("year", "month", "day", "doy")]
    dated = date[:1] != ["year"] or date in (["year", "doy"], ["year", "month", "day"])
    return chain if whole and dated else chain[:1]


def _is_part(table: RawTable, chain: Sequence[str], name: str) -> bool:
    """Whether a column counts parts of the last unit of a stamp."""
    before, column = table.column(chain[-1]), table.column(name)
    if column.is_text or before.is_text:
        texts = [str(c.values[0]).strip() if len(c.values) else "" for c in (before, column)]
        dated = before.is_text and is_date(texts[0]) and ":" not in texts[0]
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


def _is_whole(column: RawColumn) -> bool:
    return column.is_text or not np.any(np.nan_to_num(column.values) % 1.0)


def _stem(name: str) -> str:
    """The words of a name that are no units."""
    return " ".join(w for w in words_of(name) if w not in UNIT_WORDS and w not in _NO_STEM)


def stamp_units(table: RawTable, names: Sequence[str]) -> list[str]:
    """What each column of a stamp counts, as a mapping writes it: "date" for texts, "" if unknown.

    Examples
    --------
    >>> cuc = {"coarse": np.array([7.0, 7.0]), "fine": np.array([16384.0, 49152.0])}
    >>> stamp_units(RawTable("a.csv", {k: RawColumn(v) for k, v in cuc.items()}), list(cuc))
    ['s', 's/2^16']
    """
    units: list[str] = []
    for name in names:
        column, words = table.column(name), {*words_of(name)}
        unit = (
            "date" if column.is_text else unit_in_name(name) or ("s" if "coarse" in words else "")
        )
        if not column.is_text and unit in ("", "s") and words & _FINE:
            most = np.nanmax(column.values, initial=0.0)
            bits = next((n for n in (8, 16, 24, 32) if most < 2.0**n), 0)
            unit = f"s/2^{bits}" if bits and units else ""
        units.append(unit)
    return units
