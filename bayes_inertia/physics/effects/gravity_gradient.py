"""The gravity gradient along the orbit."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp

from bayes_inertia.maths import quaternion
from bayes_inertia.maths.linear_algebra import fused_product
from bayes_inertia.physics.effect import SmoothTorque
from bayes_inertia.physics.parameters import Normal, scalar


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

    name = "gravity_gradient"
    needs = ("position_N",)
    sigma: float = 1.0
    mu: float = 3.986004418e14

    def parameters(self, campaign):
        return (scalar("factor", unit="", prior=Normal(0.0, self.sigma)),)

    def body_torque(self, p, slew, t, state):
        position_B = quaternion.to_body(state.attitude, state.position_N)
        square = jnp.sum(position_B**2)
        down = position_B / jnp.sqrt(square)
        J_down = fused_product(state.inertia_B, down)
        return p["factor"] * 3.0 * self.mu / square**1.5 * jnp.cross(down, J_down)
