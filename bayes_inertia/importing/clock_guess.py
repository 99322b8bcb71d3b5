"""Which clock a column of stamps seems to be read from, told from its name, unit and size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from bayes_inertia.importing.questions import UNKNOWN
from bayes_inertia.tables.raw_table import RawColumn, RawTable
from bayes_inertia.tables.stamp_parts import UNIT_WORDS, unit_in_name, words_of
from bayes_inertia.tables.time_columns import stamp_units
from bayes_inertia.tables.time_stamps import COUNTED_CLOCKS, FREE_CLOCKS, dates_of

_CLOCKS: Mapping[str, str] = MappingProxyType(
    {"gps": "gps", "tai": "tai", "unix": "unix", "posix": "unix", "epoch": "unix"}
)
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


def guessed_clock(table: RawTable, names: Sequence[str]) -> ClockGuess:
    """The clock of the columns of the time, as far as they show it.

    Returns: its kind; "?" where name, unit and size leave more than one.

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
