"""Quaternions, against scipy and the contract."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation
from support.slews import (
    ATTITUDE,
    RATE,
    _skew,
)

from bayes_inertia.maths import quaternion


def test_quaternion_algebra_agrees_with_scipy():
    rng = np.random.default_rng(7)
    p, q = Rotation.random(50, rng=rng), Rotation.random(50, rng=rng)
    v = rng.normal(size=(50, 3))
    P, Q = jnp.asarray(p.as_quat()), jnp.asarray(q.as_quat())
    np.testing.assert_allclose(
        Rotation.from_quat(np.asarray(quaternion.multiply(P, Q))).as_matrix(),
        (p * q).as_matrix(),
        atol=1e-14,
    )
    np.testing.assert_allclose(quaternion.to_inertial(P, v), p.apply(v), atol=1e-14)
    np.testing.assert_allclose(quaternion.to_body(P, v), p.inv().apply(v), atol=1e-14)
    of_lists = quaternion.to_body(np.asarray(P).tolist(), np.asarray(v).tolist())
    np.testing.assert_allclose(of_lists, quaternion.to_body(P, v), atol=1e-14)
    np.testing.assert_allclose(quaternion.log(P), p.as_rotvec(), atol=1e-13)
    np.testing.assert_allclose(
        Rotation.from_quat(np.asarray(quaternion.exp(jnp.asarray(v)))).as_matrix(),
        Rotation.from_rotvec(v).as_matrix(),
        atol=1e-14,
    )
    np.testing.assert_allclose(quaternion.error(P, Q), (p.inv() * q).as_rotvec(), atol=1e-13)


def test_the_contracts_matrix_is_v_B_from_v_N():
    """C(q) = (eta^2 - eps.eps) 1 + 2 eps eps^T - 2 eta [eps]x, and eps' = (eps x w + eta w)/2, eta'
    = -(eps.w)/2.
    """
    eps, eta = ATTITUDE[:3], ATTITUDE[3]
    C = (eta**2 - eps @ eps) * np.eye(3) + 2.0 * np.outer(eps, eps) - 2.0 * eta * _skew(eps)
    v = np.array([0.3, -1.0, 2.0])
    np.testing.assert_allclose(
        quaternion.to_body(jnp.asarray(ATTITUDE), jnp.asarray(v)), C @ v, atol=1e-14
    )
    slope = np.concatenate([0.5 * (np.cross(eps, RATE) + eta * RATE), [-0.5 * eps @ RATE]])
    np.testing.assert_allclose(
        quaternion.rate_of_components(tuple(ATTITUDE), tuple(RATE)), slope, atol=1e-15
    )


def test_small_rotations_are_smooth_through_zero_and_across_the_switch_of_formulas():
    direction = np.array([0.6, 0.0, 0.8])
    for size in (0.0, 1e-12, 0.99e-4, 1.01e-4, 1e-3):
        x = jnp.asarray(size * direction)
        np.testing.assert_allclose(quaternion.log(quaternion.exp(x)), x, rtol=1e-13, atol=0)
        np.testing.assert_allclose(
            jax.jacfwd(lambda y: quaternion.log(quaternion.exp(y)))(x), np.eye(3), atol=1e-7
        )
