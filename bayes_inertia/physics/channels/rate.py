"""A rate sensor: K w_meas = C_rate w + b, with noise (paper eq 12)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import body_rates
from bayes_inertia.campaign.sensors import streams_of
from bayes_inertia.campaign.sensors.rate import RateStream
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.device_arrays import on_device
from bayes_inertia.physics.actuators.gimballed_rotors import momentum_noise
from bayes_inertia.physics.channels.channel import Channel, Readings, SensorAtFit
from bayes_inertia.physics.parameters import Normal, Parameter, scalar
from bayes_inertia.physics.slew_context import SlewContext, Trajectory
from bayes_inertia.physics.slew_input import Drive, SlewInput


class RateConstants(NamedTuple):
    """Constants of a rate sensor.

    Parameters
    ----------
    axes : (n, 3) array
        C_rate, one row a sensor axis.
    bias : (n,) array
        Prior mean of the bias [rad/s].
    """

    axes: Array
    bias: Array


@dataclass(frozen=True)
class RateChannel(Channel):
    """Angular rates [rad/s]; its parameters are the scale factors K."""

    hook = "rate_output"
    columns = components = "sensor_axis"

    @property
    def axes(self) -> tuple[str, str, str]:
        """A further rate sensor may have another number of axes."""
        own = self.columns if self.stream.field else f"{self.name}_axis"
        return (*super().axes[:2], own)

    @property
    def residual_axes(self) -> tuple[str, str, str]:
        """One residual a reading."""
        return self.axes

    def readings(self, campaign: Campaign, slew: Slew) -> Readings:
        """Those inside the sensor's range."""
        rows, known = np.arange(len(slew.time)), self.stream.of(slew)
        if known is None:
            shape = len(rows), len(self.constants(campaign).axes)
            return Readings(np.zeros(shape), np.zeros(shape, bool), rows)
        valid = self.stream.valid(campaign, slew)
        return Readings(np.where(valid, known, 0.0), valid, rows)

    def start(self, campaign: Campaign, slew: Slew) -> dict[str, np.ndarray]:
        """The body rate by the first readings."""
        if not self.stream.field:
            return {}
        seen = campaign.with_body_rates
        sensor, slew = seen.gyro, next(s for s in seen.slews if s.name == slew.name)
        _, readings = slew.complete_rates(seen.valid_readings(slew))
        some = readings[: max(1, min(8, len(readings) // 50))]
        first = some.mean(axis=0) if len(some) else np.zeros(3)
        return {"rate_B": body_rates(sensor, first, sensor.scale_factor)}

    def constants(self, campaign: Campaign) -> RateConstants:
        """Axes and prior bias; a further sensor's bias is a parameter."""
        sensor = self.stream.hardware(campaign)
        if sensor is None:
            return RateConstants(on_device(np.eye(3)), on_device(np.zeros(3)))
        bias = sensor.bias if self.stream.field else np.zeros(len(sensor.axes))
        return RateConstants(on_device(sensor.axes), on_device(bias))

    def own_parameters(self, campaign: Campaign) -> tuple[Parameter, ...]:
        """K and bias of a further sensor."""
        if self.stream.field:
            return ()
        sensor = self.stream.hardware(campaign)
        kinds = (
            ("K", "", sensor.scale_factor, sensor.scale_factor_sigma, 1.0),
            ("bias", "rad/s", sensor.bias, sensor.bias_sigma, 0.0),
        )
        return tuple(
            scalar(f"{name}{i + 1}", unit=unit, prior=Normal(mean[i], sd[i]), null=null)
            for name, unit, mean, sd, null in kinds
            for i in range(len(sensor.axes))
        )

    def sensed(self, constants: Any, bias: Array, slew: SlewInput, trajectory: Trajectory) -> Array:
        """Rates about the sensor's axes, with its bias."""
        has_bias = self.stream.field and len(bias)
        bias_S = constants.bias + bias if has_bias else constants.bias
        C = constants.axes
        rate_B = trajectory.rate_B
        return jnp.stack(
            [sum(C[i, j] * rate_B[:, j] for j in range(3)) + bias_S[i] for i in range(len(C))], -1
        )

    def context(self, constants: Any, slew: SlewContext) -> SlewContext:
        """With the axes of this sensor."""
        return slew if self.stream.field else slew._replace(rate_axes=constants.axes)

    def read(self, parameters: Array, values: Array) -> Array:
        """Divided by the scale factors."""
        n = values.shape[-1]
        if not len(parameters):
            return values
        K, bias = parameters[:n], parameters[n : 2 * n]
        return (values if self.stream.field else values + bias) / K

    def noise(self, campaign: Campaign, theta: np.ndarray, drive: Drive) -> np.ndarray:
        """Covariance (n, n) of one reading [rad^2/s^2].

        In the measured drive tachometer noise is an input, as is that of gimbal angles: it shakes
        the predicted rate by J^-1 G dh. (The part of it that accumulates in the attitude is among
        the nuisances.) Several gyros are shaken alike, and channels count as independent: each is
        given more of it, so that all together do not average it away.
        """
        sensor = self.stream.hardware(campaign)
        if sensor is None:
            return np.eye(3)
        momentum = momentum_noise(campaign, drive)
        covariance = np.diag(np.square(sensor.sigma))
        if not momentum.any():
            return covariance
        shake = self.shake(campaign, theta, np.eye(3))
        return covariance + shake @ momentum @ shake.T / self.share(campaign)

    def share(self, campaign: Campaign) -> float:
        """Share of this gyro in what all gyros tell by their white noise; 1 of a single one.

        Shaken by one common noise, gyros may be taken as independent where each has that noise's
        covariance over its share: the shares sum to one, and no combination then has a variance
        below its true one (covariance intersection: Julier and Uhlmann 1997).
        """
        gyros = (stream for stream in streams_of(campaign) if isinstance(stream, RateStream))
        told = {stream.name: _told(campaign, stream) for stream in gyros}
        return told[self.name] / sum(told.values()) if told[self.name] else 1.0

    def shake(self, campaign: Campaign, theta: np.ndarray, axes_B: np.ndarray) -> np.ndarray:
        """Readings (n, k) by momentum along axes (3, k) in the body."""
        axes = self.stream.hardware(campaign).axes
        rates_B = np.linalg.solve(_locked_inertia(campaign, theta), axes_B)
        return axes @ rates_B / np.asarray(theta[slice(*self.parameters)])[: len(axes), None]

    def variance(self, noise: np.ndarray) -> np.ndarray:
        """Whitened readings have one over these as sigmas."""
        return 1.0 / np.diagonal(np.linalg.inv(noise))

    def factors(self, noise: np.ndarray, valid: np.ndarray) -> np.ndarray:
        """Inverse Cholesky factor of the valid part of each reading's covariance (..., n, n)."""
        n = len(noise)
        factors = np.zeros((*valid.shape, n))
        for pattern in np.unique(valid.reshape(-1, n), axis=0):
            keep = np.flatnonzero(pattern)
            factor = np.zeros((n, n))
            if len(keep):
                block = noise[np.ix_(keep, keep)]
                factor[np.ix_(keep, keep)] = np.linalg.inv(np.linalg.cholesky(block))
            factors[(valid == pattern).all(axis=-1)] = factor
        return factors

    def drawn(self, noise: np.ndarray, unit: np.ndarray) -> np.ndarray:
        """Correlated between the axes as the covariance says; to single precision."""
        return (unit @ np.linalg.cholesky(noise).T).astype(np.float32)

    def whitened(self, factors: Array, gap: Array) -> Array:
        """The factors are triangular."""
        axes = range(gap.shape[-1])
        return jnp.stack(
            [sum(factors[..., i, j] * gap[..., j] for j in range(i + 1)) for i in axes], -1
        )

    def whitened_motion(self, fit: SensorAtFit, turn: np.ndarray, rate_B: np.ndarray) -> np.ndarray:
        """Along the sensor's axes, over the scale factors."""
        axes = np.asarray(self.constants(fit.campaign).axes)
        K = fit.theta[slice(*self.parameters)][: len(axes)]
        scale_factors = K[:, None] if len(K) else 1.0
        sensed = np.einsum("ij,snjk->snik", axes, rate_B) / scale_factors
        return self.whitened_columns(fit.factors, sensed)


def _told(campaign: Campaign, gyro: RateStream) -> float:
    """Sum over all readings of a gyro of one over their white noise's variance [s^2/rad^2]."""
    read = [gyro.valid(campaign, s).sum(0) for s in campaign.slews if gyro.of(s) is not None]
    return float(np.sum(read / np.square(gyro.hardware(campaign).sigma))) if read else 0.0


def _locked_inertia(campaign: Campaign, theta: np.ndarray) -> np.ndarray:
    """J (3, 3) with the wheels' spin inertia."""
    J = inertia_tensor.tensor(theta[:6])
    if campaign.inertia.includes_wheel_spin:
        return J
    axes, spin = on_device(campaign.wheel_axes_B), on_device(campaign.spin_inertias)
    return np.asarray(inertia_tensor.with_wheel_spin(J, axes, spin))
