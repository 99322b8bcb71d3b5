"""The filter that whitens correlated noise of readings: a sum of first-order processes.

A Kalman filter with one state for each process and axis tells them apart. Its gains follow from the
times and from which readings are missing alone, so that its innovations are a linear map of the
residuals: white, of unit variance, and everything that follows from residuals and their derivatives
stays as it is (Anderson and Moore 1979, section 9.2). Exact for any size, any correlation time and
any gap. What the processes are: `physics.stochastic_effect`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.inference.channel_rows import row_times
from bayes_inertia.maths.device_arrays import filled, padded, padded_size
from bayes_inertia.maths.kept_programs import KeptProgram
from bayes_inertia.maths.values import AnyArray
from bayes_inertia.physics.channels import Channel
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.prediction import Structure
from bayes_inertia.physics.processes import Process, RowTimes, StateSpace
from bayes_inertia.physics.stated_noise import stated_reading_noise
from bayes_inertia.physics.stochastic_effect import StochasticEffect


class Memory(NamedTuple):
    """The filter that whitens correlated noise.

    Parameters
    ----------
    decay : (slews, n, c, processes) array
        What is left of each process at the next row.
    gain : (slews, n, c, processes) array
        Share of an innovation that belongs to a process; 0 where nothing was measured.
    scale : (slews, n, c) array
        One over the standard deviation of the innovations; 1 where nothing was measured.
    """

    # Of numpy on the host, of JAX in compiled code.
    decay: AnyArray
    gain: AnyArray
    scale: AnyArray


def innovations(rate: Any, memory: Memory) -> Any:
    """Whitened residuals without what the residuals before them let expect.

    `rate` (slews, n, c, ...): whitened residuals, or columns of their derivatives; zero where
    nothing was measured. Of numpy, or of JAX in compiled code. Returns (slews, n, c, ...).

    Examples
    --------
    >>> decay, gain = np.full((1, 2, 3, 1), 0.6), np.ones((1, 2, 3, 1))
    >>> memory = Memory(decay, gain, np.full((1, 2, 3), 1.25))
    >>> innovations(np.ones((1, 2, 3)), memory)[0, :, 0].tolist()
    [1.25, 0.5]
    """
    if not isinstance(rate, np.ndarray):
        return compiled_innovations(rate, memory)
    # Slews, rows and columns in few sizes.
    columns = rate.reshape(*memory.scale.shape, -1)
    slews, n, _, k = columns.shape
    filter_ = Memory(*(padded(np.asarray(x)) for x in memory))
    size = padded_size(k, 1, often=True)
    new = compiled_innovations(filled(padded(columns), size, -1), filter_)
    return np.asarray(new)[:slews, :n, :, :k].reshape(rate.shape)


@partial(KeptProgram, static=0)
def compiled_innovations(rate: Array, memory: Memory) -> Array:
    """As `innovations`, of JAX; numbers may also stand flat, (slews, n c, ...)."""
    rows = memory.scale.ndim - 2
    # Columns stand last, side by side in memory: a step is one pass over them.
    columns = rate.reshape(*memory.scale.shape, -1)

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

    `white_noise` (..., slews, n, c). Returns (..., slews, n, c): correlated noise, in units of the
    white noise's sigma.
    """
    decay, gain, scale = (np.asarray(x) for x in memory)
    noise = white_noise / scale
    expected = np.zeros((*noise.shape[:-2], *decay.shape[-2:]))
    for row in range(noise.shape[-2]):
        new = noise[..., row, :].copy()
        noise[..., row, :] += expected.sum(-1)
        expected = decay[:, row] * (expected + gain[:, row] * new[..., None])
    return noise


class ChannelProcess(NamedTuple):
    """One process of a channel's noise, and who says so.

    Parameters
    ----------
    source : str
        "measured", "stated", or the name of the effect that estimates it.
    process : Process
    coefficients : slice, optional
        Which of a slew's own nuisances stand for it.
    """

    source: str
    process: Process
    coefficients: slice = slice(0, 0)

    @property
    def estimated(self) -> bool:
        """Whether an effect estimates it."""
        return self.coefficients.stop > 0


class WanderingNoise(NamedTuple):
    """The noise of a channel that is correlated in time: white noise and processes beside it.

    Parameters
    ----------
    variance : (c,) array
        Of one reading, stated and estimated processes left out.
    white : (c,) array
        Share of it that is white.
    processes : tuple of ChannelProcess
        Measured, stated and estimated ones.
    """

    variance: np.ndarray
    white: np.ndarray
    processes: tuple[ChannelProcess, ...]


def wandering_noise(
    model: Model, channel: Channel, theta: np.ndarray, *, level: float = 1.0, measured: bool = True
) -> WanderingNoise | None:
    """What noise a channel has beside white noise: measured, stated, and estimated by effects.

    `theta` (d,). `level`: factor on its stated sigma. `measured`: whether correlated noise that was
    measured counts; it is part of the stated sigma. None where the noise is white.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> model = Model(small_campaign())
    >>> wandering_noise(model, model.channels[0], model.space.mean) is None
    True
    """
    campaign, structure = model.campaign, model.structure
    correlated = channel.stream.correlated(campaign) if measured else None
    stated = stated_reading_noise(campaign, structure.effects)
    processes = [ChannelProcess("stated", x) for x in stated if x.channel == channel.name]
    processes += [x for x in estimated_noise(model, theta) if x.process.channel == channel.name]
    if correlated is None and not processes:
        return None
    noise = channel.noise(campaign, theta, structure.drive)
    variance = level**2 * channel.variance(noise)
    white = np.ones(len(variance))
    if correlated is not None:
        share = np.array(correlated.share)
        own = Process(channel.name, np.sqrt(share * variance), np.array(correlated.time))
        white = white - share
        processes.append(ChannelProcess("measured", own))
    return WanderingNoise(variance, white, tuple(processes))


