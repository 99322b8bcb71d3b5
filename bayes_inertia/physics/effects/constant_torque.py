"""A body-fixed torque that never changes."""

from __future__ import annotations

from dataclasses import dataclass

from bayes_inertia.physics.effect import SmoothTorque
from bayes_inertia.physics.effects.scales import torque_scale
from bayes_inertia.physics.parameters import Normal, vector


@dataclass(frozen=True)
class ConstantTorque(SmoothTorque):
    """A body-fixed external torque, the same in all slews.

    Outgassing, a leak, or pressure on a fixed face.

    Parameters
    ----------
    sigma : float or None, optional
        Prior sd [N m]; None takes 3 % of J w / T, the torque that would make the observed
        motion: 5e-6 N m for a microsatellite's slew, the size of its environmental torques.

    Examples
    --------
    >>> ConstantTorque(sigma=1e-5).parameters(None)[0].names
    ('torque_x', 'torque_y', 'torque_z')
    """

    name = "constant_torque"
    sigma: float | None = None

    def parameters(self, campaign):
        sigma = self.sigma if self.sigma is not None else 0.03 * torque_scale(campaign)
        return (vector("torque", "xyz", unit="N m", prior=Normal(0.0, sigma)),)

    def body_torque(self, p, slew, t, state):
        return p["torque"]
