"""Torques on the body from outside: constant, by its rate, by the field, by gravity."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from bayes_inertia.maths import quaternion
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects.scales import torque_scale
from bayes_inertia.physics.parameters import Normal, scalar, vector


@dataclass(frozen=True)
class SmoothTorque(Effect):
    """Base of torques that change no faster than the body turns: any step resolves them."""

    def max_step(self, campaign):
        return math.inf


@dataclass(frozen=True)
class ConstantTorque(SmoothTorque):
    """A body-fixed external torque, the same in all slews.

    Outgassing, a leak, or pressure on a fixed face.

    Parameters
    ----------
    sigma : float or None, optional
        Prior sd [N m]; None takes 3 % of J w / T, the torque that would make the observed
        motion: 5e-6 N m for a microsatellite's slew, the size of its environmental torques.

    Examples
    --------
    >>> ConstantTorque(sigma=1e-5).parameters(None)[0].names
    ('torque_x', 'torque_y', 'torque_z')
    """

    name: ClassVar[str] = "constant_torque"
    sigma: float | None = None

    def parameters(self, campaign):
        sigma = self.sigma if self.sigma is not None else 0.03 * torque_scale(campaign)
        return (vector("torque", "xyz", unit="N m", prior=Normal(0.0, sigma)),)

    def body_torque(self, p, slew, t, state):
        return p["torque"]


@dataclass(frozen=True)
class ViscousTorque(SmoothTorque):
    """External torque -drag w, axis by axis: eddy currents, or air on a body thrown in a room.

    A real drag is positive. Negative values are allowed, because a prior that ends at "no
    effect" spoils the comparison with it; a negative result says that something else puts
    energy in.

    Parameters
    ----------
    sigma : float or None, optional
        Prior sd [N m s]; None takes 3 % of J / T: a body that loses 3 % of its rate in one
        slew.

    Examples
    --------
    >>> ViscousTorque(sigma=1e-5).parameters(None)[0].names
    ('drag_x', 'drag_y', 'drag_z')
    """

    name: ClassVar[str] = "viscous_torque"
    sigma: float | None = None

    def parameters(self, campaign):
        sigma = self.sigma
        if sigma is None:
            _, duration, inertia = campaign.scale_of_motion()
            sigma = 0.03 * inertia / duration
        return (vector("drag", "xyz", unit="N m s", prior=Normal(0.0, sigma)),)

    def body_torque(self, p, slew, t, state):
        return -p["drag"] * state.rate_B


@dataclass(frozen=True)
class MagneticDipole(SmoothTorque):
    """A body-fixed dipole m feels the torque m x B, B the telemetered field turned into body axes.

    Parameters
    ----------
    sigma : float or None, optional
        Prior sd of each component [A m^2]; None takes the dipole whose torque in the campaign's
        mean field is 3 % of J w / T: a few tenths of an A m^2 for a microsatellite, two or
        three times the milliampere square metre per kilogram that NASA SP-8018 expects of one
        without magnetic cleanliness.

    Examples
    --------
    >>> MagneticDipole(sigma=0.1).parameters(None)[0].unit
    'A m^2'
    """

    name: ClassVar[str] = "magnetic_dipole"
    needs: ClassVar[tuple[str, ...]] = ("magnetic_field_N",)
    sigma: float | None = None

    def parameters(self, campaign):
        sigma = self.sigma
        if sigma is None:
            fields = [
                np.linalg.norm(s.magnetic_field_N, axis=1)
                for s in campaign.slews
                if s.magnetic_field_N is not None
            ]
            mean = float(np.nanmean(np.concatenate(fields))) if fields else 3e-5
            sigma = 0.03 * torque_scale(campaign) / max(mean, 1e-9)
        return (vector("dipole", "xyz", unit="A m^2", prior=Normal(0.0, sigma)),)

    def body_torque(self, p, slew, t, state):
        return jnp.cross(p["dipole"], quaternion.to_body(state.attitude, state.magnetic_field_N))


@dataclass(frozen=True)
class GravityGradient(SmoothTorque):
    """The gravity-gradient torque of a spherical planet, times a factor.

    The torque is 3 mu / r^5 (r x J_locked r) (Hughes 1986, eq 8.1.18); the factor is 0 without
    it and 1 in full.

    r is the telemetered position from the planet's centre, turned into body axes; J_locked is
    the tensor that is being estimated, as it is in the slew. The factor should come out near 1
    or not differ from 0; anything else means that another torque imitates it.

    Parameters
    ----------
    sigma : float, optional
        Prior sd of the factor, centred on 0.
    mu : float, optional
        Gravitational parameter [m^3/s^2], the Earth's by default.

    Examples
    --------
    >>> GravityGradient().parameters(None)[0].names
    ('factor',)
    """

    name: ClassVar[str] = "gravity_gradient"
    needs: ClassVar[tuple[str, ...]] = ("position_N",)
    sigma: float = 1.0
    mu: float = 3.986004418e14

    def parameters(self, campaign):
        return (scalar("factor", unit="", prior=Normal(0.0, self.sigma)),)

    def body_torque(self, p, slew, t, state):
        position_B = quaternion.to_body(state.attitude, state.position_N)
        square = jnp.sum(position_B**2)
        down = position_B / jnp.sqrt(square)
        return p["factor"] * 3.0 * self.mu / square**1.5 * jnp.cross(down, state.inertia_B @ down)
