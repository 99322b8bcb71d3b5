"""A drag torque in proportion to the body's rate."""

from __future__ import annotations

from dataclasses import dataclass

from bayes_inertia.physics.effect import SmoothTorque
from bayes_inertia.physics.parameters import Normal, vector


@dataclass(frozen=True)
class ViscousTorque(SmoothTorque):
    """External torque -drag w, axis by axis: eddy currents, or air on a body thrown in a room.

    A real drag is positive. Negative values are allowed, because a prior that ends at "no
    effect" spoils the comparison with it; a negative result says that something else puts
    energy in.

    Parameters
    ----------
    sigma : float or None, optional
        Prior sd [N m s]; None takes 3 % of J / T: a body that loses 3 % of its rate in one
        slew.

    Examples
    --------
    >>> ViscousTorque(sigma=1e-5).parameters(None)[0].names
    ('drag_x', 'drag_y', 'drag_z')
    """

    name = "viscous_torque"
    sigma: float | None = None

    def parameters(self, campaign):
        sigma = self.sigma
        if sigma is None:
            _, duration, inertia = campaign.scale_of_motion()
            sigma = 0.03 * inertia / duration
        return (vector("drag", "xyz", unit="N m s", prior=Normal(0.0, sigma)),)

    def body_torque(self, p, slew, t, state):
        return -p["drag"] * state.rate_B
