"""The noise of every measurement: the factors that whiten residuals, and how these then count.

Correlated noise of readings is a sum of first-order processes. A Kalman filter with one state for
each process and axis tells them apart. Its gains follow from the times and from which readings are
missing alone, so that its innovations are a linear map of the residuals: white, of unit variance,
and everything that follows from residuals and their derivatives stays as it is (Anderson and Moore
1979, section 9.2). Exact for any size, any correlation time and any gap. What the processes are:
`physics.stochastic_effect`.

Each reading pulls with the slope of its own log density, so that outliers hardly pull; a channel's
normal matrix is that of Gaussian noise times the mean curvature of its log density. Scale and shape
have their Fisher information, and none across to J, K and the nuisances (Lange, Little and Taylor
1989). A fit is reweighted so at every step. Gaussian noise of the stated sigma has no density here:
its residuals count as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.maths.device_arrays import filled, on_device, padded, padded_size, repeated
from bayes_inertia.maths.kept_programs import KeptProgram
from bayes_inertia.maths.values import AnyArray
from bayes_inertia.physics.channel_noise import NOISE_OWNER
from bayes_inertia.physics.channels import Channel
from bayes_inertia.physics.densities import Density
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
    if not any(structure.coefficients):
        return ()
    start, found = structure.n_start, []
    active = structure.active_effects(theta)
    for (effect, p), count in zip(active, structure.coefficients, strict=False):
        if count and isinstance(effect, StochasticEffect) and (process := effect.reading_noise(p)):
            found.append(ChannelProcess(effect.name, process, slice(start, start + count)))
        start += count
    return tuple(found)


def estimated_noise(model: Model, theta: np.ndarray) -> tuple[ChannelProcess, ...]:
    """Those of `processes_of_effects` whose readings are compared, as plain numbers."""
    compared = {channel.name for channel in model.channels if channel.compared}
    return tuple(
        each._replace(process=own._replace(size=float(own.size), time=float(own.time)))
        for each in processes_of_effects(model.structure, jnp.asarray(theta))
        if (own := each.process).channel in compared
    )


def coefficients_of(model: Model, noise: Sequence[ChannelProcess]) -> np.ndarray:
    """Which of a slew's own nuisances (n_local,) stand for processes."""
    standing = np.zeros(model.structure.n_local, bool)
    for each in noise:
        standing[each.coefficients] = True
    return standing