def processes_of_effects(structure: Structure, theta: Any) -> tuple[ChannelProcess, ...]:
    """What effects add to readings, at parameters (d,) that may be traced."""
    start, found = structure.n_start, []
    if not any(structure.coefficients):
        return ()
    active = structure.active_effects(theta)
    for (effect, p), count in zip(active, structure.coefficients, strict=False):
        if count and isinstance(effect, StochasticEffect):
            process = effect.reading_noise(p)
            if process is not None:
                found.append(ChannelProcess(effect.name, process, slice(start, start + count)))
        start += count
    return tuple(found)


def estimated_noise(model: Model, theta: np.ndarray) -> tuple[ChannelProcess, ...]:
    """Those of `processes_of_effects` whose readings are compared, as plain numbers."""
    compared = {channel.name for channel in model.channels if channel.compared}
    return tuple(
        each._replace(
            process=each.process._replace(
                size=float(each.process.size), time=float(each.process.time)
            )
        )
        for each in processes_of_effects(model.structure, jnp.asarray(theta))
        if each.process.channel in compared
    )


def coefficients_of(model: Model, noise: Sequence[ChannelProcess]) -> np.ndarray:
    """Which of a slew's own nuisances (n_local,) stand for processes."""
    standing = np.zeros(model.structure.n_local, bool)
    for each in noise:
        standing[each.coefficients] = True
    return standing


def noise_memory(
    model: Model,
    channel: Channel,
    theta: np.ndarray,
    *,
    whole: bool = False,
    measured: bool = True,
) -> Memory | None:
    """The filter for the noise of a channel; None where that is white.

    `theta` (d,). `whole`: whether coefficients of effects on knots are left out, and their
    processes are filtered whole; else what these do between knots.
    """
    noise = wandering_noise(model, channel, theta, measured=measured)
    if noise is None:
        return None
    every = [
        each.process._replace(knots=0) if whole else each.process
        for each in noise.processes
        if whole or each.process.knots or not each.estimated
    ]
    if not every:
        return None
    rows, valid = rows_of(model), readings_of(model, channel)
    joined = in_states([each.in_rows(rows, noise.variance) for each in every])
    (slews, n), known = valid.shape[:2], padded(valid)
    start = filled(joined.start, len(known), 0)
    states = StateSpace(start, padded(joined.decay), padded(joined.fresh))
    memory = filter_of(states, noise.white, known)
    return Memory(*(np.asarray(x)[:slews, :n] for x in memory))


def readings_of(model: Model, channel: Channel) -> np.ndarray:
    """Which readings (slews, n, c) of a channel were taken."""
    readings = model.data.arrays.telemetry.readings[model.structure.place(channel.name)]
    return np.asarray(readings.valid)


def rows_of(model: Model) -> RowTimes:
    """When the rows of telemetry are."""
    context = model.data.arrays.slews.context
    # A slew's start is its first row, whatever its own clock says there.
    away = np.abs(np.asarray(context.start) - np.asarray(context.middle))
    return RowTimes(row_times(model), away)


def in_states(processes: Sequence[StateSpace], xp: Any = np) -> StateSpace:
    """Processes side by side, along a last axis."""
    return StateSpace(*(xp.stack(parts, -1) for parts in zip(*processes, strict=True)))


@partial(KeptProgram, static=0)
def filter_of(states: StateSpace, white: Array, valid: Array) -> Memory:
    """The filter for processes (last axis) beside white noise (c,) or (n, c).

    `valid` (slews, n, c).
    """
    same, white = jnp.eye(states.decay.shape[-1]), jnp.broadcast_to(white, valid.shape)

    def step(covariance: Array, row: tuple[Array, ...]) -> tuple[Array, tuple[Array, Array]]:
        decay, fresh, known, white = row
        with_reading = covariance.sum(-1)
        of_reading = jnp.maximum(with_reading.sum(-1) + white, 1e-12)
        gain = jnp.where(known[..., None], with_reading / of_reading[..., None], 0.0)
        left = covariance - gain[..., None] * with_reading[..., None, :]
        after = decay[..., None] * decay[..., None, :] * left + fresh[..., None] * same
        return after, (gain, jnp.where(known, 1.0 / jnp.sqrt(of_reading), 1.0))

    rows = (jnp.moveaxis(x, 1, 0) for x in (states.decay, states.fresh, valid, white))
    _, (gain, scale) = jax.lax.scan(step, states.start[..., None] * same, tuple(rows))
    return Memory(states.decay, jnp.moveaxis(gain, 0, 1), jnp.moveaxis(scale, 0, 1))
