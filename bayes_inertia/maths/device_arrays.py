"""Arrays of the host as arrays of JAX, without compiling anything; and sizes to compile for."""

from __future__ import annotations

import jax
import numpy as np
from jax import Array

from bayes_inertia.maths.jax_settings import require_usable_jax
from bayes_inertia.maths.values import AnyArray

# Rows or star-tracker fixes of a slew are padded to so many at least. Sizes are multiples of three,
# as the rows of an integration step are.
_SMALLEST = 48
# Up to here sizes are doubled: compiling (30 s of a fit) costs more than running (5 s). Beyond,
# there is a size between.
_RUNS_SOON = 768


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


def padded_size(n: int, least: int = _SMALLEST, *, often: bool = False) -> int:
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
    return between if least < n <= between and (often or octave > _RUNS_SOON) else octave


def repeated(rows: AnyArray, size: int, axis: int = 1) -> AnyArray:
    """Rows along an axis, the last one repeated up to so many."""
    last = np.take(rows, [-1] * (size - rows.shape[axis]), axis)
    return np.concatenate([rows, last], axis)


def filled(rows: AnyArray, size: int, axis: int = 1) -> AnyArray:
    """Rows along an axis, followed by zeros up to so many."""
    spare = list(rows.shape)
    spare[axis] = size - rows.shape[axis]
    return np.concatenate([rows, np.zeros(spare, rows.dtype)], axis)
