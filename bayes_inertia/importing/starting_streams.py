"""One `[[streams]]` of a mapping to be filled in.

What names of columns say by a notation that a simulator defines; suggestions, said as such.

Basilisk writes the frame into the name: omega_BN_B is the rate of B against N in axes of B,
sigma_BN the modified Rodrigues parameters of B from N; its wheelSpeeds are relative to the body
[rad/s], and its motorTorque acts on the wheel [N m]. 42's wbn is in axes of the body, its Hwhl the
whole momentum about the spin axis. ROS (REP 103) and PX4 write rates in rad/s and the quaternion
that takes vectors of the body to the world; PX4 begins it with the scalar and counts microseconds.
Names with _B or "body" say that the axes are the body's.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from bayes_inertia.importing.clock_guess import ClockGuess, guessed_clock
from bayes_inertia.importing.column_families import ColumnFamily
from bayes_inertia.importing.mapping_text import mapping_comment, mapping_entry, mapping_value
from bayes_inertia.importing.questions import UNKNOWN, question_at
from bayes_inertia.importing.stated_facts import stated_attitude
from bayes_inertia.tables.raw_table import RawTable
from bayes_inertia.tables.time_columns import stamp_units, time_names
from bayes_inertia.tables.time_stamps import FREE_CLOCKS

_SENSES = {
    "wheel_torque": "acts_on",
    "wheel_momentum": "relative_to",
    "wheel_speed": "relative_to",
}
_FROM_NAMES = "from the names of the columns"


@dataclass(frozen=True)
class FileGroup:
    """Files whose tables have the same columns.

    Parameters
    ----------
    files : tuple of Path
        The files.
    table_name : str
        Their table; "" for files that are one table.
    table : RawTable
        The first of them.
    packet : tuple of str and (str or int), optional
        Of tables with rows of several packets, the column that says which, and its value.
    """

    files: tuple[Path, ...]
    table_name: str
    table: RawTable
    packet: tuple[str, str | int] | None = None


def stream_text(group: FileGroup, family: ColumnFamily, *, commented: bool = False) -> str:
    """A stream of a mapping, with a question at everything that the files do not say.

    `commented`: whether it is a second candidate, which the user must choose.
    """
    path = ("streams", family.holds)
    stated = family.holds == "attitude" and group.table.attitude is not None
    why = "the file says so" if stated else "a guess from the names"
    lines = ["[[streams]]", mapping_entry((*path, "holds"), family.holds, why)]
    lines.append(mapping_entry((*path, "files"), _pattern(group.files)))
    if group.table_name:
        lines.append(mapping_entry((*path, "table"), group.table_name))
    lines += _time(group, path)
    lines.append("offset_s = 0.0  # true time minus stamp [s]: -0.125 if stamps are 0.125 s late")
    lines += _attitude(group, family) if family.holds == "attitude" else _readings(group, family)
    if group.packet is not None:
        of_packet = dict(zip(("name", "equals"), group.packet, strict=True))
        lines.append(f"valid = {mapping_value(of_packet)}  # the rows of this packet")
    flags = [n for n in group.table.columns if re.search(r"valid|flag|status|quality", n.lower())]
    if flags and group.packet is None:
        lines.append(f'# valid = {{ name = "{flags[0]}", equals = 1 }}  # rows that count')
    lines.append("# missing = -9999  # what marks that there is no reading")
    text = "\n".join(lines) + "\n"
    return "\n".join(f"# {line}" for line in text.splitlines()) + "\n" if commented else text


def counts_from_zero(group: FileGroup) -> bool:
    """Whether the stamps count from a zero of their own.

    Returns: false where the file or the stamps say the date.
    """
    table = group.table
    if table.time_names and table.time_kind and table.time_kind not in FREE_CLOCKS:
        return False
    return _guessed_clock(group, time_names(table)).kind in FREE_CLOCKS


def _pattern(files: Sequence[Path]) -> list[str]:
    """Names of files; one pattern where they differ in a number only."""
    names = [path.name for path in files]
    patterns = {re.sub(r"\d+(?=\D*$)", "*", name) for name in names}
    return sorted(patterns) if len(names) > 1 and len(patterns) == 1 else names


def _readings(group: FileGroup, family: ColumnFamily) -> list[str]:
    """Columns, unit and sense of readings."""
    path = ("streams", family.holds)
    says = _said(group, family)
    lines = [mapping_entry((*path, "names"), list(family.names))]
    unit, why = says.get("unit", ("", ""))
    if family.stated_unit:
        lines.append(f"# the file states the unit: {family.stated_unit}")
    elif family.unit or unit:
        lines.append(mapping_entry((*path, "unit"), family.unit or unit, why or _FROM_NAMES))
    else:
        hint = _range(group.table, family.names)
        lines.append(mapping_entry((*path, "unit"), UNKNOWN, hint=hint))
    lines.append("# scale = 1.0  # for counts: reading = scale * count + offset, in this unit")
    key = _SENSES.get(family.holds, "frame")
    value, why = says.get(key, (UNKNOWN, ""))
    lines.append(mapping_entry((*path, key), value, why))
    return lines


def _said(group: FileGroup, family: ColumnFamily) -> dict[str, tuple[str, str]]:
    """What the name of the first column says, or that of a file of PX4, which is its message."""
    stem, name = group.files[0].stem, family.names[0]
    return notation_of(family.holds, f"{stem}/{name}" if "vehicle_" in stem else name)


def _guessed_clock(group: FileGroup, names: Sequence[str]) -> ClockGuess:
    """The clock that the stamps show, or that the notation of the columns and the file says."""
    guess = guessed_clock(group.table, names)
    columns = " ".join([*group.table.columns, f"{group.files[0].stem}/{' '.join(names)}"])
    says = notation_of("time", columns)
    return ClockGuess(*says["kind"]) if guess.kind == UNKNOWN and says else guess


def _range(table: RawTable, names: Sequence[str]) -> str:
    """Between what the readings of columns lie."""
    values = np.concatenate([table.columns[name].values.astype(float) for name in names])
    values = values[np.isfinite(values)]
    if not len(values):
        return ""
    return f"The readings lie between {values.min():.3g} and {values.max():.3g}."


def _attitude(group: FileGroup, family: ColumnFamily) -> list[str]:
    """Form, columns and sense of attitudes; what the file states is left out."""
    stated = stated_attitude(group.table)
    says = _said(group, family)
    path = ("streams", "attitude")
    values: dict[str, tuple[Any, str]] = {
        "form": (family.form, ""),
        "names": (list(family.names), ""),
    }
    if family.form == "quaternion":
        scalar = (family.scalar or UNKNOWN, _FROM_NAMES)
        values["scalar"] = scalar if family.scalar else says.get("scalar", scalar)
    if family.form == "euler":
        values |= {"sequence": (UNKNOWN, ""), "turns": (UNKNOWN, "")}
        values["unit"] = (family.unit or family.stated_unit or UNKNOWN, _FROM_NAMES)
    values |= {key: says.get(key, (UNKNOWN, "")) for key in ("maps", "frame")}
    lines = [
        mapping_entry((*path, key), value, why, _scalar_hint(group.table, family, key))
        for key, (value, why) in values.items()
        if not stated.get(key)
    ]
    if stated:
        told = ", ".join(
            f"{key} = {mapping_value(value)}" for key, value in stated.items() if value
        )
        lines.append(mapping_comment(f"the file states {told}"))
    if not stated:
        lines.append("# scale = 1.0  # for counts: element = scale * count")
    if stated.get("frame") != "body":
        lines.append('# body_from_tracker = [[...], [...], [...]]  # with frame = "tracker"')
    return lines


def _scalar_hint(table: RawTable, family: ColumnFamily, key: str) -> str:
    """What the first and the last of four columns read, where the scalar is asked."""
    if key != "scalar":
        return ""
    first, last = (_range(table, [family.names[k]]) for k in (0, -1))
    return f"{family.names[0]}: {first} {family.names[-1]}: {last}" if first and last else ""


def _time(group: FileGroup, path: tuple[str, ...]) -> list[str]:
    """The stamps: columns and clock."""
    table = group.table
    if table.time_names and table.time_kind and table.time_kind not in FREE_CLOCKS:
        return [f"# the file states its time: {', '.join(table.time_names)} ({table.time_kind})"]
    names = time_names(table)
    guess = _guessed_clock(group, names)
    entry: dict[str, Any] = {"names": names or UNKNOWN, "kind": guess.kind}
    units = stamp_units(table, names)
    if len(names) > 1 and set(units) != {"date"}:
        entry["units"] = [unit or UNKNOWN for unit in units]
    hints = {"kind": guess.hint}
    questions = [
        mapping_comment(f"{key}: {question_at((*path[:1], 'time', key))} {hints.get(key, '')}")
        for key, value in entry.items()
        if value == UNKNOWN
    ]
    line = f"time = {mapping_value(entry)}"
    return [*questions, f"{line}  # {guess.why}" if guess.why else line]


_NOTATIONS: tuple[tuple[str, re.Pattern[str], str, Mapping[str, str]], ...] = tuple(
    (holds, re.compile(pattern), why, MappingProxyType(says))
    for holds, pattern, why, says in (
        ("rate", r"omega_BN_B", "Basilisk's", {"unit": "rad/s", "frame": "body"}),
        (
            "attitude",
            r"sigma_BN",
            "Basilisk's",
            {"maps": "inertial_to_body", "frame": "body"},
        ),
        ("wheel_speed", r"wheelSpeeds", "Basilisk's", {"unit": "rad/s", "relative_to": "body"}),
        ("wheel_torque", r"motorTorque", "Basilisk's", {"unit": "N m", "acts_on": "wheel"}),
        ("rate", r"wbn\[", "42's", {"frame": "body"}),
        ("wheel_momentum", r"Hwhl\[", "42's", {"relative_to": "inertial"}),
        (
            "rate",
            r"vehicle_angular_velocity|gyro_rad",
            "PX4's",
            {"unit": "rad/s", "frame": "body"},
        ),
        ("rate", r"angular_velocity", "ROS's", {"unit": "rad/s"}),
        (
            "attitude",
            r"vehicle_attitude",
            "PX4's",
            {"scalar": "first", "maps": "inertial_to_body", "frame": "body"},
        ),
        ("attitude", r"orientation", "ROS's", {"maps": "inertial_to_body"}),
        ("time", r"timestamp_sample|vehicle_[a-z_]+_\d+/timestamp", "PX4's", {"kind": "us"}),
        ("rate", r"_B(\b|_|\[)|[Bb]ody", "a usual", {"frame": "body"}),
        ("magnetic_field", r"_(N|eci|ECI)(\b|_|\[)|inertial", "a usual", {"frame": "inertial"}),
        ("position", r"_(N|eci|ECI)(\b|_|\[)|inertial", "a usual", {"frame": "inertial"}),
    )
)


def notation_of(holds: str, name: str) -> dict[str, tuple[str, str]]:
    """What a name says by its notation.

    `holds`: what the column seems to hold, as a mapping says it. Returns: for keys of the stream a
    value, and whose notation says it; the first that fits.

    Examples
    --------
    >>> notation_of("rate", "omega_BN_B[0]")["frame"], notation_of("rate", "gx_dps")
    (('body', "Basilisk's notation"), {})
    """
    for of, pattern, whose, says in _NOTATIONS:
        if of == holds and pattern.search(name):
            return {key: (value, f"{whose} notation") for key, value in says.items()}
    return {}
