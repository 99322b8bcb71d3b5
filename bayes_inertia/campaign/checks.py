"""What the records of a campaign demand of the numbers they are given."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bayes_inertia.errors import CampaignError
from bayes_inertia.maths.values import Vector


def require(condition: bool, key: str, what: str, advice: str) -> None:
    """Raise an error that names a key of the campaign, unless a condition holds.

    Examples
    --------
    >>> require(1.0 > 0.0, "rate_sensor.sigma", "is not positive", "give a positive number")
    """
    if not condition:
        raise CampaignError(what, where=f"key {key}", advice=advice)


def unit_vector(value: Any, key: str) -> Vector:
    """Three numbers of length 1, as plain floats.

    `value` (3,): A vector whose length is 1 to within a percent.

    Examples
    --------
    >>> unit_vector([0, 0, 1.001], "wheels.z.axis")
    (0.0, 0.0, 1.0)
    """
    array = np.asarray(value, dtype=float)
    is_vector = array.shape == (3,) and bool(np.all(np.isfinite(array)))
    require(is_vector, key, f"{value!r} is not a vector", "give three finite numbers")
    norm = math.hypot(*array.tolist())
    require(
        abs(norm - 1.0) < 0.01,
        key,
        f"the vector has length {norm:.6g}, not 1",
        "give a unit vector in body axes",
    )
    x, y, z = unit_length(array).tolist()
    return (x, y, z)


def unit_length(vectors: np.ndarray) -> np.ndarray:
    """Vectors divided by their length.

    `vectors` (..., n). Returns (..., n): the same directions. A vector whose length is 1 to
    rounding stays as it is, so that reading what was written changes no digit.

    Examples
    --------
    >>> unit_length(np.array([0.0, 3.0, 4.0])).tolist()
    [0.0, 0.6, 0.8]
    """
    norm = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(np.abs(norm - 1.0) < 1e-15, vectors, vectors / norm)


def triple(value: Any, key: str) -> Vector:
    """One number for each of three axes, as plain floats.

    `value` (3,): one number for all axes, or one for each.

    Examples
    --------
    >>> triple(2e-5, "rate_sensor.sigma")
    (2e-05, 2e-05, 2e-05)
    """
    array = np.broadcast_to(np.asarray(value, dtype=float), (3,))
    finite = bool(np.all(np.isfinite(array)))
    require(finite, key, f"{value!r} is not finite", "give finite numbers")
    x, y, z = array.tolist()
    return (x, y, z)


def require_positive(value: Any, key: str, *, optional: bool = False) -> None:
    """Raise an error unless numbers are finite and positive.

    Examples
    --------
    >>> require_positive(None, "wheels.x.max_torque", optional=True)
    """
    if value is None and optional:
        return
    positive = (
        value is not None
        and bool(np.all(np.isfinite(value)))
        and bool(np.all(np.asarray(value) > 0.0))
    )
    require(positive, key, f"{value!r} is not positive", "give a positive number in SI units")
