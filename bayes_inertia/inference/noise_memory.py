"""Correlated noise of the rate sensor, as what each reading's noise keeps of those before it.

White noise and a Gauss-Markov process are told apart by a Kalman filter of one state an axis. Its
gains follow from the times and from which readings are missing alone, so that its innovations are a
linear map of the residuals: white, of unit variance, and everything that follows from residuals and
their derivatives stays as it is (Anderson and Moore 1979, section 9.2). Exact for any share, any
correlation time and any gap.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.campaign.hardware import CorrelatedNoise
from bayes_inertia.inference.channel_rows import row_times
from bayes_inertia.physics.forward_model import Model


class Memory(NamedTuple):
    """The filter that whitens correlated noise.

    Parameters
    ----------
    decay : (slews, n, 3) array
        What is left of the correlated part at the next row.
    gain : (slews, n, 3) array
        Share of an innovation that belongs to the correlated part; 0 where nothing was measured.
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
    >>> decay, gain = jnp.full((2, 3), 0.6), jnp.ones((2, 3))
    >>> innovations(jnp.ones((2, 3)), Memory(decay, gain, jnp.full((2, 3), 1.25)))[:, 0].tolist()
    [1.25, 0.5]
    """
    keep = memory.decay * (1.0 - memory.gain)
    add = memory.decay * memory.gain * rate

    def step(expected: Array, row: tuple[Array, Array]) -> tuple[Array, Array]:
        return row[0] * expected + row[1], expected

    rows = (jnp.moveaxis(jnp.broadcast_to(keep, add.shape), -2, 0), jnp.moveaxis(add, -2, 0))
    _, expected = jax.lax.scan(step, jnp.zeros_like(add[..., 0, :]), rows)
    expected = jnp.moveaxis(expected, 0, -2)
    return memory.scale * (rate - jnp.where(memory.gain > 0.0, expected, 0.0))


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
        Correlated noise of unit variance.
    """
    decay, gain, scale = (np.asarray(x) for x in memory)
    new = white_noise / scale
    noise, expected = new.copy(), np.zeros_like(new[..., 0, :])
    for row in range(noise.shape[-2]):
        noise[..., row, :] += expected
        expected = decay[:, row] * (expected + gain[:, row] * new[..., row, :])
    return noise


def rate_noise_memory(model: Model) -> Memory | None:
    """What the noise of each rate reading keeps of those before.

    Parameters
    ----------
    model : Model
        Its campaign says how the noise is correlated.

    Returns
    -------
    Memory or None
        None where the noise is white.
    """
    noise = model.campaign.rate_sensor.correlated_noise
    if noise is None:
        return None
    times = row_times(model)
    steps = np.diff(times, axis=1, append=times[:, -1:])
    return _filter(steps, np.asarray(model.data.arrays.telemetry.rate_valid), noise)


def _filter(steps: np.ndarray, valid: np.ndarray, noise: CorrelatedNoise) -> Memory:
    """The filter for steps of time (slews, n) [s] and what was measured (slews, n, 3)."""
    share = np.array(noise.share)
    decay = np.exp(-steps[..., None] / np.array(noise.time))
    gain, scale = np.zeros(valid.shape), np.ones(valid.shape)
    variance = np.broadcast_to(share, (len(valid), 3)).copy()
    for row in range(valid.shape[1]):
        of_reading = variance + 1.0 - share
        known = valid[:, row]
        gain[:, row] = np.where(known, variance / of_reading, 0.0)
        scale[:, row] = np.where(known, 1.0 / np.sqrt(np.maximum(of_reading, 1e-12)), 1.0)
        left = (1.0 - gain[:, row]) * variance
        variance = decay[:, row] ** 2 * left + share * (1.0 - decay[:, row] ** 2)
    return Memory(jnp.asarray(decay), jnp.asarray(gain), jnp.asarray(scale))
