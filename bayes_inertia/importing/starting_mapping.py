"""A mapping to be filled in, written from the columns of raw files.

What files and names of columns say is suggested; what only the user can know is asked ("?").

The hardware's part of a mapping to be filled in: inertia, wheels, sensors.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tomlkit

from bayes_inertia.errors import OutputError
from bayes_inertia.files import write_atomically
from bayes_inertia.importing.column_families import ColumnFamily, families
from bayes_inertia.importing.file_share import SHARED_ZERO
from bayes_inertia.importing.mapping_schema import MAPPING_FORMAT
from bayes_inertia.importing.mapping_text import mapping_comment, mapping_entry, mapping_value
from bayes_inertia.importing.questions import UNKNOWN, open_questions
from bayes_inertia.importing.starting_streams import FileGroup, counts_from_zero, stream_text
from bayes_inertia.tables.raw_files import read_raw, tables_in
from bayes_inertia.tables.raw_table import RawTable
from bayes_inertia.tables.time_columns import split_unit, time_names

_ORDER = (
    "rate",
    "wheel_torque",
    "wheel_momentum",
    "wheel_speed",
    "attitude",
    "magnetic_field",
    "position",
)
_CUT = """\
# [cut]  # how the log becomes slews; without it, at the rests
# before_s = 30.0  # rest kept before a motion [s]; without it, as long as the motion
# after_s = 30.0
# rest_rate = 1e-4  # [rad/s]; a slew exceeds it

# [[slews]]  # or name the slews
# name = "slew 1"
# start = "2026-03-01T12:00:00Z"
# end = "2026-03-01T12:05:00Z"
"""
_NOTHING_SEEN = """\
# No stream was recognised. Say which columns hold what, for each quantity:
# [[streams]]
# holds = "rate"  # or wheel_torque, wheel_momentum, wheel_speed, attitude, ...
# files = {files}
# time = {{ names = ["..."], kind = "utc" }}
# names = ["...", "...", "..."]
# unit = "rad/s"
# frame = "body"
"""
# Names, in small letters, of a column that says which packet a row is.
_PACKET = re.compile(r"(.*[ _.])?(packet|pkt|apid|msg|message|record)([ _]?(type|name|id))?")
_MOST_PACKETS = 40  # More different values are a counter, or texts.
_WHEEL_STREAMS = ("wheel_torque", "wheel_momentum", "wheel_speed")


@dataclass(frozen=True)
class StartingMapping:
    """A mapping to be filled in.

    Parameters
    ----------
    text : str
        TOML with comments.
    questions : int
        Number of questions that it asks.
    streams : tuple of str
        What the streams that were recognised hold.
    left_over : tuple of str
        Columns that no stream holds, such as "gyro.csv: c1, c2".
    """

    text: str
    questions: int
    streams: tuple[str, ...]
    left_over: tuple[str, ...]


def write_starting_mapping(files: Sequence[str | Path], path: str | Path) -> StartingMapping:
    """Write a mapping with a question at everything that the files do not say."""
    path = Path(path)
    if path.exists():
        raise OutputError(
            "is there already", where=str(path), advice="fill it in, or name another file"
        )
    started = starting_mapping([Path(file) for file in files])
    write_atomically(path, started.text)
    return started


def starting_mapping(files: Sequence[Path]) -> StartingMapping:
    """A mapping with a question at everything that the files do not say."""
    groups = _groups(files)
    streams: list[tuple[FileGroup, ColumnFamily]] = []
    for group in groups:
        streams += [(group, family) for family in _families(group)]
    streams.sort(key=lambda stream: _ORDER.index(stream[1].holds))
    parts = [_hardware(streams, files)]
    held: dict[str, None] = {}
    for group, family in streams:
        # A second candidate for what may stand once is left to the user.
        doubled = family.holds in held and family.holds not in _WHEEL_STREAMS
        parts.append(stream_text(group, family, commented=doubled))
        held[family.holds] = None
    if not streams:
        names = mapping_value(sorted({path.name for path in files}))
        parts.append(_NOTHING_SEEN.format(files=names))
    left_over = _left_over(groups, streams)
    comments = [mapping_comment(f"not recognised in {names}") for names in left_over]
    parts += ["\n".join(comments) + "\n" if comments else "", _CUT]
    text = "\n".join(parts)
    questions = len(open_questions(tomlkit.parse(text).unwrap()))
    return StartingMapping(text, questions, tuple(held), tuple(left_over))


def _hardware(streams: Sequence[tuple[FileGroup, ColumnFamily]], files: Sequence[Path]) -> str:
    """Name and hardware; the folder of the logs gives the name."""
    of_wheels = [family.names for _, family in streams if family.holds in _WHEEL_STREAMS]
    most = max(of_wheels, key=len, default=())
    name = files[0].resolve().parent.name if files else ""
    tracker = any(family.holds == "attitude" for _, family in streams)
    epoch = ""
    if any(counts_from_zero(group) for group, _ in streams):
        epoch = SHARED_ZERO if len(set(files)) == 1 else UNKNOWN
    return hardware_text(name or "campaign", wheel_words(most), tracker=tracker, epoch=epoch)


def _groups(files: Sequence[Path]) -> list[FileGroup]:
    """Files by their columns."""
    groups: dict[tuple, FileGroup] = {}
    for path in sorted(set(files)):
        for name in tables_in(path):
            for packet, table in _packets(read_raw(path, table=name)).items():
                stem = re.sub(r"\d+", "", path.stem)
                key = (name, packet, path.suffix, tuple(table.columns), stem)
                before = groups.get(key)
                group = (path,) if before is None else (*before.files, path)
                shown = table if before is None else before.table
                groups[key] = FileGroup(group, name, shown, packet)
    return list(groups.values())


def _packets(table: RawTable) -> dict[tuple[str, str | int] | None, RawTable]:
    """The rows of each packet where a column says which, with the columns that it fills."""
    for name, column in table.columns.items():
        values, counts = np.unique(column.values, return_counts=True)
        if _PACKET.fullmatch(name.lower()) and 1 < len(values) <= _MOST_PACKETS < counts.sum():
            of_row = column.values == values[:, None]
            parts = zip(values.tolist(), of_row, strict=True)
            return {(name, _plain(value)): _filled(table, name, rows) for value, rows in parts}
    return {None: table}


def _plain(value: str | float) -> str | int:
    return value if isinstance(value, str) else int(value)


def _filled(table: RawTable, packet: str, rows: np.ndarray) -> RawTable:
    """Some rows of a table, without the packet and columns in which they hold nothing."""
    columns = {
        name: replace(
            column,
            values=column.values[rows],
            exact=None if column.exact is None else column.exact[rows],
        )
        for name, column in table.columns.items()
        if name != packet and (column.is_text or np.isfinite(column.values[rows]).any())
    }
    return replace(table, columns=columns, lines=None)


def _families(group: FileGroup) -> list[ColumnFamily]:
    packet = "" if group.packet is None else f"{group.packet[1]}_"
    found = families(group.table, packet + group.files[0].name)
    if group.table.attitude is not None:
        form = "quaternion" if group.table.attitude.scalar else "euler"
        found = [family for family in found if family.holds != "attitude"]
        found.insert(0, ColumnFamily("attitude", group.table.attitude.names, form=form))
    return found


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
    """What tells the columns of the wheels from each other.

    Returns: A word a wheel: "x" of "cmd_wheel_x", else its number.

    Examples
    --------
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


