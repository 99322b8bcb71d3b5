"""Whitened residuals, their sensitivities, and the normal equations that follow from them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree

from bayes_inertia.inference.kept_programs import KeptProgram
from bayes_inertia.inference.noise_memory import Memory, innovations
from bayes_inertia.inference.noise_model import Whitening, n_data
from bayes_inertia.inference.point import Point
from bayes_inertia.maths import quaternion
from bayes_inertia.maths.at_once import at_once
from bayes_inertia.maths.device_arrays import on_device
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.nuisances import Nuisances
from bayes_inertia.physics.packing import Telemetry
from bayes_inertia.physics.prediction import Data, Prediction, Structure, predict, predict_all

# Sensitivities are taken so many columns at a time.
_COLUMNS_AT_ONCE = 24


class Residuals(NamedTuple):
    """Whitened residuals by channel; zero where nothing was measured.

    Parameters
    ----------
    rate, attitude, momentum : (slews, numbers of that channel) arrays
        Measured minus predicted, in sigmas. Or derivatives of these, with further axes.
    """

    rate: Array
    attitude: Array
    momentum: Array


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
    matrix : (slews, 3, p, p) array
    gradient : (slews, 3, p) array
    chi2 : (slews, 3) array
        Sums of squares.
    n_data : (slews, 3) array of int
        Numbers measured.
    free : (f,) array of int
        Indices of the parameters that may move.
    """

    matrix: np.ndarray
    gradient: np.ndarray
    chi2: np.ndarray
    n_data: np.ndarray
    free: np.ndarray


def whitened(
    structure: Structure, prediction: Prediction, telemetry: Telemetry, white: Whitening
) -> Residuals:
    """Measured minus predicted, whitened and flattened.

    Parameters
    ----------
    structure : Structure
    prediction : Prediction
        Of one slew, or of all with a leading axis.
    telemetry : Telemetry
        What was measured, likewise.
    white : Whitening
        The noise, likewise.

    Returns
    -------
    Residuals
    """
    gap = telemetry.rate - prediction.rate
    rate = jnp.stack(
        [sum(white.rate[..., i, j] * gap[..., j] for j in range(i + 1)) for i in range(3)], -1
    )
    if white.memory is not None:
        rate = innovations(rate, white.memory)
    turn = quaternion.error(prediction.attitude, telemetry.attitude)
    attitude = jnp.einsum("...ij,...j->...i", white.attitude, turn)
    momentum = white.momentum * (telemetry.momentum - prediction.momentum)
    if structure.drive == "measured":
        momentum = momentum[..., :0]
    return Residuals(*(r.reshape(*r.shape[:-2], -1) for r in (rate, attitude, momentum)))


def residuals(structure: Structure, point: Point, data: Data, white: Whitening) -> Residuals:
    """Whitened residuals of all slews.

    Parameters
    ----------
    structure : Structure
    point : Point
        Where.
    data : Data
    white : Whitening
        The noise.

    Returns
    -------
    Residuals
    """
    plain = _plain_residuals(structure, point, data, white._replace(memory=None))
    return plain if white.memory is None else _remembered(plain, white.memory)


@KeptProgram
def _plain_residuals(structure: Structure, point: Point, data: Data, white: Whitening) -> Residuals:
    prediction = predict_all(structure, point.theta, point.local, point.bias, data)
    return whitened(structure, prediction, data.arrays.telemetry, white)


