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
    rate : (..., n, 3) array
        Whitened residuals, zero where nothing was measured.
    memory : Memory
        Of one slew, or of all with a leading axis.

    Returns
    -------
    (..., n, 3) array

    Examples
    --------
    >>> decay, gain = jnp.full((2, 3, 1), 0.6), jnp.ones((2, 3, 1))
    >>> innovations(jnp.ones((2, 3)), Memory(decay, gain, jnp.full((2, 3), 1.25)))[:, 0].tolist()
    [1.25, 0.5]
    """

    def step(expected: Array, row: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        reading, decay, gain = row
        new = reading - expected.sum(-1)
        return decay * (expected + gain * new[..., None]), new

    shape = rate.shape[:-2]
    decay = jnp.moveaxis(jnp.broadcast_to(memory.decay, (*shape, *memory.decay.shape[-3:])), -3, 0)
    gain = jnp.moveaxis(jnp.broadcast_to(memory.gain, (*shape, *memory.gain.shape[-3:])), -3, 0)
    rows = (jnp.moveaxis(rate, -2, 0), decay, gain)
    _, new = jax.lax.scan(step, jnp.zeros_like(decay[0]), rows)
    measured = memory.gain.sum(-1) > 0.0
    return memory.scale * jnp.where(measured, jnp.moveaxis(new, 0, -2), rate)


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
