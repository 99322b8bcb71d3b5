"""Arrays of the host as arrays of JAX, without compiling anything; and sizes to compile for."""

from __future__ import annotations

import jax
import numpy as np
from jax import Array

from bayes_inertia.maths.jax_settings import require_usable_jax
from bayes_inertia.maths.values import AnyArray

# Of an axis, at least: a slew has some ten star-tracker fixes. Sizes are multiples of three, as the
# rows of an integration step are.
_SMALLEST = 12


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


def padded_size(n: int, least: int = _SMALLEST) -> int:
    """The size that an axis of n numbers is padded to: 12, 18, 24, 36, 48, 72, 96, ...

    Two sizes an octave: more would be compiled more often than they save (of a fit, compiled code
    runs for 4 s and is compiled for 30).

    Returns: at least n; less than 1.5 n from `least` on.

    Examples
    --------
    >>> [padded_size(n) for n in (3, 13, 19, 581, 769)]
    [12, 18, 24, 768, 1152]
    """
    octave = least
    while octave < n:
        octave *= 2
    between = 3 * octave // 4
    return between if least < n <= between else octave


def repeated(rows: AnyArray, size: int, axis: int = 1) -> AnyArray:
    """Rows along an axis, the last one repeated up to so many."""
    last = np.take(rows, [-1] * (size - rows.shape[axis]), axis)
    return np.concatenate([rows, last], axis)


def filled(rows: AnyArray, size: int, axis: int = 1) -> AnyArray:
    """Rows along an axis, followed by zeros up to so many."""
    spare = list(rows.shape)
    spare[axis] = size - rows.shape[axis]
    return np.concatenate([rows, np.zeros(spare, rows.dtype)], axis)
