"""Thrusters by their levels, 0 to 1 of full thrust."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp

from bayes_inertia.physics.actuators.device import DeviceEffect, gain
from bayes_inertia.physics.parameters import Normal, vector


@dataclass(frozen=True)
class ThrusterTorque(DeviceEffect):
    """The sum of the thrusters' torques; gains of all and of each, and a rotation of all."""

    by: ClassVar[str] = "thrust times arm"

    def parameters(self, campaign):
        device, found = self.device, list(super().parameters(campaign))
        if sd := device.each_gain_sigma:
            names = [str(k + 1) for k in range(device.columns)]
            found.append(vector("each_gain", names, unit="", prior=Normal(1.0, sd), null=1.0))
        if sd := device.direction_sigma:
            found.append(vector("direction", "xyz", unit="rad", prior=Normal(0.0, sd)))
        return tuple(found)

    def body_torque(self, p, slew, t, state):
        level = state.input(self.name) * p.get("each_gain", 1.0)
        torque = gain(p) * (level @ self.device.torque_B)
        return torque + jnp.cross(p["direction"], torque) if "direction" in p else torque
