"""What columns of a raw table seem to hold, and which clock: told from names, units and sizes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_inertia.files import by_word, vocabulary
from bayes_inertia.importing.limits import LIMITS
from bayes_inertia.importing.questions import UNKNOWN
from bayes_inertia.tables.stamp_parts import UNIT_WORDS, unit_in_name, words_of
from bayes_inertia.tables.table import Column, Table
from bayes_inertia.tables.time_stamps import (
    COUNTED_CLOCKS,
    FREE_CLOCKS,
    dates_of,
    split_unit,
    stamp_units,
    time_names,
)

_WORDS = vocabulary("importing")["columns"]
# Quantities of the same sensors and estimators that are none of a campaign.
_OTHER = re.compile(r".*(acc|linear|deriv|covar|reset|delta).*")
_SETPOINT = re.compile(r".*setpoint.*")  # What a controller wants, unless it is a wheel's command.
# A q, but not that of torque, trq, freq, sequence or squared.
_QUATERNION = re.compile(r".*((?<!tr)(?<!fre)q(?!u)|quat|att|orientation|beta)[a-z_]*")
# Names that leave the quantity to the name of the file, as a message of ROS or PX4 does.
_ANY_VECTOR = frozenset({"xyz", "vector", "value", "data"})


@dataclass(frozen=True)
class ColumnFamily:
    """Columns that seem to hold one quantity."""

    holds: str  # What they seem to hold, as a mapping says it
    names: tuple[str, ...]  # The columns, in their order
    unit: str = ""  # The unit that their names end with; "" if none
    stated_unit: str = ""  # The unit that the file states; "" if none
    form: str = ""  # Of attitudes: "quaternion", "euler", "dcm" or "mrp"
    scalar: str = ""  # Of quaternions: "first" or "last", where the names say it


def families(table: Table, file: str) -> list[ColumnFamily]:
    """The quantities that the columns of a table, or the name of its file, seem to hold."""
    numbers = {
        n: c for n, c in table.columns.items() if not c.is_text and n not in time_names(table)
    }
    numbers, taken = _filled(numbers), set[str]()
    result: list[ColumnFamily] = []
    for find in (_matrices, _quaternions, _vectors, _single_wheels):
        for family in find({n: c for n, c in numbers.items() if n not in taken}, file):
            if not taken & set(family.names):
                result.append(family)
                taken |= set(family.names)
    order = list(table.columns)
    return sorted(result, key=lambda family: order.index(family.names[0]))


def _stems(columns: Mapping[str, Column]) -> dict[str, tuple[str, str]]:
    """Stem in small letters, and unit, of each column."""
    split = {name: split_unit(name) for name in columns}
    return {name: (stem.lower(), unit) for name, (stem, unit) in split.items()}


def _groups(
    columns: Mapping[str, Column], members: Sequence[str]
) -> list[tuple[str, list[str], str]]:
    """Template, names and unit of columns that differ only in one of some words."""
    groups: dict[tuple[str, str], dict[str, str]] = {}
    for name, (stem, unit) in _stems(columns).items():
        for match in re.finditer("|".join(sorted(map(re.escape, members), key=len)[::-1]), stem):
            before, after = stem[: match.start()], stem[match.end() :]
            # A letter inside a word is no index.
            if not re.match(r"[a-z0-9]", after) or re.match(r"[a-z]?$", before):
                groups.setdefault((f"{before}*{after}", unit), {})[match[0]] = name
    return [
        (template, [found[m] for m in members if m in found], unit)
        for (template, unit), found in groups.items()
    ]


def _matrices(columns: Mapping[str, Column], file: str) -> Iterator[ColumnFamily]:
    """Direction cosine matrices: nine columns with two indices."""
    indexed: dict[str, dict[str, str]] = {}
    for name in columns:
        match = re.fullmatch(r"(.*?)_?\[?([0-3])[_,\]\[]*([0-3])\]?", name)
        if match:
            indexed.setdefault(match[1], {})[match[2] + match[3]] = name
    for found in indexed.values():
        keys = sorted(found)
        if keys in ([f"{i}{j}" for i in indices for j in indices] for indices in ("123", "012")):
            yield ColumnFamily("attitude", tuple(found[key] for key in keys), form="dcm")


def _quaternions(columns: Mapping[str, Column], file: str) -> Iterator[ColumnFamily]:
    for members, scalar in _WORDS["quaternions"]:
        for template, names, unit in _groups(columns, members):
            word = re.sub(r"[./]0$", "", template.partition("*")[0]).strip("_ [./")
            is_quaternion = _QUATERNION.fullmatch(word) and not _OTHER.fullmatch(word)
            if len(names) == 4 and is_quaternion and not unit:
                yield ColumnFamily("attitude", tuple(names), form="quaternion", scalar=scalar)


def _vectors(columns: Mapping[str, Column], file: str) -> Iterator[ColumnFamily]:
    """Three columns a vector, or one a wheel."""
    taken: set[str] = set()
    candidates = [
        (members, *group) for members in _members(columns) for group in _groups(columns, members)
    ]
    # Of [0] to [3] all four are meant, not [1] to [3].
    for members, template, names, unit in sorted(candidates, key=lambda c: -len(c[2])):
        names = [name for name in names if name not in taken]
        stated = columns[names[0]].unit if names else ""
        family = _vector(template, names, (unit, stated), file, members)
        if family is not None:
            yield family
            taken |= set(names)


def _members(columns: Mapping[str, Column]) -> list[list[str]]:
    """Words in which columns of one quantity differ: names of axes, and numbers from 0 or 1."""
    numbers = [int(number) for name in columns for number in re.findall(r"\d+", name)]
    last = max((number for number in numbers if number <= LIMITS.last_index), default=0)
    counted = ([f"{k:0{n}}" for k in range(first, last + 1)] for n in (1, 2) for first in (1, 0))
    return [*_WORDS["members"], *filter(None, counted)]


def _filled(columns: Mapping[str, Column]) -> dict[str, Column]:
    """Columns without the places at the end of an array that no wheel fills."""
    idle: set[str] = set()
    for members in _members(columns):
        for _, names, _ in _groups(columns, members):
            is_array = len(names) > LIMITS.most_wheels
            while is_array and names and not np.any(columns[names[-1]].values):
                idle.add(names.pop())
    return {name: column for name, column in columns.items() if name not in idle}


def _single_wheels(columns: Mapping[str, Column], file: str) -> Iterator[ColumnFamily]:
    """Columns of a single wheel."""
    seen: set[str] = set()
    for name, (stem, unit) in _stems(columns).items():
        family = _vector(stem, [name], (unit, columns[name].unit), file, ("",))
        if family is not None and family.holds not in seen:
            yield family
            seen.add(family.holds)


def _vector(
    template: str, names: list[str], units: tuple[str, str], file: str, members: Sequence[str]
) -> ColumnFamily | None:
    """Content of columns of one template; None if the names do not say it.

    `units`: the one with which the names end, and the one that the file states.
    """
    text = re.sub(r"[./]0$", "", template.replace("*", "")).strip("_ .[]/")
    if _OTHER.fullmatch(text):
        return None
    if members[0] in ("roll", "phi") and len(names) == 3 and not _SETPOINT.fullmatch(file.lower()):
        # Yaw first is the usual sequence.
        return ColumnFamily("attitude", tuple(reversed(names)), *units, form="euler")
    if "sigma" in text and len(names) == 3 and not units[0]:
        return ColumnFamily("attitude", tuple(names), form="mrp")
    squeezed = re.sub(r"[^a-z0-9]", "", (units[0] or units[1]).lower())
    holds = _kind(text, squeezed, file.lower(), members)
    if holds is None or not names or (not holds.startswith("wheel") and len(names) != 3):
        return None
    return ColumnFamily(holds, tuple(names), *units)


def _kind(text: str, unit: str, file: str, members: Sequence[str]) -> str | None:
    """Content of a template, by its unit, its words, and the name of its file."""
    if unit in _WORDS["of_unit"]:
        return str(_WORDS["of_unit"][unit])
    of_wheels = re.search(r"wheel|whl|rw|hwhl", f"{text} {file}")
    if unit in ("rads", "degs") or (of_wheels and re.search("omega|rate|velocity", text)):
        return "wheel_speed" if of_wheels else "rate"
    for holds, words in _WORDS["kinds"].items():
        if re.fullmatch(words, text) and (
            of_wheels or not holds.startswith("wheel") or len(text) > 2
        ):
            return holds
    if members[0] == "p" and not text:
        return "rate"
    stem = re.sub(r"[^a-z]", "", file.partition(".")[0])
    for holds, words in _WORDS["kinds"].items():
        vector = text in _ANY_VECTOR and not holds.startswith("wheel")
        other = _OTHER.fullmatch(stem) or (not of_wheels and _SETPOINT.fullmatch(stem))
        if (len(text) <= 2 or vector) and re.fullmatch(words, stem) and not other:
            return str(holds)
    return None


_CLOCKS = by_word({"gps": "gps", "tai": "tai", "unix": "unix posix epoch"})
_TIME_OF_DAY = re.compile(r"\d{1,2}:\d{2}(:[\d.,]+)?")
_ZONE = re.compile(r"(Z|UTC|:[\d.]+\s*[+-]\d{2}:?\d{2})$")
# Logs of spacecraft are from these years.
_FIRST, _LAST = np.datetime64("1995-01-01"), np.datetime64("2060-01-01")


@dataclass(frozen=True)
class ClockGuess:
    """The clock of a column of stamps."""

    kind: str  # As a mapping names it; "?" where only the user can know it
    why: str = ""  # What shows it; "" for "?"
    hint: str = ""  # What helps the user to answer; "" where nothing does


def guessed_clock(table: Table, names: Sequence[str]) -> ClockGuess:
    """The clock of the columns of the time, as far as name, unit and size show it; else "?".

    >>> ms = Table("a.csv", {"unix_ms": Column(np.array([1772366400000.0, 1772366400250.0]))})
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
        if len(names) == 1 and _TIME_OF_DAY.fullmatch(last):
            return ClockGuess("s", "the seconds of these times of the day")
        zoned = _ZONE.search(last.upper()) or "utc" in words
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


