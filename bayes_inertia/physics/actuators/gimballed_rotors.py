"""Gimballed rotors: momentum that is carried inside, known from the gimbal angles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from bayes_inertia.campaign.actuators import GimballedRotors
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.maths.linear_algebra import fused_product
from bayes_inertia.physics.actuators.device import DeviceEffect
from bayes_inertia.physics.random_basis import independent, slew_fraction
from bayes_inertia.physics.slew_input import Drive
from bayes_inertia.physics.stochastic_effect import StochasticEffect


@dataclass(frozen=True)
class RotorMomentum(DeviceEffect):
    """Each rotor's momentum turns about its gimbal axis; total momentum stays what it was."""

    by = "momentum"

    def stated(self, given, gains=1.0):
        spin_axes = _directions(self.record, given, jnp)[0]
        return fused_product(spin_axes.T, self.record.momentum * gains)

    def carried_momentum(self, p, slew, t, inputs):
        return self.made(p, inputs[self.name])


@dataclass(frozen=True)
class GimbalAngleNoise(StochasticEffect):
    """What of the noise of the gimbal angles, an input, moves the attitude.

    Parameters
    ----------
    record : GimballedRotors
        Whose angles they are, with their noise.
    readings : tuple of int
        How many each slew has.
    shapes : tuple of tuple of int
        Half periods in each slew of the shapes that it has.
    """

    record: GimballedRotors
    readings: tuple[int, ...]
    shapes: tuple[tuple[int, ...], ...]

    @property
    def name(self) -> str:  # type: ignore[override]
        """The device's name, and what it is."""
        return f"{self.record.name} angle noise"

    @property
    def inputs(self) -> tuple[str, ...]:  # type: ignore[override]
        """The gimbal angles."""
        return (self.record.name,)

    def coefficient_count(self, campaign):
        return self.record.columns * min(len(self.shapes[0]), max(self.readings))

    def coefficient_root(self, p, slew, count):
        readings = jnp.asarray(self.readings, float)[slew.index]
        return independent(self.record.angle_sigma / jnp.sqrt(readings), count)

    def carried_momentum(self, p, slew, t, inputs):
        size = p["coefficients"].reshape(self.record.columns, -1)
        mode = jnp.asarray(self.shapes)[slew.index, : size.shape[1]]
        shape = jnp.cos(jnp.pi * mode * slew_fraction(slew, t)) * jnp.where(mode == 0, 1.0, 2**0.5)
        _, turned = _directions(self.record, inputs[self.record.name], jnp)
        return -fused_product(turned.T, self.record.momentum * fused_product(size, shape))


def _directions(device: GimballedRotors, angle: Any, xp: Any) -> tuple[Any, Any]:
    """Spin axes (..., k, 3) at gimbal angles (..., k), and their derivatives by the angles."""
    along = device.spin_axes_at_zero_B
    across = np.cross(device.gimbal_axes_B, along)
    c, s = xp.cos(angle)[..., None], xp.sin(angle)[..., None]
    return c * along + s * across, c * across - s * along


def turning(device: GimballedRotors, angle: np.ndarray) -> np.ndarray:
    """Derivatives (..., k, 3) of the spin axes by the gimbal angles (..., k)."""
    return _directions(device, angle, np)[1]


def carried_momentum(campaign: Campaign, slew: Slew, times: np.ndarray) -> np.ndarray:
    """Momentum (n, 3) that rotors carry at times (n,) on the slew's clock, body axes [N m s]."""
    total = np.zeros((len(times), 3))
    for device in campaign.actuators:
        if isinstance(device, GimballedRotors):
            given = (slew.inputs or {})[device.name]
            angle = np.stack([np.interp(times, given.time, a) for a in given.values.T], axis=-1)
            total += np.einsum("k,nki->ni", device.momentum, _directions(device, angle, np)[0])
    return total


def momentum_noise(campaign: Campaign, drive: Drive) -> np.ndarray:
    """Covariance (3, 3) of the momentum that the noise of one reading makes [(N m s)^2].

    Of gimbal angles, and of tachometers where these drive the model.
    """
    total = np.zeros((3, 3))
    if drive == "measured" and campaign.wheels:
        root = campaign.wheel_axes_B * [w.momentum_sigma or 0.0 for w in campaign.wheels]
        total = total + root @ root.T
    for device in campaign.actuators:
        if isinstance(device, GimballedRotors) and device.angle_sigma:
            angles = [(slew.inputs or {})[device.name].values for slew in campaign.slews]
            turned = turning(device, np.concatenate(angles))
            moved = device.angle_sigma * np.asarray(device.momentum)[:, None] * turned
            total += np.einsum("nki,nkj->ij", moved, moved) / len(moved)
    return total
