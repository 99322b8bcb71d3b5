"""Rotations of many slews at once with numpy alone, which loads in no time.

Quaternions are those of `maths.quaternion` (scalar last, Hamilton products); that module computes
with JAX, which takes longer to load than the whole check lasts.
"""

from __future__ import annotations

import numpy as np

from bayes_inertia.maths.quaternion_product import product_components


def composed(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Hamilton product p * q of quaternions (..., 4).

    Examples
    --------
    >>> composed(np.array([0., 0., 0., 1.]), np.array([1., 0., 0., 0.])).tolist()
    [1.0, 0.0, 0.0, 0.0]
    """
    return np.stack(product_components(np.moveaxis(p, -1, 0), np.moveaxis(q, -1, 0)), axis=-1)


def turned_back(q: np.ndarray) -> np.ndarray:
    """The inverse of unit quaternions (..., 4).

    Examples
    --------
    >>> turned_back(np.array([0., 0., 1., 0.])).tolist()
    [-0.0, -0.0, -1.0, 0.0]
    """
    return q * np.array([-1.0, -1.0, -1.0, 1.0])


def of_angle(vector: np.ndarray) -> np.ndarray:
    """Unit quaternions (..., 4) of rotation vectors (..., 3) [rad].

    `vector` (..., 3) [rad].

    Examples
    --------
    >>> of_angle(np.array([0., 0., np.pi])).round(6).tolist()
    [0.0, 0.0, 1.0, 0.0]
    """
    angle = np.sqrt(np.einsum("...i,...i", vector, vector))[..., None]
    half = 0.5 * angle
    return np.concatenate([0.5 * np.sinc(half / np.pi) * vector, np.cos(half)], axis=-1)


def angle_of(q: np.ndarray) -> np.ndarray:
    """Rotation vectors (..., 3) [rad], at most pi long, of unit quaternions (..., 4).

    Examples
    --------
    >>> angle_of(-of_angle(np.array([0.25, 0., 0.]))).round(6).tolist()
    [0.25, 0.0, 0.0]
    """
    q = np.where(q[..., 3:] < 0.0, -q, q)
    norm = np.sqrt(np.einsum("...i,...i", q[..., :3], q[..., :3]))[..., None]
    safe = np.maximum(norm, 1e-12)
    return q[..., :3] * np.where(norm > 1e-12, 2.0 * np.arctan2(norm, q[..., 3:]) / safe, 2.0)


def matrix_to_start(q: np.ndarray) -> np.ndarray:
    """C(q)^T (..., 3, 3): from body axes to the axes that q starts from.

    `q` (..., 4).

    Examples
    --------
    >>> np.abs(matrix_to_start(np.array([0., 0., .5**.5, .5**.5])) @ [1., 0., 0.]).round(6).tolist()
    [0.0, 1.0, 0.0]
    """
    x, y, z, w = np.moveaxis(q, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def accumulated(steps: np.ndarray) -> np.ndarray:
    """Products steps[0] * ... * steps[k] of quaternions along the last axis but one.

    The products double their length in each round, so that a slew of n steps takes log2(n) rounds
    of array operations.

    `steps` (..., n, 4). Returns (..., n, 4).

    Examples
    --------
    >>> quarter = of_angle(np.array([0., 0., np.pi / 2]))
    >>> angle_of(accumulated(np.stack([quarter, quarter]))).round(3)[1].tolist()
    [0.0, 0.0, 3.142]
    """
    product, reach = np.array(steps), 1
    while reach < product.shape[-2]:
        longer = composed(product[..., :-reach, :], product[..., reach:, :])
        product = np.concatenate([product[..., :reach, :], longer], axis=-2)
        reach *= 2
    return product
