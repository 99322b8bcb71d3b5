"""What a sensor may get wrong: bias, scale, time stamps and mounting."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.campaign.sensors import stream_of_device
from bayes_inertia.maths import quaternion
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects.scales import gyro_of, rate_axes
from bayes_inertia.physics.parameters import Normal, scalar, vector
from bayes_inertia.physics.slew_context import SlewContext


@dataclass(frozen=True)
class RowByRow(Effect):
    """Base of errors of a sensor that depend on nothing but the row that is asked for."""

    def looks_between_rows(self, campaign):
        return False


@dataclass(frozen=True)
class RateBias(RowByRow):
    """A constant bias of the rate sensor beyond the prior that the campaign file states.

    The sensor reads C_rate w + b + bias before its scale factors.

    A small bias within that prior is always fitted as a nuisance; this one is for a sensor
    whose bias moved after calibration (turn-on to turn-on shifts of MEMS and fibre-optic gyros
    are several times the in-run figure).

    Parameters
    ----------
    sigma : float or None, optional
        Prior sd [rad/s]; None takes ten times the largest `bias_sigma` of the campaign.

    Examples
    --------
    >>> RateBias(sigma=1e-5).parameters(None)[0].names
    ('bias_x', 'bias_y', 'bias_z')
    """

    name: ClassVar[str] = "rate_bias"
    kind: ClassVar[str] = "bias"
    sigma: float | None = None

    def parameters(self, campaign):
        sigma = self.sigma
        if sigma is None:
            sigma = 10.0 * float(np.max(gyro_of(campaign, self.device).bias_sigma))
        axes = rate_axes(campaign, self.device)
        return (vector("bias", axes, unit="rad/s", prior=Normal(0.0, sigma)),)

    def rate_output(self, p, slew, trajectory, rate_S):
        return rate_S + p["bias"]


@dataclass(frozen=True)
class RateBiasDrift(RowByRow):
    """The rate bias changes linearly in CAMPAIGN time (warming up, ageing).

    It passes through zero at the campaign's middle.

    Counting from the middle keeps the drift apart from the mean bias, which is a nuisance of
    its own.

    Parameters
    ----------
    sigma : float or None, optional
        Prior sd [rad/s^2]; None lets the bias move ten times the largest `bias_sigma` of the
        campaign between its middle and its end.

    Examples
    --------
    >>> RateBiasDrift(sigma=1e-8).parameters(None)[0].unit
    'rad/s^2'
    """

    name: ClassVar[str] = "rate_bias_drift"
    kind: ClassVar[str] = "bias_drift"
    sigma: float | None = None

    def parameters(self, campaign):
        sigma = self.sigma
        if sigma is None:
            first, last = campaign.span
            bias_sigma = gyro_of(campaign, self.device).bias_sigma
            sigma = 20.0 * float(np.max(bias_sigma)) / (last - first)
        axes = rate_axes(campaign, self.device)
        return (vector("drift", axes, unit="rad/s^2", prior=Normal(0.0, sigma)),)

    def rate_output(self, p, slew, trajectory, rate_S):
        return rate_S + (slew.start + slew.time - slew.middle)[:, None] * p["drift"]


@dataclass(frozen=True)
class RateSensorNonlinearity(RowByRow):
    """Each sensor axis reads s + quadratic s^2 + cubic s^3 where it should read s.

    A quadratic term is a difference of scale factor between the two senses of rotation; a cubic
    one bends both ends.

    Parameters
    ----------
    sigma : float, optional
        Prior sd of each term's share of the reading at the campaign's largest rate; 0.003 is
        the linearity of a low-cost MEMS gyro over its range.

    Examples
    --------
    >>> RateSensorNonlinearity().sigma
    0.003
    """

    name: ClassVar[str] = "rate_sensor_nonlinearity"
    kind: ClassVar[str] = "nonlinearity"
    sigma: float = 0.003

    def parameters(self, campaign):
        stream = stream_of_device(self.device, campaign)
        full = max(
            float(np.max(np.abs(stream.values(s)), where=stream.valid(campaign, s), initial=0.0))
            for s in campaign.slews
            if stream.of(s) is not None
        )
        full = max(full, float(np.mean(gyro_of(campaign, self.device).sigma)))
        axes = rate_axes(campaign, self.device)
        second, third = self.sigma / full, self.sigma / full**2
        return (
            vector("quadratic", axes, unit="s/rad", prior=Normal(0.0, second)),
            vector("cubic", axes, unit="s^2/rad^2", prior=Normal(0.0, third)),
        )

    def rate_output(self, p, slew, trajectory, rate_S):
        return rate_S + p["quadratic"] * rate_S**2 + p["cubic"] * rate_S**3


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

    name: ClassVar[str] = "rate_sensor_delay"
    kind: ClassVar[str] = "delay"
    sigma: float | None = None
    told: bool = False

    def in_campaign(self, campaign):
        return replace(self, told=bool(campaign.actuators))

    def parameters(self, campaign):
        sigma = self.sigma if self.sigma is not None else campaign.scale_of_motion()[1] / 1000.0
        return (scalar("tau", unit="s", prior=Normal(0.0, sigma, lower=0.0)),)

    def looks_between_rows(self, campaign):
        return any(s.wheel_torque is not None and s.wheel_torque.any() for s in campaign.slews)

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

    name: ClassVar[str] = "direction_delay"

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


@dataclass(frozen=True)
class Misalignment(RowByRow):
    """A sensor that is turned by a small constant rotation.

    Parameters
    ----------
    sigma : float, optional
        Prior sd of each angle [rad]; 3e-3 (0.2 deg) is common for a sensor that was bolted, not
        surveyed.

    Examples
    --------
    >>> Misalignment().parameters(None)[0].names
    ('angle_x', 'angle_y', 'angle_z')
    """

    kind: ClassVar[str] = "misalignment"
    sigma: float = 3e-3

    def parameters(self, campaign):
        return (vector("angle", "xyz", unit="rad", prior=Normal(0.0, self.sigma)),)


@dataclass(frozen=True)
class RateSensorMisalignment(Misalignment):
    """The rate sensor is turned as one unit by a small rotation vector a (body axes).

    Each row c_i of C_rate becomes exp([a]x) c_i.

    The sensor then reads C_rate C(a) w instead of C_rate w.

    Parameters
    ----------
    sigma : float, optional
        As of `Misalignment`.
    """

    name: ClassVar[str] = "rate_sensor_misalignment"

    def rate_output(self, p, slew, trajectory, rate_S):
        seen_B = quaternion.to_body(quaternion.exp(p["angle"]), trajectory.rate_B)
        return rate_S + (seen_B - trajectory.rate_B) @ slew.rate_axes.T


@dataclass(frozen=True)
class StarTrackerMisalignment(Misalignment):
    """A constant rotation a between the star tracker's frame and the body.

    q_meas = q * exp(a), for all fixes alike.

    Each slew's start attitude is free, so the fixes before a slew say nothing about a. The slew
    does: the tracker sees it about exp(-a) n instead of n, so that the part of a across the
    slew's axis n shows in the fixes after it, 2 sin(angle/2) |n x a| large. A single slew axis
    leaves the rotation about that axis unobservable; two determine all of a.

    Parameters
    ----------
    sigma : float, optional
        As of `Misalignment`.
    """

    name: ClassVar[str] = "star_tracker_misalignment"

    def attitude_output(self, p, slew, trajectory, attitude):
        return quaternion.turned(attitude, p["angle"])


@dataclass(frozen=True)
class DirectionMisalignment(Misalignment):
    """A sensor of directions or of a field is turned against the body.

    Parameters
    ----------
    sigma : float, optional
        As of `Misalignment`.
    """

    name: ClassVar[str] = "direction_misalignment"

    def direction_output(self, p, slew, trajectory, seen_B):
        return quaternion.to_body(quaternion.exp(p["angle"]), seen_B)


@dataclass(frozen=True)
class StarTrackerShift(RowByRow):
    """Fixes in a slew's second half are turned by exp(shift) against those in its first half.

    The method reads the tracker before and after each slew; an alignment that differs between
    the two (the bench warms in the new attitude, stray light or aberration bends one of them)
    enters every slew's rotation angle directly. The shift is the same in all slews. A jump
    BETWEEN two slews needs no parameter of its own: each slew's start attitude is free, and
    what remains of it is `star_tracker_misalignment`.

    Parameters
    ----------
    sigma : float or None, optional
        Prior sd of each angle [rad]; None takes twenty times the tracker's sigma_cross (100 arc
        seconds for a 5 arc second tracker: a thermoelastic shift without a stable bench).

    Examples
    --------
    >>> StarTrackerShift(sigma=1e-4).parameters(None)[0].names
    ('shift_x', 'shift_y', 'shift_z')
    """

    name: ClassVar[str] = "star_tracker_shift"
    kind: ClassVar[str] = "shift"
    sigma: float | None = None

    def parameters(self, campaign):
        sigma = self.sigma
        if sigma is None:
            tracker = campaign.sensors.get(self.device or campaign.names[1])
            sigma = 20.0 * tracker.sigma_cross if tracker else 5e-4
        return (vector("shift", "xyz", unit="rad", prior=Normal(0.0, sigma)),)

    def attitude_output(self, p, slew, trajectory, attitude):
        after = slew.time > 0.5 * (slew.time[0] + slew.time[-1])
        return quaternion.turned(attitude, jnp.where(after[:, None], p["shift"], 0.0))


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

    name: ClassVar[str] = "star_tracker_time_offset"
    kind: ClassVar[str] = "delay"
    sigma: float | None = None

    def parameters(self, campaign):
        sigma = self.sigma if self.sigma is not None else campaign.scale_of_motion()[1] / 1000.0
        return (scalar("tau", unit="s", prior=Normal(0.0, sigma)),)

    def looks_between_rows(self, campaign):
        return any(slew.fixes.any() for slew in campaign.slews)

    def attitude_output(self, p, slew, trajectory, attitude):
        rate, step = trajectory.rate_B, slew.step
        # Angle turned since the first row: the integral of the piecewise linear rate.
        turned = jnp.cumsum(
            0.5 * (rate + jnp.concatenate([rate[1:], rate[-1:]])) * step[:, None], axis=0
        )
        turned = jnp.concatenate([jnp.zeros((1, 3)), turned[:-1]])
        steps = jnp.sum(step > 0.0)
        times = slew.time - p["tau"]
        left = jnp.where(
            times < slew.time[0],
            0,
            jnp.clip(jnp.searchsorted(slew.time, times, side="right") - 1, 0, steps),
        )
        ahead = (times - slew.time[left])[:, None]
        inside = (times >= slew.time[0]) & (left < steps)
        acceleration = jnp.where(
            inside[:, None],
            (rate[left + 1] - rate[left]) / jnp.where(inside, step[left], 1.0)[:, None],
            0.0,
        )
        back = turned[left] + ahead * (rate[left] + 0.5 * ahead * acceleration) - turned
        return quaternion.turned(attitude, back)


@dataclass(frozen=True)
class FieldOffset(RowByRow):
    """A constant field of the spacecraft's own, beyond what the campaign states.

    Parameters
    ----------
    share : float, optional
        Prior sd of each component as a share of the field that the sensor sees; 0.05 is what
        magnets and currents near a magnetometer without a boom make. Ten times a stated
        `offset_sigma` if that is more.

    Examples
    --------
    >>> FieldOffset(device="magnetometer").name
    'offset[magnetometer]'
    """

    name: ClassVar[str] = "field_offset"
    kind: ClassVar[str] = "offset"
    share: float = 0.05

    def parameters(self, campaign):
        seen = [(slew.more or {}).get(self.device) for slew in campaign.slews]
        size = np.concatenate([np.linalg.norm(x, axis=1) for x in seen if x is not None])
        stated = campaign.sensors[self.device].offset_sigma
        sigma = max(self.share * float(np.nanmedian(size)), 10.0 * stated)
        return (vector("offset", "xyz", unit="T", prior=Normal(0.0, sigma)),)

    def direction_output(self, p, slew, trajectory, seen_B):
        return seen_B + p["offset"]


@dataclass(frozen=True)
class FieldScale(RowByRow):
    """Each axis reads 1 + scale times the field along it, beyond what the campaign states.

    Parameters
    ----------
    sigma : float, optional
        Prior sd; 0.03 is the spread of magnetometers that nobody calibrated. Ten times a stated
        `scale_sigma` if that is more.

    Examples
    --------
    >>> FieldScale(device="magnetometer").name
    'scale[magnetometer]'
    """

    name: ClassVar[str] = "field_scale"
    kind: ClassVar[str] = "scale"
    sigma: float = 0.03

    def parameters(self, campaign):
        sigma = max(self.sigma, 10.0 * campaign.sensors[self.device].scale_sigma)
        return (vector("scale", "xyz", unit="", prior=Normal(0.0, sigma)),)

    def direction_output(self, p, slew, trajectory, seen_B):
        return seen_B * (1.0 + p["scale"])
