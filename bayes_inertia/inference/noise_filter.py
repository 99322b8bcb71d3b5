"""The filter for correlated noise of readings: what the noise consists of, and the gains.

First-order processes beside white noise: correlated noise that was measured in the residuals of the
rates; what the campaign states of the gyro's bias, a random walk (RRW) and a Gauss-Markov process
that stands for its instability (BI); what an effect was estimated to add, all of it or what it does
between the knots that a fit knows. Farrenkopf 1978; IEEE Std 952-1997, annexes B and C.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bayes_inertia.inference.channel_rows import row_times
from bayes_inertia.inference.noise_memory import Memory
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.reading_noise import ReadingNoise
from bayes_inertia.physics.stated_noise import stated_reading_noise


class _Process(NamedTuple):
    """A first-order process in each of c components, in units of one reading's variance.

    Parameters
    ----------
    start : (slews, c) array
        Variance at a slew's first row.
    decay : (slews, n, c) array
        What is left at the next row.
    fresh : (slews, n, c) array
        Variance that is new by then.
    """

    start: np.ndarray
    decay: np.ndarray
    fresh: np.ndarray


def rate_noise_memory(
    model: Model,
    covariance: np.ndarray,
    more: Sequence[ReadingNoise] = (),
    *,
    measured: bool = True,
) -> Memory | None:
    """What the noise of each rate reading keeps of those before.

    `model`: its campaign says how the noise is correlated. What its effects estimate is none of it.
    `covariance` (3, 3): of one reading's noise, its bias' wandering left out [rad^2/s^2]. `more`:
    what effects add to the rates. Of those with knots what is left between them. `measured`:
    whether correlated noise that was measured counts, beside what is stated.
    """
    memory = rate_noise_memories(model, covariance, [more], measured=measured)
    return None if memory is None else Memory(*(x[0] for x in memory))


def rate_noise_memories(
    model: Model,
    covariance: np.ndarray,
    settings: Sequence[Sequence[ReadingNoise]],
    *,
    measured: bool = True,
    white: float = 1.0,
) -> Memory | None:
    """As `rate_noise_memory`, for several sets of what effects add.

    `covariance` (3, 3): of one reading's noise, its bias' wandering left out [rad^2/s^2]. `white`:
    variance of the white noise, in units of `covariance`. Returns: with the settings as leading
    axis; None where the noise is white and as `covariance` says.
    """
    # Whitened readings have one over these as sigmas.
    variance = 1.0 / np.diagonal(np.linalg.inv(covariance))
    noise = model.campaign.rate_sensor.correlated_noise if measured else None
    stated = stated_reading_noise(model.campaign, model.structure.effects)
    whites = np.full(3, white)
    common = [_process(model, each, variance) for each in stated]
    if noise is not None:
        whites = whites - np.array(noise.share)
        common.append(_gauss_markov(model, np.array(noise.share), np.array(noise.time)))
    more = [[_process(model, each, variance) for each in processes] for processes in settings]
    if not common and not more[0]:
        return None
    # Sets are filtered as if they were further slews.
    joined = [_joined(parts) for parts in zip(*([*common, *own] for own in more), strict=True)]
    valid = np.asarray(model.data.arrays.telemetry.rate_valid)
    filtered = _filter(joined, whites, np.tile(valid, (len(settings), 1, 1)))
    return Memory(*(np.reshape(x, (len(settings), len(valid), *x.shape[1:])) for x in filtered))


def _joined(processes: Sequence[_Process]) -> _Process:
    """Processes one after the other, along the axis of slews."""
    return _Process(*(np.concatenate(parts) for parts in zip(*processes, strict=True)))


def momentum_noise_memory(model: Model, noise: Sequence[ReadingNoise]) -> Memory | None:
    """What the noise of each tachometer reading keeps of those before."""
    if not noise:
        return None
    variance = np.square([wheel.momentum_sigma or np.inf for wheel in model.campaign.wheels])
    processes = [_process(model, each, variance) for each in noise]
    valid = np.asarray(model.data.arrays.telemetry.momentum_valid)
    return _filter(processes, np.ones(len(variance)), valid)


def _process(model: Model, noise: ReadingNoise, variance: np.ndarray) -> _Process:
    """The process in units of one reading's variance (c,)."""
    power = float(noise.size) ** 2 / variance
    if noise.knots:
        return _between_knots(model, noise, power)
    if np.isinf(noise.time):
        return _random_walk(model, power)
    return _gauss_markov(model, power, np.full(len(variance), float(noise.time)))


def _steps(model: Model) -> np.ndarray:
    """Time (slews, n) from each row to the next [s], zero after the last."""
    times = row_times(model)
    return np.diff(times, axis=1, append=times[:, -1:])


def _gauss_markov(model: Model, variance: np.ndarray, time: np.ndarray) -> _Process:
    """A stationary process of these variances and correlation times (c,) [s]."""
    decay = np.exp(-_steps(model)[..., None] / time)
    start = np.broadcast_to(variance, (len(decay), len(variance)))
    return _Process(start, decay, variance * (1.0 - decay**2))


def _random_walk(model: Model, growth: np.ndarray) -> _Process:
    """A Wiener process whose variance grows by `growth` (c,) a second.

    It is zero in the middle of the campaign, as in `random_walk_root`.
    """
    steps, times = _steps(model), row_times(model)
    context = model.data.arrays.slews.context
    away = np.abs(np.asarray(context.start) + times[:, 0] - np.asarray(context.middle))
    first = away + times[:, -1] - times[:, 0]
    fresh = steps[..., None] * growth
    return _Process(first[:, None] * growth, np.ones_like(fresh), fresh)


def _between_knots(model: Model, noise: ReadingNoise, power: np.ndarray) -> _Process:
    """What straight lines between knots leave of a process: Brownian bridges from knot to knot.

    Their density is the variance of the change from one knot to the next, over the time between
    them. For a random walk that is exact. For a Gauss-Markov process the variance is, and a bridge
    is close where knots are not far apart.
    """
    times = row_times(model)
    spacing = np.maximum(times[:, -1:] - times[:, :1], 1e-9) / (noise.knots - 1)
    place = (times - times[:, :1]) / spacing
    # A row at a knot must not fall into the interval before it by rounding.
    knot = np.floor(place + 1e-9)
    since = np.maximum(place - knot, 0.0) * spacing
    left = spacing - since
    if np.isinf(noise.time):
        growth = np.ones_like(spacing)
    else:
        growth = -2.0 * np.expm1(-spacing / noise.time) / spacing
    variance = growth * since * left / spacing
    same = np.diff(knot, axis=1, append=knot[:, -1:]) == 0.0
    next_left, next_variance = (np.roll(x, -1, axis=1) for x in (left, variance))
    decay = np.where(same, next_left / left, 0.0)
    decay[:, -1] = 1.0
    fresh = np.maximum(next_variance - decay**2 * variance, 0.0)
    fresh[:, -1] = 0.0
    shape = (*times.shape, len(power))
    return _Process(
        variance[:, :1] * power,
        np.broadcast_to(decay[..., None], shape),
        fresh[..., None] * power,
    )


def _filter(processes: list[_Process], white: np.ndarray, valid: np.ndarray) -> Memory:
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
