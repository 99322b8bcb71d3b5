"""Correlated noise of the rate sensor, as what each reading's noise keeps of those before it.

Noise that remembers is a sum of first-order processes beside white noise. A Kalman filter with one
state for each process and axis tells them apart. Its gains follow from the times and from which
readings are missing alone, so that its innovations are a linear map of the residuals: white, of
unit variance, and everything that follows from residuals and their derivatives stays as it is
(Anderson and Moore 1979, section 9.2). Exact for any size, any correlation time and any gap.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.maths.device_arrays import filled, padded_size
from bayes_inertia.maths.values import AnyArray


class Memory(NamedTuple):
    """The filter that whitens correlated noise.

    Parameters
    ----------
    decay : (slews, n, 3, processes) array
        What is left of each process at the next row.
    gain : (slews, n, 3, processes) array
        Share of an innovation that belongs to a process; 0 where nothing was measured.
    scale : (slews, n, 3) array
        One over the standard deviation of the innovations; 1 where nothing was measured.
    """

    # Of numpy on the host, of JAX in compiled code.
    decay: AnyArray
    gain: AnyArray
    scale: AnyArray


def innovations(rate: Any, memory: Memory) -> Any:
    """Whitened residuals without what the residuals before them let expect.

    `rate` (slews, n, 3, ...): whitened residuals, or columns of their derivatives; zero where
    nothing was measured. Of numpy, or of JAX in compiled code. Returns (slews, n, 3, ...).

    Examples
    --------
    >>> decay, gain = np.full((1, 2, 3, 1), 0.6), np.ones((1, 2, 3, 1))
    >>> memory = Memory(decay, gain, np.full((1, 2, 3), 1.25))
    >>> innovations(np.ones((1, 2, 3)), memory)[0, :, 0].tolist()
    [1.25, 0.5]
    """
    if not isinstance(rate, np.ndarray):
        return _innovations(rate, memory)
    # Slews, rows and columns in few sizes.
    slews, n, axes = rate.shape[:3]
    columns = rate.reshape(slews, n, axes, -1)
    size = (
        padded_size(slews, 1, often=True),
        padded_size(n),
        padded_size(columns.shape[-1], 1, often=True),
    )

    def padded(rows: Any) -> Any:
        return filled(filled(np.asarray(rows), size[0], 0), padded_size(n))

    new = _innovations(filled(padded(columns), size[1], -1), Memory(*map(padded, memory)))
    return np.asarray(new)[:slews, :n, :, : columns.shape[-1]].reshape(rate.shape)


@jax.jit
def _innovations(rate: Array, memory: Memory) -> Array:
    rows, known = memory.scale.ndim - 2, memory.scale.ndim
    # Columns stand last, side by side in memory: a step is one pass over them.
    columns = rate.reshape(*rate.shape[:known], -1)

    def step(expected: Array, row: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        reading, decay, gain = row
        new = reading - expected.sum(-2)
        return decay[..., None] * (expected + gain[..., None] * new[..., None, :]), new

    reading, decay, gain = (jnp.moveaxis(x, rows, 0) for x in (columns, memory.decay, memory.gain))
    nothing = jnp.zeros((*decay.shape[1:], columns.shape[-1]))
    _, new = jax.lax.scan(step, nothing, (reading, decay, gain))
    measured = (memory.gain.sum(-1) > 0.0)[..., None]
    whitened = memory.scale[..., None] * jnp.where(measured, jnp.moveaxis(new, 0, rows), columns)
    return whitened.reshape(rate.shape)


def correlated_noise(white_noise: np.ndarray, memory: Memory) -> np.ndarray:
    """Noise whose innovations are given: the inverse of `innovations`.

    `white_noise` (..., slews, n, 3). Returns (..., slews, n, 3): correlated noise, in units of the
    white noise's sigma.
    """
    decay, gain, scale = (np.asarray(x) for x in memory)
    noise = white_noise / scale
    expected = np.zeros((*noise.shape[:-2], 3, decay.shape[-1]))
    for row in range(noise.shape[-2]):
        new = noise[..., row, :].copy()
        noise[..., row, :] += expected.sum(-1)
        expected = decay[:, row] * (expected + gain[:, row] * new[..., None])
    return noise
