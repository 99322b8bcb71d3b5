"""A mapping to be filled in, written from the columns of raw files.

What files and names of columns say is suggested; what only the user can know is asked ("?").
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from bayes_inertia.errors import OutputError
from bayes_inertia.files import write_atomically
from bayes_inertia.importing.column_families import (
    ColumnFamily,
    families,
    time_names,
)
from bayes_inertia.importing.mapping_schema import MAPPING_FORMAT
from bayes_inertia.importing.questions import UNKNOWN, open_questions, question_at
from bayes_inertia.importing.raw_files import read_raw, tables_in
from bayes_inertia.importing.raw_table import RawTable
from bayes_inertia.importing.stated_facts import stated_attitude

_WIDTH = 96  # Of a comment.
# Counts of seconds since 1970, 1980 or 1958 lie between these numbers in this century.
_SECONDS_OF_DATES = (5e8, 4e9)
_ORDER = (
    "rate",
    "wheel_torque",
    "wheel_momentum",
    "wheel_speed",
    "attitude",
    "magnetic_field",
    "position",
)
_WHEEL_STREAMS = ("wheel_torque", "wheel_momentum", "wheel_speed")


@dataclass(frozen=True)
class _Group:
    """Files whose tables have the same columns."""

    files: tuple[Path, ...]
    table_name: str
    table: RawTable


def write_starting_mapping(files: Sequence[str | Path], path: str | Path) -> int:
    """Write a mapping with a question at everything that the files do not say.

    Parameters
    ----------
    files : sequence of str or Path
        Raw files.
    path : str or Path
        The mapping to write; must not exist.

    Returns
    -------
    int
        Number of questions.

    Raises
    ------
    CampaignError
        If a file cannot be read.
    OutputError
        If the mapping exists, or cannot be written.
    """
    path = Path(path)
    if path.exists():
        raise OutputError(
            "is there already", where=str(path), advice="fill it in, or name another file"
        )
    text = starting_mapping([Path(file) for file in files])
    write_atomically(path, text)
    return len(open_questions(tomlkit.parse(text).unwrap()))


def starting_mapping(files: Sequence[Path]) -> str:
    """The text of a mapping with a question at everything that the files do not say.

    Parameters
    ----------
    files : sequence of Path
        Raw files.

    Returns
    -------
    str
        TOML with comments.

    Raises
    ------
    CampaignError
        If a file cannot be read.
    """
    groups = _groups(files)
    streams: list[tuple[_Group, ColumnFamily]] = []
    for group in groups:
        streams += [(group, family) for family in _families(group)]
    streams.sort(key=lambda stream: _ORDER.index(stream[1].holds))
    parts = [_head(streams)]
    held: set[str] = set()
    for group, family in streams:
        # A second candidate for what may stand once is left to the user.
        doubled = family.holds in held and family.holds not in _WHEEL_STREAMS
        parts.append(_stream(group, family, commented=doubled))
        held.add(family.holds)
    parts += [_left_over(groups, streams), _cut()]
    return "\n".join(parts)


def _groups(files: Sequence[Path]) -> list[_Group]:
    """Files by their columns."""
    groups: dict[tuple, _Group] = {}
    for path in sorted(set(files)):
        for name in tables_in(path):
            table = read_raw(path, table=name)
            key = (name, path.suffix, tuple(table.columns), re.sub(r"\d+", "", path.stem))
            before = groups.get(key)
            group = (path,) if before is None else (*before.files, path)
            groups[key] = _Group(group, name, table if before is None else before.table)
    return list(groups.values())


def _families(group: _Group) -> list[ColumnFamily]:
    found = families(group.table, group.files[0].name)
    if group.table.attitude is not None:
        form = "quaternion" if group.table.attitude.scalar else "euler"
        found = [family for family in found if family.holds != "attitude"]
        found.insert(0, ColumnFamily("attitude", group.table.attitude.names, form=form))
    return found


def _pattern(files: Sequence[Path]) -> list[str]:
    """Names of files; one pattern where they differ in a number only."""
    names = [path.name for path in files]
    patterns = {re.sub(r"\d+(?=\D*$)", "*", name) for name in names}
    return sorted(patterns) if len(names) > 1 and len(patterns) == 1 else names


def _toml(value: Any) -> str:
    """A value as TOML writes it on one line."""
    if isinstance(value, dict):
        inner = ", ".join(f"{key} = {_toml(inner)}" for key, inner in value.items())
        return f"{{ {inner} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(_toml(inner) for inner in value)}]"
    return tomlkit.item(value).as_string()


def _comment(text: str) -> str:
    return "\n".join(f"# {line}" for line in textwrap.wrap(text, _WIDTH))


def _entry(path: tuple[str, ...], value: Any, comment: str = "") -> str:
    """One key, with its question above where it is open."""
    text = f"{path[-1]} = {_toml(value)}"
    if open_questions({"value": value}):
        return f"{_comment(question_at(path))}\n{text}"
    return f"{text}  # {comment}" if comment else text


def _head(streams: Sequence[tuple[_Group, ColumnFamily]]) -> str:
    """Format, name and hardware."""
    lines = [
        '# What the raw logs hold. Answer every question: replace each "?" and delete what does',
        "# not apply. Suggestions come from the files and from names of columns: check them.",
        f'format = "{MAPPING_FORMAT}"',
        _entry(("name",), UNKNOWN),
        "",
        "[inertia]",
        *(
            _entry(("inertia", key), UNKNOWN)
            for key in ("tensor", "relative_sigma", "product_sigma", "includes_wheel_spin")
        ),
    ]
    wheels = [family.names for _, family in streams if family.holds in _WHEEL_STREAMS]
    for k in range(max(map(len, wheels), default=0)):
        lines += [
            "",
            "[[wheels]]",
            f'name = "wheel_{k + 1}"',
            _entry(("wheels", "", "axis"), UNKNOWN),
            _entry(("wheels", "", "spin_inertia"), UNKNOWN),
            "# momentum_sigma = ...  # noise of the tachometer [N m s]; the import measures it",
        ]
    lines += [
        "",
        "[rate_sensor]",
        "# sigma = ...  # white noise per sample [rad/s]; left out, the import says what it sees",
        "# scale_factor_sigma = 0.03",
        "# bias_sigma = 1e-5  # [rad/s]",
    ]
    if any(family.holds == "attitude" for _, family in streams):
        lines += [
            "",
            "[star_tracker]",
            _entry(("star_tracker", "boresight"), UNKNOWN),
            "# sigma_cross = ...  # noise across the boresight [rad]; left out, the import says",
            "# sigma_roll = ...  # and about it [rad]",
        ]
    return "\n".join(lines) + "\n"


def _stream(group: _Group, family: ColumnFamily, *, commented: bool) -> str:
    """One `[[streams]]`."""
    path = ("streams", family.holds)
    stated = family.holds == "attitude" and group.table.attitude is not None
    why = "the file says so" if stated else "a guess from the names"
    lines = ["[[streams]]", _entry((*path, "holds"), family.holds, why)]
    lines.append(_entry((*path, "files"), _pattern(group.files)))
    if group.table_name:
        lines.append(_entry((*path, "table"), group.table_name))
    lines += _time(group, path)
    lines.append("offset_s = 0.0  # true time minus stamp [s]")
    if family.holds == "attitude":
        lines += _attitude(group, family)
    else:
        lines.append(_entry((*path, "names"), list(family.names)))
        lines += _unit(family, path)
        lines.append("# scale = 1.0  # for counts: reading = scale * count + offset, in this unit")
        sense = {"wheel_torque": "acts_on", "wheel_momentum": "relative_to"}
        key = sense.get(family.holds, "relative_to" if family.holds == "wheel_speed" else "frame")
        lines.append(_entry((*path, key), UNKNOWN))
    flags = [n for n in group.table.columns if re.search(r"valid|flag|status|quality", n.lower())]
    if flags:
        lines.append(f'# valid = {{ name = "{flags[0]}", equals = 1 }}  # rows that count')
    text = "\n".join(lines) + "\n"
    return "\n".join(f"# {line}" for line in text.splitlines()) + "\n" if commented else text


def _unit(family: ColumnFamily, path: tuple[str, ...]) -> list[str]:
    if family.stated_unit:
        return [f"# the file states the unit: {family.stated_unit}"]
    if family.unit:
        return [_entry((*path, "unit"), family.unit, "from the names of the columns")]
    return [_entry((*path, "unit"), UNKNOWN)]


def _attitude(group: _Group, family: ColumnFamily) -> list[str]:
    """Form, columns and sense of attitudes; what the file states is left out."""
    stated = stated_attitude(group.table)
    path = ("streams", "attitude")
    values: dict[str, Any] = {"form": family.form, "names": list(family.names)}
    if family.form == "quaternion":
        values["scalar"] = family.scalar or UNKNOWN
    if family.form == "euler":
        values |= {"sequence": UNKNOWN, "turns": UNKNOWN, "unit": family.unit or UNKNOWN}
    values |= {"maps": UNKNOWN, "frame": UNKNOWN}
    lines = [
        _entry((*path, key), value, "from the names of the columns" if key == "scalar" else "")
        for key, value in values.items()
        if not stated.get(key)
    ]
    if stated:
        told = ", ".join(f"{key} = {_toml(value)}" for key, value in stated.items() if value)
        lines.append(_comment(f"the file states {told}"))
    lines.append('# body_from_tracker = [[...], [...], [...]]  # with frame = "tracker"')
    return lines


def _time(group: _Group, path: tuple[str, ...]) -> list[str]:
    """The stamps: columns, clock, zero."""
    table = group.table
    if table.time_names and table.time_kind and table.time_kind not in ("s", "ms", "us", "ns"):
        return [f"# the file states its time: {', '.join(table.time_names)} ({table.time_kind})"]
    names = time_names(table)
    kind, why = _kind_of_time(table, names)
    entry: dict[str, Any] = {"names": names or UNKNOWN, "kind": kind}
    if kind in ("s", "ms", "us", "ns", "min", "h"):
        entry["epoch"] = UNKNOWN
    questions = [
        _comment(f"{key}: {question_at(('streams', 'time', key))}")
        for key, value in entry.items()
        if value == UNKNOWN
    ]
    line = f"time = {_toml(entry)}"
    return [*questions, f"{line}  # {why}" if why else line]


def _kind_of_time(table: RawTable, names: Sequence[str]) -> tuple[str, str]:
    """The clock of columns as far as they show it, and what shows it."""
    if not names:
        return UNKNOWN, ""
    if table.time_kind and list(table.time_names) == list(names):
        return table.time_kind, "the file states the kind"
    column, name = table.column(names[0]), names[0].lower()
    if len(names) == 2:
        return "gps_week", "from the names of the columns"
    if column.is_text:
        first = str(column.values[0]).strip()
        zoned = first.upper().endswith(("Z", "UTC")) or "utc" in name
        return ("utc", "the dates say so") if zoned else (UNKNOWN, "")
    numbers = column.values[np.isfinite(column.values.astype(float))].astype(float)
    size = float(np.abs(numbers).max()) if len(numbers) else 0.0
    if _SECONDS_OF_DATES[0] < size < _SECONDS_OF_DATES[1]:
        for word in ("gps", "tai", "unix"):
            if word in name:
                return f"{word}_s", "from the name and the size of the numbers"
        return UNKNOWN, ""
    ending = column.unit or re.split(r"[_\s\[\]().]+", names[0].strip("[]() "))[-1]
    if ending in ("s", "ms", "us", "ns") and (column.unit or ending != names[0]):
        return ending, "the file states the unit" if column.unit else "from the name of the column"
    return UNKNOWN, ""


def _left_over(groups: Sequence[_Group], streams: Sequence[tuple[_Group, ColumnFamily]]) -> str:
    """Columns that no stream holds."""
    lines = []
    for group in groups:
        used = {name for other, family in streams if other is group for name in family.names}
        rest = [n for n in group.table.columns if n not in used | set(time_names(group.table))]
        if rest:
            where = f"{group.files[0].name} {group.table_name}".strip()
            lines.append(_comment(f"not recognised in {where}: {', '.join(rest)}"))
    return "\n".join(lines) + "\n" if lines else ""


def _cut() -> str:
    return """\
# [cut]  # how the log becomes slews; without it, at the rests
# before_s = 30.0  # rest kept before a motion [s]; without it, as long as the motion
# after_s = 30.0
# rest_rate = 1e-4  # [rad/s]; a slew exceeds it

# [[slews]]  # or name the slews
# name = "slew 1"
# start = "2026-03-01T12:00:00Z"
# end = "2026-03-01T12:05:00Z"
"""
