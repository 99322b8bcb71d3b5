"""The readings of a stream from the cells of a table: units, scales, attitudes, flags and marks.

Attitudes in any form become quaternions: body from inertial, scalar last.

A rotation that `maps = "inertial_to_body"` has v_B = C v_N. For each form:

- quaternion: C = (eta^2 - eps.eps) 1 + 2 eps eps^T - 2 eta [eps]x (Ferguson eqs 10, 11; Shuster;
  CCSDS). Where v_N = q v_B q* with Hamilton's product (scipy, ROS, Eigen: "body to world"), q is
  this same quaternion, and it maps inertial to body.
- Euler angles: the turns take the inertial axes to the body axes; intrinsic turns are about the
  axes as they have been turned so far.
- direction cosine matrix: C itself, its nine elements row by row.
- modified Rodrigues parameters: eps / (1 + eta), such as Basilisk's `sigma_BN`.

Units stand in rows of units and in attributes; CCSDS AEM states the columns, the form, the frames
and the direction of attitudes.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from bayes_inertia.campaign.slew import bad_quaternion
from bayes_inertia.errors import CampaignError, require
from bayes_inertia.faults.noise import rounding_sigmas
from bayes_inertia.importing.limits import LIMITS
from bayes_inertia.importing.mapping_schema import (
    AttitudeStream,
    MappedStream,
    ReadingsStream,
    TorqueStream,
    ValidRows,
)
from bayes_inertia.importing.questions import question_at, require_answer
from bayes_inertia.importing.unit_factors import to_si_with, unit_factor
from bayes_inertia.tables.table import Table, number_of

AttitudeForm = Literal["quaternion", "euler", "dcm", "mrp"]
COLUMNS_OF_FORM = {"quaternion": 4, "euler": 3, "dcm": 9, "mrp": 3}
"""Number of columns that each form of an attitude has."""


@dataclass(frozen=True)
class AttitudeConvention:
    """Attitude convention of a log."""

    form: AttitudeForm  # What the columns are
    # Between which axes, as the module's text defines it for each form
    maps: Literal["inertial_to_body", "body_to_inertial"]
    scalar: Literal["first", "last"] = "last"  # Place of a quaternion's scalar
    sequence: str = ""  # Axes of Euler angles in the order of the turns, such as "zyx"
    # Whether Euler angles turn about the turned axes or about the first ones
    turns: Literal["intrinsic", "extrinsic"] = "intrinsic"
    radians: float = 1.0  # Radians of one unit of the angles


def to_quaternions(values: np.ndarray, convention: AttitudeConvention) -> np.ndarray:
    """Quaternions (n, 4), body from inertial, scalar last, of attitudes (n, columns) in any form.

    >>> degrees = {"sequence": "zyx", "radians": np.pi / 180}
    >>> yaw_first = AttitudeConvention("euler", "inertial_to_body", **degrees)
    >>> to_quaternions(np.array([[90.0, 0.0, 0.0]]), yaw_first).round(4).tolist()
    [[0.0, 0.0, 0.7071, 0.7071]]
    """
    quaternions = np.full((len(values), 4), np.nan)
    rows = np.isfinite(values).all(axis=1)
    if rows.any():
        quaternions[rows] = _inertial_to_body(values[rows], convention)
    turned = convention.maps == "body_to_inertial"
    return quaternions * np.array([-1.0, -1.0, -1.0, 1.0]) if turned else quaternions


def _inertial_to_body(values: np.ndarray, convention: AttitudeConvention) -> np.ndarray:
    """Quaternions (n, 4) of complete rows, as if they mapped inertial to body."""
    if convention.form == "quaternion":
        return values[:, [1, 2, 3, 0]] if convention.scalar == "first" else values
    if convention.form == "mrp":
        return Rotation.from_mrp(values).as_quat()
    if convention.form == "dcm":
        # scipy's matrices turn vectors, C turns axes: each is the other's transpose.
        return Rotation.from_matrix(values.reshape(-1, 3, 3).transpose(0, 2, 1)).as_quat()
    sequence = convention.sequence
    sequence = sequence.upper() if convention.turns == "intrinsic" else sequence.lower()
    return Rotation.from_euler(sequence, values * convention.radians).as_quat()


def without_solution(
    values: np.ndarray, convention: AttitudeConvention, marked: np.ndarray
) -> np.ndarray:
    """Rows (n,) that hold a mark of "no solution", such as 0 0 0 0 or -9999, not an attitude.

    That is one number in all columns which no attitude has there, or a mark that the mapping names.
    """
    size = np.abs(values[:, 0])
    impossible = {
        "quaternion": np.abs(size - 0.5) > LIMITS.not_orthogonal,
        "dcm": size >= 0.0,
        "mrp": size > 1.0,
        "euler": size * convention.radians > 2.0 * np.pi,
    }[convention.form]
    same = (values == values[:, :1]).all(axis=1)
    return marked.all(axis=1) | (same & impossible)


def standing_mark(quaternions: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Rows (n,) whose attitude, to which others jump and back, is a mark of "no solution"."""
    marks = np.zeros(len(time), dtype=bool)
    rows = np.flatnonzero(np.isfinite(quaternions).all(axis=1) & np.isfinite(time))
    q, steps = quaternions[rows], np.diff(time[rows])
    usual = 1.5 * float(np.median(steps)) if len(steps) else 0.0
    # Weights of a sum that tells attitudes apart.
    key = np.array([1.0, np.pi, math.e, np.sqrt(2.0)])
    _, first, counts = np.unique(q @ key, return_index=True, return_counts=True)
    for row in first[np.argsort(-counts)[: LIMITS.most_common_attitudes]]:
        same = (q == q[row]).all(axis=1)
        # After a pause a body may be anywhere.
        borders = np.flatnonzero((same[1:] != same[:-1]) & (steps < usual))
        others = np.where(same[borders, None], q[borders + 1], q[borders])
        jumps = np.abs(others @ q[row]) < np.cos(0.5 * LIMITS.attitude_jump)
        again = int((same[1:] & ~same[:-1]).sum() + same[0]) > 1
        # Of two that stand still, the one beside several others is the mark.
        if again and len(borders) > 1 and jumps.all() and np.any(others != others[0]):
            marks[rows[same]] = True
            break
    return marks


