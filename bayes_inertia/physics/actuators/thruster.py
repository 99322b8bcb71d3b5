"""Thrusters by their levels, 0 to 1 of full thrust."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from bayes_inertia.physics.actuators.device import DeviceEffect, gain
from bayes_inertia.physics.parameters import Normal, vector


@dataclass(frozen=True)
class ThrusterTorque(DeviceEffect):
    """The sum of the thrusters' torques; gains of all together, and of each."""

    by: ClassVar[str] = "thrust times arm"

    def parameters(self, campaign):
        sd = self.device.each_gain_sigma
        if not sd:
            return super().parameters(campaign)
        names = [str(k + 1) for k in range(self.device.columns)]
        each = vector("each_gain", names, unit="", prior=Normal(1.0, sd), null=1.0)
        return (*super().parameters(campaign), each)

    def body_torque(self, p, slew, t, state):
        level = state.input(self.name) * p.get("each_gain", 1.0)
        return gain(p) * (level @ self.device.torque_B)
