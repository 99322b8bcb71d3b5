"""What else an engineer would use: least squares on Euler's equation, and a Kalman filter.

Both are written here from their equations, as plainly as somebody without this package would write
them. The first is the method of TU Delft's inertiaEstimation (rates low-passed without phase and
differentiated) and of the batch estimator of satellite-inertia-id; neither estimates scale factors.
The second is an extended Kalman filter with J, K and the rate bias in its state, as
satellite-inertia-id has one with the diagonal of J in its state.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy import signal

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.maths import inertia_tensor, quaternion

# Corner of the low pass, as a share of the sampling frequency: the best of 0.02, 0.05, 0.1, 0.2 on
# clean campaigns, which favours this method.
CORNER = 0.05
# sds of what a slew starts from: attitude [rad], rate [rad/s], wheel momentum [N m s].
_START_SD = (0.01, 1e-2, 1e-2)


def least_squares(campaign: Campaign, corner: float = CORNER) -> tuple[np.ndarray, np.ndarray]:
    """J from J w' + w x (J w + G h) = -G h', solved for the six elements; K is taken as stated.

    `corner`: of the low pass, as a share of the sampling frequency. Returns J [kg m^2] and K as
    stated, and sds of ordinary least squares, errors of rows taken as independent; zero for K.
    """
    parts = [_equations(slew, campaign, corner) for slew in campaign.slews]
    A, b = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
    elements, _, _, _ = np.linalg.lstsq(A, b, rcond=None)
    residual = b - A @ elements
    variance = residual @ residual / (len(b) - 6)
    sd = np.sqrt(np.diag(np.linalg.inv(A.T @ A)) * variance)
    K = np.asarray(campaign.rate_sensor.scale_factor, dtype=float)
    return np.concatenate([elements, K]), np.concatenate([sd, np.zeros(3)])


def _equations(slew: Slew, campaign: Campaign, corner: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows (3 n, 6) and right-hand sides (3 n,) of one slew."""
    low_pass = signal.butter(4, 2.0 * corner, output="sos")
    sensor, axes = campaign.rate_sensor, campaign.wheel_axes_B
    rate = np.asarray(slew.rate) * np.asarray(sensor.scale_factor) - np.asarray(sensor.bias)
    rate = signal.sosfiltfilt(low_pass, rate @ np.linalg.inv(sensor.axes).T, axis=0)
    momentum = signal.sosfiltfilt(low_pass, np.asarray(slew.wheel_momentum), axis=0)
    spin = campaign.spin_inertias
    acceleration = np.gradient(rate, slew.time, axis=0)
    # Relative momentum plus what the wheels have of the body's rate.
    total = momentum + spin * (rate @ axes)
    change = np.gradient(total, slew.time, axis=0)
    columns = []
    for k in range(6):
        unit = np.asarray(inertia_tensor.tensor(np.eye(6)[k]))
        columns.append(acceleration @ unit + np.cross(rate, rate @ unit))
    right = -(change @ axes.T) - np.cross(rate, total @ axes.T)
    return np.stack(columns, -1).reshape(-1, 6), right.ravel()


class State(NamedTuple):
    """The filter's state: attitude (4,), rate (3,), total wheel momentum (wheels,), constants.

    Constants are J (6), K (3) and the rate bias (3).
    """

    attitude: Array
    rate: Array
    momentum: Array
    constants: Array


class Rows(NamedTuple):
    """One slew as the filter reads it; `fixed` says which rows hold a fix."""

    step: Array
    torque: Array
    rate: Array
    momentum: Array
    attitude: Array
    fixed: Array


class Hardware(NamedTuple):
    """Axes, spin inertias and noise (variances)."""

    axes: Array
    spin: Array
    sensor: Array
    rate: Array
    tachometer: Array
    tracker: Array


def kalman_filter(campaign: Campaign) -> tuple[np.ndarray, np.ndarray]:
    """J and K from one pass of an extended Kalman filter over all slews.

    J, K and bias go on from slew to slew; attitude, rate and momentum start anew.

    `campaign`: with commands, tachometers and a star tracker whose boresight is a body axis.
    Returns `estimate, sd`: J and K.
    """
    sensor, prior = campaign.rate_sensor, campaign.inertia
    mean = np.concatenate([prior.elements, sensor.scale_factor, sensor.bias])
    sd = np.concatenate([prior.sd, sensor.scale_factor_sigma, sensor.bias_sigma])
    constants, covariance = jnp.asarray(mean), jnp.diag(jnp.asarray(sd) ** 2)
    hardware = _hardware(campaign)
    for slew in campaign.slews:
        constants, covariance = _filtered(constants, covariance, _rows(slew), hardware)
    return np.asarray(constants[:9]), np.sqrt(np.diag(np.asarray(covariance)))[:9]


def _hardware(campaign: Campaign) -> Hardware:
    tracker, sensor = campaign.star_tracker, campaign.rate_sensor
    if tracker is None:
        raise ValueError("the filter needs a star tracker")
    along = np.abs(np.asarray(tracker.boresight_B)) > 0.5
    numbers = (
        campaign.wheel_axes_B,
        campaign.spin_inertias,
        sensor.axes,
        np.asarray(sensor.sigma) ** 2,
        np.array([wheel.momentum_sigma for wheel in campaign.wheels], dtype=float) ** 2,
        np.where(along, tracker.sigma_roll, tracker.sigma_cross) ** 2,
    )
    return Hardware(*map(jnp.asarray, numbers))