def _of_days(column: Column, words: Sequence[str]) -> ClockGuess:
    """The clock of a column of whole days beside one of parts of the day."""
    days = column.values[np.isfinite(column.values)][:1]
    if {"mjd", "jd"} & {*words}:
        return _of_numbers(column, words)
    date = np.datetime64(int(days[0]) - 4383, "D") if len(days) and abs(days[0]) < 1e5 else None
    if date is not None and _FIRST < date < _LAST:
        return ClockGuess("cds", f"the first day counted from 1958 is {date}")
    return ClockGuess("day", "from the names of the columns")


def _of_numbers(column: Column, words: Sequence[str]) -> ClockGuess:
    """The clock of a column of counts."""
    numbers = column.values.astype(float)
    numbers = numbers[np.isfinite(numbers)]
    stated = UNIT_WORDS.get(column.unit.lower().strip(), "")
    unit = stated or (UNIT_WORDS.get(words[-1], "") if len(words) > 1 else "")
    dates = _dates(numbers, unit)
    for day in ("mjd", "jd"):
        if day in words:
            named = [f"{day}_{scale}" for scale in ("utc", "tai", "tt") if scale in words]
            if len(named) == 1:
                return ClockGuess(named[0], "from the name of the column")
            hint = f"The column counts days: {day}_utc, {day}_tai or {day}_tt."
            return ClockGuess(UNKNOWN, hint=hint)
    clocks = {_CLOCKS[word] for word in words if word in _CLOCKS}
    fitting = [kind for kind in dates if kind.partition("_")[0] in clocks]
    if len(fitting) == 1:
        return ClockGuess(fitting[0], "from the name and the size of the numbers")
    if dates:
        listed = ", ".join(f"{date} as {kind}" for kind, date in dates.items())
        return ClockGuess(UNKNOWN, hint=f"The first row is {listed}.")
    if unit in FREE_CLOCKS:
        why = "the file states the unit" if stated else "from the name of the column"
        return ClockGuess(unit, why)
    return ClockGuess(UNKNOWN)


def _dates(numbers: np.ndarray, unit: str) -> dict[str, str]:
    """The kinds by which the first stamp is a date of spaceflight, and that date in UTC."""
    if not len(numbers):
        return {}
    kinds = [kind for kind in COUNTED_CLOCKS if unit in ("", kind.rpartition("_")[2])]
    dates = ((kind, dates_of(float(numbers[0]), kind)) for kind in kinds)
    return {
        kind: f"{date.astype('datetime64[s]')}Z"
        for kind, date in dates
        if date is not None and _FIRST < date < _LAST
    }