def rounding_of_attitudes(
    values: np.ndarray, convention: AttitudeConvention, sigmas: np.ndarray
) -> float:
    """Sd of an attitude about any axis [rad] from the rounding `sigmas` of its columns."""
    given = values[np.isfinite(values).all(axis=1)]
    given = given[:: max(1, len(given) // LIMITS.attitudes_of_rounding)]
    if not len(given):
        return 0.0
    exact = Rotation.from_quat(to_quaternions(given, convention))
    moved = (given + column for column in np.diag(sigmas))
    turned = (Rotation.from_quat(to_quaternions(x, convention)) * exact.inv() for x in moved)
    angles = np.array([turn.magnitude() for turn in turned])
    return float(np.sqrt((angles**2).sum(axis=0).mean() / 3.0))


def bad_attitude(values: np.ndarray, convention: AttitudeConvention) -> tuple[int, str] | None:
    """The first row that is neither empty nor an attitude, and what is wrong; None if none."""
    if convention.form == "quaternion":
        return bad_quaternion(values)
    given = np.isfinite(values).sum(axis=1)
    problems = {"the attitude is incomplete": (given > 0) & (given < values.shape[1])}
    if convention.form == "dcm":
        matrices = values.reshape(-1, 3, 3)
        square = np.einsum("nij,nkj->nik", matrices, matrices) - np.eye(3)
        what = "the matrix is no rotation: its rows are not of length 1 and square to each other"
        problems[what] = np.abs(square).max(axis=(1, 2)) > LIMITS.not_orthogonal
        what = "the matrix mirrors: an axis has the wrong sign"
        with np.errstate(invalid="ignore"):  # Of a row that is empty or incomplete.
            problems[what] = np.linalg.det(matrices) < 0.0
    for what, bad in problems.items():
        if bad.any():
            return int(np.argmax(bad)), what
    return None


def from_tracker_axes(quaternions: np.ndarray, body_from_tracker: np.ndarray) -> np.ndarray:
    """Attitudes of the body (n, 4) from those of a star tracker: v_B = R v_T.

    >>> half_turn = np.diag([-1.0, -1.0, 1.0])
    >>> (from_tracker_axes(np.array([[0.0, 0.0, 0.0, 1.0]]), half_turn) + 0.0).tolist()
    [[0.0, 0.0, 1.0, 0.0]]
    """
    result = np.full(quaternions.shape, np.nan)
    rows = np.isfinite(quaternions).all(axis=1)
    if rows.any():
        # C_BN = R C_TN; scipy's rotations are the transposes, so that the order is reversed.
        tracker = Rotation.from_quat(quaternions[rows])
        mounting = Rotation.from_matrix(np.asarray(body_from_tracker).T)
        result[rows] = (tracker * mounting).as_quat()
    return result


# Names of frames as CCSDS (SANA registry) and ground systems write them, in capitals.
_BODY = re.compile(r"(SC|SPACECRAFT)_?(BODY|FRAME)?(_\d+)?|BODY.*|S/C.*")
_TRACKER = re.compile(r"(STAR_?TRACKER|STR|ST|AST|INSTRUMENT|STARTRACKER).*")


def agreed(stated: Any, mapped: Any, where: str, file: str) -> Any:
    """The value that file or mapping states ("" or None: nothing); an error if they differ."""
    if not stated:
        return mapped
    what = f"{mapped!r} contradicts the file {file}, which states {stated!r}"
    advice = "leave the key out to take what the file states, or correct the file"
    require(not mapped or mapped == stated, where, what, advice)
    return stated


def agreed_unit(table: Table, name: str, quantity: str, mapped: str, where: str) -> str:
    """The unit of a column, as the mapping or the file states it."""
    stated = table.column(name).unit
    path = tuple(where.rpartition(", key ")[2].split("."))
    advice = f'add unit = "...": units are never guessed. {question_at((*path, "unit"))}'
    require(bool(mapped or stated), f"{where}.unit", "missing key", advice)
    if not mapped:
        _factor(quantity, stated, f"{table.label}, column {name}")
        return stated
    factor = _factor(quantity, mapped, f"{where}.unit")
    try:
        differs = bool(stated) and abs(unit_factor(quantity, stated) / factor - 1.0) > 1e-9
    except CampaignError:  # Such as "counts": the file states no unit of this quantity.
        differs = False
    if differs:
        agreed(stated, mapped, f"{where}.unit", f"{table.label} (column {name})")
    return mapped


def _factor(quantity: str, unit: str, where: str) -> float:
    try:
        return unit_factor(quantity, unit)
    except CampaignError as error:
        raise CampaignError(f"{unit!r} {error.what}", where=where, advice=error.advice) from None


def agreed_attitude(
    table: Table, part: AttitudeStream, where: str
) -> tuple[list[str], AttitudeConvention, bool]:
    """Columns of attitudes, what they mean, and whether they are of the tracker's axes."""
    says = stated_attitude(table)
    unit = _angle_unit(table, part, says, where)

    def value(key: str) -> Any:
        mapped = getattr(part, key)
        mapped = mapped.lower() if key == "sequence" else mapped
        both = agreed(says.get(key), mapped, f"{where}.{key}", table.label)
        require_answer(both, ("streams", "attitude", key), where)
        return both

    form = value("form")
    names = list(value("names"))
    count = COLUMNS_OF_FORM[form]
    what = f"{len(names)} columns for the form {form!r}"
    require(len(names) == count, f"{where}.names", what, f"name {count} columns in their order")
    euler = form == "euler"
    convention = AttitudeConvention(
        form,
        value("maps"),
        scalar=value("scalar") if form == "quaternion" else "last",
        sequence=value("sequence") if euler else "",
        turns=value("turns") if euler else "intrinsic",
        radians=_factor("angle", unit, f"{where}.unit") if euler else 1.0,
    )
    of_tracker = value("frame") == "tracker"
    mounted = part.body_from_tracker or not of_tracker
    require_answer(mounted, ("streams", "attitude", "body_from_tracker"), where)
    return names, convention, of_tracker


def _angle_unit(table: Table, part: AttitudeStream, says: dict[str, Any], where: str) -> str:
    """Unit of Euler angles; "" for other forms."""
    if (says.get("form") or part.form) != "euler":
        return ""
    if says.get("unit"):
        return str(agreed(says["unit"], part.unit, f"{where}.unit", table.label))
    first = (part.names or says.get("names") or [""])[0]
    return agreed_unit(table, first, "angle", part.unit, where)


def stated_attitude(table: Table) -> dict[str, Any]:
    """Attitude convention that a file states, in the keys of a mapping."""
    stated = table.attitude
    if stated is None:
        return {}
    advice = "export the attitude relative to inertial axes, such as EME2000 or ICRF"
    what = f"the attitudes are between the frames {stated.from_frame} and {stated.to_frame}"
    why = "one must be inertial, the other one of the spacecraft"
    require(bool(stated.maps), table.label, f"{what}: {why}", advice)
    forward = stated.maps == "inertial_to_body"
    return {
        "names": list(stated.names),
        "form": "quaternion" if stated.scalar else "euler",
        "scalar": stated.scalar,
        "sequence": stated.sequence.lower(),
        "turns": "intrinsic" if stated.sequence else "",
        "unit": stated.angle_unit,
        "maps": stated.maps,
        "frame": _frame((stated.to_frame if forward else stated.from_frame).upper()),
    }


def _frame(name: str) -> str:
    """Kind of a frame of the spacecraft; "" if its name does not say it."""
    if _BODY.fullmatch(name):
        return "body"
    return "tracker" if _TRACKER.fullmatch(name) else ""


# Readings (rows, width); the rounding of each column, of attitudes of all together; notes.
_Readings = tuple[np.ndarray, tuple[float, ...], list[str]]


def readings_of(part: MappedStream, table: Table, where: str) -> _Readings:
    """Readings of a stream in SI units and in the package's senses."""
    flagged = np.zeros((1, 1), dtype=bool)
    notes = []
    if part.valid is not None:
        flagged = ~_valid_rows(part.valid, table, where)[:, None]
        notes.append(f"{int(flagged.sum())} rows are flagged as not valid")
    if isinstance(part, AttitudeStream):
        values, rounding, said = _attitudes(part, table, flagged, where)
    else:
        values, rounding, said = _readings(part, table, flagged, where)
    return values, rounding, [*notes, *said]


def with_signs(counts: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Counts (n, columns) that lost their sign, with it, and what to say; others as they are.

    A reading that passes zero then leaps to the end of the counter, and none is far from both ends.

    >>> with_signs(np.array([[65533.0], [65535.0], [1.0], [65534.0]]))[0].ravel().tolist()
    [-3.0, -1.0, 1.0, -2.0]
    """
    given = counts[np.isfinite(counts)]
    whole = given.size > 0 and given.min() >= 0.0 and bool((given == np.rint(given)).all())
    fitting = (b for b in LIMITS.bits_of_counts if given.max(initial=0.0) < 2.0**b)
    bits = next(fitting, 0) if whole else 0
    low, high = given < 2.0 ** (bits - 2), given >= 3.0 * 2.0 ** (bits - 2)
    several = len(np.unique(given[high])) >= LIMITS.fewest_negative_counts
    if not (bits and several and low.any() and (low | high).all()):
        return counts, []
    signed = np.where(counts >= 2.0 ** (bits - 1), counts - 2.0**bits, counts)
    return signed, [f"counts without their sign: {2**bits - 1} is read as -1 ({bits} bits)"]


def _marks(part: MappedStream, numbers: np.ndarray) -> np.ndarray:
    """Which numbers of the file are marks of "no reading"."""
    return np.isin(numbers, [] if part.missing is None else part.missing)


def _readings(part: ReadingsStream, table: Table, flagged: np.ndarray, where: str) -> _Readings:
    """Columns in SI units, torques on the wheel; their rounding; what was taken for no reading."""
    read = table.stack(part.names)
    marks = _marks(part, read)
    read, unsigned = with_signs(np.where(flagged | marks, np.nan, read))
    roundings = rounding_sigmas(read)
    values = np.empty_like(read)
    for k, name in enumerate(part.names):
        unit = agreed_unit(table, name, part.holds, part.unit, where)
        scale, offset = (v[k] if isinstance(v, list) else v for v in (part.scale, part.offset))
        values[:, k] = to_si_with(read[:, k], unit, part.holds, scale=scale, offset=offset)
        roundings[k] *= abs(scale) * unit_factor(part.holds, unit)
    # 0 - values, because -values would make zeros negative.
    body = isinstance(part, TorqueStream) and part.acts_on == "body"
    said = [f"{marks.sum()} cells hold {part.missing}, a mark of no reading"] if marks.any() else []
    said += unsigned
    counts = np.isfinite(values).sum(axis=0)
    fewest = int(np.argmin(counts))
    # Commands may change one by one.
    least = 1 if isinstance(part, TorqueStream) else LIMITS.complete_column * counts.max()
    if counts[fewest] < least:
        said.append(f"{part.names[fewest]} has {counts[fewest]} readings, others {counts.max()}")
    return 0.0 - values if body else values, tuple(roundings.tolist()), said


def _attitudes(part: AttitudeStream, table: Table, flagged: np.ndarray, where: str) -> _Readings:
    """Quaternions, body from inertial, scalar last; rounding [rad]; what was taken for no fix."""
    names, convention, of_tracker = agreed_attitude(table, part, where)
    read, said = with_signs(np.where(flagged, np.nan, table.stack(names)))
    values = read * np.array(part.scale)
    without = without_solution(values, convention, _marks(part, read))
    if without.any():
        texts = ", ".join(f"{value:.6g}" for value in np.unique(read[without])[:4])
        said += [f"{int(without.sum())} rows hold {texts} in all of {', '.join(names)}: no fix"]
        values = np.where(without[:, None], np.nan, values)
    problem = bad_attitude(values, convention)
    if problem is not None:
        row, what = problem
        place = f"{table.place(row, names[0])} to {names[-1]}"
        advice = _advice_on(row, read, convention, part.scale != 1.0)
        raise CampaignError(f"{what}: {read[row].tolist()}", where=place, advice=advice)
    if not np.isfinite(values).any():
        said.append("no row holds a fix")
    quaternions = to_quaternions(values, convention)
    # Of the numbers in the file: decimals are not seen once they are scaled.
    roundings = rounding_sigmas(np.where(np.isnan(values), np.nan, read)) * np.abs(part.scale)
    rounding = rounding_of_attitudes(values, convention, roundings)
    if of_tracker:
        quaternions = from_tracker_axes(quaternions, np.array(part.body_from_tracker))
    return quaternions, (rounding,), said


def _advice_on(row: int, read: np.ndarray, convention: AttitudeConvention, scaled: bool) -> str:
    """Advice on a row that is no attitude."""
    different = np.unique(read[np.isfinite(read).all(axis=1)], axis=0)
    lengths = np.linalg.norm(different, axis=1)
    length = max(float(np.median(lengths)), 1e-300) if len(lengths) else 1.0
    alike = np.abs(lengths / length - 1.0) <= LIMITS.even_length
    even = len(different) > 1 and np.mean(alike) >= LIMITS.most_even_rows
    counts = convention.form == "quaternion" and even and abs(length - 1.0) > LIMITS.even_length
    if counts and not scaled:
        return f"if these are counts, add scale = {1.0 / length:.10g} to the stream"
    if (read == read[row]).all(axis=1).sum() > 1:
        marks = ", ".join(f"{number:.10g}" for number in np.unique(read[row]))
        return f"if such rows mark that there is no fix, add missing = [{marks}] to the stream"
    return (
        "repair the row, leave all its cells empty (no fix), or name other columns in the mapping"
    )


def _valid_rows(valid: ValidRows, table: Table, where: str) -> np.ndarray:
    column = table.column(valid.name)
    accepted = valid.equals if isinstance(valid.equals, list) else [valid.equals]
    if column.is_text:
        # TRUE and true are one flag.
        cells = np.array([str(cell).strip().lower() for cell in column.values.tolist()])
        rows = np.isin(cells, [str(value).lower() for value in accepted])
    else:
        numbers = [number_of(v) if isinstance(v, str) else float(v) for v in accepted]
        rows = np.isin(column.values.astype(float), numbers)
    if not rows.any():
        present = ", ".join(repr(v) for v in np.unique(column.values)[:8].tolist())
        what, advice = f"no row has {valid.name} = {valid.equals!r}", f"the column has {present}"
        raise CampaignError(what, where=f"{where}.valid.equals", advice=advice)
    return rows
