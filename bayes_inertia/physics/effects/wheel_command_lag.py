"""Wheel motors that follow their commands with a first-order lag."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.parameters import Normal, scalar


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

    name = "wheel_command_lag"
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
        steps = jnp.where(slew.step > 0.0, tau / jnp.where(slew.step > 0.0, slew.step, 1.0), 1.0)
        weight = steps * (1.0 - decay)

        def interval(y, row):
            u, kept, taken = row
            return u + (y - u) * kept, u + (y - u) * taken

        return jax.lax.scan(interval, torque[0], (torque, decay, weight))[1]
