"""Which clock a column of stamps seems to be read from, told from its name, unit and size."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from bayes_inertia.importing.questions import UNKNOWN
from bayes_inertia.importing.raw_table import RawColumn, RawTable
from bayes_inertia.importing.stamp_parts import UNIT_WORDS, unit_in_name, unit_size, words_of
from bayes_inertia.importing.time_stamps import COUNTED_CLOCKS, FREE_CLOCKS, dates_of
from bayes_inertia.importing.time_texts import is_date

_CLOCKS: Mapping[str, str] = MappingProxyType(
    {"gps": "gps", "tai": "tai", "unix": "unix", "posix": "unix", "epoch": "unix"}
)
# Units of parts of a stamp, the coarsest first.
_ORDER = ("week", "year", "month", "doy", "day", "h", "min", "s", "ms", "us", "ns")
_FINE = frozenset({"fine", "frac", "fraction", "sub", "subsec", "subsecs", "subseconds", "ticks"})
# Words that say nothing of the clock that a column belongs to.
_NO_STEM = frozenset({*_FINE, "of", "in", "coarse", "utc", "date", "time", "the"})
_OF_DAY = re.compile(r"\d{1,2}:\d{2}")
# Logs of spacecraft are from these years.
_FIRST, _LAST = np.datetime64("1995-01-01"), np.datetime64("2060-01-01")


@dataclass(frozen=True)
class ClockGuess:
    """The clock of a column of stamps.

    Parameters
    ----------
    kind : str
        As a mapping names it; "?" where only the user can know it.
    why : str
        What shows it; "" for "?".
    hint : str
        What helps the user to answer; "" where nothing does.
    """

    kind: str
    why: str = ""
    hint: str = ""


def stamp_columns(table: RawTable, named: Sequence[str]) -> list[str]:
    """Columns that make one stamp together.

    Parameters
    ----------
    table : RawTable
        The table.
    named : sequence of str
        Columns with a name of a time.

    Returns
    -------
    list of str
        Whole units first; the first of `named` where no others belong to it.

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
    """What each column of a stamp counts, as a mapping writes it.

    Parameters
    ----------
    table : RawTable
        The table.
    names : sequence of str
        The columns, whole units first.

    Returns
    -------
    list of str
        "date" for texts; "" where nothing says it.

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


def guessed_clock(table: RawTable, names: Sequence[str]) -> ClockGuess:
    """The clock of the columns of the time, as far as they show it.

    Parameters
    ----------
    table : RawTable
        The table.
    names : sequence of str
        The columns that seem to hold the time.

    Returns
    -------
    ClockGuess
        Its kind; "?" where name, unit and size leave more than one.

    Examples
    --------
    >>> ms = RawTable("a.csv", {"unix_ms": RawColumn(np.array([1772366400000.0, 1772366400250.0]))})
    >>> guessed_clock(ms, ["unix_ms"]).kind
    'unix_ms'
    """
    if not names:
        return ClockGuess(UNKNOWN)
    if table.time_kind and list(table.time_names) == list(names):
        return ClockGuess(table.time_kind, "the file states the kind")
    units = stamp_units(table, names)
    if units[0] == "week":
        return ClockGuess("gps_week", "from the names of the columns")
    column, words = table.column(names[0]), [word for name in names for word in words_of(name)]
    if column.is_text or units[0] == "year":
        last = str(table.column(names[-1]).values[0]).strip()
        zoned = last.upper().endswith(("Z", "UTC")) or "utc" in words
        return ClockGuess("utc", "the dates say so") if zoned else ClockGuess(UNKNOWN)
    if len(names) > 1 and units[0] == "day":
        return _of_days(column, words)
    if len(names) > 1:
        guess = _of_numbers(replace(column, unit="s"), words_of(names[0]))
        unix = "unix_s" in _dates(column.values.astype(float), "s")
        ros = [unit_in_name(names[1]), *words_of(names[0])[-1:]] in (["ns", "sec"], ["ns", "secs"])
        if unix and (ros or "tv" in words):
            return ClockGuess("unix_s", "ROS and POSIX name the columns so")
        cuc = 'from the names of the columns; a CUC that counts from 1958 is "tai_s"'
        return replace(guess, why=cuc) if guess.kind == "s" else guess
    return _of_numbers(column, words)


def _of_days(column: RawColumn, words: Sequence[str]) -> ClockGuess:
    """The clock of a column of whole days beside one of parts of the day."""
    days = column.values[np.isfinite(column.values)][:1]
    if {"mjd", "jd"} & {*words}:
        return _of_numbers(column, words)
    date = np.datetime64(int(days[0]) - 4383, "D") if len(days) and abs(days[0]) < 1e5 else None
    if date is not None and _FIRST < date < _LAST:
        return ClockGuess("cds", f"the first day counted from 1958 is {date}")
    return ClockGuess("day", "from the names of the columns")


def _of_numbers(column: RawColumn, words: Sequence[str]) -> ClockGuess:
    """The clock of a column of counts."""
    numbers = column.values.astype(float)
    numbers = numbers[np.isfinite(numbers)]
    unit = UNIT_WORDS.get(column.unit.lower().strip(), "")
    stated = bool(unit)
    if not unit and len(words) > 1:
        unit = UNIT_WORDS.get(words[-1], "")
    dates = _dates(numbers, unit)
    for day in ("mjd", "jd"):
        scales = [scale for scale in ("utc", "tai", "tt") if scale in words]
        if day in words:
            named = [f"{day}_{scale}" for scale in scales]
            kind = named[0] if len(named) == 1 else UNKNOWN
            return ClockGuess(kind, "from the name of the column" if named else "")
    clocks = {_CLOCKS[word] for word in words if word in _CLOCKS}
    fitting = [kind for kind in dates if kind.partition("_")[0] in clocks]
    if len(fitting) == 1:
        return ClockGuess(fitting[0], "from the name and the size of the numbers")
    if dates:
        listed = ", ".join(f"{date} as {kind}" for kind, date in dates.items())
        return ClockGuess(UNKNOWN, hint=f"The first row is {listed}.")
    if unit in FREE_CLOCKS:
        return ClockGuess(
            unit, "the file states the unit" if stated else "from the name of the column"
        )
    return ClockGuess(UNKNOWN)


def _dates(numbers: np.ndarray, unit: str) -> dict[str, str]:
    """The kinds by which the first stamp is a date of spaceflight, and that date in UTC."""
    if not len(numbers):
        return {}
    dates = {}
    for kind in COUNTED_CLOCKS:
        if unit and kind.rpartition("_")[2] != unit:
            continue
        date = dates_of(float(numbers[0]), kind)
        if date is not None and _FIRST < date < _LAST:
            dates[kind] = f"{date.astype('datetime64[s]')}Z"
    return dates
