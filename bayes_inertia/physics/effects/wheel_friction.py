"""Bearing friction that the drive electronics do not compensate."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects.scales import per_wheel, torque_scale
from bayes_inertia.physics.parameters import Normal


@dataclass(frozen=True)
class WheelFriction(Effect):
    """Friction on each wheel, Coulomb and viscous.

    The torque is -coulomb tanh(speed / smooth_speed) - viscous speed, with speed = h / Js
    relative to the body.

    It is what remains after the drive's own compensation, which may do too much: both signs are
    allowed. In the measured drive, where wheel torques are not used, it does nothing.

    Parameters
    ----------
    sigma_coulomb : float or None, optional
        Prior sd [N m]; None takes 10 % of J w / T (2e-5 N m for a microsatellite's slew: a few
        per cent of its wheels' torque).
    sigma_viscous : float or None, optional
        Prior sd [N m s]; None takes 10 % of Js / T: wheels that coast down over ten slews.
    smooth_speed : float, optional
        Wheel speed [rad/s] within which the Coulomb torque changes its sign; 1 rad/s is a few
        revolutions a minute, and keeps the crossing long enough for the integrator.

    Examples
    --------
    >>> WheelFriction().smooth_speed
    1.0
    """

    name = "wheel_friction"
    sigma_coulomb: float | None = None
    sigma_viscous: float | None = None
    smooth_speed: float = 1.0

    def parameters(self, campaign):
        if not campaign.wheels:
            return ()
        coulomb, viscous = self.sigma_coulomb, self.sigma_viscous
        if coulomb is None:
            coulomb = 0.1 * torque_scale(campaign)
        if viscous is None:
            viscous = 0.1 * float(np.mean(campaign.spin_inertias)) / campaign.scale_of_motion()[1]
        return (
            *per_wheel(campaign, "coulomb", unit="N m", prior=Normal(0.0, coulomb)),
            *per_wheel(campaign, "viscous", unit="N m s", prior=Normal(0.0, viscous)),
        )

    def wheel_torque(self, p, slew, t, state):
        if not p:
            return jnp.zeros_like(state.wheel_momentum)
        speed = state.wheel_momentum / slew.spin_inertia
        return -p["coulomb"] * jnp.tanh(speed / self.smooth_speed) - p["viscous"] * speed
