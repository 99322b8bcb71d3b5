"""What the columns of a raw table seem to hold, told from their names; suggestions, no more."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from bayes_inertia.tables.raw_table import RawColumn, RawTable
from bayes_inertia.tables.time_columns import split_unit, time_names

# Columns of one quantity differ in such a word only.
_MEMBERS = (
    ("x", "y", "z"),
    ("1", "2", "3", "4", "5", "6"),
    ("0", "1", "2", "3", "4", "5"),
    ("01", "02", "03", "04", "05", "06"),
    ("00", "01", "02", "03"),
    ("p", "q", "r"),
    ("roll", "pitch", "yaw"),
    ("phi", "theta", "psi"),
    ("a", "b", "c", "d"),
)
_QUATERNIONS: tuple[tuple[tuple[str, ...], str], ...] = (
    # Members, and where the scalar stands if their names say it.
    (("s", "x", "y", "z"), "first"),
    (("w", "x", "y", "z"), "first"),
    (("x", "y", "z", "s"), "last"),
    (("x", "y", "z", "w"), "last"),
    (("1", "2", "3", "c"), "last"),
    (("0", "1", "2", "3"), ""),
    (("1", "2", "3", "4"), ""),
    (("00", "01", "02", "03"), ""),
)
# Quantities of the same sensors and estimators that are none of a campaign.
_OTHER = re.compile(r".*(acc|linear|deriv|covar|reset|delta).*")
_SETPOINT = re.compile(r".*setpoint.*")  # What a controller wants, unless it is a wheel's command.
# Names that leave the quantity to the name of the file, as a message of ROS or PX4 does.
_ANY_VECTOR = frozenset({"xyz", "vector", "value", "data"})
# The first that fits a family's words and file decides.
_KINDS: tuple[tuple[str, re.Pattern[str]], ...] = (
    ("wheel_momentum", re.compile(r"hwhl|h_?w|h\d?|.*(momentum|nms).*")),
    ("wheel_speed", re.compile(r".*(rpm|tach|speed|omega_?w|whl_?w|rw_?omega).*")),
    ("wheel_torque", re.compile(r"u|tau|.*(torq|trq|mnm|nm$|cmd|command|motor|current).*")),
    ("magnetic_field", re.compile(r"b|.*(mag|bfield|b_[nb]|tesla|nt$|ut$).*")),
    ("position", re.compile(r"r|.*(pos|r_[bn]|eci|orbit).*")),
    (
        "rate",
        re.compile(
            r"w|g|om|.*(gyro|gyr|omega|rate|ang(ular)?_?vel|angular$|wx|wbn|wn|dps|degs|imu).*"
        ),
    ),
)


@dataclass(frozen=True)
class ColumnFamily:
    """Columns that seem to hold one quantity.

    Parameters
    ----------
    holds : str
        What they seem to hold, as a mapping says it.
    names : tuple of str
        The columns, in their order.
    unit : str
        The unit that their names end with; "" if none.
    stated_unit : str
        The unit that the file states; "" if none.
    form : str
        Of attitudes: "quaternion", "euler", "dcm" or "mrp".
    scalar : str
        Of quaternions: "first" or "last", where the names say it.
    sequence : str
        Of Euler angles: the sequence, where it is usual for the names.
    """

    holds: str
    names: tuple[str, ...]
    unit: str = ""
    stated_unit: str = ""
    form: str = ""
    scalar: str = ""
    sequence: str = ""


def families(table: RawTable, file: str) -> list[ColumnFamily]:
    """The quantities that a table seems to hold.

    `file`: name of its file, which may say what the columns do not. Returns: in the order of the
    columns; none for columns that are not recognised.

    Examples
    --------
    >>> import numpy as np
    >>> columns = dict.fromkeys(("t", "gx_dps", "gy_dps", "gz_dps"), RawColumn(np.zeros(1)))
    >>> families(RawTable("imu.csv", columns), "imu.csv")[0].unit
    'deg/s'
    """
    numbers = {
        n: c for n, c in table.columns.items() if not c.is_text and n not in time_names(table)
    }
    taken: set[str] = set()
    result: list[ColumnFamily] = []
    for find in (_matrices, _quaternions, _vectors, _single_wheels):
        for family in find({n: c for n, c in numbers.items() if n not in taken}, file):
            result.append(family)
            taken |= set(family.names)
    order = list(table.columns)
    return sorted(result, key=lambda family: order.index(family.names[0]))


def _stems(columns: Mapping[str, RawColumn]) -> dict[str, tuple[str, str]]:
    """Stem in small letters, and unit, of each column."""
    split = {name: split_unit(name) for name in columns}
    return {name: (stem.lower(), unit) for name, (stem, unit) in split.items()}


def _groups(
    columns: Mapping[str, RawColumn], members: Sequence[str]
) -> list[tuple[str, list[str], str]]:
    """Template, names and unit of columns that differ only in one of some words."""
    groups: dict[tuple[str, str], dict[str, str]] = {}
    for name, (stem, unit) in _stems(columns).items():
        for match in re.finditer("|".join(sorted(map(re.escape, members), key=len)[::-1]), stem):
            before, after = stem[: match.start()], stem[match.end() :]
            # A letter inside a word is no index.
            if re.match(r"[a-z0-9]", after) and not re.match(r"[a-z]?$", before):
                continue
            groups.setdefault((f"{before}*{after}", unit), {})[match[0]] = name
    return [
        (template, [found[m] for m in members if m in found], unit)
        for (template, unit), found in groups.items()
    ]


def _matrices(columns: Mapping[str, RawColumn], file: str) -> list[ColumnFamily]:
    """Direction cosine matrices: nine columns with two indices."""
    indexed: dict[str, dict[str, str]] = {}
    for name in columns:
        match = re.fullmatch(r"(.*?)_?\[?([0-3])[_,\]\[]*([0-3])\]?", name)
        if match:
            indexed.setdefault(match[1], {})[match[2] + match[3]] = name
    return [
        ColumnFamily("attitude", tuple(found[key] for key in sorted(found)), form="dcm")
        for found in indexed.values()
        if sorted(found)
        in (
            [f"{i}{j}" for i in "123" for j in "123"],
            [f"{i}{j}" for i in "012" for j in "012"],
        )
    ]


def _quaternions(columns: Mapping[str, RawColumn], file: str) -> list[ColumnFamily]:
    result = []
    taken: set[str] = set()
    for members, scalar in _QUATERNIONS:
        for template, names, _ in _groups(columns, members):
            word = re.sub(r"[./]0$", "", template.partition("*")[0]).strip("_ [./")
            is_quaternion = re.fullmatch(r".*(q|quat|quaternion|att|orientation|beta)[a-z_]*", word)
            other = _OTHER.fullmatch(word) or taken & set(names)
            if len(names) == 4 and is_quaternion and not other:
                result.append(
                    ColumnFamily("attitude", tuple(names), form="quaternion", scalar=scalar)
                )
                taken |= set(names)
    return result


def _vectors(columns: Mapping[str, RawColumn], file: str) -> list[ColumnFamily]:
    """Three columns a vector, or one a wheel."""
    result: list[ColumnFamily] = []
    taken: set[str] = set()
    candidates = [(members, *group) for members in _MEMBERS for group in _groups(columns, members)]
    # Of [0] to [3] all four are meant, not [1] to [3].
    for members, template, names, unit in sorted(candidates, key=lambda c: -len(c[2])):
        names = [name for name in names if name not in taken]
        family = _vector(template, names, unit, columns, file, members)
        if family is not None:
            result.append(family)
            taken |= set(names)
    return result


def _single_wheels(columns: Mapping[str, RawColumn], file: str) -> list[ColumnFamily]:
    """Columns of a single wheel."""
    result: list[ColumnFamily] = []
    for name, (stem, unit) in _stems(columns).items():
        family = _vector(stem, [name], unit, columns, file, ("",))
        if family is not None and family.holds not in {other.holds for other in result}:
            result.append(family)
    return result


def _vector(
    template: str,
    names: list[str],
    unit: str,
    columns: Mapping[str, RawColumn],
    file: str,
    members: Sequence[str],
) -> ColumnFamily | None:
    """What columns of one template hold; None if that is not to be seen."""
    stated = columns[names[0]].unit if names else ""
    text = re.sub(r"[./]0$", "", template.replace("*", "")).strip("_ .[]/")
    if _OTHER.fullmatch(text):
        return None
    if members[0] in ("roll", "phi") and len(names) == 3 and not _SETPOINT.fullmatch(file.lower()):
        # Yaw first is the usual sequence; the question stays open.
        angles = tuple(reversed(names))
        return ColumnFamily("attitude", angles, unit, stated, form="euler", sequence="zyx")
    if "sigma" in text and len(names) == 3 and not unit:
        return ColumnFamily("attitude", tuple(names), form="mrp")
    squeezed = re.sub(r"[^a-z0-9]", "", f"{unit or stated}".lower())
    holds = _kind(text, squeezed, file.lower(), members)
    if holds is None or len(names) < (1 if holds.startswith("wheel") else 3):
        return None
    if not holds.startswith("wheel") and len(names) != 3:
        return None
    return ColumnFamily(holds, tuple(names), unit, stated)


def _kind(text: str, unit: str, file: str, members: Sequence[str]) -> str | None:
    """What a template holds, by its unit, its words, and the name of its file."""
    of_unit = {
        "rpm": "wheel_speed",
        "mnm": "wheel_torque",
        "nm": "wheel_torque",
        "nms": "wheel_momentum",
        "mnms": "wheel_momentum",
        "nt": "magnetic_field",
        "ut": "magnetic_field",
        "t": "magnetic_field",
        "km": "position",
        "m": "position",
    }
    if unit in of_unit:
        return of_unit[unit]
    of_wheels = re.search(r"wheel|whl|rw|hwhl", f"{text} {file}")
    if unit in ("rads", "degs") or (of_wheels and re.search("omega|rate", text)):
        return "wheel_speed" if of_wheels else "rate"
    for holds, words in _KINDS:
        if words.fullmatch(text) and (of_wheels or not holds.startswith("wheel") or len(text) > 2):
            return holds
    if members[0] == "p" and not text:
        return "rate"
    stem = re.sub(r"[^a-z]", "", file.partition(".")[0])
    for holds, words in _KINDS:
        vector = text in _ANY_VECTOR and not holds.startswith("wheel")
        other = _OTHER.fullmatch(stem) or (not of_wheels and _SETPOINT.fullmatch(stem))
        if (len(text) <= 2 or vector) and words.fullmatch(stem) and not other:
            return holds
    return None
