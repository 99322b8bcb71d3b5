"""Whitened residuals at a point, their sensitivities, and the normal equations that follow.

Large programs are compiled for one slew and run for each: padded before, cut afterwards. How many
slews a campaign has decides nothing of what is compiled, and its rows only through the few sizes
that slews are padded to (`physics.packing`). Outside of here nobody sees the padding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree

from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.inference.noise_model import (
    Pull,
    Whitenings,
    compiled_innovations,
    measured,
    n_data,
    without_memory,
)
from bayes_inertia.maths.device_arrays import filled, on_device
from bayes_inertia.maths.kept_programs import KeptProgram
from bayes_inertia.maths.values import AnyArray, array_dataclass
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.packing import Data, Nuisances, Telemetry
from bayes_inertia.physics.prediction import Structure, predict, predict_all


@jax.tree_util.register_dataclass
@array_dataclass
class Point:
    """Where residuals are evaluated; compiled code takes it as one argument.

    Parameters
    ----------
    theta : (d,) array
        Parameters of the model, in physical units.
    bias : (axes,) array
        Deviation of the rate bias from its prior mean, in prior sd.
    local : (slews, n_local) array
        Nuisances of each slew (start state; in the measured drive slow tachometer noise), in
        prior sd.

    Examples
    --------
    >>> import numpy as np
    >>> Point(np.zeros(9), np.zeros(3), np.zeros((2, 9))).n_local
    9
    """

    # Of numpy on the host, of JAX in compiled code.
    theta: Any
    bias: Any
    local: Any

    @property
    def n_local(self) -> int:
        """Nuisances of one slew."""
        return self.local.shape[1]


def is_traced(*arrays: Any) -> bool:
    """Whether JAX transforms the caller: then all slews are one program, in their own size."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(arrays))


# What a program of one slew is given; the slew's axis stays, of length one.
SlewPiece = tuple[Point, Data, Whitenings]


def slew_pieces(point: Point, data: Data, white: Whitenings) -> list[SlewPiece]:
    """Nuisances (slews, n_local), arrays and noise of each slew alone; padding has no weight."""
    local = np.asarray(point.local)
    sizes = [readings.values.shape[1] for readings in data.pieces[0].arrays.telemetry.readings]
    padded = tuple(
        jax.tree.map(lambda x, size=size: filled(np.asarray(x), size), each)
        for each, size in zip(white, sizes, strict=True)
    )
    return [
        (replace(point, local=local[k : k + 1]), alone, of_slew(k, padded))
        for k, alone in enumerate(data.pieces)
    ]


def of_slew(k: int, arrays: Any) -> Any:
    """One slew of arrays of numpy whose leading axis are slews."""
    return jax.tree.map(lambda rows: rows[k : k + 1], arrays)


def of_all_slews(parts: Sequence[Any], sizes: Any) -> Any:
    """Results of each slew (1, padded, ...) as those of all (slews, size, ...), of numpy.

    `sizes` has an array's true second axis in its place.
    """

    def stacked(size: int, *of_slews: Any) -> np.ndarray:
        return np.concatenate([np.asarray(x)[:, :size] for x in of_slews])

    return jax.tree.map(stacked, sizes, *parts)


# Whitened residuals (slews, numbers) of each channel, measured minus predicted, in sigmas; zero
# where nothing was measured. Or derivatives of these, with further axes.
Residuals = tuple[AnyArray, ...]


class Sensitivities(NamedTuple):
    """Residuals with their derivatives.

    Parameters
    ----------
    residuals : Residuals
    jacobian : Residuals
        By channel (slews, numbers, p), for the p columns asked for.
    """

    residuals: Residuals
    jacobian: Residuals


class Information(NamedTuple):
    """Normal equations of the whitened residuals by slew and channel, without priors.

    The unknowns of a slew are (theta[free], bias, its own nuisances), p together.

    Parameters
    ----------
    matrix : (slews, channels, p, p) array
    gradient : (slews, channels, p) array
    chi2 : (slews, channels) array
        Sums of squares.
    n_data : (slews, channels) array of int
        Numbers measured.
    free : (f,) array of int
        Indices of the parameters that may move.
    weight : (channels,) array, optional
        Information of a reading over that of Gaussian noise of its sigma.
    """

    matrix: np.ndarray
    gradient: np.ndarray
    chi2: np.ndarray
    n_data: np.ndarray
    free: np.ndarray
    weight: np.ndarray | float = 1.0


