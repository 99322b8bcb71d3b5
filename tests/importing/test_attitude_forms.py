"""Every way to write an attitude gives the same quaternion: body from inertial, scalar last."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bayes_inertia.importing.stream_readings import (
    AttitudeConvention,
    bad_attitude,
    from_tracker_axes,
    to_quaternions,
)
from bayes_inertia.maths.quaternion import to_body

# scipy's rotations take body vectors to inertial axes where this package's take inertial ones to
# body axes: the same quaternion, the transposed matrix.
TRUTH = Rotation.random(40, rng=np.random.default_rng(3))
C = TRUTH.as_matrix().transpose(0, 2, 1)  # v_B = C v_N
INVERSE = {"inertial_to_body": "body_to_inertial", "body_to_inertial": "inertial_to_body"}


def written(form: str, maps: str, **how) -> tuple[np.ndarray, AttitudeConvention]:
    """The attitudes as a log would have them."""
    rotation = TRUTH if maps == "inertial_to_body" else TRUTH.inv()
    if form == "quaternion":
        values = rotation.as_quat(scalar_first=how["scalar"] == "first")
    elif form == "dcm":
        values = (C if maps == "inertial_to_body" else C.transpose(0, 2, 1)).reshape(-1, 9)
    elif form == "mrp":
        values = rotation.as_mrp()
    else:
        intrinsic = how["turns"] == "intrinsic"
        letters = how["sequence"].upper() if intrinsic else how["sequence"].lower()
        values = rotation.as_euler(letters) / how["radians"]
    return values, AttitudeConvention(form, maps, **how)


CASES = [
    ("quaternion", {"scalar": "first"}),
    ("quaternion", {"scalar": "last"}),
    ("dcm", {}),
    ("mrp", {}),
    *(
        ("euler", {"sequence": sequence, "turns": turns, "radians": unit})
        for sequence, unit in (("zyx", 1.0), ("xyz", np.pi / 180), ("zxz", np.pi / 180))
        for turns in ("intrinsic", "extrinsic")
    ),
]
every_case = pytest.mark.parametrize(("form", "how"), CASES, ids=lambda v: str(v))


def misaligned(quaternions: np.ndarray) -> float:
    """Largest angle to the truth [rad]."""
    return float((Rotation.from_quat(quaternions) * TRUTH.inv()).magnitude().max())


@every_case
@pytest.mark.parametrize("maps", INVERSE)
def test_every_form_gives_the_same_quaternions(form, how, maps):
    values, convention = written(form, maps, **how)
    assert bad_attitude(values, convention) is None
    assert misaligned(to_quaternions(values, convention)) < 1e-7


@every_case
def test_the_wrong_direction_is_another_attitude(form, how):
    values, _ = written(form, "inertial_to_body", **how)
    wrong = AttitudeConvention(form, "body_to_inertial", **how)
    assert misaligned(to_quaternions(values, wrong)) > 0.1


def test_the_quaternion_is_that_of_the_package():
    """C(q) v_N of the package is the matrix that the log means."""
    values, convention = written("dcm", "inertial_to_body")
    quaternions = to_quaternions(values, convention)
    v_N = np.random.default_rng(1).normal(size=(len(values), 3))
    np.testing.assert_allclose(
        to_body(quaternions, v_N), np.einsum("nij,nj->ni", C, v_N), atol=1e-12
    )


def test_quaternions_keep_their_digits_and_signs():
    values = -TRUTH.as_quat()
    same = to_quaternions(values, AttitudeConvention("quaternion", "inertial_to_body"))
    np.testing.assert_array_equal(same, values)


def test_mrps_of_basilisk():
    """sigma_BN = e tan(angle / 4); [BN] takes inertial components to body components."""
    angle, axis = 1.1, np.array([2.0, -1.0, 2.0]) / 3.0
    sigma = np.tan(angle / 4.0) * axis
    tilde = np.array([[0, -sigma[2], sigma[1]], [sigma[2], 0, -sigma[0]], [-sigma[1], sigma[0], 0]])
    square = sigma @ sigma
    BN = np.eye(3) + (8 * tilde @ tilde - 4 * (1 - square) * tilde) / (1 + square) ** 2
    quaternion = to_quaternions(sigma[None], AttitudeConvention("mrp", "inertial_to_body"))
    v_N = np.array([[0.3, -0.2, 0.9]])
    np.testing.assert_allclose(to_body(quaternion, v_N), v_N @ BN.T, atol=1e-14)


def test_rows_without_a_fix_stay_empty():
    for form, how in CASES:
        values, convention = written(form, "inertial_to_body", **how)
        values = values.copy()
        values[3] = np.nan
        quaternions = to_quaternions(values, convention)
        assert np.isnan(quaternions[3]).all()
        assert np.isfinite(np.delete(quaternions, 3, axis=0)).all()


def test_attitudes_of_the_tracker_become_those_of_the_body():
    """v_B = R v_T = R C_T v_N."""
    R = Rotation.random(rng=np.random.default_rng(8)).as_matrix()
    tracker = Rotation.from_matrix(np.einsum("ij,njk->nik", R.T, C).transpose(0, 2, 1)).as_quat()
    assert misaligned(from_tracker_axes(tracker, R)) < 1e-7
    assert misaligned(from_tracker_axes(tracker, R.T)) > 0.1


@pytest.mark.parametrize(
    ("form", "row", "said"),
    [
        ("quaternion", [0.5, 0.5, 0.5, 0.9], "length"),
        ("quaternion", [0.5, 0.5, 0.5, np.nan], "incomplete"),
        ("mrp", [0.1, np.nan, 0.1], "incomplete"),
        ("dcm", np.diag([1.0, 1.0, 1.1]).ravel(), "no rotation"),
        ("dcm", np.diag([1.0, 1.0, -1.0]).ravel(), "mirrors"),
    ],
)
def test_what_is_no_attitude_is_named(form, row, said):
    values, convention = written(
        form, "inertial_to_body", **({"scalar": "last"} if form == "quaternion" else {})
    )
    problem = bad_attitude(np.vstack([values, row]), convention)
    assert problem is not None
    assert problem[0] == len(values)
    assert said in problem[1]
