"""Vectors as tuples of components, in time: interpolation, and one Runge-Kutta step.

Compiled code handles a few scalars faster than arrays of three numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

Components = tuple[Array, ...]


def columns(rows: Array) -> Components:
    """The columns of an array.

    Parameters
    ----------
    rows : (n, k) array
        One row a grid point.

    Returns
    -------
    tuple of k (n,) arrays
        One array a column.

    Examples
    --------
    >>> [column.tolist() for column in columns(jnp.array([[1.0, 2.0], [3.0, 4.0]]))]
    [[1.0, 3.0], [2.0, 4.0]]
    """
    return tuple(rows[:, i] for i in range(rows.shape[1]))


def stacked(components: Components, *shape: int) -> Array:
    """Components as one array, also where there are none.

    Parameters
    ----------
    components : tuple of k Array
        Arrays of one shape.
    *shape : int
        That shape, for the case of no components.

    Returns
    -------
    (..., k) array
        The components along the last axis.

    Examples
    --------
    >>> stacked((), 3).shape
    (3, 0)
    """
    return jnp.stack(components, -1) if len(components) else jnp.zeros((*shape, 0))


def following(rows: Array) -> Array:
    """Every row's successor; the last row is its own.

    Parameters
    ----------
    rows : (n, ...) array
        One row a grid point.

    Returns
    -------
    (n, ...) array
        The rows from the second on, and the last once more.

    Examples
    --------
    >>> following(jnp.array([1.0, 2.0, 3.0])).tolist()
    [2.0, 3.0, 3.0]
    """
    return jnp.concatenate([rows[1:], rows[-1:]])


def between(fraction: float | Array, step_ends: tuple[Components, Components]) -> Components:
    """Linear interpolation within one step.

    Parameters
    ----------
    fraction : float
        Part of the step that has passed, 0 to 1.
    step_ends : tuple of two tuples of Array
        The components at the step's beginning and end.

    Returns
    -------
    tuple of Array
        The components at that instant.

    Examples
    --------
    >>> between(0.5, ((1.0,), (2.0,)))
    (1.5,)
    """
    return tuple(a + fraction * (b - a) for a, b in zip(*step_ends, strict=True))


def unit(components: Components) -> Components:
    """A vector or quaternion scaled to unit length.

    Parameters
    ----------
    components : tuple of Array
        Its components, not all zero.

    Returns
    -------
    tuple of Array
        Components whose squares sum to one.

    Examples
    --------
    >>> [round(float(c), 6) for c in unit((3.0, 4.0))]
    [0.6, 0.8]
    """
    shrink = 1.0 / jnp.sqrt(sum(c * c for c in components))
    return tuple(c * shrink for c in components)


def runge_kutta_4(slope: Callable[[Any, Any], Any], x: Any, step: Array) -> Any:
    """One step of the classical Runge-Kutta method of fourth order.

    Parameters
    ----------
    slope : callable
        Takes the fraction of the step that has passed and the state; returns its time derivative.
    x : pytree
        The state at the step's beginning.
    step : () array
        Length of the step [s].

    Returns
    -------
    pytree
        The state at the step's end.

    Examples
    --------
    >>> runge_kutta_4(lambda fraction, x: -x, jnp.array(1.0), 0.1).round(4).item()
    0.9048
    """

    # The stages are a loop, not written out: with many effects compiling takes minutes otherwise.
    def stage(carry, row):
        fraction, share = row
        k, total = carry
        k = slope(fraction, jax.tree.map(lambda a, b: a + fraction * step * b, x, k))
        return (k, jax.tree.map(lambda t, b: t + share * step * b, total, k)), None

    still = jax.tree.map(jnp.zeros_like, x)
    stages = (jnp.array([0.0, 0.5, 0.5, 1.0]), jnp.array([1.0, 2.0, 2.0, 1.0]) / 6.0)
    return jax.lax.scan(stage, (still, x), stages)[0][1]