def whitened(
    structure: Structure, prediction: tuple[Array, ...], telemetry: Telemetry, white: Whitenings
) -> Residuals:
    """Measured minus predicted, whitened and flattened.

    `prediction`: of one slew, or of all with a leading axis.
    """
    residuals = []
    for channel, predicted, readings, noise in zip(
        structure.channels, prediction, telemetry.readings, white, strict=True
    ):
        r = channel.whitened(noise.factors, channel.gap(readings.values, predicted))
        r = r if noise.memory is None else compiled_innovations(r, noise.memory)
        r = r if channel.compared else r[..., :0]
        residuals.append(r.reshape(*r.shape[:-2], -1))
    return tuple(residuals)


def residuals(structure: Structure, point: Point, data: Data, white: Whitenings) -> Residuals:
    """Whitened residuals of all slews."""
    program = partial(_filtered, _plain_residuals, structure)
    if is_traced(point, data, white):
        return program(point, data, white)
    parts = [program(*piece) for piece in slew_pieces(point, data, white)]
    return of_all_slews(parts, _numbers(structure, white))


@KeptProgram
def _plain_residuals(
    structure: Structure, point: Point, data: Data, white: Whitenings
) -> Residuals:
    prediction = predict_all(structure, point.theta, point.local, point.bias, data)
    return whitened(structure, prediction, data.arrays.telemetry, white)


def _filtered(
    program: Any, structure: Structure, point: Point, data: Data, white: Whitenings, *more: Any
) -> Any:
    """Residuals, or their derivatives (slews, numbers, p), without what noise before lets expect.

    It is linear: one compiled model serves white and correlated noise.
    """
    plain = program(structure, point, data, without_memory(white), *more)
    if isinstance(plain, Sensitivities):
        return Sensitivities(*(filtered(part, white) for part in plain))
    return filtered(plain, white)


def filtered(plain: Residuals, white: Whitenings) -> Residuals:
    """Residuals, or derivatives of them, where noise may remember."""
    pairs = zip(plain, white, strict=True)
    return tuple(r if w.memory is None else compiled_innovations(r, w.memory) for r, w in pairs)


def _numbers(structure: Structure, white: Whitenings) -> Residuals:
    """How many numbers a slew has in each channel."""
    pairs = zip(structure.channels, white, strict=True)
    return tuple(w.factors.shape[1] * w.factors.shape[2] * c.compared for c, w in pairs)


@KeptProgram
def _plain_sensitivities(
    structure: Structure, point: Point, data: Data, white: Whitenings, columns: Array
) -> Sensitivities:
    d, b = len(point.theta), len(point.bias)

    def of_slew(x, slew, telemetry, reference, white_of_slew):
        def parts(z):
            nuisances = structure.nuisances(z[d + b :])
            prediction = predict(
                structure, z[:d], nuisances, z[d : d + b], slew, telemetry, reference, data
            )
            return whitened(structure, prediction, telemetry, white_of_slew)

        directions = jax.nn.one_hot(columns, len(x), dtype=x.dtype)
        value, jacobian = jax.vmap(lambda v: jax.jvp(parts, (x,), (v,)), out_axes=(None, -1))(
            directions
        )
        return Sensitivities(value, jacobian)

    shared = jnp.broadcast_to(jnp.concatenate([point.theta, point.bias]), (len(point.local), d + b))
    return jax.vmap(of_slew)(jnp.concatenate([shared, point.local], -1), *data.arrays, white)


