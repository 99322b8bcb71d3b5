"""Correlated noise of the rate sensor, as what each reading's noise keeps of those before it.

Each reading is compared with what the noise of the last few readings lets expect (Vecchia 1988):
the innovations are white and of unit variance, and a linear map of the residuals, so that
everything that follows from residuals and their derivatives stays as it is. For a Gauss-Markov
process without white part this is exact; across missing readings too.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.campaign.hardware import CorrelatedNoise
from bayes_inertia.physics.forward_model import Model

# Readings before that are taken into account.
_READINGS_BEFORE = 8


class Memory(NamedTuple):
    """What the whitened noise of each reading keeps of the p readings before.

    Parameters
    ----------
    past : (slews, n, 3, p) array
        Weights of the residuals one row before, two rows before, ...
    scale : (slews, n, 3) array
        One over the standard deviation of what is new.
    """

    past: Array
    scale: Array


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
    >>> memory = Memory(jnp.full((2, 3, 1), 0.6), jnp.full((2, 3), 1.25))
    >>> innovations(jnp.ones((2, 3)), memory)[:, 0].tolist()
    [1.25, 0.5]
    """
    expected = jnp.zeros_like(rate)
    for before in range(1, memory.past.shape[-1] + 1):
        nothing = jnp.zeros_like(rate[..., :before, :])
        earlier = jnp.concatenate([nothing, rate[..., :-before, :]], -2)
        expected = expected + memory.past[..., before - 1] * earlier
    return memory.scale * (rate - expected)


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
    past, scale = np.asarray(memory.past), np.asarray(memory.scale)
    noise = white_noise / scale
    for row in range(1, noise.shape[-2]):
        for before in range(1, min(row, past.shape[-1]) + 1):
            noise[..., row, :] += past[:, row, :, before - 1] * noise[..., row - before, :]
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
    telemetry = model.data.arrays.telemetry
    valid, n = np.asarray(telemetry.rate_valid), telemetry.rate.shape[1]
    past = np.zeros((*valid.shape, min(_READINGS_BEFORE, n - 1)))
    scale = np.ones(valid.shape)
    for s, slew in enumerate(model.campaign.slews):
        time = np.concatenate([slew.time, np.full(n - len(slew.time), slew.time[-1])])
        for axis in range(3):
            weights = _conditional_weights(time, valid[s, :, axis], noise, axis, past.shape[-1])
            past[s, :, axis], scale[s, :, axis] = weights
    return Memory(jnp.asarray(past), jnp.asarray(scale))


def _conditional_weights(
    time: np.ndarray, valid: np.ndarray, noise: CorrelatedNoise, axis: int, before: int
) -> tuple[np.ndarray, np.ndarray]:
    """Weights (n, before) of the readings before, and one over the sd (n,) of what is new."""
    share, correlation_time = noise.share[axis], noise.time[axis]

    def covariance(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        return share * np.exp(-np.abs(first - second) / correlation_time)

    rows = np.arange(len(time))[:, None] - np.arange(1, before + 1)
    known = (rows >= 0) & valid[np.maximum(rows, 0)] & valid[:, None]
    earlier = time[np.maximum(rows, 0)]
    pairs = known[:, :, None] & known[:, None, :]
    among = np.where(pairs, covariance(earlier[:, :, None], earlier[:, None, :]), 0.0)
    diagonal = np.arange(before)
    among[:, diagonal, diagonal] = 1.0
    across = np.where(known, covariance(time[:, None], earlier), 0.0)
    weights = np.linalg.solve(among, across[..., None])[..., 0]
    left = 1.0 - np.einsum("np,np->n", weights, across)
    return weights, 1.0 / np.sqrt(np.maximum(left, 1e-12))
