"""A circular orbit, for effects that need position or magnetic field."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bayes_inertia.campaign.hardware import require_key
from bayes_inertia.flight.numerics import NUMERICS
from bayes_inertia.physics.effects.gravity_gradient import GravityGradient
from bayes_inertia.physics.slew_context import Environment


@dataclass(frozen=True)
class Orbit:
    """A circular orbit about the Earth.

    Parameters
    ----------
    radius : float
        Distance from the Earth's centre [m].
    inclination : float
        Inclination [rad].
    node : float
        Right ascension of the ascending node [rad].
    argument : float
        Angle from the node at the campaign's beginning [rad].

    Raises
    ------
    CampaignError
        If the orbit lies inside the Earth.

    Examples
    --------
    >>> float(np.linalg.norm(Orbit().position_N(np.array([10.0]))).round(3))
    7197428.0
    """

    radius: float = 7.197428e6
    inclination: float = math.radians(98.7)
    node: float = math.radians(40.0)
    argument: float = math.radians(10.0)

    def __post_init__(self) -> None:
        what = f"{self.radius / 1e3:.6g} km lies inside the Earth"
        advice = "give the distance from the Earth's centre"
        require_key(self.radius > NUMERICS.smallest_radius, "orbit.radius_km", what, advice)

    def environment(self, time: np.ndarray) -> Environment:
        """What effects need, at times of the campaign.

        Parameters
        ----------
        time : (n,) array
            Times of the campaign [s].

        Returns
        -------
        Environment
            Its columns (n, 3).
        """
        return Environment(self.magnetic_field_N(time), self.position_N(time))

    def position_N(self, time: np.ndarray) -> np.ndarray:
        """Position at times of the campaign.

        Parameters
        ----------
        time : (n,) array
            Times of the campaign [s].

        Returns
        -------
        (n, 3) array
            From the Earth's centre, in inertial axes [m].
        """
        u = self.argument + math.sqrt(GravityGradient.mu / self.radius**3) * np.asarray(time)
        cos_i, sin_i = math.cos(self.inclination), math.sin(self.inclination)
        cos_n, sin_n = math.cos(self.node), math.sin(self.node)
        to_node = np.array([cos_n, sin_n, 0.0])
        ahead_of_node = np.array([-sin_n * cos_i, cos_n * cos_i, sin_i])
        return self.radius * (np.cos(u)[:, None] * to_node + np.sin(u)[:, None] * ahead_of_node)

    def magnetic_field_N(self, time: np.ndarray) -> np.ndarray:
        """Field of a dipole along the Earth's axis, at times of the campaign.

        Parameters
        ----------
        time : (n,) array
            Times of the campaign [s].

        Returns
        -------
        (n, 3) array
            In inertial axes [T].

        Examples
        --------
        >>> bool(np.linalg.norm(Orbit().magnetic_field_N(np.array([10.0]))) < 5e-5)
        True
        """
        position = self.position_N(time)
        up = position / self.radius
        south = np.array([0.0, 0.0, -1.0])
        return NUMERICS.earth_dipole / self.radius**3 * (3.0 * (up @ south)[:, None] * up - south)
