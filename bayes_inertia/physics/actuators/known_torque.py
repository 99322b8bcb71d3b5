"""A torque that telemetry tells."""

from __future__ import annotations

from dataclasses import dataclass

from bayes_inertia.maths import quaternion
from bayes_inertia.physics.actuators.device import DeviceEffect, gain


@dataclass(frozen=True)
class ToldTorque(DeviceEffect):
    """The torque of a `KnownTorque`, body or inertial axes."""

    def body_torque(self, p, slew, t, state):
        torque = gain(p) * state.input(self.name)
        in_body = self.device.frame == "body"
        return torque if in_body else quaternion.to_body(state.attitude, torque)