def _rows(slew: Slew) -> Rows:
    attitude = np.asarray(slew.attitude)
    fixed = np.isfinite(attitude).all(axis=1)
    filled = np.where(fixed[:, None], attitude, [0.0, 0.0, 0.0, 1.0])
    step = np.append(np.diff(slew.time), 0.0)
    numbers = (step, slew.wheel_torque, slew.rate, slew.wheel_momentum, filled, fixed)
    return Rows(*map(jnp.asarray, numbers))


def _moved(state: State, error: Array) -> State:
    """The state with a small error added; attitude's is a rotation in body axes."""
    n = len(state.momentum)
    return State(
        quaternion.multiply(state.attitude, quaternion.exp(error[:3])),
        state.rate + error[3:6],
        state.momentum + error[6 : 6 + n],
        state.constants + error[6 + n :],
    )


def _difference(state: State, other: State) -> Array:
    """The error that leads from a state to another."""
    turn = quaternion.error(state.attitude, other.attitude)
    rest = (b - a for a, b in zip(state[1:], other[1:], strict=True))
    return jnp.concatenate([turn, *rest])


def _flown(state: State, torque: Array, step: Array, hardware: Hardware) -> State:
    """One step of Runge-Kutta, commands held."""
    J = inertia_tensor.tensor(state.constants[:6])

    def slope(attitude: Array, rate: Array, momentum: Array) -> tuple[Array, Array, Array]:
        total = J @ rate + hardware.axes @ momentum
        acceleration = jnp.linalg.solve(J, -jnp.cross(rate, total) - hardware.axes @ torque)
        turning = 0.5 * quaternion.multiply(attitude, jnp.append(rate, 0.0))
        return turning, acceleration, torque

    start = (state.attitude, state.rate, state.momentum)
    at = start
    sums = [jnp.zeros_like(part) for part in start]
    for share, weight in ((0.5, 1.0), (0.5, 2.0), (1.0, 2.0), (0.0, 1.0)):
        slopes = slope(*at)
        sums = [total + weight * k for total, k in zip(sums, slopes, strict=True)]
        at = tuple(x + share * step * k for x, k in zip(start, slopes, strict=True))
    attitude, rate, momentum = (
        x + step / 6.0 * total for x, total in zip(start, sums, strict=True)
    )
    return State(attitude / jnp.linalg.norm(attitude), rate, momentum, state.constants)


def _read(state: State, hardware: Hardware) -> Array:
    """What rate sensor and tachometers read."""
    K, bias = state.constants[6:9], state.constants[9:12]
    rate = (hardware.sensor @ state.rate + bias) / K
    return jnp.concatenate([rate, state.momentum - hardware.spin * (hardware.axes.T @ state.rate)])


@jax.jit
def _filtered(
    constants: Array, covariance: Array, rows: Rows, hardware: Hardware
) -> tuple[Array, Array]:
    """The constants and their covariance after one slew."""
    n = rows.momentum.shape[1]
    start_sd = jnp.repeat(jnp.array(_START_SD), jnp.array([3, 3, n]), total_repeat_length=6 + n)
    momentum = rows.momentum[0] + hardware.spin * (hardware.axes.T @ rows.rate[0])
    state = State(rows.attitude[0], rows.rate[0], momentum, constants)
    P = jax.scipy.linalg.block_diag(jnp.diag(start_sd**2), covariance)

    def one_row(carried: tuple[State, Array], row: Rows) -> tuple[tuple[State, Array], None]:
        state, P = _updated(*carried, row, hardware)
        fly = partial(_flown, torque=row.torque, step=row.step, hardware=hardware)
        flown = fly(state)
        zero = jnp.zeros(len(P))
        F = jax.jacfwd(lambda error: _difference(flown, fly(_moved(state, error))))(zero)
        return (flown, F @ P @ F.T), None

    (state, P), _ = jax.lax.scan(one_row, (state, P), rows)
    return state.constants, P[6 + n :, 6 + n :]


def _updated(state: State, P: Array, row: Rows, hardware: Hardware) -> tuple[State, Array]:
    """State and covariance with the readings of one row (Joseph's form)."""
    zero = jnp.zeros(len(P))

    def misfit(error: Array) -> Array:
        moved = _moved(state, error)
        readings = jnp.concatenate([row.rate, row.momentum]) - _read(moved, hardware)
        fix = quaternion.error(moved.attitude, row.attitude)
        return jnp.concatenate([readings, jnp.where(row.fixed, fix, 0.0)])

    variance = jnp.concatenate([hardware.rate, hardware.tachometer, hardware.tracker])
    H = -jax.jacfwd(misfit)(zero)
    S = H @ P @ H.T + jnp.diag(variance)
    gain = jnp.linalg.solve(S, H @ P).T
    left = jnp.eye(len(P)) - gain @ H
    return _moved(state, gain @ misfit(zero)), left @ P @ left.T + (gain * variance) @ gain.T
