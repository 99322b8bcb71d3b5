"""Whitened residuals, their sensitivities, and the marginal log posterior of the sampled parameters.

Start states of each slew, slow tachometer noise (measured drive) and the rate bias are nuisances.
They enter the residuals almost linearly, so they are integrated out in closed form: the residuals
are evaluated on the ridge n(theta) = n0 + L (theta - theta0), the nuisances' best values for every
theta to first order, and what is left is projected by a Schur complement with the sensitivities at
theta0. On a linear model this is exact; the ridge keeps it accurate where theta moves far.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.campaign.channel_names import CHANNELS
from bayes_inertia.inference.point import Point
from bayes_inertia.maths import inertia_tensor, quaternion
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import log_prior
from bayes_inertia.physics.prediction import Data, Prediction, Structure, predict, predict_all

# Sensitivities are taken so many columns at a time.
_COLUMNS = 24


class Whitening(NamedTuple):
    """Inverse Cholesky factors of the noise, zero where nothing was measured: `rate` (slews, n, 3, 3),
    `attitude` (slews, f, 3, 3), `momentum` (slews, n, wheels)."""

    rate: Array
    attitude: Array
    momentum: Array


class Residuals(NamedTuple):
    """Whitened residuals by channel, each (slews, numbers of that channel); zero where nothing was measured."""

    rate: Array
    attitude: Array
    momentum: Array


class Sensitivities(NamedTuple):
    """`residuals` and `jacobian`, by channel (slews, numbers, p) for the columns asked for."""

    residuals: Residuals
    jacobian: Residuals


class Information(NamedTuple):
    """Normal equations by slew and channel: `matrix` (slews, 3, p, p), `gradient` (slews, 3, p),
    `chi2` (slews, 3), `n_data` (slews, 3) of the whitened residuals; p = (theta[free], bias, local nuisances),
    `free` the indices of the parameters that may move."""

    matrix: np.ndarray
    gradient: np.ndarray
    chi2: np.ndarray
    n_data: np.ndarray
    free: np.ndarray


def whitening(model: Model, theta: np.ndarray) -> Whitening:
    """Noise of every measurement, at the parameters theta (d,).

    In the measured drive tachometer noise is an input: it shakes the predicted rate by J^-1 G dh
    (the part of it that accumulates in the attitude is among the nuisances).
    """
    campaign, telemetry = model.campaign, model.data.arrays.telemetry
    sensor = campaign.rate_sensor
    covariance = np.diag(np.square(sensor.sigma))
    if model.structure.drive == "measured" and campaign.wheels:
        shake = (
            sensor.axes
            @ np.linalg.solve(_locked(model, theta), campaign.wheel_axes_B)
            / np.asarray(theta[6:9])[:, None]
        )
        covariance = (
            covariance
            + shake @ np.diag(np.square([w.momentum_sigma for w in campaign.wheels])) @ shake.T
        )
    momentum = np.zeros(telemetry.momentum.shape)
    if model.structure.drive == "commanded":
        sigma = np.array([w.momentum_sigma or np.inf for w in campaign.wheels])
        momentum = np.where(telemetry.momentum_valid, 1.0 / sigma, 0.0)
    attitude = np.zeros((*telemetry.attitude.shape[:2], 3, 3))
    if campaign.star_tracker is not None:
        tracker = campaign.star_tracker
        along = np.outer(tracker.boresight_B, tracker.boresight_B)
        whiten = (np.eye(3) - along) / tracker.sigma_cross + along / tracker.sigma_roll
        attitude = np.asarray(telemetry.fix_valid)[..., None, None] * whiten
    return Whitening(
        jnp.asarray(_whiten_rows(covariance, np.asarray(telemetry.rate_valid))),
        jnp.asarray(attitude),
        jnp.asarray(momentum),
    )


def _locked(model: Model, theta: np.ndarray) -> np.ndarray:
    J = np.array(inertia_tensor.tensor(jnp.asarray(theta[:6])))
    if model.structure.includes_wheel_spin:
        return J
    axes, spin = model.campaign.wheel_axes_B, model.campaign.spin_inertias
    return np.array(inertia_tensor.with_wheel_spin(J, jnp.asarray(axes), jnp.asarray(spin)))


def _whiten_rows(covariance: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Inverse Cholesky factor of the valid part of each row's covariance (..., 3, 3)."""
    out = np.zeros((*valid.shape, 3))
    for pattern in np.unique(valid.reshape(-1, 3), axis=0):
        keep = np.flatnonzero(pattern)
        factor = np.zeros((3, 3))
        if len(keep):
            factor[np.ix_(keep, keep)] = np.linalg.inv(
                np.linalg.cholesky(covariance[np.ix_(keep, keep)])
            )
        out[(valid == pattern).all(axis=-1)] = factor
    return out