@KeptProgram
def _sensor_columns(structure: Structure, point: Point, data: Data, white: Whitenings) -> Residuals:
    """Derivatives by the coefficients that only sensors feel: the motion is simulated once."""
    sensed = structure.only_sensed

    def of_slew(local, slew, telemetry, reference, white_of_slew):
        start, coefficients = structure.nuisances(local)
        flat, unflatten = ravel_pytree(
            [c for c, chosen in zip(coefficients, sensed, strict=True) if chosen]
        )

        def parts(z):
            moved = iter(unflatten(z))
            mixed = tuple(
                next(moved) if chosen else c for c, chosen in zip(coefficients, sensed, strict=True)
            )
            nuisances = Nuisances(start, mixed)
            prediction = predict(
                structure, point.theta, nuisances, point.bias, slew, telemetry, reference, data
            )
            return whitened(structure, prediction, telemetry, white_of_slew)

        columns = jax.vmap(lambda v: jax.jvp(parts, (flat,), (v,))[1], out_axes=-1)
        return columns(jnp.eye(len(flat)))

    return jax.vmap(of_slew)(point.local, *data.arrays, white)


def padded_sensitivities(
    model: Model, point: Point, white: Whitenings, free: np.ndarray, *, silent: bool = False
) -> Sensitivities:
    """Sensitivities to everything fitted, padded: all fits of a model share compiled code.

    Columns are taken some at a time; the last one is repeated to fill the last group. Those of
    coefficients that only sensors feel come from a program of their own, which costs less.

    `free` (f,). `silent`: without columns of coefficients. Returns: with at least f + n_bias +
    n_local (silent: n_start) columns; what follows those is padding.
    """
    structure, d = model.structure, model.space.size
    b, of_effects = len(point.bias), np.repeat(structure.only_sensed, structure.coefficients)
    columns = np.concatenate([free, np.arange(d, d + b + structure.n_local)])
    sensed = np.zeros(len(columns), dtype=bool)
    sensed[len(columns) - len(of_effects) :] = of_effects
    if silent:
        columns, sensed = (x[: len(columns) - len(of_effects)] for x in (columns, sensed))
    moving = np.flatnonzero(~sensed)
    # The same whatever is free: all fits of a model share its program.
    width = _columns_at_once(d + b + structure.n_local - int(of_effects.sum()))
    while width > 1 and width * model.data.contexts.time.shape[1] > LIMITS.numbers_of_columns:
        width //= 2
    padding = -len(moving) % width
    groups = columns[np.concatenate([moving, np.repeat(moving[-1:], padding)])]
    pieces = slew_pieces(point, model.data, white)
    programs = [
        partial(_filtered, _plain_sensitivities, structure, *piece, on_device(group))
        for group in groups.reshape(-1, width)
        for piece in pieces
    ]
    if sensed.any():
        programs += [partial(_filtered, _sensor_columns, structure, *piece) for piece in pieces]
    parts, numbers = _at_once(programs), _numbers(structure, white)
    # Of the sensors' coefficients there are derivatives alone.
    derivatives = [part.jacobian if isinstance(part, Sensitivities) else part for part in parts]
    jacobians = [
        of_all_slews(derivatives[k : k + len(pieces)], numbers)
        for k in range(0, len(parts), len(pieces))
    ]
    jacobian = tuple(np.concatenate(c, -1) for c in zip(*jacobians, strict=True))
    if sensed.any():
        padded = len(columns) + np.arange(padding)
        order = np.argsort(np.concatenate([moving, padded, np.flatnonzero(sensed)]))
        jacobian = tuple(channel[..., order] for channel in jacobian)
    at_point = [part.residuals for part in parts[: len(pieces)]]
    return Sensitivities(of_all_slews(at_point, numbers), jacobian)


