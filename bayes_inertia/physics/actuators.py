"""The devices of a campaign beside wheels, and the changes that it dates, as effects.

They are in every model of the campaign: no candidates of a diagnosis, and known but for a gain.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.campaign.actuators import (
    Change,
    GimballedRotors,
    KnownTorque,
    Magnetorquer,
    Thruster,
)
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.maths import quaternion
from bayes_inertia.maths.inertia_tensor import ELEMENTS, tensor
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.numerics import NUMERICS
from bayes_inertia.physics.parameters import Normal, Parameter, scalar, vector
from bayes_inertia.physics.random_basis import independent, slew_fraction
from bayes_inertia.physics.stochastic_effect import StochasticEffect

if TYPE_CHECKING:
    from bayes_inertia.campaign.campaign import Campaign


@dataclass(frozen=True)
class DeviceEffect(Effect):
    """What a device of the campaign does: a vector in body axes, with errors that are in doubt.

    Parameters
    ----------
    record : record of `campaign.actuators`
        What is known of it before a fit.
    """

    record: Any
    by: ClassVar[str] = "torque"  # what of stated size it turns the body by

    @property
    def name(self) -> str:  # type: ignore[override]
        """The device's name."""
        return self.record.name

    @property
    def inputs(self) -> tuple[str, ...]:  # type: ignore[override]
        """The input of the device's name."""
        return (self.record.name,)

    def parameters(self, campaign: Campaign) -> tuple[Parameter, ...]:
        """Gain of all, gain of each and rotation of all, where they are in doubt."""
        found = []
        if sd := self.record.gain_sigma:
            found.append(scalar("gain", unit="", prior=Normal(1.0, sd), null=1.0))
        if sd := getattr(self.record, "each_gain_sigma", 0.0):
            names = [str(k + 1) for k in range(self.record.columns)]
            found.append(vector("each_gain", names, unit="", prior=Normal(1.0, sd), null=1.0))
        if sd := getattr(self.record, "direction_sigma", 0.0):
            found.append(vector("direction", "xyz", unit="rad", prior=Normal(0.0, sd)))
        return tuple(found)

    def stated(self, given: Array, gains: Any = 1.0) -> Array:
        """The vector (3,) that the device makes of its input (k,), with a gain of each (k,)."""
        return given * gains

    def made(self, p: Mapping[str, Array], given: Array) -> Array:
        """The vector (3,) that it makes with its errors."""
        vector_B = p.get("gain", 1.0) * self.stated(given, p.get("each_gain", 1.0))
        return vector_B + jnp.cross(p["direction"], vector_B) if "direction" in p else vector_B


@dataclass(frozen=True)
class ToldTorque(DeviceEffect):
    """The torque of a `KnownTorque`, body or inertial axes."""

    def body_torque(self, p, slew, t, state):
        torque = self.made(p, state.input(self.name))
        in_body = self.record.frame == "body"
        return torque if in_body else quaternion.to_body(state.attitude, torque)


@dataclass(frozen=True)
class TorquerTorque(DeviceEffect):
    """The dipole's cross product with the field in body axes."""

    needs: ClassVar[tuple[str, ...]] = ("magnetic_field_N",)
    by: ClassVar[str] = "dipole times field"

    def stated(self, given, gains=1.0):
        return (given * gains) @ self.record.axes_B

    def body_torque(self, p, slew, t, state):
        dipole = self.made(p, state.input(self.name))
        return jnp.cross(dipole, quaternion.to_body(state.attitude, state.magnetic_field_N))


@dataclass(frozen=True)
class ThrusterTorque(DeviceEffect):
    """The sum of the thrusters' torques by their levels, 0 to 1 of full thrust."""

    by: ClassVar[str] = "thrust times arm"

    def stated(self, given, gains=1.0):
        return (given * gains) @ self.record.torque_B

    def body_torque(self, p, slew, t, state):
        return self.made(p, state.input(self.name))


@dataclass(frozen=True)
class RotorMomentum(DeviceEffect):
    """Each rotor's momentum turns about its gimbal axis; total momentum stays what it was."""

    by: ClassVar[str] = "momentum"

    def stated(self, given, gains=1.0):
        return (self.record.momentum * gains) @ _directions(self.record, given, jnp)[0]

    def carried_momentum(self, p, slew, t, inputs):
        return self.made(p, inputs[self.name])


