"""A rate sensor whose readings are older (or newer) than their time stamps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.parameters import Normal, scalar
from bayes_inertia.physics.slew_context import SlewContext


@dataclass(frozen=True)
class RateSensorDelay(Effect):
    """The rate sensor reports what was true tau >= 0 earlier: w(t - tau).

    Held torques make the rate piecewise linear between samples, so that linear interpolation is
    exact up to gyroscopic terms. Only delays: a feedback controller answers the noise of a
    reading with the torque that follows it, so that a reading "predicted" from what came after
    it would agree with its own noise. Before the first row the rate is continued linearly where
    no torque is commanded there (a body in free flight), and held otherwise: the torques before
    it are unknown.

    Parameters
    ----------
    sigma : float or None, optional
        Prior scale of tau [s]; None takes 1/1000 of a slew's duration (a tenth of a second for
        a microsatellite's slew, filters and buses are that slow; half a millisecond for a body
        thrown by hand).

    Examples
    --------
    >>> RateSensorDelay(sigma=0.1).parameters(None)[0].names
    ('tau',)
    """

    name: ClassVar[str] = "rate_sensor_delay"
    sigma: float | None = None

    def parameters(self, campaign):
        sigma = self.sigma if self.sigma is not None else campaign.scale_of_motion()[1] / 1000.0
        return (scalar("tau", unit="s", prior=Normal(0.0, sigma, lower=0.0)),)

    def rate_output(self, p, slew, trajectory, rate_S):
        return _at(slew, rate_S, slew.time - p["tau"])


def _at(slew: SlewContext, rows: Array, times: Array) -> Array:
    """Rows (n, 3) given on the slew's grid, at other times (m,).

    Linear in between and beyond the ends; at a row, the line before it.
    """
    steps = jnp.sum(slew.step > 0.0)  # what follows is padding
    left = jnp.clip(jnp.searchsorted(slew.time, times, side="left") - 1, 0, steps - 1)
    slope = (rows[left + 1] - rows[left]) / slew.step[left][:, None]
    held = (times < slew.time[0])[:, None] & jnp.any(slew.torque[0] != 0.0)
    # From the right end, so that a row at its own time is itself to the last bit.
    back = times - slew.time[left + 1]
    return jnp.where(held, rows[left], rows[left + 1] + slope * back[:, None])
