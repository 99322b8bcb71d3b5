"""States between the ends of integration steps, from values and slopes at both ends.

Attitude and body-frame momentum are polynomials of fifth degree (Hairer, Norsett and Wanner 1993,
section II.6), whose error is far below that of the step; what effects add is a cubic. Slopes are
counted per step, not per second, so that steps of zero length are no exception.
"""

from __future__ import annotations

from typing import Any

from jax import Array

from bayes_inertia.maths import quaternion
from bayes_inertia.physics.components import Components, unit

Polynomial = tuple[Array, ...]


def quintic(first: tuple[Any, Any, Any], last: tuple[Any, Any, Any]) -> Polynomial:
    """The quintic with given value, slope and curvature at both ends.

    Parameters
    ----------
    first : tuple of three arrays
        Value, first and second derivative at s = 0.
    last : tuple of three arrays
        The same at s = 1.

    Returns
    -------
    tuple of six arrays
        Coefficients of 1, s, ..., s^5.

    Examples
    --------
    >>> quintic((0.0, 0.0, 0.0), (1.0, 5.0, 20.0))
    (0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    """
    (x, v, a), (end, end_v, end_a) = first, last
    gap, turn, bend = end - x - v - 0.5 * a, end_v - v - a, end_a - a
    return (
        x,
        v,
        0.5 * a,
        10.0 * gap - 4.0 * turn + 0.5 * bend,
        -15.0 * gap + 7.0 * turn - bend,
        6.0 * gap - 3.0 * turn + 0.5 * bend,
    )


def cubic(first: tuple[Any, Any], last: tuple[Any, Any]) -> Polynomial:
    """The cubic with given value and slope at both ends.

    Parameters
    ----------
    first : tuple of two arrays
        Value and derivative at s = 0.
    last : tuple of two arrays
        The same at s = 1.

    Returns
    -------
    tuple of four arrays
        Coefficients of 1, s, s^2, s^3.

    Examples
    --------
    >>> cubic((0.0, 0.0), (1.0, 3.0))
    (0.0, 0.0, 0.0, 1.0)
    """
    (x, v), (end, end_v) = first, last
    gap, turn = end - x - v, end_v - v
    return x, v, 3.0 * gap - turn, turn - 2.0 * gap


def attitude_derivatives(
    attitude: Components, rate: Components, rate_change: Components
) -> list[tuple[Array, Array, Array]]:
    """Value, first and second derivative of a quaternion's components over a step.

    Parameters
    ----------
    attitude : tuple of 4 Array
        Unit quaternion, body from inertial.
    rate : tuple of 3 Array
        Body rate times the step's length [rad].
    rate_change : tuple of 3 Array
        Its derivative over the step [rad].

    Returns
    -------
    list of 4 tuples of 3 Array
        One a component.

    Examples
    --------
    >>> attitude_derivatives((0.0, 0.0, 0.0, 1.0), (2.0, 0.0, 0.0), (0.0, 0.0, 0.0))[0]
    (0.0, 1.0, 0.0)
    """
    turn = quaternion.rate_of_components(attitude, rate)
    of_turn = quaternion.rate_of_components(turn, rate)
    of_change = quaternion.rate_of_components(attitude, rate_change)
    return [(q, v, a + b) for q, v, a, b in zip(attitude, turn, of_turn, of_change, strict=True)]


def turned(attitude: Components, angle: Components) -> Components:
    """A quaternion near the unit sphere, turned by a small angle and put on the sphere.

    Parameters
    ----------
    attitude : tuple of 4 Array
        Body from inertial.
    angle : tuple of 3 Array
        Rotation of the body in its own axes [rad]; its cube is neglected.

    Returns
    -------
    tuple of 4 Array
        Of unit length.

    Examples
    --------
    >>> [round(float(c), 4) for c in turned((0.0, 0.0, 0.0, 1.0), (0.02, 0.0, 0.0))]
    [0.01, 0.0, 0.0, 1.0]
    """
    change = quaternion.rate_of_components(attitude, angle)
    return unit(tuple(q + d for q, d in zip(attitude, change, strict=True)))