def _whitened(
    structure: Structure, prediction: Prediction, telemetry, white: Whitening
) -> Residuals:
    """Measured minus predicted, whitened and flattened (leading axis: slews, if any)."""
    gap = telemetry.rate - prediction.rate
    rate = jnp.stack(
        [sum(white.rate[..., i, j] * gap[..., j] for j in range(i + 1)) for i in range(3)], -1
    )
    turn = quaternion.error(prediction.attitude, telemetry.attitude)
    attitude = jnp.einsum("...ij,...j->...i", white.attitude, turn)
    momentum = white.momentum * (telemetry.momentum - prediction.momentum)
    if structure.drive == "measured":
        momentum = momentum[..., :0]
    return Residuals(*(r.reshape(*r.shape[:-2], -1) for r in (rate, attitude, momentum)))


@partial(jax.jit, static_argnums=0)
def residuals(structure: Structure, point: Point, data: Data, white: Whitening) -> Residuals:
    """Whitened residuals of all slews at a point."""
    prediction = predict_all(structure, point.theta, point.local, point.bias, data)
    return _whitened(structure, prediction, data.arrays.telemetry, white)


@partial(jax.jit, static_argnums=0)
def sensitivities(
    structure: Structure,
    point: Point,
    data: Data,
    white: Whitening,
    columns: Array | None = None,
) -> Sensitivities:
    """Residuals, and their exact derivatives with respect to some of (theta, bias, each slew's own nuisances).

    Parameters
    ----------
    columns : (p,) indices into that vector of d + 3 + n_local numbers; None for all.
    """
    d, b = len(point.theta), len(point.bias)

    def of_slew(x, slew, telemetry, reference, white_of_slew):
        def parts(z):
            prediction = predict(
                structure, z[:d], z[d + b :], z[d : d + b], slew, telemetry, reference, data
            )
            return _whitened(structure, prediction, telemetry, white_of_slew)

        directions = (
            jnp.eye(len(x)) if columns is None else jax.nn.one_hot(columns, len(x), dtype=x.dtype)
        )
        value, jacobian = jax.vmap(lambda v: jax.jvp(parts, (x,), (v,)), out_axes=(None, -1))(
            directions
        )
        return Sensitivities(value, jacobian)

    shared = jnp.broadcast_to(jnp.concatenate([point.theta, point.bias]), (len(point.local), d + b))
    return jax.vmap(of_slew)(jnp.concatenate([shared, point.local], -1), *data.arrays, white)


def all_columns(model: Model, free: np.ndarray | None = None) -> np.ndarray:
    """Columns for `sensitivities`: the free parameters (all by default), the bias, and the local nuisances."""
    d = model.space.size
    free = np.arange(d) if free is None else np.asarray(free)
    return np.concatenate([free, np.arange(d, d + 3 + model.structure.n_local)])


def padded_sensitivities(
    model: Model, point: Point, white: Whitening, free: np.ndarray
) -> Sensitivities:
    """Sensitivities to (theta[free], bias, local nuisances), some columns at a time, the last one repeated: all fits of a model share compiled code."""
    columns = all_columns(model, free)
    columns = np.concatenate([columns, np.repeat(columns[-1:], -len(columns) % _COLUMNS)])
    point = jax.tree.map(jnp.asarray, point)
    parts = [
        sensitivities(model.structure, point, model.data, white, jnp.asarray(chunk))
        for chunk in columns.reshape(-1, _COLUMNS)
    ]
    return Sensitivities(
        parts[0].residuals,
        Residuals(
            *(jnp.concatenate(some, -1) for some in zip(*(p.jacobian for p in parts), strict=True))
        ),
    )


@jax.jit
def _normal_equations(s: Sensitivities):
    matrix = jnp.stack([jnp.einsum("snp,snq->spq", j, j) for j in s.jacobian], 1)
    gradient = jnp.stack(
        [jnp.einsum("snp,sn->sp", j, r) for j, r in zip(s.jacobian, s.residuals, strict=True)], 1
    )
    return matrix, gradient, jnp.stack([jnp.sum(r**2, -1) for r in s.residuals], 1)


def information(
    model: Model, point: Point, white: Whitening, free: np.ndarray | None = None
) -> Information:
    """Normal equations of every slew and channel at one point (host arrays), for the free parameters (all by default)."""
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


def discounted(white: Whitening, factors: np.ndarray) -> Whitening:
    """The same noise with each slew's and channel's information multiplied by `factors` (slews, 3)."""
    root = jnp.sqrt(jnp.asarray(factors))
    return Whitening(
        white.rate * root[:, 0, None, None, None],
        white.attitude * root[:, 1, None, None, None],
        white.momentum * root[:, 2, None, None],
    )


