"""Arrays of the host as arrays of JAX, without compiling anything; and sizes to compile for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax import Array

from bayes_inertia.maths.jax_settings import require_usable_jax
from bayes_inertia.maths.numerics import NUMERICS
from bayes_inertia.maths.values import AnyArray


def on_device(values: AnyArray) -> Array:
    """Numbers of the host as an array of JAX.

    `jnp.asarray` compiles a copy for every new shape, some 20 ms each; this compiles nothing.

    `values`: numbers; they must not be changed afterwards, the array may share their memory.

    Examples
    --------
    >>> on_device((1.0, 2.0)).shape
    (2,)
    """
    require_usable_jax()
    return jax.device_put(np.asarray(values))


def padded_size(n: int, least: int = NUMERICS.smallest_padding, *, often: bool = False) -> int:
    """The size that an axis of n numbers is padded to, so that other lengths share a program.

    `often`: whether all sizes have one between them and the next, as from 768 on: what is compiled
    for the axis costs little. Returns 48, 96, 192, 384, 768, 1152, 1536, 2304, ...

    Examples
    --------
    >>> [padded_size(n) for n in (3, 49, 511, 581, 769)], padded_size(5, 1, often=True)
    ([48, 96, 768, 768, 1152], 6)
    """
    octave = least
    while octave < n:
        octave *= 2
    between = 3 * octave // 4
    return (
        between if least < n <= between and (often or octave > NUMERICS.doubled_up_to) else octave
    )


def repeated(rows: AnyArray, size: int, axis: int = 1) -> AnyArray:
    """Rows along an axis, the last one repeated up to so many."""
    last = np.take(rows, [-1] * (size - rows.shape[axis]), axis)
    return np.concatenate([rows, last], axis)


def in_batches(program: Callable[..., Any], rows: Any, size: int) -> Any:
    """Results of a compiled program for any number of rows, so many at once; of numpy.

    `rows`: an array, or a tree of arrays with the rows as leading axis.
    """
    n = len(jax.tree.leaves(rows)[0])
    every = jax.tree.map(lambda x: repeated(np.asarray(x), n + -n % size, 0), rows)
    starts = range(0, n, size)
    parts = [program(jax.tree.map(lambda x, i=i: x[i : i + size], every)) for i in starts]
    return jax.tree.map(lambda *of_parts: np.concatenate(of_parts)[:n], *parts)


def filled(rows: AnyArray, size: int, axis: int = 1) -> AnyArray:
    """Rows along an axis, followed by zeros up to so many."""
    spare = list(rows.shape)
    spare[axis] = size - rows.shape[axis]
    return np.concatenate([rows, np.zeros(spare, rows.dtype)], axis)


def padded(rows: AnyArray) -> AnyArray:
    """Rows of all slews (slews, n, ...), followed by zeros up to sizes that share programs."""
    slews, n = padded_size(len(rows), 1, often=True), padded_size(rows.shape[1])
    return filled(filled(rows, slews, 0), n)
