"""Vectors as tuples of components, and Runge-Kutta steps of them.

Compiled code handles a few scalars faster than arrays of three numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

Components = tuple[Array, ...]


@dataclass(frozen=True, eq=False)
class Tableau:
    """An explicit Runge-Kutta method of s stages (Butcher's tableau)."""

    fractions: np.ndarray  # (s,), of the step that have passed
    stages: np.ndarray  # (s, s), what each stage takes of the slopes of those before it
    weights: np.ndarray  # (s,), of the slopes in the step

    @classmethod
    def butcher_6(cls) -> Tableau:
        """Sixth order in seven stages (J. C. Butcher, J. Austral. Math. Soc. 4, 1964)."""
        third, half = 1.0 / 3.0, 0.5
        stages = np.zeros((7, 7))
        stages[1, :1] = third
        stages[2, :2] = 0.0, 2.0 / 3.0
        stages[3, :3] = 1.0 / 12.0, third, -1.0 / 12.0
        stages[4, :4] = -1.0 / 16.0, 9.0 / 8.0, -3.0 / 16.0, -3.0 / 8.0
        stages[5, :5] = 0.0, 9.0 / 8.0, -3.0 / 8.0, -3.0 / 4.0, half
        stages[6, :6] = 9.0 / 44.0, -9.0 / 11.0, 63.0 / 44.0, 18.0 / 11.0, 0.0, -16.0 / 11.0
        weights = np.array([11.0, 0.0, 81.0, 81.0, -32.0, -32.0, 11.0]) / 120.0
        return cls(np.array([0.0, third, 2.0 / 3.0, third, half, half, 1.0]), stages, weights)


def columns(rows: Array) -> Components:
    """The columns of an array.

    `rows` (n, k). Returns (n,).

    Examples
    --------
    >>> [column.tolist() for column in columns(jnp.array([[1.0, 2.0], [3.0, 4.0]]))]
    [[1.0, 3.0], [2.0, 4.0]]
    """
    return tuple(rows[:, i] for i in range(rows.shape[1]))


def stacked(components: Components, *shape: int) -> Array:
    """Components as one array, also where there are none.

    Returns (..., k).

    Examples
    --------
    >>> stacked((), 3).shape
    (3, 0)
    """
    return jnp.stack(components, -1) if len(components) else jnp.zeros((*shape, 0))


def following(rows: Array) -> Array:
    """Every row's successor; the last row is its own.

    `rows` (n, ...). Returns (n, ...): the rows from the second on, and the last once more.

    Examples
    --------
    >>> following(jnp.array([1.0, 2.0, 3.0])).tolist()
    [2.0, 3.0, 3.0]
    """
    return jnp.concatenate([rows[1:], rows[-1:]])


def unit(components: Components) -> Components:
    """A vector or quaternion scaled to unit length.

    Examples
    --------
    >>> [round(float(c), 6) for c in unit((3.0, 4.0))]
    [0.6, 0.8]
    """
    shrink = 1.0 / jnp.sqrt(sum(c * c for c in components))
    return tuple(c * shrink for c in components)


def computed_once(values: Any) -> Any:
    """Values that compiled code computes once and keeps.

    Otherwise it computes them anew for each of the numbers that depend on them: a simulation with
    many effects takes three times as long, and compiling it longer too.

    Examples
    --------
    >>> computed_once((jnp.array(1.0), jnp.array(2.0)))[1].item()
    2.0
    """
    return jax.lax.optimization_barrier(values)


def runge_kutta_4(slope: Callable[[Any, Any], Any], x: Any, step: Array) -> Any:
    """One step of the classical Runge-Kutta method of fourth order.

    `step` [s]. `slope`: takes the fraction of the step that has passed and the state; returns its
    time derivative.

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


def runge_kutta_6(slope: Callable[[Any, Any], Any], x: Any, step: Array) -> Any:
    """One step of Butcher's Runge-Kutta method of sixth order (1964, seven stages).

    `step` [s]. `slope`: takes the fraction of the step that has passed and the state; returns its
    time derivative.

    Examples
    --------
    >>> print(f"{runge_kutta_6(lambda fraction, x: -x, jnp.array(1.0), 0.1):.9f}")
    0.904837418
    """

    def stage(slopes, row):
        index, fraction, taken = row
        k = slope(fraction, _moved(x, slopes, step * taken))
        return jax.tree.map(
            lambda rows, now: jax.lax.dynamic_update_index_in_dim(rows, now, index, 0), slopes, k
        ), None

    method = Tableau.butcher_6()
    count = len(method.weights)
    none = jax.tree.map(lambda a: jnp.zeros((count, *jnp.shape(a))), x)
    rows = (jnp.arange(count), jnp.asarray(method.fractions), jnp.asarray(method.stages))
    return _moved(x, jax.lax.scan(stage, none, rows)[0], step * method.weights)


def _moved(x: Any, slopes: Any, shares: Array) -> Any:
    """The state, moved along the slopes of all stages (7, ...) by so much of each."""
    # Products and a sum become part of what comes next; `tensordot` is a call of its own.
    of_all = jax.vmap(jnp.multiply)
    return jax.tree.map(lambda a, k: a + jnp.sum(of_all(shares, k), 0), x, slopes)
