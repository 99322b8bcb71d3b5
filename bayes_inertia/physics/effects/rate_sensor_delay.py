"""A rate sensor whose readings are older (or newer) than their time stamps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax.numpy as jnp
from jax import Array

from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.parameters import Normal, scalar
from bayes_inertia.physics.slew_context import SlewContext


@dataclass(frozen=True)
class RateSensorDelay(Effect):
    """The rate sensor reports what was true tau >= 0 earlier: w(t - tau).

    Held torques, and devices that are told what to do, make the rate piecewise linear between
    samples, so that linear interpolation is exact up to gyroscopic terms. Without them the motion
    is smooth, and the parabola through the row before too follows it. Only delays: a feedback
    controller answers the noise of a reading with the torque that follows it, so that a reading
    "predicted" from what came after it would agree with its own noise. Before the first row the
    rate is continued linearly where no torque is commanded there (a body in free flight), and held
    otherwise: the torques before it are unknown.

    Parameters
    ----------
    sigma : float or None, optional
        Prior scale of tau [s]; None takes 1/1000 of a slew's duration (a tenth of a second for
        a microsatellite's slew, filters and buses are that slow; half a millisecond for a body
        thrown by hand).
    told : bool, optional
        Whether devices beside wheels act; the campaign says so.

    Examples
    --------
    >>> RateSensorDelay(sigma=0.1).parameters(None)[0].names
    ('tau',)
    """

    name = "rate_sensor_delay"
    kind = "delay"
    sigma: float | None = None
    told: bool = False

    def in_campaign(self, campaign):
        return replace(self, told=bool(campaign.actuators))

    def parameters(self, campaign):
        sigma = self.sigma if self.sigma is not None else campaign.scale_of_motion()[1] / 1000.0
        return (scalar("tau", unit="s", prior=Normal(0.0, sigma, lower=0.0)),)

    def looks_between_rows(self, campaign):
        torques = (slew.wheel_torque for slew in campaign.slews)
        return self.told or any(torque is not None and torque.any() for torque in torques)

    def rate_output(self, p, slew, trajectory, rate_S):
        return _at(slew, rate_S, slew.time - p["tau"], self.told)


@dataclass(frozen=True)
class DirectionDelay(RateSensorDelay):
    """A sensor of directions or of a field reports what it saw tau >= 0 earlier.

    Parameters
    ----------
    sigma : float or None, optional
        As of `RateSensorDelay`.

    Examples
    --------
    >>> DirectionDelay(device="sun").name
    'delay[sun]'
    """

    name = "direction_delay"

    def rate_output(self, p, slew, trajectory, rate_S):
        return rate_S

    def acts(self, hook):
        return hook == "direction_output"

    def direction_output(self, p, slew, trajectory, seen_B):
        return _at(slew, seen_B, slew.time - p["tau"], False)


def _at(slew: SlewContext, rows: Array, times: Array, told: bool) -> Array:
    """Rows (n, 3) given on the slew's grid, at other times (m,).

    In between linear where torques are commanded or devices `told`, else quadratic; linear beyond
    the ends. At a row, the line before it.
    """
    steps = jnp.sum(slew.step > 0.0)  # what follows is padding
    left = jnp.clip(jnp.searchsorted(slew.time, times, side="left") - 1, 0, steps - 1)
    slope = (rows[left + 1] - rows[left]) / slew.step[left][:, None]
    held = (times < slew.time[0])[:, None] & jnp.any(slew.torque[0] != 0.0)
    # From the right end, so that a row at its own time is itself to the last bit.
    back = times - slew.time[left + 1]
    line = rows[left + 1] + slope * back[:, None]
    straight = told or jnp.any(slew.torque != 0.0)
    bend = jnp.where(straight, 0.0, _bend(slew, rows, left, back))
    return jnp.where(held, rows[left], line + bend)


def _bend(slew: SlewContext, rows: Array, left: Array, back: Array) -> Array:
    """What a parabola through the row before too adds (m, 3) to the line of an interval.

    No row after the reading counts. Nothing is added beyond the ends and before the second row.
    """
    step = jnp.where(slew.step > 0.0, slew.step, 1.0)[:-1, None]
    chord = (rows[1:] - rows[:-1]) / step
    bent = (chord[1:] - chord[:-1]) / (step[1:] + step[:-1])
    bent = jnp.concatenate([jnp.zeros_like(bent[:1]), bent])
    before, after = back[:, None] + step[left], back[:, None]
    within = (before >= 0.0) & (after <= 0.0)
    return jnp.where(within, bent[left] * before * after, 0.0)
