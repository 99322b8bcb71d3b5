"""What to fly: slews about given axes, the rests around them with star-tracker fixes, and the file an operator reads.

A slew turns about an axis fixed in the body: a rest with fixes, a ramp up, a coast, a ramp down, time to
settle, and a rest with fixes again. `angle_and_rate` is written in `jax.numpy`, so that a slew's
consequences can be differentiated with respect to its axis, angle and rate.
"""

from __future__ import annotations

import math
import operator
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Literal, get_args

import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.spatial.transform import Rotation

from bayes_inertia.errors import CampaignError
from bayes_inertia.maths.values import Vector

Profile = Literal["trapezoid", "smooth"]
_EARTH_GM = 3.986004418e14  # [m^3/s^2]
_EARTH_DIPOLE = 7.75e15  # [T m^3], axial term of the geomagnetic field


def _require(condition: bool, key: str, what: str, advice: str) -> None:
    if not condition:
        raise CampaignError(what, where=f"key {key}", advice=advice)


def _positive(value: float, key: str) -> None:
    _require(
        bool(np.isfinite(value)) and value > 0.0,
        key,
        f"{value!r} is not positive",
        "give a positive number",
    )


@dataclass(frozen=True)
class PlannedSlew:
    """One slew about a body-fixed axis.

    Parameters
    ----------
    axis_B : axis in body axes (made a unit vector). angle : [rad], positive; turn the axis round for the other sense.
    rate : largest rate [rad/s], not reached by a short slew. acceleration : limit of the angular acceleration [rad/s^2].
    profile : "trapezoid" (constant acceleration in the ramps) or "smooth" (versine ramps, acceleration without jumps).
    duration : of the whole telemetry [s]; None for no longer than needed.

    Raises `CampaignError` for an angle, rate or acceleration that is not positive, an axis of no length, an unknown profile.

    >>> slew = PlannedSlew((0., 0., 2.), math.radians(30.0))
    >>> slew.axis_B, round(slew.motion_time, 9)
    ((0.0, 0.0, 1.0), 50.0)
    """

    axis_B: Vector
    angle: float
    rate: float = math.radians(1.0)
    acceleration: float = math.radians(0.05)
    profile: Profile = "trapezoid"
    duration: float | None = None

    def __post_init__(self):
        axis = np.asarray(self.axis_B, dtype=float)
        good = (
            axis.shape == (3,)
            and bool(np.all(np.isfinite(axis)))
            and bool(np.linalg.norm(axis) > 0.0)
        )
        _require(
            good,
            "slews.axis",
            f"{self.axis_B!r} is no direction",
            "give three numbers, not all zero",
        )
        norm = float(np.linalg.norm(axis))
        # What has unit length to rounding stays as it is, so that reading what was written changes no digit.
        axis = axis if abs(norm - 1.0) < 1e-15 else axis / norm
        object.__setattr__(self, "axis_B", tuple(axis.tolist()))
        for key in ("angle", "rate", "acceleration"):
            _positive(getattr(self, key), f"slews.{key}")
        if self.duration is not None:
            _positive(self.duration, "slews.duration")
        _require(
            self.profile in get_args(Profile),
            "slews.profile",
            f"{self.profile!r} is unknown",
            f"choose {' or '.join(get_args(Profile))}",
        )

    @property
    def motion_time(self) -> float:
        """Time from the beginning of the first ramp to the end of the last [s]."""
        ramp_factor = _ramp_factor(self.profile)
        peak = min(self.rate, math.sqrt(self.acceleration * self.angle / ramp_factor))
        return self.angle / peak + ramp_factor * peak / self.acceleration


def _ramp_factor(profile: Profile) -> float:
    """Ramp time times acceleration limit over peak rate."""
    return math.pi / 2.0 if profile == "smooth" else 1.0


