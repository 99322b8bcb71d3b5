"""A rate sensor that is mounted slightly turned."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from bayes_inertia.maths import quaternion
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.parameters import Normal, vector


@dataclass(frozen=True)
class RateSensorMisalignment(Effect):
    """The rate sensor is turned as one unit by a small rotation vector a (body axes).

    Each row c_i of C_rate becomes exp([a]x) c_i.

    The sensor then reads C_rate C(a) w instead of C_rate w.

    Parameters
    ----------
    sigma : float, optional
        Prior sd of each angle [rad]; 3e-3 (0.2 deg) is common for a sensor box that was bolted,
        not surveyed.

    Examples
    --------
    >>> RateSensorMisalignment().parameters(None)[0].names
    ('angle_x', 'angle_y', 'angle_z')
    """

    name: ClassVar[str] = "rate_sensor_misalignment"
    sigma: float = 3e-3

    def parameters(self, campaign):
        return (vector("angle", "xyz", unit="rad", prior=Normal(0.0, self.sigma)),)

    def looks_between_rows(self, campaign):
        return False

    def rate_output(self, p, slew, trajectory, rate_S):
        seen_B = quaternion.to_body(quaternion.exp(p["angle"]), trajectory.rate_B)
        return rate_S + (seen_B - trajectory.rate_B) @ slew.rate_axes.T