def noise_memory(
    model: Model, channel: Channel, theta: np.ndarray, *, whole: bool = False, measured: bool = True
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


def row_times(model: Model) -> np.ndarray:
    """Times of the rows of telemetry.

    Returns (slews, n): on each slew's own clock [s], the last one repeated in padding.
    """
    n = model.data.arrays.telemetry.sample.shape[1]
    return np.stack([repeated(slew.time, n, 0) for slew in model.campaign.slews])


def measured(model: Model) -> tuple[np.ndarray, ...]:
    """What the model compares with measurements, by channel (slews, rows, components)."""
    pairs = zip(model.structure.channels, model.data.arrays.telemetry.readings, strict=True)
    return tuple(np.asarray(x.valid, bool)[..., : None if c.compared else 0] for c, x in pairs)


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


class Pull(NamedTuple):
    """How the readings of one channel pull at a fit.

    Parameters
    ----------
    slope : (slews, numbers) array
        Derivative of the loss by each residual; the residual itself for Gaussian noise.
    weight : float
        Information of a reading over that of Gaussian noise of the stated sigma.
    chi2 : (slews,) array
        Sums of residual times slope, in the noise of that information.
    noise : ((slews, 2), (slews, 2, 2)) arrays, optional
        Derivative of the loss by scale and shape, and their Fisher information.
    """

    slope: np.ndarray
    weight: float
    chi2: np.ndarray
    noise: tuple[np.ndarray, np.ndarray] | None = None


@jax.tree_util.register_static
@dataclass(frozen=True)
class ChannelDensity:
    """The density of a channel, and where its numbers stand in theta.

    Parameters
    ----------
    family : Density
    shape : float
        Where it is given.
    scale_at, shape_at : int or None
        Where scale and shape stand in theta, if they are sampled.
    inflation : float
        Factor on the scale, above 1 while a descent begins among outliers.
    lost : float
        By how much fitting lowered the sum of y psi(y): the scale is that of the numbers left.
    """

    family: Density
    shape: float
    scale_at: int | None = None
    shape_at: int | None = None
    inflation: float = 1.0
    lost: float = 0.0

    def scale_of(self, theta: Any) -> Any:
        """The factor on the stated sigmas."""
        return self.inflation * (1.0 if self.scale_at is None else theta[self.scale_at])

    def shape_of(self, theta: Any) -> Any:
        """The number that shapes the family."""
        return self.shape if self.shape_at is None else theta[self.shape_at]

    def loss(self, r: Array, valid: np.ndarray, theta: np.ndarray) -> float:
        """Minus the log density of residuals in stated sigmas, up to a constant."""
        scale, shape = float(self.scale_of(theta)), float(self.shape_of(theta))
        summed = float(_summed(self.family, r, valid, scale, shape))
        return summed + (float(valid.sum()) - self.lost) * np.log(scale)

    def pull(self, r: Array, valid: np.ndarray, theta: np.ndarray) -> Pull:
        """How residuals (slews, numbers) in stated sigmas pull; `valid`: was measured."""
        scale, shape = float(self.scale_of(theta)), float(self.shape_of(theta))
        parts = _pull(self.family, r, valid, scale, shape)
        slope, curvature, squares, towards = (np.asarray(part) for part in parts)
        numbers = valid.sum(1)
        kept = numbers * (1.0 - self.lost / max(numbers.sum(), 1))
        information = np.asarray(self.family.moments(shape).information)
        by_noise = (
            np.stack([(kept - squares) / scale, towards], -1),
            kept[:, None, None] * information / np.outer([scale, 1.0], [scale, 1.0]),
        )
        return Pull(slope, float(curvature) / scale**2, curvature * squares, by_noise)

    def judged(
        self, series: list[np.ndarray], theta: np.ndarray, numbers: float, parameters: float
    ) -> tuple[list[np.ndarray], float, float]:
        """How residuals (rows, components) by slew are tested: by their own distribution.

        The size of residuals is the sum of y psi(y). Fitting lowers it by a share for each of the
        `parameters` that the channel pays for, and it scatters like chi^2 with more degrees of
        freedom than `numbers`. Whiteness is asked of normal scores.

        Returns the scores by slew, and chi^2 with its degrees of freedom.
        """
        scale, shape = float(self.scale_of(theta)), float(self.shape_of(theta))
        y = [slew / scale for slew in series]
        moments = self.family.moments(shape)
        worth, share = float(moments.worth), float(moments.per_parameter)
        slopes = [np.asarray(self.family.slope(jnp.asarray(x), shape)) for x in y]
        squares = float(sum(np.nansum(x * slope) for x, slope in zip(y, slopes, strict=True)))
        scores = [self.family.normal_scores(x, shape) for x in y]
        return scores, worth * squares, worth * (numbers - share * parameters)

    def noise_columns(self, free: np.ndarray) -> tuple[list[int], np.ndarray]:
        """Which of scale and shape are among the free parameters (f,), and where."""
        at = [self.scale_at, self.shape_at]
        kept = [i for i, index in enumerate(at) if index is not None and index in free]
        return kept, np.searchsorted(free, [at[i] or 0 for i in kept])


Densities = tuple[ChannelDensity, ...]


def densities_of(model: Model) -> Densities:
    """The density of each channel of a model."""
    place = {name: i for i, name in enumerate(model.space.names)}
    densities = []
    for channel in model.channels:
        noise = model.noise.of(channel.name)
        family, own = noise.density, f"{NOISE_OWNER}.{channel.name}_"
        shape_at = place.get(own + family.shape.name) if family.shape else None
        shape = (noise.degrees or 0.0) if family.shape else 0.0
        densities.append(ChannelDensity(family, shape, place.get(f"{own}scale"), shape_at))
    return tuple(densities)


@KeptProgram
def _summed(family: Density, r: Array, valid: Array, scale: Array, shape: Array) -> Array:
    return jnp.sum(jnp.where(valid, family.loss(r / scale, shape), 0.0))


@KeptProgram
def _pull(family: Density, r: Array, valid: Array, scale: Array, shape: Array) -> tuple[Array, ...]:
    """Slope by each residual, mean curvature, sums of y psi(y) and slope towards the shape."""
    y = r / scale
    slope = family.slope(y, shape)
    towards = family.towards_shape(y, shape) if family.shape else jnp.zeros_like(y)
    return (
        slope / scale,
        mean_curvature(family, y, valid, shape),
        jnp.sum(slope * y, -1),
        jnp.sum(jnp.where(valid, towards, 0.0), -1),
    )


def mean_curvature(family: Density, y: Array, valid: Array, shape: Array) -> Array:
    """Mean curvature of a channel's log density, no less than a share of what is expected."""
    curvature = jnp.where(valid, family.curvature(y, shape), 0.0)
    least = LIMITS.least_curvature * family.moments(shape).location
    return jnp.maximum(jnp.sum(curvature) / jnp.maximum(jnp.sum(valid), 1), least)


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
    white = []
    for channel in model.structure.channels:
        noise = channel.noise(model.campaign, theta, model.structure.drive)
        factors = channel.factors(noise, readings_of(model, channel))
        white.append(Whitening(on_device(factors), noise_memory(model, channel, theta)))
    return tuple(white)


def is_alike(one: Whitenings, other: Whitenings) -> bool:
    """Whether two noises of one model differ by no more than rounds of them settle to."""
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return all(np.allclose(a, b, rtol=LIMITS.settled_noise, atol=0.0) for a, b in pairs)


def with_memory(model: Model, white: Whitenings, theta: np.ndarray, **counted: bool) -> Whitenings:
    """The same noise with another memory; `counted`: as `noise_memory` takes it."""
    pairs = zip(model.channels, white, strict=True)
    return tuple(
        each._replace(memory=noise_memory(model, channel, theta, **counted))
        for channel, each in pairs
    )


def without_memory(white: Whitenings) -> Whitenings:
    """The same noise as if it were white and Gaussian."""
    return tuple(each._replace(memory=None, density=None) for each in white)


def of_densities(white: Whitenings, densities: Densities) -> Whitenings:
    """The same noise with other densities."""
    pairs = zip(white, densities, strict=True)
    return tuple(each._replace(density=density) for each, density in pairs)


def discounted(white: Whitenings, factors: np.ndarray) -> Whitenings:
    """The same noise with information taken away.

    `factors` (slews, channels): what each slew's and channel's information is multiplied by.
    """
    weak = []
    for each, root in zip(white, np.sqrt(np.asarray(factors)).T, strict=True):
        shaped = root.reshape(-1, *(1 for _ in each.factors.shape[1:]))
        weak.append(each._replace(factors=on_device(np.asarray(each.factors) * shaped)))
    return tuple(weak)


def log_normalisation(model: Model, white: Whitenings) -> float:
    """Log of what the density of readings is multiplied by, beside the exponential of squares.

    Returns: up to a constant that all noises of the same readings share.
    """
    return sum(float(logs.sum()) for logs in log_norms(model, white))


def log_norms(model: Model, white: Whitenings) -> list[np.ndarray]:
    """The same of each reading (slews, rows), by channel."""
    norms = []
    for channel, each in zip(model.structure.channels, white, strict=True):
        diagonal = channel.diagonal(np.asarray(each.factors))
        logs = np.log(np.where(diagonal > 0.0, diagonal, 1.0)).sum(-1)
        norms.append(logs if each.memory is None else logs + np.log(each.memory.scale).sum(-1))
    return norms


def n_data(model: Model, white: Whitenings) -> np.ndarray:
    """How many numbers were measured.

    Returns (slews, channels).
    """
    pairs = zip(model.structure.channels, white, strict=True)
    return np.stack(
        [np.count_nonzero(c.diagonal(np.asarray(w.factors)), axis=(1, 2)) for c, w in pairs], 1
    )