def angle_and_rate(
    angle: Array, rate: Array, acceleration: Array, smooth: Array, t: Array
) -> tuple[Array, Array]:
    """Angle turned [rad] and rate [rad/s] at times t [s] after the beginning of the motion; all arguments broadcast.

    `smooth` (bool) chooses versine ramps. A slew too short for `rate` has a lower peak and no coast.

    >>> [x.tolist() for x in angle_and_rate(2.0, 2.0**-5, 2.0**-10, False, jnp.array([-1.0, 16.0, 99.0]))]
    [[0.0, 0.125, 2.0], [0.0, 0.015625, 0.0]]
    """
    factor = jnp.where(smooth, math.pi / 2.0, 1.0)
    peak = jnp.minimum(rate, jnp.sqrt(acceleration * angle / factor))
    ramp = factor * peak / acceleration
    down = angle / peak  # the ramp down begins when ramp and coast have passed, which is this long

    def risen(t):
        """The ramp from 0 to 1 beginning at t = 0, and its integral over time."""
        x = jnp.clip(t / ramp, 0.0, 1.0)
        value = jnp.where(smooth, 0.5 * (1.0 - jnp.cos(math.pi * x)), x)
        integral = jnp.where(smooth, 0.5 * x - jnp.sin(math.pi * x) / (2.0 * math.pi), 0.5 * x**2)
        return value, ramp * integral + jnp.maximum(t - ramp, 0.0)

    (up, turned), (fallen, missing) = risen(t), risen(t - down)
    return peak * (turned - missing), peak * (up - fallen)


@dataclass(frozen=True)
class Orbit:
    """A circular orbit about the Earth, for effects that need position or magnetic field.

    Parameters
    ----------
    radius [m], inclination [rad], node : right ascension of the ascending node [rad],
    argument : angle from the node at the campaign's beginning [rad].

    >>> float(np.linalg.norm(Orbit().position_N(np.array([10.0]))).round(3))
    7197428.0
    """

    radius: float = 7.197428e6
    inclination: float = math.radians(98.7)
    node: float = math.radians(40.0)
    argument: float = math.radians(10.0)

    def __post_init__(self):
        _require(
            self.radius > 6.0e6,
            "orbit.radius_km",
            f"{self.radius / 1e3:.6g} km lies inside the Earth",
            "give the distance from the Earth's centre",
        )

    def position_N(self, time: np.ndarray) -> np.ndarray:
        """Position (n, 3) [m] at times (n,) [s] of the campaign."""
        u = self.argument + math.sqrt(_EARTH_GM / self.radius**3) * np.asarray(time)
        cos_i, sin_i, cos_n, sin_n = (
            math.cos(self.inclination),
            math.sin(self.inclination),
            math.cos(self.node),
            math.sin(self.node),
        )
        along, across = (
            np.array([cos_n, sin_n, 0.0]),
            np.array([-sin_n * cos_i, cos_n * cos_i, sin_i]),
        )
        return self.radius * (np.cos(u)[:, None] * along + np.sin(u)[:, None] * across)

    def magnetic_field_N(self, time: np.ndarray) -> np.ndarray:
        """Field (n, 3) [T] of a dipole along the Earth's axis, at times (n,) [s] of the campaign."""
        position = self.position_N(time)
        up = position / self.radius
        south = np.array([0.0, 0.0, -1.0])
        return _EARTH_DIPOLE / self.radius**3 * (3.0 * (up @ south)[:, None] * up - south)


