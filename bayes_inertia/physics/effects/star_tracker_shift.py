"""A star tracker whose alignment after a slew differs from before it."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp

from bayes_inertia.maths import quaternion
from bayes_inertia.physics.effect import RowByRow
from bayes_inertia.physics.parameters import Normal, vector


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

    name = "star_tracker_shift"
    kind = "shift"
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
