"""Wheels that do other than they are told: gain, lag, friction and tilted axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects.scales import per_wheel, torque_scale
from bayes_inertia.physics.parameters import Normal, scalar


@dataclass(frozen=True)
class WheelTorqueGain(Effect):
    """Every wheel's motor torque is its command times a factor of its own.

    The causes are the motor constant and the current loop.

    A gain common to all wheels is exactly degenerate with the size of J unless tachometers see
    the wheels' momentum. In the measured drive, where commands are not used, it does nothing.

    Parameters
    ----------
    sigma : float, optional
        Prior sd of the gain; 0.03 is the usual tolerance of a motor constant over temperature.

    Examples
    --------
    >>> WheelTorqueGain().sigma
    0.03
    """

    name: ClassVar[str] = "wheel_torque_gain"
    sigma: float = 0.03

    def parameters(self, campaign):
        return per_wheel(campaign, "gain", unit="", prior=Normal(1.0, self.sigma), null=1.0)

    def delivered_torque(self, p, slew, torque):
        return torque * p["gain"] if p else torque


@dataclass(frozen=True)
class WheelCommandLag(Effect):
    """Motor torque y follows the held command u as tau y' = u - y, the same tau for all wheels.

    The torque handed to the simulator is the exact mean of y over each grid interval, so that
    momentum is exact at every sample. At the first row y equals the first command: telemetry
    that begins in the middle of a long-held command is then right, and so is a slew that begins
    at rest, with a command of zero. In the measured drive, where commands are not used, it does
    nothing.

    Parameters
    ----------
    sigma : float or None, optional
        Prior scale of tau >= 0 [s]; None takes 1/300 of a slew's duration: a lag that matters
        is a visible fraction of the manoeuvre, and a drive loop is much faster than it.

    Examples
    --------
    >>> WheelCommandLag(sigma=0.1).parameters(None)[0].priors[0].lower
    0.0
    """

    name: ClassVar[str] = "wheel_command_lag"
    sigma: float | None = None

    def parameters(self, campaign):
        sigma = self.sigma if self.sigma is not None else campaign.scale_of_motion()[1] / 300.0
        return (scalar("tau", unit="s", prior=Normal(0.0, sigma, lower=0.0)),)

    def delivered_torque(self, p, slew, torque):
        tau = p["tau"]
        # exp(-step/tau) and all its derivatives vanish as tau -> 0.
        # The guarded branch says so without 0 * inf.
        slow = tau > slew.step / 500.0
        decay = jnp.where(slow, jnp.exp(-slew.step / jnp.where(slow, tau, 1.0)), 0.0)
        decay = jnp.where(slew.step > 0.0, decay, 1.0)
        weight = jnp.where(
            slew.step > 0.0, tau / jnp.where(slew.step > 0.0, slew.step, 1.0), 1.0
        ) * (1.0 - decay)

        def interval(y, row):
            u, kept, share = row
            return u + (y - u) * kept, u + (y - u) * share

        return jax.lax.scan(interval, torque[0], (torque, decay, weight))[1]


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

    name: ClassVar[str] = "wheel_friction"
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


@dataclass(frozen=True)
class WheelMisalignment(Effect):
    """Each wheel's spin axis g is tilted by two small angles.

    It becomes g + tilt_1 e1 + tilt_2 e2, normalised.

    e1 is the body axis that makes the largest angle with g, made perpendicular to it; e2 = g x
    e1. A tilt common to all wheels turns the wheels' frame: it is a rotation of the body frame
    that J, rate sensor and star tracker are counted in, and only one of the three can be told
    from the others.

    Parameters
    ----------
    sigma : float, optional
        Prior sd of each angle [rad]; 3e-3 (0.2 deg) is common for wheels that were bolted, not
        surveyed.

    Examples
    --------
    >>> WheelMisalignment().sigma
    0.003
    """

    name: ClassVar[str] = "wheel_misalignment"
    sigma: float = 3e-3

    def parameters(self, campaign):
        prior = Normal(0.0, self.sigma)
        return tuple(
            p for i in (1, 2) for p in per_wheel(campaign, f"tilt_{i}", unit="rad", prior=prior)
        )

    def wheel_axes(self, p, slew, axes_B):
        if not p:
            return axes_B
        nominal = slew.wheel_axes_B
        farthest = jnp.eye(3)[jnp.argmin(jnp.abs(nominal), axis=0)].T
        first = farthest - nominal * jnp.sum(nominal * farthest, axis=0)
        first = first / jnp.linalg.norm(first, axis=0)
        second = jnp.cross(nominal, first, axis=0)
        length = jnp.sqrt(1.0 + p["tilt_1"] ** 2 + p["tilt_2"] ** 2)
        return (axes_B + p["tilt_1"] * first + p["tilt_2"] * second) / length
