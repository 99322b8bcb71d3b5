"""Quaternion algebra, scalar last, body from inertial: v_B = C(q) v_N.

The array functions take `jax.numpy` or numpy arrays with the components on the last axis and
broadcast over the axes before it. Products are Hamilton products, so that a small rotation
e in BODY axes is applied on the right: q_new = q * exp(e). (The kinematics
eps' = (eps x w + eta w)/2, eta' = -(eps.w)/2 of Ferguson's eqs 10 and 11 are q' = q * [w, 0]/2.)

The `..._components` functions do the same on tuples of components (x, y, z) and (e1, e2, e3, eta);
the simulator's inner loop uses them because XLA fuses scalars twice as well as stacked vectors
(measured).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.maths import jax_settings as jax_settings
from bayes_inertia.maths.quaternion_product import product_components

ComponentSequence = Sequence[Array]


def cross_components(a: ComponentSequence, b: ComponentSequence) -> tuple[Array, Array, Array]:
    """a x b of two vectors given as components.

    Examples
    --------
    >>> cross_components((1, 0, 0), (0, 1, 0))
    (0, 0, 1)
    """
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def to_body_components(q: ComponentSequence, v_N: ComponentSequence) -> tuple[Array, ...]:
    """C(q) v_N: an inertial vector in body axes.

    Examples
    --------
    >>> to_body_components((0, 0, 1, 0), (1, 2, 3))
    (-1, -2, 3)
    """
    twice = cross_components([2 * e for e in q[:3]], v_N)
    inner = cross_components(q[:3], twice)
    return tuple(v_N[i] - q[3] * twice[i] + inner[i] for i in range(3))


def to_inertial_components(q: ComponentSequence, v_B: ComponentSequence) -> tuple[Array, ...]:
    """C(q)^T v_B: a body vector in inertial axes.

    Examples
    --------
    >>> to_inertial_components((0, 0, 1, 0), (1, 2, 3))
    (-1, -2, 3)
    """
    return to_body_components((q[0], q[1], q[2], -q[3]), v_B)


def rate_of_components(q: ComponentSequence, rate_B: ComponentSequence) -> tuple[Array, ...]:
    """dq/dt for the body rate w (paper eqs 10, 11).

    `rate_B` [rad/s]. Returns [1/s].

    Examples
    --------
    >>> rate_of_components((0, 0, 0, 1), (2, 0, 0))
    (1.0, 0.0, 0.0, -0.0)
    """
    turn = cross_components(q[:3], rate_B)
    vector = [0.5 * (turn[i] + q[3] * rate_B[i]) for i in range(3)]
    return (*vector, -0.5 * (q[0] * rate_B[0] + q[1] * rate_B[1] + q[2] * rate_B[2]))


def _split(array: Any) -> list[Any]:
    array = array if hasattr(array, "shape") else np.asarray(array, dtype=float)
    return [array[..., i] for i in range(array.shape[-1])]


def multiply(p: Array, q: Array) -> Array:
    """Hamilton product p * q of quaternions (..., 4), scalar last.

    Examples
    --------
    >>> multiply(jnp.array([0., 0., 0., 1.]), jnp.array([1., 0., 0., 0.])).tolist()
    [1.0, 0.0, 0.0, 0.0]
    """
    return jnp.stack(product_components(_split(p), _split(q)), axis=-1)


def conjugate(q: Array) -> Array:
    """The inverse of a unit quaternion (..., 4).

    Examples
    --------
    >>> conjugate(jnp.array([1., 0., 0., 2.])).tolist()
    [-1.0, -0.0, -0.0, 2.0]
    """
    return q * jnp.array([-1.0, -1.0, -1.0, 1.0])


def to_inertial(q: Array, v_B: Array) -> Array:
    """C(q)^T v_B: a body-frame vector (..., 3) in inertial axes.

    Parameters
    ----------
    q : (..., 4) array
        Attitude, body from inertial.
    v_B : (..., 3) array
        Vector in body axes.

    Returns
    -------
    (..., 3) array
        The vector in inertial axes.

    Examples
    --------
    >>> quarter_turn = jnp.array([0., 0., 2**-.5, 2**-.5])
    >>> (to_inertial(quarter_turn, jnp.array([1., 0., 0.])).round(6) + 0.0).tolist()
    [0.0, 1.0, 0.0]
    """
    return jnp.stack(to_inertial_components(_split(q), _split(v_B)), axis=-1)


def to_body(q: Array, v_N: Array) -> Array:
    """C(q) v_N: an inertial vector (..., 3) in body axes.

    Parameters
    ----------
    q : (..., 4) array
        Attitude, body from inertial.
    v_N : (..., 3) array
        Vector in inertial axes.

    Returns
    -------
    (..., 3) array
        The vector in body axes.

    Examples
    --------
    >>> quarter_turn = jnp.array([0., 0., 2**-.5, 2**-.5])
    >>> (to_body(quarter_turn, jnp.array([0., 1., 0.])).round(6) + 0.0).tolist()
    [1.0, 0.0, 0.0]
    """
    return jnp.stack(to_body_components(_split(q), _split(v_N)), axis=-1)


def exp(rotation_vector: Array) -> Array:
    """The unit quaternion (..., 4) of a rotation vector (..., 3) [rad]; smooth at zero.

    `rotation_vector` (..., 3) [rad].

    Examples
    --------
    >>> exp(jnp.array([0., 0., jnp.pi])).round(6).tolist()
    [0.0, 0.0, 1.0, 0.0]
    """
    square = jnp.sum(rotation_vector**2, axis=-1, keepdims=True)
    small = square < 1e-8
    angle = jnp.sqrt(jnp.where(small, 1.0, square))
    sinc_half = jnp.where(small, 0.5 - square / 48.0, jnp.sin(angle / 2.0) / angle)
    cosine = jnp.where(small, 1.0 - square / 8.0, jnp.cos(angle / 2.0))
    return jnp.concatenate([sinc_half * rotation_vector, cosine], axis=-1)


def turned(q: Array, rotation_vector: Array) -> Array:
    """q * exp(rotation vector): a quaternion (..., 4) turned about body axes by (..., 3) [rad]."""
    return multiply(q, exp(rotation_vector))


def log(q: Array) -> Array:
    """The rotation vector (..., 3) [rad], at most pi long, of a unit quaternion; log(q) = log(-q).

    `q` (..., 4).

    Examples
    --------
    >>> (log(-exp(jnp.array([0.25, 0., 0.]))).round(6) + 0.0).tolist()
    [0.25, 0.0, 0.0]
    """
    q = jnp.where(q[..., 3:] < 0.0, -q, q)
    vector, scalar = q[..., :3], q[..., 3:]
    square = jnp.sum(vector**2, axis=-1, keepdims=True)
    small = square < 1e-8
    norm = jnp.sqrt(jnp.where(small, 1.0, square))
    scale = jnp.where(small, 2.0 + square / 3.0, 2.0 * jnp.arctan2(norm, scalar) / norm)
    return scale * vector


def error(q_predicted: Array, q_measured: Array) -> Array:
    """The small rotation e in body axes (..., 3) [rad] with q_measured = q_predicted * exp(e).

    The sign of either quaternion does not matter.

    `q_predicted` and `q_measured` (..., 4).

    Examples
    --------
    >>> q = exp(jnp.array([0.3, -0.2, 0.1]))
    >>> (error(q, -multiply(q, exp(jnp.array([0., 0.25, 0.])))).round(9) + 0.0).tolist()
    [0.0, 0.25, 0.0]
    """
    return log(multiply(conjugate(q_predicted), q_measured))
