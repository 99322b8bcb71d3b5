"""A star tracker that is mounted slightly turned."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from bayes_inertia.maths import quaternion
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.parameters import Normal, vector


@dataclass(frozen=True)
class StarTrackerMisalignment(Effect):
    """A constant rotation a between the star tracker's frame and the body.

    q_meas = q * exp(a), for all fixes alike.

    Each slew's start attitude is free, so the fixes before a slew say nothing about a. The slew
    does: the tracker sees it about exp(-a) n instead of n, so that the part of a across the
    slew's axis n shows in the fixes after it, 2 sin(angle/2) |n x a| large. A single slew axis
    leaves the rotation about that axis unobservable; two determine all of a.

    Parameters
    ----------
    sigma : float, optional
        Prior sd of each angle [rad]; 3e-3 (0.2 deg), as for a tracker whose alignment was not
        surveyed.

    Examples
    --------
    >>> StarTrackerMisalignment().parameters(None)[0].names
    ('angle_x', 'angle_y', 'angle_z')
    """

    name: ClassVar[str] = "star_tracker_misalignment"
    sigma: float = 3e-3

    def parameters(self, campaign):
        return (vector("angle", "xyz", unit="rad", prior=Normal(0.0, self.sigma)),)

    def looks_between_rows(self, campaign):
        return False

    def attitude_output(self, p, slew, trajectory, attitude):
        return quaternion.multiply(attitude, quaternion.exp(p["angle"]))
