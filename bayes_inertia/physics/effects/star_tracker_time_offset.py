"""Star-tracker fixes that are older (or newer) than their time stamps."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from bayes_inertia.campaign.sensors import stream_of_device
from bayes_inertia.maths import quaternion
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.parameters import Normal, scalar


@dataclass(frozen=True)
class StarTrackerTimeOffset(Effect):
    """Fixes stamped t show the attitude at t - tau; negative tau is a lead.

    That is exposure and processing time.

    The body turns back by the integral of its rate over tau. It shows only where fixes are
    taken while the body turns: fixes at rest before and after a slew cannot see it. Beyond the
    telemetry's ends the rate is held.

    Parameters
    ----------
    sigma : float or None, optional
        Prior sd of tau [s]; None takes 1/1000 of a slew's duration (a tenth of a second, a
        tracker's exposure).

    Examples
    --------
    >>> StarTrackerTimeOffset(sigma=0.1).parameters(None)[0].names
    ('tau',)
    """

    name = "star_tracker_time_offset"
    kind = "delay"
    sigma: float | None = None

    def parameters(self, campaign):
        sigma = self.sigma if self.sigma is not None else campaign.scale_of_motion()[1] / 1000.0
        return (scalar("tau", unit="s", prior=Normal(0.0, sigma)),)

    def looks_between_rows(self, campaign):
        stream = stream_of_device(self.device or campaign.names[1], campaign)
        read = (stream.of(slew) for slew in campaign.slews)
        return any(fixes is not None and np.isfinite(fixes).any() for fixes in read)

    def attitude_output(self, p, slew, trajectory, attitude):
        rate, step = trajectory.rate_B, slew.step
        # Angle turned since the first row: the integral of the piecewise linear rate.
        mean = 0.5 * (rate + jnp.concatenate([rate[1:], rate[-1:]]))
        turned = jnp.cumsum(mean * step[:, None], axis=0)
        turned = jnp.concatenate([jnp.zeros((1, 3)), turned[:-1]])
        steps = jnp.sum(step > 0.0)
        times = slew.time - p["tau"]
        before = times < slew.time[0]
        row = jnp.clip(jnp.searchsorted(slew.time, times, side="right") - 1, 0, steps)
        left = jnp.where(before, 0, row)
        ahead = (times - slew.time[left])[:, None]
        inside = (times >= slew.time[0]) & (left < steps)
        slope = (rate[left + 1] - rate[left]) / jnp.where(inside, step[left], 1.0)[:, None]
        acceleration = jnp.where(inside[:, None], slope, 0.0)
        back = turned[left] + ahead * (rate[left] + 0.5 * ahead * acceleration) - turned
        return quaternion.turned(attitude, back)