def _columns_at_once(every: int) -> int:
    """How many of so many columns are taken at a time, in groups of about one size.

    >>> _columns_at_once(22), _columns_at_once(27), _columns_at_once(40)
    (24, 32, 24)
    """
    groups = -(-every // LIMITS.columns_at_once)
    return -(-every // (groups * LIMITS.lanes)) * LIMITS.lanes


def _at_once(tasks: Sequence[Callable[[], Any]]) -> list[Any]:
    """Results of independent compiled work, two at a time: one core alone would leave others idle.

    Compiled code runs beside other threads of Python. Results do not depend on how many there are.
    """
    if len(tasks) == 1:
        return [jax.block_until_ready(tasks[0]())]
    with ThreadPoolExecutor(LIMITS.threads) as pool:
        return list(pool.map(lambda task: jax.block_until_ready(task()), tasks))


def unpadded_sensitivities(
    model: Model, point: Point, white: Whitenings, free: np.ndarray
) -> Sensitivities:
    """Sensitivities to everything fitted, and nothing else.

    `free` (f,).
    """
    padded = padded_sensitivities(model, point, white, free)
    p = len(free) + len(point.bias) + model.structure.n_local
    return Sensitivities(padded.residuals, tuple(j[..., :p] for j in padded.jacobian))


def _pulls(model: Model, white: Whitenings, r: Residuals, theta: np.ndarray) -> list[Pull]:
    """How the residuals of each channel pull."""
    return [
        Pull(x, 1.0, np.sum(x**2, -1))
        if noise.density is None
        else noise.density.pull(x, ok.reshape(x.shape), theta)
        for noise, x, ok in zip(white, r, measured(model), strict=True)
    ]


def _gradient(
    jacobian: Residuals, white: Whitenings, pulls: Sequence[Pull], free: np.ndarray
) -> np.ndarray:
    """Gradient (slews, channels, columns) of half the squares, or of the losses."""
    pairs = zip(jacobian, pulls, strict=True)
    gradient = np.stack([np.einsum("snp,sn->sp", j, pull.slope) for j, pull in pairs], 1)
    for c, (each, pull) in enumerate(zip(white, pulls, strict=True)):
        if each.density is not None and pull.noise is not None:
            kept, at = each.density.noise_columns(free)
            gradient[:, c, at] += pull.noise[0][:, kept]
    return gradient


def information_blocks(
    model: Model, point: Point, white: Whitenings, free: np.ndarray | None = None, **asked: bool
) -> Information:
    """Normal equations of every slew and channel at one point.

    `free` (f,): indices of the parameters that may move; None for all. `asked`: as of
    `information_and_pull`.
    """
    free = np.arange(model.space.size) if free is None else np.asarray(free)
    return information_and_pull(model, point, white, free, **asked)[0]


def information_and_pull(
    model: Model, point: Point, white: Whitenings, free: np.ndarray, *, silent: bool = False
) -> tuple[Information, Callable[[Point], np.ndarray]]:
    """Normal equations at one point, and how other points pull with the derivatives there.

    `free` (f,). `silent`: as if no data told of coefficients, so that they stay where they are
    zero. Returns the equations; from a point to the gradient (slews, channels, p) that its
    residuals have.
    """
    s = padded_sensitivities(model, point, white, free, silent=silent)
    every = len(free) + len(point.bias) + model.structure.n_local
    p = every - silent * sum(model.structure.coefficients)

    def gradient_of(pulls: Sequence[Pull]) -> np.ndarray:
        return filled(_gradient(s.jacobian, white, pulls, free)[..., :p], every, 2)

    def pull_of(other: Point) -> np.ndarray:
        r = residuals(model.structure, other, model.data, white)
        return gradient_of(_pulls(model, white, r, other.theta))

    pulls = _pulls(model, white, s.residuals, point.theta)
    pairs = zip(s.jacobian, pulls, strict=True)
    matrix = np.stack([pull.weight * (np.swapaxes(j, 1, 2) @ j) for j, pull in pairs], 1)
    for c, (each, pull) in enumerate(zip(white, pulls, strict=True)):
        if each.density is not None and pull.noise is not None:
            kept, at = each.density.noise_columns(free)
            matrix[:, c, at[:, None], at] += pull.noise[1][:, kept][:, :, kept]
    matrix = filled(filled(matrix[..., :p, :p], every, 2), every, 3)
    chi2 = np.stack([pull.chi2 for pull in pulls], 1)
    weight = np.array([pull.weight for pull in pulls])
    numbers = n_data(model, white)
    return Information(matrix, gradient_of(pulls), chi2, numbers, free, weight), pull_of
