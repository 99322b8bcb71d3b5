"""The contract of a channel: one sensor's stream, from the simulated motion to whitened residuals.

Models go over a tuple of instances and name none. What a channel holds is hashable and decides
compiled code; its numbers (axes, noise) come with the arrays. Methods are written for ONE slew, or
for arrays with leading axes where `...` says so.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.sensors.sensor_stream import SensorStream
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.maths import quaternion
from bayes_inertia.maths.values import AnyArray
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.parameters import Normal, Parameter, scalar
from bayes_inertia.physics.slew_context import SlewContext, Trajectory
from bayes_inertia.physics.slew_input import Drive, SlewInput


class Readings(NamedTuple):
    """One channel's n readings of one slew (leading axis: slews, when stacked).

    Parameters
    ----------
    values : (n, columns) array
    valid : (n, components) array of bool
        Which numbers count; components are those of a residual.
    row : (n,) array of int
        Row of the slew's telemetry.
    """

    # Of numpy on the host, of JAX in compiled code.
    values: AnyArray
    valid: AnyArray
    row: AnyArray


class SensorAtFit(NamedTuple):
    """A sensor at a fit, all slews together: what changes of its readings depend on."""

    campaign: Campaign
    theta: np.ndarray
    readings: Readings
    factors: np.ndarray


@dataclass(frozen=True)
class Channel(ABC):
    """One sensor's stream of readings, compared with the model.

    Parameters
    ----------
    stream : SensorStream
        What the campaign knows of it.
    compared : bool
        Whether residuals are taken; tachometers that drive the model are an input.
    parameters : (int, int)
        Where its parameters begin and end in theta.
    mounting : bool
        Whether the last three are a rotation of the sensor from where it is said to sit.
    device : str
        What effects call the sensor.
    """

    stream: SensorStream
    compared: bool = True
    parameters: tuple[int, int] = (0, 0)
    mounting: bool = False
    device: str = ""

    # Hook of `Effect` by which effects reach the readings.
    hook: ClassVar[str]
    # Names of the columns of readings and of the components of residuals in a posterior.
    columns: ClassVar[str]
    components: ClassVar[str]
    # Whether readings in every row follow the attitude, which is then worked out at every row.
    sees_attitude: ClassVar[bool] = False
    # Whether readings tell the angle turned.
    tells_angle: ClassVar[bool] = False
    # What stands for a reading in padding.
    blank: ClassVar[tuple[float, ...]] = (0.0,)

    @property
    def name(self) -> str:
        """Of the channel."""
        return self.stream.name

    @property
    def axes(self) -> tuple[str, str, str]:
        """Names of the axes of readings in a posterior."""
        fix = "fix" if self.stream.field else f"{self.name}_fix"
        return ("slew", "row" if self.stream.is_series else fix, self.columns)

    @property
    def residual_axes(self) -> tuple[str, str, str]:
        """Names of the axes of residuals in a posterior."""
        return (*self.axes[:2], self.components)

    @abstractmethod
    def readings(self, campaign: Campaign, slew: Slew) -> Readings:
        """What was measured, of numpy."""

    def start(self, campaign: Campaign, slew: Slew) -> dict[str, np.ndarray]:
        """Fields of `Start` that the first readings tell roughly."""
        return {}

    def own_parameters(self, campaign: Campaign) -> tuple[Parameter, ...]:
        """What is estimated of the sensor itself, beside K of the rate sensor."""
        return ()

    def every_parameter(self, campaign: Campaign) -> tuple[Parameter, ...]:
        """Its own, then the rotation of its mounting [rad]."""
        own = self.own_parameters(campaign)
        if not self.mounting:
            return own
        prior = Normal(0.0, self.stream.hardware(campaign).mounting_sigma)
        turns = tuple(scalar(f"mounting_{axis}", unit="rad", prior=prior) for axis in "xyz")
        return (*own, *turns)

    def seen(
        self, theta: Array, constants: Any, bias: Array, slew: SlewInput, trajectory: Trajectory
    ) -> Array:
        """As `sensed`, of a sensor that may be turned: the body's motion as if it were turned."""
        if self.mounting:
            turn = quaternion.exp(theta[slice(*self.parameters)][-3:])
            attitude = quaternion.multiply(trajectory.attitude, turn)
            rate_B = quaternion.to_body(turn, trajectory.rate_B)
            trajectory = trajectory._replace(attitude=attitude, rate_B=rate_B)
        return self.sensed(constants, bias, slew, trajectory)

    def of_campaign(self, campaign: Campaign) -> Channel:
        """The channel with what decides compiled code of this campaign's sensor."""
        return self

    def is_read(self, campaign: Campaign) -> bool:
        """Whether there are readings to compare."""
        read = (self.readings(campaign, slew).valid.any() for slew in campaign.slews)
        return self.compared and any(read)

    def constants(self, campaign: Campaign) -> Any:
        """Numbers of the sensor that its prediction needs: a pytree, empty by default."""
        return ()

    @abstractmethod
    def sensed(self, constants: Any, bias: Array, slew: SlewInput, trajectory: Trajectory) -> Array:
        """What a perfect sensor would give along a trajectory (n, columns)."""

    def with_effect(
        self,
        effect: Effect,
        p: Any,
        constants: Any,
        slew: SlewContext,
        trajectory: Trajectory,
        values: Array,
    ) -> Array:
        """`values` as an effect leaves them: one of this sensor, or of the first of its kind."""
        if effect.device != self.device and (effect.device or not self.stream.field):
            return values
        slew = self.context(constants, slew)
        return getattr(effect, self.hook)(p, slew, trajectory, values)

    def context(self, constants: Any, slew: SlewContext) -> SlewContext:
        """What an effect of this sensor knows of the slew."""
        return slew

    def read(self, parameters: Array, values: Array) -> Array:
        """What the sensor reports of `values`, by its own `parameters`."""
        return values

    def gap(self, measured: Array, predicted: Array) -> Array:
        """Measured minus predicted (..., n, components)."""
        return measured - predicted

    def moved(self, values: AnyArray, change: AnyArray) -> AnyArray:
        """Readings (..., n, columns) changed by (..., n, components), the inverse of `gap`."""
        return values + change

    def known(self, readings: Readings) -> np.ndarray:
        """Values (..., n, columns) with NaN where nothing was measured."""
        values, valid = np.asarray(readings.values), np.asarray(readings.valid)
        # Of other components than columns, a reading is whole or missing.
        valid = valid if valid.shape == values.shape else valid[..., :1]
        return np.where(valid, values, np.nan)

    def column_sigma(self, campaign: Campaign) -> np.ndarray:
        """Size of the noise in each column of readings (columns,), infinite if it is not stated."""
        return np.array([sigma or np.inf for sigma in self.stream.sigma(campaign)])

    @abstractmethod
    def noise(self, campaign: Campaign, theta: np.ndarray, drive: Drive) -> np.ndarray:
        """Stated noise of one reading, in the form that the methods below take."""

    def variance(self, noise: np.ndarray) -> np.ndarray:
        """Variance (components,) of a number when those beside it are known."""
        raise NotImplementedError(f"noise of {self.name} that is correlated in time")

    @abstractmethod
    def factors(self, noise: np.ndarray, valid: np.ndarray) -> np.ndarray:
        """What whitens a gap, for each reading; zero where nothing was measured."""

    @abstractmethod
    def drawn(self, noise: np.ndarray, unit: np.ndarray) -> np.ndarray:
        """Noise from standard normal numbers (..., n, components)."""

    def whitened(self, factors: Array, gap: Array) -> Array:
        """Gaps (..., n, components) in sigmas."""
        return jnp.einsum("...ij,...j->...i", factors, gap)

    def whitened_columns(self, factors: np.ndarray, error: np.ndarray) -> np.ndarray:
        """Errors of readings (..., n, components, k) in sigmas."""
        return np.einsum("snij,snjk->snik", factors, error)

    @abstractmethod
    def whitened_motion(self, fit: SensorAtFit, turn: np.ndarray, rate_B: np.ndarray) -> np.ndarray:
        """Changes of predictions in sigmas (..., n, components, k), by changes of the motion.

        `turn` [rad, body axes], `rate_B` [rad/s] (..., n, 3, k).
        """

    def unwhitened(self, factors: np.ndarray, residual: np.ndarray) -> np.ndarray:
        """The inverse of `whitened`, zero where nothing was measured."""
        empty = np.diagonal(factors, axis1=-2, axis2=-1) == 0.0
        filled = factors + np.where(empty[..., None], np.eye(empty.shape[-1]), 0.0)
        inverse = np.linalg.inv(filled) * ~empty[..., None]
        return np.einsum("srij,srj->sri", inverse, residual)

    def diagonal(self, factors: AnyArray) -> np.ndarray:
        """One over the sigma of each number (..., n, components)."""
        return np.diagonal(factors, axis1=-2, axis2=-1)


