"""A residual magnetic dipole in the geomagnetic field."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from bayes_inertia.maths import quaternion
from bayes_inertia.physics.effect import SmoothTorque
from bayes_inertia.physics.effects.scales import torque_scale
from bayes_inertia.physics.parameters import Normal, vector


@dataclass(frozen=True)
class MagneticDipole(SmoothTorque):
    """A body-fixed dipole m feels the torque m x B, B the telemetered field turned into body axes.

    Parameters
    ----------
    sigma : float or None, optional
        Prior sd of each component [A m^2]; None takes the dipole whose torque in the campaign's
        mean field is 3 % of J w / T: a few tenths of an A m^2 for a microsatellite, two or
        three times the milliampere square metre per kilogram that NASA SP-8018 expects of one
        without magnetic cleanliness.

    Examples
    --------
    >>> MagneticDipole(sigma=0.1).parameters(None)[0].unit
    'A m^2'
    """

    name = "magnetic_dipole"
    needs = ("magnetic_field_N",)
    sigma: float | None = None

    def parameters(self, campaign):
        sigma = self.sigma
        if sigma is None:
            given = (slew.magnetic_field_N for slew in campaign.slews)
            fields = [np.linalg.norm(field, axis=1) for field in given if field is not None]
            mean = float(np.nanmean(np.concatenate(fields))) if fields else 3e-5
            sigma = 0.03 * torque_scale(campaign) / max(mean, 1e-9)
        return (vector("dipole", "xyz", unit="A m^2", prior=Normal(0.0, sigma)),)

    def body_torque(self, p, slew, t, state):
        return jnp.cross(p["dipole"], quaternion.to_body(state.attitude, state.magnetic_field_N))
