"""A vector known in inertial axes and seen in body axes: by a Sun sensor or a magnetometer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.campaign.body_rates import (
    attitudes_seen,
    first_attitude_by_rates,
    reference_of,
)
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.maths import quaternion
from bayes_inertia.maths.device_arrays import on_device
from bayes_inertia.maths.values import AnyArray
from bayes_inertia.physics.channels.channel import Readings, SensorAtFit, SeparateColumns
from bayes_inertia.physics.parameters import Normal, Parameter, scalar
from bayes_inertia.physics.slew_context import Trajectory
from bayes_inertia.physics.slew_input import Drive, SlewInput


class DirectionConstants(NamedTuple):
    """What a direction sensor looks at, slew by slew.

    Parameters
    ----------
    time : (slews, m) array
        From the first row of each slew [s], ascending.
    reference_N : (slews, m, 3) array
        Unit vector, or field [T].
    """

    time: Array
    reference_N: Array


@dataclass(frozen=True)
class DirectionChannel(SeparateColumns):
    """Residuals are angles in the tangent plane of a direction [rad], or components of a field [T].

    Parameters
    ----------
    is_field : bool
    errors : tuple of str
        Which of a magnetometer's own errors are estimated.
    """

    is_field: bool = False
    errors: tuple[str, ...] = ()

    hook = "direction_output"
    columns = "body_axis"
    components = "component"
    sees_attitude = True
    tells_angle = True

    @property
    def residual_axes(self) -> tuple[str, str, str]:
        """Two components of a direction, three of a field."""
        return (*self.axes[:2], f"{self.name}_component")

    def of_campaign(self, campaign: Campaign) -> DirectionChannel:
        """The channel of this sensor: what decides compiled code."""
        sensor = self.stream.hardware(campaign)
        errors = tuple(e for e in _ERRORS if getattr(sensor, f"{e}_sigma") > 0.0)
        return replace(self, is_field=sensor.is_field, errors=errors)

    def readings(self, campaign: Campaign, slew: Slew) -> Readings:
        """Whole vectors whose reference is known; directions at length one."""
        rows, known = np.arange(len(slew.time)), self.stream.of(slew)
        components = 3 if self.is_field else 2
        if known is None:
            return Readings(np.zeros((len(rows), 3)), np.zeros((len(rows), components), bool), rows)
        length = np.linalg.norm(known, axis=1)
        whole = np.isfinite(length) & (length > 0.0)
        scale = 1.0 if self.is_field else np.where(whole, length, 1.0)[:, None]
        values = np.where(whole[:, None], known / scale, 0.0)
        return Readings(values, np.repeat(whole[:, None], components, axis=1), rows)

    def start(self, campaign: Campaign, slew: Slew) -> dict[str, np.ndarray]:
        """The attitude at the first row with two directions, or by one that the rates carry."""
        rows, attitude, _ = attitudes_seen(campaign, slew)
        first = attitude[0] if len(rows) else first_attitude_by_rates(campaign, slew)
        return {} if first is None else {"attitude": first}

    def own_parameters(self, campaign: Campaign) -> tuple[Parameter, ...]:
        """Offset, scale and soft iron of a magnetometer, as far as their sds are stated."""
        sensor = self.stream.hardware(campaign)
        found = []
        for error in self.errors:
            (unit, axes), prior = _ERRORS[error], Normal(0.0, getattr(sensor, f"{error}_sigma"))
            found += [scalar(f"{error}_{axis}", unit=unit, prior=prior) for axis in axes]
        return tuple(found)

    def constants(self, campaign: Campaign) -> DirectionConstants:
        """References of all slews, the last one of each repeated to one length."""
        sensor = self.stream.hardware(campaign)
        known = [reference_of(self.name, sensor, slew) for slew in campaign.slews]
        n = max(len(time) for time, _ in known)
        times, references = [], []
        for time, reference_N in known:
            more = n - len(time)
            times.append(np.concatenate([time, time[-1] + 1.0 + np.arange(more)]))
            references.append(np.concatenate([reference_N, np.repeat(reference_N[-1:], more, 0)]))
        return DirectionConstants(on_device(np.stack(times)), on_device(np.stack(references)))

    def sensed(self, constants: Any, bias: Array, slew: SlewInput, trajectory: Trajectory) -> Array:
        """The reference, seen from the body."""
        index, time = slew.context.index, slew.context.time
        reference_N = constants.reference_N[index]
        there = [jnp.interp(time, constants.time[index], reference_N[:, i]) for i in range(3)]
        return quaternion.to_body(trajectory.attitude, jnp.stack(there, axis=-1))

    def read(self, parameters: Array, values: Array) -> Array:
        """A magnetometer's own errors."""
        known = {e: parameters[3 * i : 3 * i + 3] for i, e in enumerate(self.errors)}
        read = values
        if "scale" in known:
            read = read + known["scale"] * values
        if "soft_iron" in known:
            xy, xz, yz = known["soft_iron"]
            zero = jnp.zeros(())
            S = jnp.array([[zero, xy, xz], [xy, zero, yz], [xz, yz, zero]])
            read = read + values @ S
        return read + known["offset"] if "offset" in known else read

    def gap(self, measured: Array, predicted: Array) -> Array:
        """Measured minus predicted: components of a field, or angles across a direction."""
        if self.is_field:
            return measured - predicted
        return _angles(measured, predicted)

    def moved(self, values: AnyArray, change: AnyArray) -> AnyArray:
        """Fields with something added, or directions turned by small angles."""
        if self.is_field:
            return values + change
        return np.asarray(_turned(jnp.asarray(values), jnp.asarray(change)))

    def noise(self, campaign: Campaign, theta: np.ndarray, drive: Drive) -> np.ndarray:
        """Sigma (components,)."""
        return self.column_sigma(campaign)[: 3 if self.is_field else 2]

    def whitened_motion(self, fit: SensorAtFit, turn: np.ndarray, rate_B: np.ndarray) -> np.ndarray:
        """A vector at rest moves in a body that turns, by its cross product with the turn."""
        seen = np.asarray(fit.readings.values)
        change = np.cross(seen[..., None], turn, axis=2)
        if not self.is_field:
            change = np.einsum("snic,snik->snck", np.asarray(_across(jnp.asarray(seen))), change)
        return self.whitened_columns(fit.factors, change)


