"""The noise of every measurement, as the factors that whiten residuals."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jax import Array

from bayes_inertia.inference.effect_noise import effects_between_knots
from bayes_inertia.inference.noise_filter import rate_noise_memory
from bayes_inertia.inference.noise_memory import Memory
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.device_arrays import on_device
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.reading_noise import ReadingNoise


class Whitening(NamedTuple):
    """Inverse Cholesky factors of the noise, zero where nothing was measured.

    Parameters
    ----------
    rate : (slews, n, 3, 3) array
        Of the rate readings [s/rad].
    attitude : (slews, fixes, 3, 3) array
        Of the star tracker's fixes [1/rad], body axes.
    momentum : (slews, n, wheels) array
        Of the tachometers [1/(N m s)].
    memory : Memory, optional
        What the noise of the rates keeps of the readings before; None where it is white.
    """

    rate: Array
    attitude: Array
    momentum: Array
    memory: Memory | None = None


def whitening(model: Model, theta: np.ndarray) -> Whitening:
    """Noise of every measurement.

    `theta` (d,): parameters; in the measured drive the noise of the rates depends on J and K, and
    what an effect's process does between its knots depends on its size and time.
    """
    campaign, telemetry = model.campaign, model.data.arrays.telemetry
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
    covariance = rate_noise_covariance(model, theta)
    return Whitening(
        on_device(_whiten_rows(covariance, np.asarray(telemetry.rate_valid))),
        on_device(attitude),
        on_device(momentum),
        rate_noise_memory(model, covariance, noise_between_knots(model, theta)),
    )


def noise_between_knots(model: Model, theta: np.ndarray) -> tuple[ReadingNoise, ...]:
    """What a fit's effects add to the rates and its coefficients do not hold.

    `theta` (d,).
    """
    return tuple(each.noise for each in effects_between_knots(model, theta))


def rate_noise_covariance(model: Model, theta: np.ndarray) -> np.ndarray:
    """Covariance of one rate reading's noise.

    In the measured drive tachometer noise is an input: it shakes the predicted rate by J^-1 G dh.
    (The part of it that accumulates in the attitude is among the nuisances.)

    `theta` (d,). Returns (3, 3) [rad^2/s^2].
    """
    campaign, sensor = model.campaign, model.campaign.rate_sensor
    covariance = np.diag(np.square(sensor.sigma))
    if model.structure.drive == "measured" and campaign.wheels:
        shake = (
            sensor.axes
            @ np.linalg.solve(_locked_inertia(model, theta), campaign.wheel_axes_B)
            / np.asarray(theta[6:9])[:, None]
        )
        momentum = np.diag(np.square([w.momentum_sigma or 0.0 for w in campaign.wheels]))
        covariance = covariance + shake @ momentum @ shake.T
    return covariance


def _locked_inertia(model: Model, theta: np.ndarray) -> np.ndarray:
    """J (3, 3) with the wheels' spin inertia."""
    J = inertia_tensor.tensor(theta[:6])
    if model.structure.includes_wheel_spin:
        return J
    axes, spin = model.campaign.wheel_axes_B, model.campaign.spin_inertias
    return np.asarray(inertia_tensor.with_wheel_spin(J, on_device(axes), on_device(spin)))


def _whiten_rows(covariance: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Inverse Cholesky factor of the valid part of each row's covariance (..., 3, 3)."""
    factors = np.zeros((*valid.shape, 3))
    for pattern in np.unique(valid.reshape(-1, 3), axis=0):
        keep = np.flatnonzero(pattern)
        factor = np.zeros((3, 3))
        if len(keep):
            block = covariance[np.ix_(keep, keep)]
            factor[np.ix_(keep, keep)] = np.linalg.inv(np.linalg.cholesky(block))
        factors[(valid == pattern).all(axis=-1)] = factor
    return factors


def discounted(white: Whitening, factors: np.ndarray) -> Whitening:
    """The same noise with information taken away.

    `factors` (slews, 3): what each slew's and channel's information is multiplied by.
    """
    root = np.sqrt(np.asarray(factors))
    return Whitening(
        on_device(np.asarray(white.rate) * root[:, 0, None, None, None]),
        on_device(np.asarray(white.attitude) * root[:, 1, None, None, None]),
        on_device(np.asarray(white.momentum) * root[:, 2, None, None]),
        white.memory,
    )


def log_normalisation(white: Whitening) -> float:
    """Log of what the density of readings is multiplied by, beside the exponential of squares.

    Returns: up to a constant that all noises of the same readings share.
    """
    matrices = (np.diagonal(w, axis1=-2, axis2=-1) for w in (white.rate, white.attitude))
    norms = [float(np.log(x[x > 0.0]).sum()) for x in (*matrices, np.asarray(white.momentum))]
    if white.memory is not None:
        norms.append(float(np.log(white.memory.scale).sum()))
    return sum(norms)


def n_data(white: Whitening) -> np.ndarray:
    """How many numbers were measured.

    Returns (slews, 3).
    """
    rate = np.count_nonzero(np.diagonal(white.rate, axis1=-2, axis2=-1), axis=(1, 2))
    attitude = np.count_nonzero(np.diagonal(white.attitude, axis1=-2, axis2=-1), axis=(1, 2))
    return np.stack([rate, attitude, np.count_nonzero(white.momentum, axis=(1, 2))], 1)
