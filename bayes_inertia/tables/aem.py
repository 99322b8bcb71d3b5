"""Attitude ephemeris messages of CCSDS (AEM), versions 1.0 and 2.0: what their metadata mean.

Version 2.0 (504.0-B-2) always goes from REF_FRAME_A to REF_FRAME_B with the scalar last. Version
1.0 (504.0-B-1) says so in ATTITUDE_DIR and QUATERNION_TYPE, and files of version 2.0 that still
carry these keywords mean them. Both define v_B = M(q) v_A with the M(q) of this package. Every
keyword that changes the meaning of a number is honoured or refused; none is passed over.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_inertia.errors import CampaignError, require
from bayes_inertia.files import vocabulary
from bayes_inertia.tables.table import Column, StatedAttitude, Table, joined_values
from bayes_inertia.tables.text_cells import CellRow
from bayes_inertia.tables.text_table import text_column

_QUATERNION = ("Q1", "Q2", "Q3", "QC")
_RATES = ("ANGVEL_X", "ANGVEL_Y", "ANGVEL_Z")
_SPIN = ("SPIN_ALPHA", "SPIN_DELTA", "SPIN_ANGLE", "SPIN_ANGLE_VEL")
_ANGLES = ("ANGLE_1", "ANGLE_2", "ANGLE_3")
_AXES = {"1": "X", "2": "Y", "3": "Z", "X": "X", "Y": "Y", "Z": "Z"}
_ROTATING = re.compile(r"(ITRF|GTOD|EFG|WGS|GRC|TIRF|LVLH|VVLH|RTN|RSW|QSW|TNW|NTW|PQW|NSW|SEZ).*")
_TIME_SYSTEMS = {"UTC": "utc", "TAI": "tai", "GPS": "gps", "TT": "tt", "TDT": "tt"}
EPOCH = "EPOCH"
"""Name of the column of time stamps."""

_KEYWORDS = frozenset(" ".join(vocabulary("tables")["aem_keywords"].values()).split())


@dataclass(frozen=True)
class AemSegment:
    """One block of metadata with its attitudes, KVN or XML alike."""

    version: str  # "1.0" or "2.0"
    metadata: Mapping[str, str]  # Keywords and their values
    rows: tuple[CellRow, ...]  # Time stamp and numbers, and the line; 0 for XML
    # Columns as XML names them; () for KVN, where ATTITUDE_TYPE names them
    names: tuple[str, ...] = ()
    label: str = ""  # The file and the segment, as messages name them

    def require(self, condition: bool, what: str, advice: str) -> None:
        """Raise an error that names the segment, unless a condition holds."""
        require(condition, self.label, what, advice)


def segment_table(segment: AemSegment) -> Table:
    """The table of a segment, with what the segment says of its numbers."""
    _check_keywords(segment)
    names = segment.names or _names_of_type(segment)
    segment.require(bool(segment.rows), "a segment has no attitudes", "export it again")
    for index, row in enumerate(segment.rows):
        if len(row.cells) != len(names) + 1:
            where = f"line {row.line}" if row.line else f"attitude {index + 1}"
            what = f"{len(row.cells) - 1} numbers, but {_type(segment)} has {len(names)}"
            advice = "mend or remove the line"
            raise CampaignError(what, where=f"{segment.label}, {where}", advice=advice)
    cells = list(zip(*(row.cells for row in segment.rows), strict=True))
    columns = {EPOCH: Column(np.array(cells[0], dtype=np.dtypes.StringDType()))}
    for name, values in zip(names, cells[1:], strict=True):
        columns[name] = text_column(values, ".", _unit_of(name))
    if _type(segment) == "SPIN":
        columns = _spin_angles(segment, columns)
    attitude, notes = _attitude(segment, tuple(columns))
    lines = np.array([row.line for row in segment.rows]) if segment.rows[0].line else None
    return Table(segment.label, columns, lines, (EPOCH,), _time_kind(segment), attitude, notes)


def joined_segments(tables: Sequence[Table]) -> Table:
    """Segments with the same conventions as one table."""
    first = tables[0]
    for number, table in enumerate(tables[1:], start=2):
        kinds = [(t.attitude, t.time_kind, list(t.columns)) for t in (table, first)]
        what = f"segments 1 and {number} have different frames, time systems or types"
        advice = 'name one segment as the table, such as "segment 1"'
        require(kinds[0] == kinds[1], first.label, what, advice)
    # Of one system of time and one notation, texts of dates stand in the order of their dates.
    tables = sorted(tables, key=lambda table: str(table.column(table.time_names[0]).values[:1]))
    columns = {}
    for name, column in first.columns.items():
        values = joined_values([table.columns[name].values for table in tables])
        columns[name] = Column(values, column.unit)
    known = [table.lines for table in tables if table.lines is not None]
    lines = np.concatenate(known) if len(known) == len(tables) else None
    notes = tuple(dict.fromkeys(note for table in tables for note in table.notes))
    return replace(first, columns=columns, lines=lines, notes=notes)


def _check_keywords(segment: AemSegment) -> None:
    what = f"version {segment.version!r} of the AEM is not known"
    segment.require(segment.version in ("1.0", "2.0"), what, "export version 1.0 or 2.0")
    needed = ["REF_FRAME_A", "REF_FRAME_B", "TIME_SYSTEM", "ATTITUDE_TYPE"]
    needed += ["ATTITUDE_DIR"] if segment.version == "1.0" else []
    for key in needed:
        stated = bool(segment.metadata.get(key))
        segment.require(stated, f"the metadata lack {key}", f"add the line {key} = ...")
    for key in segment.metadata:
        what = f"the keyword {key} is not one of an AEM, and could change what the numbers mean"
        segment.require(key in _KEYWORDS, what, "remove the line if it does not")


def _type(segment: AemSegment) -> str:
    return segment.metadata["ATTITUDE_TYPE"].upper().replace(" ", "_")


def _names_of_type(segment: AemSegment) -> tuple[str, ...]:
    """Names of the columns in the order of the data lines."""
    old = segment.version == "1.0"
    first = _scalar(segment) == "first"
    quaternion = (_QUATERNION[3], *_QUATERNION[:3]) if first else _QUATERNION
    angles = ("X_ANGLE", "Y_ANGLE", "Z_ANGLE") if old else _ANGLES
    rates = ("X_RATE", "Y_RATE", "Z_RATE") if old else _RATES
    names: dict[str, tuple[str, ...]] = {"SPIN": _SPIN}
    for kind, own in (("QUATERNION", quaternion), ("EULER_ANGLE", angles)):
        dots = tuple(f"{name}_DOT" for name in own)
        more = {"": (), "/DERIVATIVE": dots, "/RATE": rates, "/ANGVEL": rates}
        names |= {f"{kind}{suffix}": (*own, *further) for suffix, further in more.items()}
    _require_type(segment, _type(segment) in names, f"export one of {', '.join(names)}")
    return names[_type(segment)]


def _require_type(segment: AemSegment, is_read: bool, advice: str) -> None:
    """Refuse a type that is not read, with the reason."""
    stated = segment.metadata["ATTITUDE_TYPE"]
    why = ""
    if "NUTATION" in stated.upper():
        why = ": its angles are those of a nutation about the momentum, not those of the body"
        advice = "export QUATERNION or EULER_ANGLE"
    segment.require(is_read, f"ATTITUDE_TYPE = {stated} is not read{why}", advice)


def _unit_of(name: str) -> str:
    if name in _QUATERNION:
        return ""
    if name in _SPIN[:3] or ("ANGLE" in name and not name.endswith(("_DOT", "_VEL"))):
        return "deg"
    return "1/s" if name.startswith("Q") else "deg/s"


def _scalar(segment: AemSegment) -> str:
    """Place of the scalar: "first", "last", or "" where the file does not say."""
    stated = segment.metadata.get("QUATERNION_TYPE", "").lower()
    if stated in ("first", "last"):
        return stated
    return "last" if segment.version == "2.0" and not stated else ""


def _attitude(segment: AemSegment, names: Sequence[str]) -> tuple[StatedAttitude, tuple[str, ...]]:
    """Attitude convention of the segment, and notes on it for the user."""
    meta = segment.metadata
    frames = (meta.get(key) for key in ("ANGVEL_FRAME", "RATE_FRAME"))
    notes = [f"angular velocities are in the frame {frame}" for frame in frames if frame]
    if segment.version == "2.0":
        notes += [
            f"a file of version 2.0 that says {key} = {meta[key]}, as version 1.0 does: believed"
            for key in ("ATTITUDE_DIR", "QUATERNION_TYPE")
            if meta.get(key)
        ]
    start, end = _frames(segment)
    if _type(segment) == "SPIN":
        notes.append(
            "SPIN was read as the turns Z (SPIN_ALPHA + 90 deg), X (90 deg - SPIN_DELTA), Z "
            "(SPIN_ANGLE): the spin axis is the axis Z of the body frame"
        )
        return StatedAttitude(_ANGLES, "", start, end, "ZXZ", "deg"), tuple(notes)
    if _type(segment).startswith("EULER"):
        angles, sequence = _angles(segment, names)
        return StatedAttitude(angles, "", start, end, sequence, "deg"), tuple(notes)
    _check_quaternions(segment, names)
    return StatedAttitude(_QUATERNION, "last", start, end), tuple(notes)


def _check_quaternions(segment: AemSegment, names: Sequence[str]) -> None:
    """Refuse attitudes that are no quaternions, or whose scalar could stand anywhere."""
    meta = segment.metadata
    is_read = _type(segment).startswith("QUATERNION")
    _require_type(segment, is_read, "export QUATERNION, EULER_ANGLE or SPIN")
    what = "the attitudes are no quaternions although ATTITUDE_TYPE says so"
    segment.require(set(_QUATERNION) <= set(names), what, "export the message again")
    stated = meta.get("QUATERNION_TYPE", "last")
    what = f"QUATERNION_TYPE = {stated} is neither FIRST nor LAST"
    segment.require(stated.lower() in ("first", "last"), what, "write where the scalar QC stands")
    what = "the metadata lack QUATERNION_TYPE, so nothing says where the scalar stands"
    advice = "add QUATERNION_TYPE = FIRST or LAST to the metadata"
    # XML names each component.
    segment.require(bool(segment.names or _scalar(segment)), what, advice)


def _spin_angles(segment: AemSegment, columns: Mapping[str, Column]) -> dict[str, Column]:
    """Columns with the angles of the turns Z, X, Z that spin axis and phase are (504.0-B)."""
    what = "ATTITUDE_TYPE = SPIN with ATTITUDE_DIR = B2A does not say in which frame the spin "
    what += "axis stands"
    forward = segment.metadata.get("ATTITUDE_DIR", "A2B").upper() != "B2A"
    segment.require(forward, what, "export ATTITUDE_DIR = A2B, or QUATERNION")
    what = f"ATTITUDE_TYPE = SPIN without {', '.join(_SPIN[:3])}"
    whole = set(_SPIN[:3]) <= set(columns)
    segment.require(whole, what, "export the message again, or as QUATERNION")
    alpha, delta, phase = Table(segment.label, dict(columns)).stack(_SPIN[:3]).T
    turns = (alpha + 90.0, 90.0 - delta, phase)
    rest = {name: column for name, column in columns.items() if name not in _SPIN[:3]}
    return rest | {name: Column(v, "deg") for name, v in zip(_ANGLES, turns, strict=True)}


def _frames(segment: AemSegment) -> tuple[str, str]:
    """Frames from and to which the rotation goes."""
    meta = segment.metadata
    start, end = meta["REF_FRAME_A"], meta["REF_FRAME_B"]
    for frame in (start, end):
        what = f"the frame {frame} turns in inertial space"
        advice = "export the attitude from an inertial frame such as EME2000 or ICRF"
        segment.require(not _ROTATING.fullmatch(frame.upper()), what, advice)
    stated = meta.get("ATTITUDE_DIR", "A2B")
    what = f"ATTITUDE_DIR = {stated} is neither A2B nor B2A"
    segment.require(stated.upper() in ("A2B", "B2A"), what, "write the direction of the rotation")
    return (start, end) if stated.upper() == "A2B" else (end, start)


def _angles(segment: AemSegment, names: Sequence[str]) -> tuple[tuple[str, ...], str]:
    """Columns of the angles in the order of the rotations, and the axes of these."""
    stated = segment.metadata.get("EULER_ROT_SEQ", "").upper().strip("'\"")
    letters = [_AXES.get(letter, "") for letter in stated]
    three = len(letters) == 3 and all(letters) and letters[1] not in (letters[0], letters[2])
    what = f"EULER_ROT_SEQ = {stated or 'nothing'} names no three rotations"
    segment.require(three, what, "write three axes such as ZYX, the first rotation first")
    sequence = "".join(letters)
    if set(_ANGLES) <= set(names):
        return _ANGLES, sequence
    by_axis = tuple(f"{letter}_ANGLE" for letter in letters)
    what = f"angles about X, Y and Z cannot be those of the sequence {sequence}"
    advice = "export quaternions, or version 2.0, whose angles stand in the order of the rotations"
    segment.require(len(set(letters)) == 3 and set(by_axis) <= set(names), what, advice)
    return by_axis, sequence


def _time_kind(segment: AemSegment) -> str:
    system = segment.metadata["TIME_SYSTEM"].upper()
    what = f"TIME_SYSTEM = {system} cannot be put beside other clocks"
    segment.require(system in _TIME_SYSTEMS, what, f"export one of {', '.join(_TIME_SYSTEMS)}")
    return _TIME_SYSTEMS[system]