# Own errors of a magnetometer: unit and components.
_ERRORS = {
    "offset": ("T", ("x", "y", "z")),
    "scale": ("", ("x", "y", "z")),
    "soft_iron": ("", ("xy", "xz", "yz")),
}


@jax.jit
def _across(directions: Array) -> Array:
    """Two unit vectors (..., 3, 2) across each direction (..., 3)."""
    smallest = jnp.argmin(jnp.abs(directions), axis=-1)
    first = jnp.cross(directions, jax.nn.one_hot(smallest, 3, dtype=directions.dtype))
    first = first / jnp.maximum(jnp.linalg.norm(first, axis=-1, keepdims=True), 1e-12)
    return jnp.stack([first, jnp.cross(directions, first)], axis=-1)


@jax.jit
def _angles(measured: Array, predicted: Array) -> Array:
    """Angles (..., 2) from predicted to measured directions [rad], across the predicted ones."""
    along = jnp.sum(measured * predicted, axis=-1, keepdims=True)
    across = jnp.einsum("...ic,...i->...c", _across(predicted), measured)
    sine = jnp.sqrt(jnp.sum(across**2, axis=-1, keepdims=True) + 1e-30)
    return across * jnp.arctan2(sine, along) / sine


@jax.jit
def _turned(directions: Array, angles: Array) -> Array:
    """Directions (..., 3) turned by angles (..., 2) across them [rad]."""
    size = jnp.sqrt(jnp.sum(angles**2, axis=-1, keepdims=True) + 1e-30)
    step = jnp.einsum("...ic,...c->...i", _across(directions), angles / size)
    return jnp.cos(size) * directions + jnp.sin(size) * step
