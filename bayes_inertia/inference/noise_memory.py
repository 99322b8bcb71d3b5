"""Correlated noise of the rate sensor, as what each reading's noise keeps of those before it.

Noise that remembers is a sum of first-order processes beside white noise. A Kalman filter with one
state for each process and axis tells them apart. Its gains follow from the times and from which
readings are missing alone, so that its innovations are a linear map of the residuals: white, of
unit variance, and everything that follows from residuals and their derivatives stays as it is
(Anderson and Moore 1979, section 9.2). Exact for any size, any correlation time and any gap.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array


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

    decay: Array
    gain: Array
    scale: Array


@jax.jit
def innovations(rate: Array, memory: Memory) -> Array:
    """Whitened residuals without what the residuals before them let expect.

    Parameters
    ----------
    rate : (n, 3, ...) or (slews, n, 3, ...) array
        Whitened residuals, or columns of their derivatives; zero where nothing was measured.
    memory : Memory
        Of one slew, or of all with a leading axis.

    Returns
    -------
    (n, 3, ...) or (slews, n, 3, ...) array

    Examples
    --------
    >>> decay, gain = jnp.full((2, 3, 1), 0.6), jnp.ones((2, 3, 1))
    >>> innovations(jnp.ones((2, 3)), Memory(decay, gain, jnp.full((2, 3), 1.25)))[:, 0].tolist()
    [1.25, 0.5]
    """
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

    Parameters
    ----------
    white_noise : (..., slews, n, 3) array
        Standard normal numbers.
    memory : Memory

    Returns
    -------
    (..., slews, n, 3) array
        Correlated noise, in units of the white noise's sigma.
    """
    decay, gain, scale = (np.asarray(x) for x in memory)
    noise = white_noise / scale
    expected = np.zeros((*noise.shape[:-2], 3, decay.shape[-1]))
    for row in range(noise.shape[-2]):
        new = noise[..., row, :].copy()
        noise[..., row, :] += expected.sum(-1)
        expected = decay[:, row] * (expected + gain[:, row] * new[..., None])
    return noise