@jax.jit
def _remembered(plain: Residuals, memory: Memory) -> Residuals:
    """Residuals, or their derivatives (slews, numbers, p), without what noise before lets expect.

    It is linear: one compiled model serves white and correlated noise.
    """
    shape = plain.rate.shape
    rate = innovations(plain.rate.reshape(shape[0], shape[1] // 3, 3, *shape[2:]), memory)
    return plain._replace(rate=rate.reshape(shape))


def sensitivities(
    structure: Structure,
    point: Point,
    data: Data,
    white: Whitening,
    columns: Array | None = None,
) -> Sensitivities:
    """Residuals and their exact derivatives.

    Parameters
    ----------
    structure : Structure
    point : Point
        Where.
    data : Data
    white : Whitening
        The noise.
    columns : (p,) array of int, optional
        With respect to which of (theta, bias, each slew's own nuisances), d + 3 + n_local
        numbers; None for all.

    Returns
    -------
    Sensitivities
    """
    plain = _plain_sensitivities(structure, point, data, white._replace(memory=None), columns)
    if white.memory is None:
        return plain
    return Sensitivities(*(_remembered(part, white.memory) for part in plain))


@KeptProgram
def _plain_sensitivities(
    structure: Structure, point: Point, data: Data, white: Whitening, columns: Array | None
) -> Sensitivities:
    d, b = len(point.theta), len(point.bias)

    def of_slew(x, slew, telemetry, reference, white_of_slew):
        def parts(z):
            nuisances = structure.nuisances(z[d + b :])
            prediction = predict(
                structure, z[:d], nuisances, z[d : d + b], slew, telemetry, reference, data
            )
            return whitened(structure, prediction, telemetry, white_of_slew)

        directions = (
            jnp.eye(len(x)) if columns is None else jax.nn.one_hot(columns, len(x), dtype=x.dtype)
        )
        value, jacobian = jax.vmap(lambda v: jax.jvp(parts, (x,), (v,)), out_axes=(None, -1))(
            directions
        )
        return Sensitivities(value, jacobian)

    shared = jnp.broadcast_to(jnp.concatenate([point.theta, point.bias]), (len(point.local), d + b))
    return jax.vmap(of_slew)(jnp.concatenate([shared, point.local], -1), *data.arrays, white)


@KeptProgram
def _sensor_columns(structure: Structure, point: Point, data: Data, white: Whitening) -> Residuals:
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


def _sensor_sensitivities(
    structure: Structure, point: Point, data: Data, white: Whitening
) -> Residuals:
    plain = _sensor_columns(structure, point, data, white._replace(memory=None))
    return plain if white.memory is None else _remembered(plain, white.memory)


def padded_sensitivities(
    model: Model, point: Point, white: Whitening, free: np.ndarray
) -> Sensitivities:
    """Sensitivities to everything fitted, padded: all fits of a model share compiled code.

    Columns are taken some at a time; the last one is repeated to fill the last group. Those of
    coefficients that only sensors feel come from a program of their own, which costs less.

    Parameters
    ----------
    model : Model
    point : Point
        Where.
    white : Whitening
        The noise.
    free : (f,) array of int
        Indices of parameters.

    Returns
    -------
    Sensitivities
        With at least f + 3 + n_local columns; what follows those is padding.
    """
    structure, d = model.structure, model.space.size
    columns = np.concatenate([free, np.arange(d, d + 3 + structure.n_local)])
    sensed = np.zeros(len(columns), dtype=bool)
    of_effects = np.repeat(np.array(structure.only_sensed, dtype=bool), structure.coefficients)
    sensed[len(columns) - len(of_effects) :] = of_effects
    moving = np.flatnonzero(~sensed)
    padding = -len(moving) % _COLUMNS_AT_ONCE
    groups = columns[np.concatenate([moving, np.repeat(moving[-1:], padding)])]
    point = jax.tree.map(on_device, point)
    tasks: list[Callable[[], Any]] = [
        partial(sensitivities, structure, point, model.data, white, on_device(group))
        for group in groups.reshape(-1, _COLUMNS_AT_ONCE)
    ]
    if sensed.any():
        tasks.append(partial(_sensor_sensitivities, structure, point, model.data, white))
    parts = at_once(tasks)
    # Of the sensors' coefficients there are derivatives alone.
    jacobians = [part.jacobian if isinstance(part, Sensitivities) else part for part in parts]
    jacobian = Residuals(*(jnp.concatenate(pieces, -1) for pieces in zip(*jacobians, strict=True)))
    if sensed.any():
        padded = len(columns) + np.arange(padding)
        stacked = np.concatenate([moving, padded, np.flatnonzero(sensed)])
        jacobian = _in_order(jacobian, on_device(np.argsort(stacked)))
    return Sensitivities(parts[0].residuals, jacobian)


@jax.jit
def _in_order(jacobian: Residuals, order: Array) -> Residuals:
    return Residuals(*(jnp.take(columns, order, axis=-1) for columns in jacobian))


def unpadded_sensitivities(
    model: Model, point: Point, white: Whitening, free: np.ndarray
) -> Sensitivities:
    """Sensitivities to everything fitted, and nothing else.

    Parameters
    ----------
    model : Model
    point : Point
        Where.
    white : Whitening
        The noise.
    free : (f,) array of int
        Indices of parameters.

    Returns
    -------
    Sensitivities
        With f + 3 + n_local columns (arrays of JAX).
    """
    padded = padded_sensitivities(model, point, white, free)
    p = len(free) + 3 + model.structure.n_local
    # Cut by numpy: JAX would compile a program for each number of columns.
    cut = (on_device(np.asarray(j)[..., :p]) for j in padded.jacobian)
    return Sensitivities(padded.residuals, Residuals(*cut))


@jax.jit
def _normal_equations(s: Sensitivities) -> tuple[Array, Array, Array]:
    matrix = jnp.stack([jnp.einsum("snp,snq->spq", j, j) for j in s.jacobian], 1)
    gradient = jnp.stack(
        [jnp.einsum("snp,sn->sp", j, r) for j, r in zip(s.jacobian, s.residuals, strict=True)], 1
    )
    return matrix, gradient, jnp.stack([jnp.sum(r**2, -1) for r in s.residuals], 1)


def information_blocks(
    model: Model, point: Point, white: Whitening, free: np.ndarray | None = None
) -> Information:
    """Normal equations of every slew and channel at one point.

    Parameters
    ----------
    model : Model
    point : Point
        Where.
    white : Whitening
        The noise.
    free : (f,) array of int, optional
        Indices of the parameters that may move; None for all.

    Returns
    -------
    Information
        Arrays of numpy.
    """
    free = np.arange(model.space.size) if free is None else np.asarray(free)
    matrix, gradient, chi2 = _normal_equations(padded_sensitivities(model, point, white, free))
    p = len(free) + 3 + model.structure.n_local
    return Information(
        np.array(matrix)[..., :p, :p],
        np.array(gradient)[..., :p],
        np.array(chi2),
        n_data(white),
        free,
    )


# What is compiled for each shape of campaign, largest first.
PROGRAMS = (
    _plain_sensitivities,
    _plain_residuals,
    _normal_equations,
    _remembered,
    _sensor_columns,
    _in_order,
)
