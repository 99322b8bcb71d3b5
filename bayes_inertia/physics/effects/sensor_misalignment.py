"""Sensors that are mounted slightly turned."""

from __future__ import annotations

from dataclasses import dataclass

from bayes_inertia.maths import quaternion
from bayes_inertia.physics.effect import RowByRow
from bayes_inertia.physics.parameters import Normal, vector


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

    kind = "misalignment"
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

    name = "rate_sensor_misalignment"

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

    name = "star_tracker_misalignment"

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

    name = "direction_misalignment"

    def direction_output(self, p, slew, trajectory, seen_B):
        return quaternion.to_body(quaternion.exp(p["angle"]), seen_B)