class SeparateColumns(Channel):
    """A channel whose columns have noise of their own, as the stream states it."""

    def noise(self, campaign: Campaign, theta: np.ndarray, drive: Drive) -> np.ndarray:
        """Sigma (columns,), infinite where it is not stated."""
        return self.column_sigma(campaign)

    def variance(self, noise: np.ndarray) -> np.ndarray:
        """Column by column."""
        return np.square(noise)

    def factors(self, noise: np.ndarray, valid: np.ndarray) -> np.ndarray:
        """One over sigma (..., columns)."""
        return np.where(valid, 1.0 / noise, 0.0) if self.compared else np.zeros(valid.shape)

    def drawn(self, noise: np.ndarray, unit: np.ndarray) -> np.ndarray:
        """To single precision."""
        sigma = np.where(np.isfinite(noise), noise, np.nan)
        return (sigma * unit).astype(np.float32)

    def whitened(self, factors: Array, gap: Array) -> Array:
        """Column by column."""
        return factors * gap

    def unwhitened(self, factors: np.ndarray, residual: np.ndarray) -> np.ndarray:
        """Column by column."""
        return residual / np.where(factors > 0, factors, 1.0)

    def diagonal(self, factors: AnyArray) -> np.ndarray:
        """The factors themselves."""
        return np.asarray(factors)

    def whitened_columns(self, factors: np.ndarray, error: np.ndarray) -> np.ndarray:
        """Column by column."""
        return factors[..., None] * error
