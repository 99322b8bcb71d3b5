"""The Hamilton product on components, for arrays of NumPy and of JAX; loads neither."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any


def product_components(p: Iterable[Any], q: Iterable[Any]) -> tuple[Any, Any, Any, Any]:
    """Hamilton product p * q of two quaternions, scalar last.

    Examples
    --------
    >>> product_components((1, 0, 0, 0), (0, 1, 0, 0))
    (0, 0, 1, 0)
    """
    p1, p2, p3, p4 = p
    q1, q2, q3, q4 = q
    return (
        p4 * q1 + q4 * p1 + p2 * q3 - p3 * q2,
        p4 * q2 + q4 * p2 + p3 * q1 - p1 * q3,
        p4 * q3 + q4 * p3 + p1 * q2 - p2 * q1,
        p4 * q4 - p1 * q1 - p2 * q2 - p3 * q3,
    )
