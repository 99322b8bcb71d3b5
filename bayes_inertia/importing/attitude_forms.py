"""Attitudes in any form become quaternions: body from inertial, scalar last.

A rotation that `maps = "inertial_to_body"` has v_B = C v_N. For each form:

- quaternion: C = (eta^2 - eps.eps) 1 + 2 eps eps^T - 2 eta [eps]x (Ferguson eqs 10, 11; Shuster;
  CCSDS). Where v_N = q v_B q* with Hamilton's product (scipy, ROS, Eigen: "body to world"), q is
  this same quaternion, and it maps inertial to body.
- Euler angles: the turns take the inertial axes to the body axes; intrinsic turns are about the
  axes as they have been turned so far.
- direction cosine matrix: C itself, its nine elements row by row.
- modified Rodrigues parameters: eps / (1 + eta), such as Basilisk's `sigma_BN`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from bayes_inertia.campaign.slew import bad_quaternion

AttitudeForm = Literal["quaternion", "euler", "dcm", "mrp"]
COLUMNS_OF_FORM = {"quaternion": 4, "euler": 3, "dcm": 9, "mrp": 3}
"""Number of columns that each form of an attitude has."""

_CONJUGATE = np.array([-1.0, -1.0, -1.0, 1.0])
# Largest element of M M^T - 1 of a matrix that counts as a rotation.
_NOT_ORTHOGONAL = 1e-3
# A jump between two rows that no body makes, if it comes back to the very same attitude [rad].
_JUMP = 0.1
# So many of the attitudes that stand most often are looked at, told apart by such a sum of theirs.
_MOST_COMMON, _KEY = 4, np.array([1.0, np.pi, np.e, np.sqrt(2.0)])
# Rows looked at for what rounding does to an attitude.
_ROWS_OF_ROUNDING = 50


@dataclass(frozen=True)
class AttitudeConvention:
    """How a log writes attitudes.

    Parameters
    ----------
    form : {"quaternion", "euler", "dcm", "mrp"}
        What the columns are.
    maps : {"inertial_to_body", "body_to_inertial"}
        Between which axes, as the module's text defines it for each form.
    scalar : {"first", "last"}, optional
        Place of a quaternion's scalar.
    sequence : str, optional
        Axes of Euler angles in the order of the turns, such as "zyx".
    turns : {"intrinsic", "extrinsic"}, optional
        Whether Euler angles turn about the turned axes or about the first ones.
    radians : float, optional
        Radians of one unit of the angles.
    """

    form: AttitudeForm
    maps: Literal["inertial_to_body", "body_to_inertial"]
    scalar: Literal["first", "last"] = "last"
    sequence: str = ""
    turns: Literal["intrinsic", "extrinsic"] = "intrinsic"
    radians: float = 1.0


def to_quaternions(values: np.ndarray, convention: AttitudeConvention) -> np.ndarray:
    """Quaternions of attitudes in any form.

    `values` (n, columns): the columns; NaN throughout a row without a fix. Rows must be good
    (`bad_attitude`). Returns (n, 4): body from inertial, scalar last; NaN in rows without a fix.

    Examples
    --------
    >>> degrees = {"sequence": "zyx", "radians": np.pi / 180}
    >>> yaw_first = AttitudeConvention("euler", "inertial_to_body", **degrees)
    >>> to_quaternions(np.array([[90.0, 0.0, 0.0]]), yaw_first).round(4).tolist()
    [[0.0, 0.0, 0.7071, 0.7071]]
    """
    quaternions = np.full((len(values), 4), np.nan)
    rows = np.isfinite(values).all(axis=1)
    if rows.any():
        quaternions[rows] = _inertial_to_body(values[rows], convention)
    return quaternions * _CONJUGATE if convention.maps == "body_to_inertial" else quaternions


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
    """Rows that hold a mark of "no solution" instead of an attitude.

    That is one number in all columns which no attitude has there, such as 0 0 0 0 or -9999.

    `values` (n, columns). `marked` (n, columns): cells that hold what the mapping calls a mark.
    Returns (n,).

    Examples
    --------
    >>> rows = np.array([[0.0, 0.0, 0.0, 0.0], [0.5, 0.5, 0.5, 0.5], [-1.0, -1.0, -1.0, -1.0]])
    >>> quaternion = AttitudeConvention("quaternion", "inertial_to_body")
    >>> without_solution(rows, quaternion, np.zeros((3, 4), dtype=bool)).tolist()
    [True, False, True]
    """
    size = np.abs(values[:, 0])
    impossible = {
        "quaternion": np.abs(size - 0.5) > _NOT_ORTHOGONAL,
        "dcm": size >= 0.0,
        "mrp": size > 1.0,
        "euler": size * convention.radians > 2.0 * np.pi,
    }[convention.form]
    same = (values == values[:, :1]).all(axis=1)
    return marked.all(axis=1) | (same & impossible)


def standing_mark(quaternions: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Rows whose attitude is a mark of "no solution", such as 0 0 0 1.

    To one and the same attitude, to the last digit, the rows jump again and again and back.

    `quaternions` (n, 4); `time` (n,) [s]. Returns (n,).

    Examples
    --------
    >>> rows = np.array([[0.6, 0.0, 0.0, 0.8], [0.0, 0.0, 0.0, 1.0]] * 3)
    >>> rows[::2, 0] += 1e-6 * np.arange(3)
    >>> standing_mark(rows, np.arange(6.0)).tolist()
    [False, True, False, True, False, True]
    """
    marks = np.zeros(len(time), dtype=bool)
    rows = np.flatnonzero(np.isfinite(quaternions).all(axis=1) & np.isfinite(time))
    q, steps = quaternions[rows], np.diff(time[rows])
    usual = 1.5 * float(np.median(steps)) if len(steps) else 0.0
    _, first, counts = np.unique(q @ _KEY, return_index=True, return_counts=True)
    for row in first[np.argsort(-counts)[:_MOST_COMMON]]:
        same = (q == q[row]).all(axis=1)
        # After a pause a body may be anywhere.
        borders = np.flatnonzero((same[1:] != same[:-1]) & (steps < usual))
        others = np.where(same[borders, None], q[borders + 1], q[borders])
        jumps = np.abs(others @ q[row]) < np.cos(0.5 * _JUMP)
        again = int((same[1:] & ~same[:-1]).sum() + same[0]) > 1
        # Of two that stand still, the one beside several others is the mark.
        if again and len(borders) > 1 and jumps.all() and np.any(others != others[0]):
            marks[rows[same]] = True
            break
    return marks


