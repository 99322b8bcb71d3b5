"""A mapping to be filled in, written from the columns of raw files.

Basilisk writes the frame into the name: omega_BN_B is the rate of B against N in axes of B,
sigma_BN the modified Rodrigues parameters of B from N; its wheelSpeeds are relative to the body
[rad/s], and its motorTorque acts on the wheel [N m]. 42's wbn is in axes of the body, its Hwhl the
whole about the spin axis. ROS (REP 103) and PX4 write rates in rad/s and the quaternion
that takes vectors of the body to the world; PX4 begins it with the scalar and counts microseconds.
Names with _B or "body" say that the axes are the body's.

What files and names of columns say is suggested; what only the user can know is asked ("?").
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from bayes_inertia.errors import OutputError, require
from bayes_inertia.files import vocabulary, write_atomically
from bayes_inertia.importing.column_families import (
    ClockGuess,
    ColumnFamily,
    families,
    guessed_clock,
)
from bayes_inertia.importing.limits import LIMITS
from bayes_inertia.importing.log_reader import require_files
from bayes_inertia.importing.logged_stream import SHARED_ZERO
from bayes_inertia.importing.mapping_schema import MAPPING_FORMAT, STREAM_TYPES
from bayes_inertia.importing.questions import (
    UNKNOWN,
    mapping_comment,
    mapping_entry,
    mapping_value,
    open_questions,
    question_at,
)
from bayes_inertia.importing.stream_readings import stated_attitude
from bayes_inertia.tables.raw_files import read_raw, tables_in
from bayes_inertia.tables.table import Table
from bayes_inertia.tables.time_stamps import FREE_CLOCKS, split_unit, stamp_units, time_names
from bayes_inertia.tables.time_texts import is_date

_FROM_NAMES = "from the names of the columns"


@dataclass(frozen=True)
class FileGroup:
    """Files whose tables have the same columns."""

    files: tuple[Path, ...]  # The files
    table_name: str  # Their table; "" for files that are one table
    table: Table  # The first of them
    # Of tables with rows of several packets, the column that says which, and its value
    packet: tuple[str, str | int] | None = None


def _stream(group: FileGroup, family: ColumnFamily, *, commented: bool) -> dict[str, Any]:
    """What the template says of a stream; a second candidate is `commented`, for the user."""
    holds, table, says = family.holds, group.table, _said(group, family)
    flags = [n for n in table.columns if re.search(r"valid|flag|status|quality", n.lower())]
    keys = STREAM_TYPES[holds].model_fields
    sense = next(key for key in ("acts_on", "relative_to", "frame") if key in keys)
    stated = stated_attitude(table) if holds == "attitude" else {}
    entries = _attitude(table, family, says, stated) if holds == "attitude" else []
    if holds != "attitude":
        entries.append(("names", list(family.names), "", ""))
        unit, why = says.get("unit", ("", ""))
        if not family.stated_unit:
            hint = _range(table, family.names)
            unit = family.unit or unit or UNKNOWN
            entries.append(("unit", unit, why or _FROM_NAMES, hint))
    return {
        "group": group,
        "family": family,
        "why": "the file says so" if stated else "a guess from the names",
        "files": _pattern(group.files),
        "time": _time(group),
        "entries": entries,
        "sense": sense,
        "senses": says.get(sense, (UNKNOWN, "")),
        "stated": stated,
        "told": ", ".join(f"{key} = {mapping_value(v)}" for key, v in stated.items() if v),
        "flag": next(iter(flags), ""),
        "commented": commented,
    }


def _pattern(files: Sequence[Path]) -> list[str]:
    """Names of files; one pattern where they differ in a number only."""
    names = [path.name for path in files]
    patterns = {re.sub(r"\d+(?=\D*$)", "*", name) for name in names}
    return sorted(patterns) if len(names) > 1 and len(patterns) == 1 else names


def _said(group: FileGroup, family: ColumnFamily) -> dict[str, tuple[str, str]]:
    """Content by the name of the first column, or of a file of PX4, which is its message."""
    stem, name = group.table_name or group.files[0].stem, family.names[0]
    return notation_of(family.holds, f"{stem}/{name}" if "vehicle_" in stem else name)


def _guessed_clock(group: FileGroup) -> ClockGuess:
    """The clock that the stamps show, or that the notation of the columns and the file says."""
    names = time_names(group.table)
    guess = guessed_clock(group.table, names)
    columns = " ".join([*group.table.columns, f"{group.files[0].stem}/{' '.join(names)}"])
    says = notation_of("time", columns)
    return ClockGuess(*says["kind"]) if guess.kind == UNKNOWN and says else guess


def _range(table: Table, names: Sequence[str]) -> str:
    """Between what the readings of columns lie."""
    values = np.concatenate([table.columns[name].values.astype(float) for name in names])
    values = values[np.isfinite(values)]
    if not len(values):
        return ""
    return f"The readings lie between {values.min():.3g} and {values.max():.3g}."


def _attitude(
    table: Table, family: ColumnFamily, says: dict[str, tuple[str, str]], stated: dict[str, Any]
) -> list[tuple[str, Any, str, str]]:
    """Form, columns and sense of attitudes; what the file states is left out."""
    values: dict[str, tuple[Any, str]]
    values = {"form": (family.form, ""), "names": (list(family.names), "")}
    if family.form == "quaternion":
        scalar = (family.scalar or UNKNOWN, _FROM_NAMES)
        values["scalar"] = scalar if family.scalar else says.get("scalar", scalar)
    if family.form == "euler":
        values |= {"sequence": (UNKNOWN, ""), "turns": (UNKNOWN, "")}
        values["unit"] = (family.unit or family.stated_unit or UNKNOWN, _FROM_NAMES)
    values |= {key: says.get(key, (UNKNOWN, "")) for key in ("maps", "frame")}
    return [
        (key, value, why, _scalar_hint(table, family, key))
        for key, (value, why) in values.items()
        if not stated.get(key)
    ]


def _scalar_hint(table: Table, family: ColumnFamily, key: str) -> str:
    """First and last of four columns, where the scalar is asked."""
    if key != "scalar":
        return ""
    first, last = (_range(table, [family.names[k]]) for k in (0, -1))
    return f"{family.names[0]}: {first} {family.names[-1]}: {last}" if first and last else ""


def _time(group: FileGroup) -> str:
    """The stamps: columns and clock."""
    table = group.table
    if table.time_names and table.time_kind and table.time_kind not in FREE_CLOCKS:
        return f"# the file states its time: {', '.join(table.time_names)} ({table.time_kind})"
    names = time_names(table)
    guess = _guessed_clock(group)
    entry: dict[str, Any] = {"names": names or UNKNOWN, "kind": guess.kind}
    units = stamp_units(table, names)
    if len(names) > 1 and set(units) != {"date"}:
        entry["units"] = [unit or UNKNOWN for unit in units]
    if (
        len(names) == 1
        and guess.kind == "utc"
        and not is_date(str(table.column(names[0]).values[0]))
    ):
        entry["format"] = UNKNOWN
    asked = [key for key, value in entry.items() if value == UNKNOWN]
    hints = {"kind": guess.hint}
    questions = [
        mapping_comment(f"{key}: {question_at(('streams', 'time', key))} {hints.get(key, '')}")
        for key in asked
    ]
    line = f"time = {mapping_value(entry)}"
    return "\n".join([*questions, f"{line}  # {guess.why}" if guess.why else line])


def notation_of(holds: str, name: str) -> dict[str, tuple[str, str]]:
    """For keys of a stream, a value and whose notation says it, by the name of a column.

    >>> notation_of("rate", "omega_BN_B[0]")["frame"], notation_of("rate", "gx_dps")
    (('body', "Basilisk's notation"), {})
    """
    for notation in vocabulary("importing")["notations"]:
        if notation["holds"] == holds and re.search(notation["name"], name):
            why = f"{notation['whose']} notation"
            return {key: (value, why) for key, value in notation["says"].items()}
    return {}


# Names, in small letters, of a column that says which packet a row is.
_PACKET = re.compile(r"(.*[ _.])?(packet|pkt|apid|msg|message|record)([ _]?(type|name|id))?")


@dataclass(frozen=True)
class StartingMapping:
    """A mapping to be filled in."""

    text: str  # TOML with comments
    questions: int  # Number of questions that it asks
    streams: tuple[str, ...]  # What the streams that were recognised hold
    left_over: tuple[str, ...]  # Columns that no stream holds, such as "gyro.csv: c1, c2"


def write_starting_mapping(files: Sequence[str | Path], path: str | Path) -> StartingMapping:
    """Write a mapping with a question at everything that the files do not say."""
    path = Path(path)
    advice = "fill it in, or name another file"
    require(not path.exists(), str(path), "is there already", advice, error=OutputError)
    started = starting_mapping([Path(file) for file in files])
    write_atomically(path, started.text)
    return started


def starting_mapping(files: Sequence[Path]) -> StartingMapping:
    """A mapping with a question at everything that the files do not say."""
    require_files(files)
    groups = _groups(files)
    streams = [(group, family) for group in groups for family in _families(group)]
    streams.sort(key=lambda stream: list(STREAM_TYPES).index(stream[1].holds))
    entries = []
    held: dict[str, None] = {}
    for group, family in streams:
        # A second candidate for what may stand once is left to the user.
        doubled = family.holds in held and not STREAM_TYPES[family.holds].of_wheels()
        entries.append(_stream(group, family, commented=doubled))
        held[family.holds] = None
    of_wheels = [f.names for _, f in streams if STREAM_TYPES[f.holds].of_wheels()]
    epoch = ""
    # Not where file or stamps say the date.
    if any(_guessed_clock(group).kind in FREE_CLOCKS for group, _ in streams):
        epoch = SHARED_ZERO if len(set(files)) == 1 else UNKNOWN
    left_over = _left_over(groups, streams)
    text = _template().render(
        format=MAPPING_FORMAT,
        # The folder of the logs gives the name.
        name=(files[0].resolve().parent.name if files else "") or "campaign",
        epoch=epoch,
        wheels=wheel_words(max(of_wheels, key=len, default=())),
        axes=_AXES,
        tracker="attitude" in held,
        streams=entries,
        files=sorted({path.name for path in files}),
        left_over=left_over,
    )
    questions = len(open_questions(tomlkit.parse(text).unwrap()))
    return StartingMapping(text, questions, tuple(held), tuple(left_over))


def _template() -> Any:
    """The mapping to be filled in, without what the files say."""
    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    words = {"entry": mapping_entry, "comment": mapping_comment, "value": mapping_value}
    source = Path(__file__).with_suffix(".toml.jinja").read_text(encoding="utf-8")
    return environment.from_string(source, globals=words)


def _groups(files: Sequence[Path]) -> list[FileGroup]:
    """Files by their columns."""
    groups: dict[tuple, FileGroup] = {}
    for path in sorted(set(files)):
        for name in tables_in(path):
            for packet, table in _packets(read_raw(path, table=name)).items():
                stem = re.sub(r"\d+", "", path.stem)
                key = (name, packet, path.suffix, tuple(table.columns), stem)
                group = groups.setdefault(key, FileGroup((), name, table, packet))
                groups[key] = replace(group, files=(*group.files, path))
    return list(groups.values())


def _packets(table: Table) -> dict[tuple[str, str | int] | None, Table]:
    """The rows of each packet where a column says which, with the columns that it fills."""
    for name, column in table.columns.items():
        values, counts = np.unique(column.values, return_counts=True)
        several = 1 < len(values) <= LIMITS.most_packets < counts.sum()
        if several and _PACKET.fullmatch(name.lower()):
            of_row = column.values == values[:, None]
            parts = zip(values.tolist(), of_row, strict=True)
            return {
                (name, value if isinstance(value, str) else int(value)): _filled(table, name, rows)
                for value, rows in parts
            }
    return {None: table}


def _filled(table: Table, packet: str, rows: np.ndarray) -> Table:
    """Some rows of a table, without the packet and columns in which they hold nothing."""
    columns = {
        name: column.only(rows)
        for name, column in table.columns.items()
        if name != packet and (column.is_text or np.isfinite(column.values[rows]).any())
    }
    return replace(table, columns=columns, lines=None)


def _families(group: FileGroup) -> list[ColumnFamily]:
    packet = "" if group.packet is None else f"{group.packet[1]}_"
    found, stated = families(group.table, packet + group.files[0].name), group.table.attitude
    if group.table_name:
        # A topic of PX4 or ROS names what its message holds, where its fields do not.
        found = families(group.table, group.table_name.replace(".", "_")) or found
    if stated is None:
        return found
    family = ColumnFamily("attitude", stated.names, form="quaternion" if stated.scalar else "euler")
    return [family, *(other for other in found if other.holds != "attitude")]


def _left_over(
    groups: Sequence[FileGroup], streams: Sequence[tuple[FileGroup, ColumnFamily]]
) -> list[str]:
    """Columns that no stream holds, by file."""
    lines = []
    for group in groups:
        used = {name for other, family in streams if other is group for name in family.names}
        rest = [n for n in group.table.columns if n not in used | set(time_names(group.table))]
        if rest:
            packet = "" if group.packet is None else str(group.packet[1])
            where = " ".join(filter(None, (group.files[0].name, group.table_name, packet)))
            lines.append(f"{where}: {', '.join(rest)}")
    return lines


_AXES = {"x": [1.0, 0.0, 0.0], "y": [0.0, 1.0, 0.0], "z": [0.0, 0.0, 1.0]}


def wheel_words(names: Sequence[str]) -> list[str]:
    """A word for each wheel that tells its columns apart: "x" of "cmd_wheel_x", or a number.

    >>> wheel_words(["cmd_wheel_x", "cmd_wheel_y"]), wheel_words(["rw1_rpm", "rw2_rpm"])
    (['x', 'y'], ['1', '2'])
    """
    stems = [split_unit(name)[0] for name in names]
    before = _shared(stems)
    after = _shared([stem[before:][::-1] for stem in stems])
    words = [stem[before : len(stem) - after].lower() for stem in stems]
    usable = len(set(words)) == len(words) and all(re.fullmatch(r"[a-z0-9]+", w) for w in words)
    return words if usable and len(words) > 1 else [str(k + 1) for k in range(len(words))]


def _shared(texts: Sequence[str]) -> int:
    """Number of letters with which all texts begin."""
    columns = list(zip(*texts, strict=False))
    return next((k for k, letters in enumerate(columns) if len(set(letters)) > 1), len(columns))