def hardware_text(name: str, wheels: Sequence[str], *, tracker: bool, epoch: str = "") -> str:
    """Format, name and hardware of a mapping to be filled in.

    `wheels`: what tells the wheels apart, as `wheel_words` says it; none without wheels. `epoch`:
    zero of the clocks that count; "?" asks, "" where no stream has one.
    """
    lines = [
        '# What the raw logs hold. Answer every question: replace each "?" and delete what does',
        "# not apply. Suggestions come from the files and from names of columns: check them.",
        f'format = "{MAPPING_FORMAT}"',
        mapping_entry(("name",), name, "any text"),
        *([mapping_entry(("epoch",), epoch)] if epoch else []),
        "",
        "[inertia]",
        *(
            mapping_entry(("inertia", key), UNKNOWN)
            for key in ("tensor", "relative_sigma", "product_sigma", "includes_wheel_spin")
        ),
    ]
    for word in wheels:
        lines += _wheel(word, wheels[0])
    lines += [
        "",
        "[rate_sensor]",
        '# sigma = ...  # white noise per sample [rad/s], or such as "3 arcsec/s"; left out, the',
        "#              # import says what it sees",
        "# scale_factor_sigma = 0.03",
        "# bias_sigma = 1e-5  # [rad/s]",
        "# rate_random_walk = ...  # RRW of the data sheet [rad/s^1.5]",
    ]
    if tracker:
        lines += [
            "",
            "[star_tracker]",
            mapping_entry(("star_tracker", "boresight"), UNKNOWN),
            '# sigma_cross = ...  # noise across the boresight [rad], or such as "5 arcsec"; left',
            "#                    # out, the import says what it sees",
            "# sigma_roll = ...  # and about it [rad]",
        ]
    return "\n".join(lines) + "\n"


def _wheel(word: str, first: str) -> list[str]:
    """One `[[wheels]]`."""
    axis = _AXES.get(word, UNKNOWN)
    why = "from the name of its column: check axis and sign in the drawing"
    lines = [
        "",
        "[[wheels]]",
        mapping_entry(("wheels", "", "name"), f"wheel_{word}"),
        mapping_entry(("wheels", "", "axis"), axis, why),
    ]
    if word != first:
        why = "spin inertia, limits and noise; or give its own here"
        return [*lines, mapping_entry(("wheels", "", "same_as"), f"wheel_{first}", why)]
    return [
        *lines,
        mapping_entry(("wheels", "", "spin_inertia"), UNKNOWN),
        "# max_torque = ...  # [N m]; optional, with it impossible commands are seen",
        "# max_momentum = ...  # [N m s]; optional, with it impossible readings are seen",
        "# momentum_sigma = ...  # noise of the tachometer [N m s]; the import measures it",
    ]
