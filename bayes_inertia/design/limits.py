"""Limits of a plan: rate, angle, acceleration, time, attitudes, and keep-out cones.

The limits of wheels and rate sensor come with the spacecraft.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from bayes_inertia.campaign.body_rates import turning
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import require_number, require_positive
from bayes_inertia.design.numerics import NUMERICS
from bayes_inertia.errors import members
from bayes_inertia.flight.plan import direction, unit_quaternion
from bayes_inertia.flight.spacecraft import Spacecraft
from bayes_inertia.maths.values import Vector, json_ready

Quaternion = tuple[float, float, float, float]


@dataclass(frozen=True)
class KeepOut:
    """A cone that the star tracker's boresight must stay out of at rest.

    Parameters
    ----------
    name : str
        What lies in the cone (Sun, Earth, Moon).
    direction_N : (3,) tuple of float
        To the cone's centre, inertial axes; made a unit vector.
    half_angle : float
        Half of the cone's opening angle [rad], below pi.

    Raises
    ------
    CampaignError
        If the direction has no length, or the half angle makes no cone.

    Examples
    --------
    >>> KeepOut("Sun", (0., 0., 2.), 0.5).direction_N
    (0.0, 0.0, 1.0)
    """

    name: str
    direction_N: Vector
    half_angle: float

    def __post_init__(self) -> None:
        key = f"keep_out.{self.name}"
        unit = direction(self.direction_N, f"{key}.direction_N")
        what, advice = "is no half of a cone's angle", "give a half angle below pi rad (180 deg)"
        within = self.half_angle, f"{key}.half_angle", what, advice
        require_number(*within, lambda x: 0.0 < x < math.pi)
        object.__setattr__(self, "direction_N", unit)


@dataclass(frozen=True)
class Limits:
    """What a plan must respect, beyond the limits that come with the spacecraft.

    Parameters
    ----------
    rate : float, optional
        Largest rate of any slew [rad/s], a true rate; None for no limit.
    angle : float, optional
        Largest angle of any slew [rad]; None for no limit.
    acceleration : float, optional
        Largest angular acceleration of any slew [rad/s^2]; None for no limit.
    total_time : float, optional
        From the first row of telemetry to the last [s]; None for no limit.
    start_attitude : (4,) tuple of float, optional
        Where the campaign must begin: body from inertial, scalar last.
    end_attitude : (4,) tuple of float, optional
        Where the campaign must end: body from inertial, scalar last.
    tolerance : float, optional
        How far start and end attitude may be off [rad].
    keep_out : tuple of KeepOut, optional
        Cones that the star tracker's boresight avoids at rest.
    rate_reserve : float, optional
        Fraction of the rate that a design leaves for scale factors that are not what was believed.
        Margins count from the limit itself.
    wheel_reserve : float, optional
        Fraction of wheel torque and momentum that a design leaves for control.

    Raises
    ------
    CampaignError
        If a limit is not positive, a reserve is no fraction, or an attitude no unit quaternion.

    Examples
    --------
    >>> Limits(rate=0.0175).total_time is None
    True
    """

    rate: float | None = None
    angle: float | None = math.pi
    acceleration: float | None = None
    total_time: float | None = None
    start_attitude: Quaternion | None = None
    end_attitude: Quaternion | None = None
    tolerance: float = math.radians(0.1)
    keep_out: tuple[KeepOut, ...] = ()
    rate_reserve: float = 0.08
    wheel_reserve: float = 0.2

    def __post_init__(self) -> None:
        object.__setattr__(self, "keep_out", members(self.keep_out, KeepOut, "key keep_out"))
        for key in ("rate", "angle", "acceleration", "total_time", "tolerance"):
            require_positive(getattr(self, key), f"limits.{key}", optional=key != "tolerance")
        for key in ("rate_reserve", "wheel_reserve"):
            what, advice = "is no fraction", "give a number from 0 to below 1"
            reserve = getattr(self, key), f"limits.{key}", what, advice
            require_number(*reserve, lambda x: 0.0 <= x < 1.0)
        for key in ("start_attitude", "end_attitude"):
            if getattr(self, key) is not None:
                attitude = unit_quaternion(getattr(self, key), f"limits.{key}")
                object.__setattr__(self, key, attitude)

    def to_json(self) -> dict[str, Any]:
        """The limits as plain values.

        Returns
        -------
        dict
            {limit: value} in SI units; `keep_out` is a list of dictionaries.
        """
        plain = json_ready(self)
        return plain | {"keep_out": plain.pop("keep_out")}


def rate_turned_at(campaign: Campaign) -> float:
    """Largest rate of a campaign [rad/s]; 1 deg/s of one that shows no more than noise and bias.

    `reads_motion` asks another thing, whether noise is small beside readings: there a bias counts
    as motion.
    """
    rate, seen = campaign.largest_rate(), campaign.body_rates
    bias = max(campaign.rate_sensor.bias_sigma) if campaign.rate_sensor else 0.0
    readings = (turning(seen.campaign, slew)[1] for slew in seen.campaign.slews)
    spread = max((float(np.std(x, axis=0).max()) for x in readings if len(x)), default=0.0)
    most = NUMERICS.noise_of_rest
    at_rest = rate <= most * math.hypot(seen.noise, bias) and spread <= most * seen.noise
    return NUMERICS.default_rate if at_rest else rate


def limits_of_next_slew(campaign: Campaign) -> Limits:
    """Limits of one slew after a campaign: 1.1 times its largest rate, twice its longest slew."""
    longest = max(slew.duration for slew in campaign.slews)
    return Limits(rate=1.1 * rate_turned_at(campaign), total_time=2.0 * longest)


class HardwareLimits(NamedTuple):
    """Limits that come with a spacecraft; infinite where unknown."""

    wheel_torque: np.ndarray  # (wheels,) largest torque of each wheel [N m]
    wheel_momentum: np.ndarray  # (wheels,) largest momentum of each wheel [N m s]
    sensor_range: float  # largest rate that the rate sensor reads [rad/s]
    # (3,) the star tracker's boresight; the body's z axis without a tracker.
    boresight_B: np.ndarray
    reach: np.ndarray  # (m,) of the device along `directions_B` [N m or N m s]; (0,) without one


def hardware_limits(spacecraft: Spacecraft) -> HardwareLimits:
    """The limits of a spacecraft's wheels and sensors.

    Examples
    --------
    >>> from bayes_inertia.flight.spacecraft import most_like_spacecraft
    >>> hardware_limits(most_like_spacecraft()).wheel_torque.tolist()
    [0.02, 0.02, 0.02]
    """
    torque, momentum = (
        np.array([getattr(wheel, key) or np.inf for wheel in spacecraft.wheels])
        for key in ("max_torque", "max_momentum")
    )
    tracker = spacecraft.star_tracker
    boresight_B = np.array(tracker.boresight_B if tracker else (0.0, 0.0, 1.0))
    sensor = spacecraft.rate_sensor
    sensor_range = (sensor.range if sensor else None) or np.inf
    reach = spacecraft.device.reach if spacecraft.device else np.zeros(0)
    return HardwareLimits(torque, momentum, sensor_range, boresight_B, reach)