def n_data(white: Whitening) -> np.ndarray:
    """Numbers measured, by slew and channel (slews, 3)."""
    rate = np.count_nonzero(np.diagonal(white.rate, axis1=-2, axis2=-1), axis=(1, 2))
    attitude = np.count_nonzero(np.diagonal(white.attitude, axis1=-2, axis2=-1), axis=(1, 2))
    return np.stack([rate, attitude, np.count_nonzero(white.momentum, axis=(1, 2))], 1)


class Marginal(NamedTuple):
    """Everything the marginal log posterior needs, frozen at theta0: a JAX pytree.

    `optimum`: the point where it is expanded; `ridge_bias` (3, d), `ridge_local`
    (slews, m, d): how the nuisances follow theta; `columns` the sensitivities of the nuisances by channel
    (slews, numbers, 3 + m); `factor` (M, M) the Cholesky factor of their normal matrix, M = 3 + slews m;
    `prior` the priors of theta as arrays;
    `data`, `white`.
    """

    optimum: Point
    ridge_bias: Array
    ridge_local: Array
    columns: Residuals
    root: Array
    prior: dict
    data: Data
    white: Whitening


def point_on_ridge(m: Marginal, theta: Array) -> Point:
    """theta (d,) with the nuisances that belong to it to first order."""
    shift = theta - m.optimum.theta
    return Point(
        theta, m.optimum.bias + m.ridge_bias @ shift, m.optimum.local + m.ridge_local @ shift
    )


def _project(structure: Structure, m: Marginal, theta: Array) -> tuple[Array, Array]:
    """chi^2 () on the ridge, and the gradient (M,) of half of it with respect to the nuisances."""
    point = point_on_ridge(m, theta)
    bias, local = point.bias, point.local
    prediction = predict_all(structure, theta, local, bias, m.data)
    r = _whitened(structure, prediction, m.data.arrays.telemetry, m.white)
    pull = sum(
        jnp.einsum("sn,snk->sk", channel, columns)
        for channel, columns in zip(r, m.columns, strict=True)
    )
    gradient = jnp.concatenate([pull[:, :3].sum(0) + bias, (pull[:, 3:] + local).ravel()])
    chi2 = sum(jnp.sum(channel**2) for channel in r) + jnp.sum(bias**2) + jnp.sum(local**2)
    return chi2, gradient


def log_posterior_of(structure: Structure, m: Marginal, theta: Array) -> Array:
    """Marginal log posterior density () of theta (d,), up to a constant; -inf where J is unphysical or a prior ends.

    Differentiable; `log_posterior` is the compiled batch version.
    """
    physical = inertia_tensor.is_physical(theta[:6])
    safe = jnp.where(physical, theta, m.optimum.theta)
    chi2, gradient = _project(structure, m, safe)
    value = log_prior(m.prior, theta) - 0.5 * (chi2 - jnp.sum((m.root @ gradient) ** 2))
    return jnp.where(physical & jnp.isfinite(value), value, -jnp.inf)


def log_posterior(structure: Structure, m: Marginal) -> Callable[[Array], Array]:
    """The compiled marginal log posterior: thetas (batch, d) -> (batch,).

    The data are constants of the compiled code, which makes it twice as fast as passing them each time.
    """
    return jax.jit(jax.vmap(partial(log_posterior_of, structure, m)))


@partial(jax.jit, static_argnums=0)
def shared_log_posterior(structure: Structure, m: Marginal, thetas: Array) -> Array:
    """The same with the data as arguments: thetas (batch, d) -> (batch,).

    Compiled once for all campaigns of one shape: for studies of many short fits, where compiling takes longer than sampling.
    """
    return jax.vmap(partial(log_posterior_of, structure, m))(thetas)


def conditional_point(
    structure: Structure, m: Marginal, theta: np.ndarray, noise: np.ndarray
) -> Point:
    """theta (d,) with nuisances drawn from their posterior given theta.

    `noise` (3 + slews * n_local,) are standard normal numbers; zeros give the conditional mean.
    """
    theta, optimum = np.asarray(theta), jax.tree.map(np.asarray, m.optimum)
    shift = theta - optimum.theta
    bias = optimum.bias + np.asarray(m.ridge_bias) @ shift
    local = optimum.local + np.asarray(m.ridge_local) @ shift
    r = residuals(structure, Point(theta, bias, local), m.data, m.white)
    pull = sum(
        np.einsum("sn,snk->sk", channel, columns)
        for channel, columns in zip(r, m.columns, strict=True)
    )
    gradient = np.concatenate([pull[:, :3].sum(0) + bias, (pull[:, 3:] + local).ravel()])
    root = np.asarray(m.root)
    step = root.T @ (noise - root @ gradient)
    return Point(theta, bias + step[:3], local + step[3:].reshape(local.shape))


def by_channel(values) -> dict:
    """{channel name: value} in the order of `CHANNELS`.

    >>> by_channel([1, 2, 3])["momentum"]
    3
    """
    return dict(zip(CHANNELS, values, strict=True))
