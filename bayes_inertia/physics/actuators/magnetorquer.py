"""Magnetorquers in the telemetered field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp

from bayes_inertia.maths import quaternion
from bayes_inertia.physics.actuators.device import DeviceEffect, gain


@dataclass(frozen=True)
class TorquerTorque(DeviceEffect):
    """The dipole's cross product with the field in body axes."""

    needs: ClassVar[tuple[str, ...]] = ("magnetic_field_N",)
    by: ClassVar[str] = "dipole times field"

    def body_torque(self, p, slew, t, state):
        dipole = gain(p) * (state.input(self.name) @ self.device.axes_B)
        return jnp.cross(dipole, quaternion.to_body(state.attitude, state.magnetic_field_N))
