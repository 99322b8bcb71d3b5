"""The filter that whitens correlated noise of readings: a sum of first-order processes.

A Kalman filter with one state for each process and axis tells them apart. Its gains follow from the
times and from which readings are missing alone, so that its innovations are a linear map of the
residuals: white, of unit variance, and everything that follows from residuals and their derivatives
stays as it is (Anderson and Moore 1979, section 9.2). Exact for any size, any correlation time and
any gap. What the processes are: `physics.processes`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.inference.channel_rows import row_times
from bayes_inertia.maths.device_arrays import filled, padded_size
from bayes_inertia.maths.values import AnyArray
from bayes_inertia.physics.channels import Channel
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.processes import Process, RowTimes, StateSpace, gauss_markov
from bayes_inertia.physics.stated_noise import stated_reading_noise
from bayes_inertia.physics.stochastic_effect import StochasticEffect


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

    new = _innovations(filled(padded(columns), size[2], -1), Memory(*map(padded, memory)))
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


class EffectNoise(NamedTuple):
    """What one effect adds to readings.

    Parameters
    ----------
    effect : str
        Its name.
    noise : Process
        The process.
    coefficients : slice
        Which of a slew's own nuisances stand for it.
    """

    effect: str
    noise: Process
    coefficients: slice


def noise_of_effects(model: Model, theta: np.ndarray) -> tuple[EffectNoise, ...]:
    """What a model's effects add to readings that are compared.

    `theta` (d,).

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> model = Model(small_campaign())
    >>> noise_of_effects(model, model.space.mean)
    ()
    """
    structure, start, found = model.structure, model.structure.n_start, []
    if not any(structure.coefficients):
        return ()
    active = structure.active_effects(jnp.asarray(theta))
    for (effect, p), count in zip(active, structure.coefficients, strict=False):
        noise = effect.reading_noise(p) if isinstance(effect, StochasticEffect) else None
        if count and noise is not None and _is_read(model, noise):
            plain = noise._replace(size=float(noise.size), time=float(noise.time))
            found.append(EffectNoise(effect.name, plain, slice(start, start + count)))
        start += count
    return tuple(found)


def effects_between_knots(model: Model, theta: np.ndarray) -> tuple[EffectNoise, ...]:
    """Those of `noise_of_effects` whose coefficients are values of the rates' errors on knots.

    `theta` (d,). Returns: what they do between knots is filtered out of the readings.
    """
    every = noise_of_effects(model, theta)
    return tuple(each for each in every if each.noise.channel == "rate" and each.noise.knots)


def _is_read(model: Model, noise: Process) -> bool:
    """Whether readings with this noise are compared, and the noise is there at all."""
    channel = model.channels[model.structure.place(noise.channel)]
    return channel.compared and float(noise.size) > 0.0


def noise_memory(
    model: Model,
    channel: Channel,
    noise: np.ndarray,
    more: Sequence[Process] = (),
    *,
    measured: bool = True,
) -> Memory | None:
    """What the noise of each reading keeps of those before.

    `model`: its campaign says how the noise is correlated. What its effects estimate is none of it.
    `noise`: of one reading, wandering left out. `more`: what effects add to readings. Of those with
    knots what is left between them. `measured`: whether correlated noise that was measured counts,
    beside what is stated.
    """
    memory = noise_memories(model, channel, noise, [more], measured=measured)
    return None if memory is None else Memory(*(x[0] for x in memory))


def noise_memories(
    model: Model,
    channel: Channel,
    noise: np.ndarray,
    settings: Sequence[Sequence[Process]],
    *,
    measured: bool = True,
    white: float = 1.0,
) -> Memory | None:
    """As `noise_memory`, for several sets of what effects add.

    `noise`: of one reading, wandering left out. `white`: variance of the white noise, in units of
    that. Returns: with the settings as leading axis; None where the noise is white and as stated.
    """
    correlated = channel.stream.correlated(model.campaign) if measured else None
    stated = _of(channel, stated_reading_noise(model.campaign, model.structure.effects))
    settings = [_of(channel, processes) for processes in settings]
    if correlated is None and not stated and not settings[0]:
        return None
    rows, variance = _rows(model), channel.variance(noise)
    whites = np.full(len(variance), white)
    common = [each.in_rows(rows, variance) for each in stated]
    if correlated is not None:
        share = np.array(correlated.share)
        whites = whites - share
        common.append(gauss_markov(rows, share, np.array(correlated.time)))
    more = [[each.in_rows(rows, variance) for each in processes] for processes in settings]
    # Sets are filtered as if they were further slews.
    joined = [_joined(parts) for parts in zip(*([*common, *own] for own in more), strict=True)]
    readings = model.data.arrays.telemetry.readings[model.structure.place(channel.name)]
    valid = np.asarray(readings.valid)
    filtered = _filter(joined, whites, np.tile(valid, (len(settings), 1, 1)))
    return Memory(*(np.reshape(x, (len(settings), len(valid), *x.shape[1:])) for x in filtered))


def _joined(processes: Sequence[StateSpace]) -> StateSpace:
    """Processes one after the other, along the axis of slews."""
    return StateSpace(*(np.concatenate(parts) for parts in zip(*processes, strict=True)))


def _of(channel: Channel, noise: Sequence[Process]) -> list[Process]:
    return [each for each in noise if each.channel == channel.name]


def _rows(model: Model) -> RowTimes:
    times, context = row_times(model), model.data.arrays.slews.context
    away = np.abs(np.asarray(context.start) + times[:, 0] - np.asarray(context.middle))
    return RowTimes(times, away)


def _filter(processes: list[StateSpace], white: np.ndarray, valid: np.ndarray) -> Memory:
    """The filter for processes beside white noise (c,); `valid` (slews, n, c): was measured."""
    decay = np.stack([process.decay for process in processes], -1)
    fresh = np.stack([process.fresh for process in processes], -1)
    start = np.stack([process.start for process in processes], -1)
    same = np.eye(len(processes))
    gain, scale = np.zeros_like(decay), np.ones(valid.shape)
    covariance = start[..., None] * same
    for row in range(valid.shape[1]):
        with_reading = covariance.sum(-1)
        of_reading = np.maximum(with_reading.sum(-1) + white, 1e-12)
        known = valid[:, row]
        gain[:, row] = np.where(known[..., None], with_reading / of_reading[..., None], 0.0)
        scale[:, row] = np.where(known, 1.0 / np.sqrt(of_reading), 1.0)
        left = covariance - gain[:, row][..., None] * with_reading[..., None, :]
        kept = decay[:, row]
        covariance = kept[..., None] * kept[..., None, :] * left + fresh[:, row][..., None] * same
    return Memory(decay, gain, scale)