@dataclass(frozen=True)
class Plan:
    """A campaign to be flown.

    Each slew's telemetry begins with `rest_before`, in which the star tracker gives fixes every `fix_spacing` from
    `first_fix` on; after the motion and `settle` follow fixes over `rest_after`. Between two slews, `pause` long, the
    spacecraft corrects its attitude to the last target.

    Parameters
    ----------
    slews : what to fly. start_attitude : (4,) body from inertial, scalar last.
    wheel_momentum : of each wheel at the beginning [N m s]; empty for wheels at rest.
    telemetry_period, rest_before, first_fix, fix_spacing, settle, rest_after, pause : [s].
    orbit : where the environment comes from; None for a campaign without it.

    Raises `CampaignError` for times that do not fit each other or the telemetry period.

    >>> Plan("one", (PlannedSlew((1., 0., 0.), math.radians(30.0)),)).durations
    (115.0,)
    """

    name: str
    slews: tuple[PlannedSlew, ...]
    start_attitude: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    wheel_momentum: tuple[float, ...] = ()
    telemetry_period: float = 0.25
    rest_before: float = 20.0
    first_fix: float = 8.0
    fix_spacing: float = 1.0
    settle: float = 33.0
    rest_after: float = 12.0
    pause: float = 300.0
    orbit: Orbit | None = None
    durations: tuple[float, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self):
        object.__setattr__(self, "slews", tuple(self.slews))
        object.__setattr__(self, "wheel_momentum", tuple(float(h) for h in self.wheel_momentum))
        _require(len(self.slews) > 0, "slews", "the plan has no slew", "add at least one [[slews]]")
        for key in ("telemetry_period", "rest_before", "fix_spacing", "settle", "rest_after"):
            _positive(getattr(self, key), key)
        for key in ("first_fix", "pause"):
            _require(
                bool(np.isfinite(getattr(self, key))) and getattr(self, key) >= 0.0,
                key,
                f"{getattr(self, key)!r} is negative",
                "give seconds",
            )
        for key in ("rest_before", "fix_spacing"):
            parts = getattr(self, key) / self.telemetry_period
            _require(
                abs(parts - round(parts)) < 1e-6,
                key,
                f"{getattr(self, key)!r} s is no multiple of telemetry_period",
                "choose one that is",
            )
        _require(
            self.first_fix < self.rest_before,
            "first_fix",
            "the first fix comes after the rest",
            "make it smaller than rest_before",
        )
        attitude = np.asarray(self.start_attitude, dtype=float)
        norm = float(np.linalg.norm(attitude)) if attitude.shape == (4,) else math.nan
        _require(
            abs(norm - 1.0) < 1e-3,
            "start_attitude",
            "no unit quaternion",
            "give four numbers, scalar last",
        )
        attitude = attitude if abs(norm - 1.0) < 1e-15 else attitude / norm
        object.__setattr__(self, "start_attitude", tuple(attitude.tolist()))
        object.__setattr__(self, "durations", tuple(self._duration(slew) for slew in self.slews))

    def _duration(self, slew: PlannedSlew) -> float:
        rows = math.ceil(
            (self.rest_before + slew.motion_time + self.settle + self.rest_after)
            / self.telemetry_period
            - 1e-6
        )
        needed = rows * self.telemetry_period
        if slew.duration is None:
            return needed
        asked = round(slew.duration / self.telemetry_period) * self.telemetry_period
        _require(
            asked >= needed - 1e-9,
            "slews.duration",
            f"{slew.duration:.6g} s is too short",
            f"give at least {needed:.6g} s, or leave it out",
        )
        return asked

    @property
    def starts(self) -> tuple[float, ...]:
        """Time of each slew's first row in the campaign [s]."""
        return tuple(
            accumulate(
                self.durations[:-1],
                lambda start, duration: start + duration + self.pause,
                initial=0.0,
            )
        )

    @property
    def attitudes(self) -> np.ndarray:
        """Attitude before each slew and after the last (slews + 1, 4)."""
        # scipy's product of rotations is the Hamilton product of their quaternions.
        turns = [Rotation.from_rotvec(slew.angle * np.array(slew.axis_B)) for slew in self.slews]
        return np.array(
            [
                q.as_quat()
                for q in accumulate(
                    turns, operator.mul, initial=Rotation.from_quat(self.start_attitude)
                )
            ]
        )

    def times(self, i: int) -> np.ndarray:
        """Telemetry times (n,) of slew i [s] from its own first row."""
        return self.telemetry_period * np.arange(
            round(self.durations[i] / self.telemetry_period) + 1
        )

    def fixes(self, i: int) -> tuple[np.ndarray, np.ndarray]:
        """Rows of slew i with a star-tracker fix before its motion and after it."""
        spacing = round(self.fix_spacing / self.telemetry_period)
        first, begin = (
            math.ceil(self.first_fix / self.telemetry_period - 1e-6),
            round(self.rest_before / self.telemetry_period),
        )
        last = len(self.times(i)) - 1
        span = math.floor(self.rest_after / self.telemetry_period + 1e-6)
        return np.arange(first, begin, spacing), np.arange(
            last - span // spacing * spacing, last + 1, spacing
        )


def paper_like_plan() -> Plan:
    """Five slews of 30 to 60 degrees at 1 deg/s about the body axes and two diagonals, as in Ferguson's simulations of MOST.

    >>> paper_like_plan().starts
    (0.0, 415.0, 845.0, 1290.0, 1715.0)
    """
    axes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (-1.0, -1.0, -1.0), (5.0, -5.0, 3.0))
    slews = tuple(
        PlannedSlew(axis, math.radians(angle))
        for axis, angle in zip(axes, (30.0, 45.0, 60.0, 40.0, 55.0), strict=True)
    )
    attitude = (0.18808936328340506, -0.42308078708425323, 0.32910669079881893, 0.8229907806822447)
    return Plan(
        "five slews of a MOST-like spacecraft", slews, attitude, (0.05, -0.03, 0.07), orbit=Orbit()
    )
