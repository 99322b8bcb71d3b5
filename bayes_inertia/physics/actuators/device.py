"""Devices by their input of the same name: torques on the body, and what all devices share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import jax.numpy as jnp
from jax import Array

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.maths import quaternion
from bayes_inertia.maths.linear_algebra import fused_product
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.parameters import Normal, Parameter, scalar, vector


def error_of(record: Any, kind: str, sd: float) -> Parameter:
    """What may be in doubt of a device: the gain of all, the gain of each, the rotation of all."""
    if kind == "gain":
        return scalar("gain", unit="", prior=Normal(1.0, sd), null=1.0)
    if kind == "direction":
        return vector("direction", "xyz", unit="rad", prior=Normal(0.0, sd))
    names = [str(k + 1) for k in range(record.columns)]
    return vector("each_gain", names, unit="", prior=Normal(1.0, sd), null=1.0)


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
        kinds = ("gain", "each_gain", "direction")
        sds = {kind: getattr(self.record, f"{kind}_sigma", 0.0) for kind in kinds}
        return tuple(error_of(self.record, kind, sd) for kind, sd in sds.items() if sd)

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

    needs = ("magnetic_field_N",)
    by = "dipole times field"

    def stated(self, given, gains=1.0):
        return fused_product(self.record.axes_B.T, given * gains)

    def body_torque(self, p, slew, t, state):
        dipole = self.made(p, state.input(self.name))
        return jnp.cross(dipole, quaternion.to_body(state.attitude, state.magnetic_field_N))


@dataclass(frozen=True)
class ThrusterTorque(DeviceEffect):
    """The sum of the thrusters' torques by their levels, 0 to 1 of full thrust."""

    by = "thrust times arm"

    def stated(self, given, gains=1.0):
        return fused_product(self.record.torque_B.T, given * gains)

    def body_torque(self, p, slew, t, state):
        return self.made(p, state.input(self.name))