def rounding_of_attitudes(
    values: np.ndarray, convention: AttitudeConvention, sigmas: np.ndarray
) -> float:
    """Standard deviation of an attitude about any axis from rounding of its columns.

    `sigmas` (columns,). `values` (n, columns): the columns; NaN throughout a row without a fix.
    Returns [rad].

    Examples
    --------
    >>> fix, sigmas = np.array([[0.0, 0.0, 0.6, 0.8]]), np.full(4, 1e-4)
    >>> quaternion = AttitudeConvention("quaternion", "inertial_to_body")
    >>> round(rounding_of_attitudes(fix, quaternion, sigmas), 7)
    0.0002
    """
    given = values[np.isfinite(values).all(axis=1)]
    given = given[:: max(1, len(given) // _ROWS_OF_ROUNDING)]
    if not len(given):
        return 0.0
    exact = Rotation.from_quat(to_quaternions(given, convention))
    turned = [
        Rotation.from_quat(to_quaternions(given + sigma * column, convention)) * exact.inv()
        for sigma, column in zip(sigmas, np.eye(values.shape[1]), strict=True)
    ]
    angles = np.array([turn.magnitude() for turn in turned])
    return float(np.sqrt((angles**2).sum(axis=0).mean() / 3.0))


def bad_attitude(values: np.ndarray, convention: AttitudeConvention) -> tuple[int, str] | None:
    """The first row that is neither empty nor an attitude.

    `values` (n, columns). Returns: the row and what is wrong with it; None if all rows are good.

    Examples
    --------
    >>> bad_attitude(np.eye(3).reshape(1, 9) * 2.0, AttitudeConvention("dcm", "inertial_to_body"))
    (0, 'the matrix is no rotation: its rows are not of length 1 and square to each other')
    """
    if convention.form == "quaternion":
        return bad_quaternion(values)
    given = np.isfinite(values).sum(axis=1)
    bad = (given > 0) & (given < values.shape[1])
    if bad.any():
        return int(np.argmax(bad)), "the attitude is incomplete"
    if convention.form == "dcm":
        matrices = values.reshape(-1, 3, 3)
        square = np.einsum("nij,nkj->nik", matrices, matrices) - np.eye(3)
        bad = np.abs(square).max(axis=(1, 2)) > _NOT_ORTHOGONAL
        if bad.any():
            return int(np.argmax(bad)), (
                "the matrix is no rotation: its rows are not of length 1 and square to each other"
            )
        bad = np.linalg.det(matrices) < 0.0
        if bad.any():
            return int(np.argmax(bad)), "the matrix mirrors: an axis has the wrong sign"
    return None


def from_tracker_axes(quaternions: np.ndarray, body_from_tracker: np.ndarray) -> np.ndarray:
    """Attitudes of the body from those of a star tracker: v_B = R v_T.

    `body_from_tracker` (3, 3). `quaternions` (n, 4): tracker from inertial, scalar last; NaN in
    rows without a fix. Returns (n, 4).

    Examples
    --------
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
