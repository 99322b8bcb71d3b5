"""Gimballed rotors: momentum that is carried inside, known from the gimbal angles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from bayes_inertia.physics.actuators.device import DeviceEffect, gain


@dataclass(frozen=True)
class RotorMomentum(DeviceEffect):
    """Each rotor's momentum turns about its gimbal axis; total momentum stays what it was."""

    by: ClassVar[str] = "momentum"

    def carried_momentum(self, p, slew, inputs):
        angle, device = inputs[self.name], self.device
        across = np.cross(device.gimbal_axes_B, device.spin_axes_at_zero_B)
        directions = (
            jnp.cos(angle)[:, None] * device.spin_axes_at_zero_B + jnp.sin(angle)[:, None] * across
        )
        return gain(p) * (device.momentum @ directions)