@dataclass(frozen=True)
class GimbalAngleNoise(StochasticEffect):
    """The slow part of the noise of the gimbal angles, an input: it moves the attitude.

    Parameters
    ----------
    record : GimballedRotors
        Whose angles they are, with their noise.
    readings : int
        How many a slew has.
    """

    record: GimballedRotors
    readings: int

    @property
    def name(self) -> str:  # type: ignore[override]
        """The device's name, and what it is."""
        return f"{self.record.name} angle noise"

    @property
    def inputs(self) -> tuple[str, ...]:  # type: ignore[override]
        """The gimbal angles."""
        return (self.record.name,)

    def coefficient_count(self, campaign):
        return self.record.columns * min(NUMERICS.tachometer_modes, self.readings)

    def coefficient_root(self, p, slew, count):
        return independent(self.record.angle_sigma / np.sqrt(self.readings), count)

    def carried_momentum(self, p, slew, t, inputs):
        size = p["coefficients"].reshape(self.record.columns, -1)
        mode = jnp.arange(size.shape[1])
        shape = jnp.cos(jnp.pi * mode * slew_fraction(slew, t)) * jnp.where(mode == 0, 1.0, 2**0.5)
        _, turned = _directions(self.record, inputs[self.record.name], jnp)
        return -(self.record.momentum * (size @ shape)) @ turned


def _directions(device: GimballedRotors, angle: Any, xp: Any) -> tuple[Any, Any]:
    """Spin axes (..., k, 3) at gimbal angles (..., k), and their derivatives by the angles."""
    along = device.spin_axes_at_zero_B
    across = np.cross(device.gimbal_axes_B, along)
    c, s = xp.cos(angle)[..., None], xp.sin(angle)[..., None]
    return c * along + s * across, c * across - s * along


def turning(device: GimballedRotors, angle: np.ndarray) -> np.ndarray:
    """Derivatives (..., k, 3) of the spin axes by the gimbal angles (..., k)."""
    return _directions(device, angle, np)[1]


def momentum_noise(campaign: Campaign) -> np.ndarray:
    """Covariance (3, 3) of the carried momentum that the noise of one reading makes [(N m s)^2]."""
    total = np.zeros((3, 3))
    for device in campaign.actuators:
        if isinstance(device, GimballedRotors) and device.angle_sigma:
            angles = [(slew.inputs or {})[device.name].values for slew in campaign.slews]
            turned = turning(device, np.concatenate(angles))
            moved = device.angle_sigma * np.asarray(device.momentum)[:, None] * turned
            total += np.einsum("nki,nkj->ij", moved, moved) / len(moved)
    return total


@dataclass(frozen=True)
class StatedChange(Effect):
    """In the slews that start after it the tensor is J + change.

    Parameters
    ----------
    change : Change
        As the campaign states it.
    after : tuple of bool
        Whether each slew of the campaign is one of them.
    """

    change: Change
    after: tuple[bool, ...]

    @property
    def name(self) -> str:  # type: ignore[override]
        """The change's name."""
        return self.change.name

    def parameters(self, campaign):
        sigma = self.change.sigma_fraction * campaign.scale_of_motion()[2]
        return (vector("change", ELEMENTS, unit="kg m^2", prior=Normal(0.0, sigma)),)

    def afterwards(self):
        return replace(self, after=(True,))

    def inertia(self, p, slew, inertia_B):
        changed = jnp.asarray(self.after, dtype=float)[slew.index]
        return inertia_B + changed * tensor(p["change"])


# Which effect a device is.
KINDS: Mapping[type, type[DeviceEffect]] = MappingProxyType(
    {
        KnownTorque: ToldTorque,
        Magnetorquer: TorquerTorque,
        Thruster: ThrusterTorque,
        GimballedRotors: RotorMomentum,
    }
)


def effects_of(campaign: Campaign) -> tuple[Effect, ...]:
    """The effects that a campaign's own devices and changes are, in their order.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> effects_of(small_campaign())
    ()
    """
    devices = (KINDS[type(device)](device) for device in campaign.actuators)
    starts = [slew.start for slew in campaign.slews]
    changes = (StatedChange(x, tuple(s >= x.time for s in starts)) for x in campaign.changes)
    return (*devices, *changes)


def noise_of_inputs(campaign: Campaign) -> tuple[StochasticEffect, ...]:
    """The slow part of the noise that inputs of devices have, integrated out at its stated size."""
    noisy = [d for d in campaign.actuators if isinstance(d, GimballedRotors) and d.angle_sigma]
    counts = [
        int(np.median([len((slew.inputs or {})[d.name].time) for slew in campaign.slews]))
        for d in noisy
    ]
    return tuple(GimbalAngleNoise(d, n) for d, n in zip(noisy, counts, strict=True))


def ties_of_scale(campaign: Campaign) -> list[dict[str, Any]]:
    """What ties the absolute size of J: whatever momentum or torque of stated size turns the body.

    Returns: of each device its name, by what it does so, and the relative prior sd of that, 0 where
    it is taken as exact. Empty where nothing does: only ratios of J are known then.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> ties_of_scale(small_campaign())
    [{'device': 'wheels', 'by': 'momentum', 'relative_sd': 0.0}]
    """
    wheels = [{"device": "wheels", "by": "momentum", "relative_sd": 0.0}]
    return (wheels if campaign.wheels else []) + [
        {"device": e.name, "by": e.by, "relative_sd": e.record.gain_sigma}
        for e in effects_of(campaign)
        if isinstance(e, DeviceEffect)
    ]
