"""The noise of every measurement, as the factors that whiten residuals."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jax import Array

from bayes_inertia.inference.channel_density import ChannelDensity, Densities
from bayes_inertia.inference.noise_filter import Memory, effects_between_knots, noise_memory
from bayes_inertia.maths.device_arrays import on_device
from bayes_inertia.physics.channels import Channel
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.processes import Process


class Whitening(NamedTuple):
    """Inverse roots of the noise of one channel, zero where nothing was measured.

    Parameters
    ----------
    factors : (slews, n, ...) array
        As the channel's `whitened` takes them.
    memory : Memory, optional
        What the noise keeps of the readings before; None where it is white.
    density : ChannelDensity, optional
        How whitened residuals count; None where they are Gaussian of unit scale.
    """

    factors: Array
    memory: Memory | None = None
    density: ChannelDensity | None = None


# Of each channel of a model.
Whitenings = tuple[Whitening, ...]


def whitening(model: Model, theta: np.ndarray) -> Whitenings:
    """Noise of every measurement.

    `theta` (d,): parameters; in the measured drive the noise of the rates depends on J and K, and
    what an effect's process does between its knots depends on its size and time.
    """
    between_knots = noise_between_knots(model, theta)
    white = []
    for channel, readings in zip(
        model.structure.channels, model.data.arrays.telemetry.readings, strict=True
    ):
        noise = stated_noise_of(model, channel, theta)
        factors = channel.factors(noise, np.asarray(readings.valid))
        memory = noise_memory(model, channel, noise, between_knots)
        white.append(Whitening(on_device(factors), memory))
    return tuple(white)


def stated_noise_of(model: Model, channel: Channel, theta: np.ndarray) -> np.ndarray:
    """Noise of one reading of a channel, as the channel's methods take it."""
    return channel.noise(model.campaign, theta, model.structure.drive)


def noise_between_knots(model: Model, theta: np.ndarray) -> tuple[Process, ...]:
    """What a fit's effects add to the readings and its coefficients do not hold.

    `theta` (d,).
    """
    return tuple(each.noise for each in effects_between_knots(model, theta))


def without_memory(white: Whitenings) -> Whitenings:
    """The same noise as if it were white and Gaussian."""
    return tuple(each._replace(memory=None, density=None) for each in white)


def of_densities(white: Whitenings, densities: Densities) -> Whitenings:
    """The same noise with other densities."""
    pairs = zip(white, densities, strict=True)
    return tuple(each._replace(density=density) for each, density in pairs)


def remembers(white: Whitenings) -> bool:
    """Whether the noise of any channel is correlated in time."""
    return any(each.memory is not None for each in white)


def discounted(white: Whitenings, factors: np.ndarray) -> Whitenings:
    """The same noise with information taken away.

    `factors` (slews, channels): what each slew's and channel's information is multiplied by.
    """
    root = np.sqrt(np.asarray(factors))
    weak = []
    for c, each in enumerate(white):
        shape = -1, *(1 for _ in each.factors.shape[1:])
        weak.append(
            each._replace(factors=on_device(np.asarray(each.factors) * root[:, c].reshape(shape)))
        )
    return tuple(weak)


def log_normalisation(model: Model, white: Whitenings) -> float:
    """Log of what the density of readings is multiplied by, beside the exponential of squares.

    Returns: up to a constant that all noises of the same readings share.
    """
    diagonals = [
        c.diagonal(np.asarray(each.factors))
        for c, each in zip(model.structure.channels, white, strict=True)
    ]
    norms = [float(np.log(x[x > 0.0]).sum()) for x in diagonals]
    memories = (each.memory for each in white if each.memory is not None)
    norms += [float(np.log(memory.scale).sum()) for memory in memories]
    return sum(norms)


def n_data(model: Model, white: Whitenings) -> np.ndarray:
    """How many numbers were measured.

    Returns (slews, channels).
    """
    pairs = zip(model.structure.channels, white, strict=True)
    return np.stack(
        [np.count_nonzero(c.diagonal(np.asarray(w.factors)), axis=(1, 2)) for c, w in pairs], 1
    )
