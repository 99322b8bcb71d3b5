"""Plan of slews about given axes, and of the rests around them with star-tracker fixes.

A slew turns about an axis fixed in the body: a rest with fixes, a ramp up, a coast, a ramp down,
time to settle, and a rest with fixes again.

The angle and rate of a slew over time are written in `jax.numpy`, so that its consequences can be
differentiated with respect to axis, angle and rate.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Any, Literal, get_args

import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.spatial.transform import Rotation

from bayes_inertia.campaign.hardware import (
    numbers,
    require_key,
    require_number,
    require_positive,
    unit_length,
)
from bayes_inertia.errors import is_one_of, members
from bayes_inertia.flight.orbit import Orbit
from bayes_inertia.maths.printed import Card, counted, shown_as
from bayes_inertia.maths.values import Vector
from bayes_inertia.physics.numerics import NUMERICS

Profile = Literal["trapezoid", "smooth"]


def ramp_factor(profile: Profile) -> float:
    """Ramp time times acceleration limit over peak rate.

    Examples
    --------
    >>> ramp_factor("trapezoid")
    1.0
    """
    return math.pi / 2.0 if profile == "smooth" else 1.0


def peak_and_ramp(
    angle: Array, rate: Array, acceleration: Array, smooth: Array
) -> tuple[Array, Array]:
    """Largest rate [rad/s] that each slew reaches, and the time of each of its ramps [s]."""
    factor = jnp.where(smooth, math.pi / 2.0, 1.0)
    peak = jnp.minimum(rate, jnp.sqrt(acceleration * angle / factor))
    return peak, factor * peak / acceleration


def angle_and_rate(
    angle: Array, rate: Array, acceleration: Array, smooth: Array, t: Array
) -> tuple[Array, Array]:
    """Angle turned and rate of a slew; all arguments broadcast.

    A slew too short for `rate` has a lower peak and no coast.

    `angle` [rad]; `rate` [rad/s]; `acceleration` [rad/s^2]; `t` [s]. Returns `angle` [rad]; `rate`
    [rad/s].

    Examples
    --------
    >>> t = jnp.array([-1.0, 16.0, 99.0])
    >>> [x.tolist() for x in angle_and_rate(2.0, 2.0**-5, 2.0**-10, False, t)]
    [[0.0, 0.125, 2.0], [0.0, 0.015625, 0.0]]
    """
    peak, ramp = peak_and_ramp(angle, rate, acceleration, smooth)
    down = angle / peak  # the ramp down begins when ramp and coast have passed, which is this long

    def risen(t):
        """The ramp from 0 to 1 beginning at t = 0, and its integral over time."""
        x = jnp.clip(t / ramp, 0.0, 1.0)
        value = jnp.where(smooth, 0.5 * (1.0 - jnp.cos(math.pi * x)), x)
        integral = jnp.where(smooth, 0.5 * x - jnp.sin(math.pi * x) / (2.0 * math.pi), 0.5 * x**2)
        return value, ramp * integral + jnp.maximum(t - ramp, 0.0)

    (up, turned), (fallen, missing) = risen(t), risen(t - down)
    return peak * (turned - missing), peak * (up - fallen)


def direction(value: Any, key: str) -> tuple[float, ...]:
    """Three numbers, not all zero, as a unit vector."""
    axis = numbers(value, key)
    is_direction = axis.shape == (3,) and 0.0 < float(np.linalg.norm(axis)) < math.inf
    what = f"{value!r} is no direction"
    require_key(is_direction, key, what, "give three numbers, not all zero")
    return tuple(unit_length(axis).tolist())


def unit_quaternion(value: Any, key: str) -> tuple[float, float, float, float]:
    """Four numbers of unit length to a thousandth, scalar last, at unit length."""
    attitude = numbers(value, key)
    is_unit = attitude.shape == (4,) and abs(float(np.linalg.norm(attitude)) - 1.0) < 1e-3
    what = f"{value!r} is no unit quaternion"
    require_key(is_unit, key, what, "give four numbers, scalar last")
    x, y, z, w = unit_length(attitude).tolist()
    return (x, y, z, w)


@dataclass(frozen=True)
class PlannedSlew:
    """One slew about a body-fixed axis.

    Parameters
    ----------
    axis_B : tuple of 3 floats
        Axis of the slew in the body frame; made a unit vector.
    angle : float
        Angle of the slew [rad], positive. Turn the axis round for the other sense.
    rate : float
        Largest rate [rad/s]. A short slew does not reach it.
    acceleration : float
        Limit of the angular acceleration [rad/s^2].
    profile : "trapezoid" or "smooth"
        Constant acceleration in the ramps, or versine ramps, whose acceleration does not jump.
    duration : float, optional
        Of the whole telemetry [s]; None for no longer than needed.

    Raises
    ------
    CampaignError
        If angle, rate or acceleration is not positive, the axis has no length, or the profile is
        unknown.

    Examples
    --------
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

    def __post_init__(self) -> None:
        object.__setattr__(self, "axis_B", direction(self.axis_B, "slews.axis"))
        for key in ("angle", "rate", "acceleration", "duration"):
            require_positive(getattr(self, key), f"slews.{key}", optional=key == "duration")
        what = f"{self.profile!r} is unknown"
        advice = f"choose {' or '.join(get_args(Profile))}"
        require_key(is_one_of(self.profile, get_args(Profile)), "slews.profile", what, advice)

    @property
    def motion_time(self) -> float:
        """Time from the beginning of the first ramp to the end of the last [s]."""
        factor = ramp_factor(self.profile)
        peak = min(self.rate, math.sqrt(self.acceleration * self.angle / factor))
        if peak == 0.0:  # Too small for a number.
            return math.inf
        return self.angle / peak + factor * peak / self.acceleration


def whole_periods(time: float, period: float) -> float:
    """The time nearest to another one that is a multiple of a period, one or more [s].

    >>> whole_periods(20.0, 3.0), whole_periods(0.5, 2.0)
    (21.0, 2.0)
    """
    return max(1, round(time / period)) * period


def times_left_out(base: Plan | None, given: Mapping[str, Any]) -> dict[str, float]:
    """Rest, fix spacing and first fix of a base, none for those of `Plan`, as far as not given.

    They fit what is given: whole telemetry periods, the first fix at most half the rest.

    >>> times_left_out(None, {"rest_before": 5.0})
    {'fix_spacing': 1.0, 'first_fix': 2.5}
    """
    usual: Any = base or Plan
    period = given.get("telemetry_period", usual.telemetry_period)
    times = {
        key: whole_periods(getattr(usual, key), period)
        for key in ("rest_before", "fix_spacing")
        if key not in given
    }
    if "first_fix" not in given:
        rest = given.get("rest_before", times.get("rest_before"))
        times["first_fix"] = min(usual.first_fix, 0.5 * rest)
    return times


def slews_card(plan: Plan) -> Card:
    """How long it takes, and the slews to fly."""
    rows = tuple(
        (
            str(k),
            ", ".join(f"{x:.3f}" for x in row["axis_B"]),
            f"{row['angle_deg']:.1f}",
            f"{row['rate_deg_s']:.3g}",
            f"{row['duration_s']:.4g}",
        )
        for k, row in enumerate(plan.slew_rows(), 1)
    )
    lasts = plan.starts[-1] + plan.durations[-1]
    first = f"Plan {plan.name}: {counted(len(rows), 'slew')} in {lasts:.4g} s"
    return Card((first,), ("slew", "axis", "angle [deg]", "rate [deg/s]", "duration [s]"), rows)


@shown_as(slews_card)
@dataclass(frozen=True)
class Plan:
    """A campaign to be flown.

    The telemetry of each slew begins with a rest, in which the star tracker gives fixes. After the
    motion and some time to settle follow fixes in a second rest. Between two slews the spacecraft
    corrects its attitude to the last target.

    Parameters
    ----------
    name : str
        Name of the campaign.
    slews : tuple of PlannedSlew
        What to fly, at least one slew.
    start_attitude : tuple of 4 floats
        Quaternion before the first slew, body from inertial, scalar last.
    wheel_momentum : tuple of floats
        Momentum of each wheel at the beginning [N m s]; empty for wheels at rest.
    telemetry_period : float
        Time from row to row [s].
    rest_before : float
        Rest before the motion [s].
    first_fix : float
        Time of the first fix in that rest [s].
    fix_spacing : float
        Time between fixes [s].
    settle : float
        Time to settle after the motion [s].
    rest_after : float
        Rest with fixes after that [s].
    pause : float
        Time between the telemetry of two slews [s].
    orbit : Orbit, optional
        Where the environment comes from; None for a campaign without it.
    fixes_in_motion : bool
        Whether the star tracker gives fixes throughout each slew, not in its rests alone.

    Raises
    ------
    CampaignError
        If times do not fit each other or the telemetry period.

    Examples
    --------
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
    fixes_in_motion: bool = False
    durations: tuple[float, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "slews", members(self.slews, PlannedSlew, "key slews"))
        momentum = np.atleast_1d(numbers(self.wheel_momentum, "wheel_momentum"))
        object.__setattr__(self, "wheel_momentum", tuple(momentum.tolist()))
        require_key(
            len(self.slews) > 0, "slews", "the plan has no slew", "add at least one [[slews]]"
        )
        self._check_times()
        attitude = unit_quaternion(self.start_attitude, "start_attitude")
        object.__setattr__(self, "start_attitude", attitude)
        durations = (self._duration(k, slew) for k, slew in enumerate(self.slews, 1))
        object.__setattr__(self, "durations", tuple(durations))

    def _check_times(self) -> None:
        """Raise for times that do not fit each other or the telemetry period."""
        for key in ("telemetry_period", "rest_before", "fix_spacing", "settle", "rest_after"):
            require_positive(getattr(self, key), key)
        for key in ("first_fix", "pause"):
            what = "is no time, or negative"
            require_number(getattr(self, key), key, what, "give seconds", lambda x: x >= 0.0)
        for key in ("rest_before", "fix_spacing"):
            periods = getattr(self, key) / self.telemetry_period
            what = f"{getattr(self, key)!r} s is no multiple of telemetry_period"
            advice = "choose one that is"
            require_key(abs(periods - round(periods)) < 1e-6, key, what, advice)
        what = "the first fix comes after the rest"
        advice = "make it smaller than rest_before"
        require_key(self.first_fix < self.rest_before, "first_fix", what, advice)

    def _duration(self, k: int, slew: PlannedSlew) -> float:
        """Duration of the k-th slew's telemetry [s], whole telemetry periods."""
        place = f"slews[{k} of {len(self.slews)}]"
        least = self.rest_before + slew.motion_time + self.settle + self.rest_after
        longest = max(least, slew.duration or 0.0) / self.telemetry_period
        most = NUMERICS.most_grid_points
        what = f"it has {longest:.3g} rows of telemetry, more than {most:,.0f}"
        keys = "rate_deg_per_s, acceleration_deg_per_s2 and telemetry_period_s"
        require_key(longest <= most, place, what, f"look at the units of {keys}")
        needed = math.ceil(least / self.telemetry_period - 1e-6) * self.telemetry_period
        if slew.duration is None:
            return needed
        asked = round(slew.duration / self.telemetry_period) * self.telemetry_period
        what = f"{slew.duration:.6g} s is too short"
        advice = f"give at least {needed:.6g} s, or leave it out"
        require_key(asked >= needed - 1e-9, f"{place}.duration", what, advice)
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

    def slew_rows(self) -> list[dict[str, Any]]:
        """The slews in degrees and seconds.

        Returns
        -------
        list of dict
            One a slew, with the keys `axis_B`, `angle_deg`, `rate_deg_s`, `acceleration_deg_s2`,
            `start_s` and `duration_s`.

        Examples
        --------
        >>> row = paper_like_plan().slew_rows()[1]
        >>> round(row["angle_deg"], 9), row["start_s"]
        (45.0, 415.0)
        """
        return [
            {
                "axis_B": list(slew.axis_B),
                "angle_deg": math.degrees(slew.angle),
                "rate_deg_s": math.degrees(slew.rate),
                "acceleration_deg_s2": math.degrees(slew.acceleration),
                "start_s": start,
                "duration_s": duration,
            }
            for slew, start, duration in zip(self.slews, self.starts, self.durations, strict=True)
        ]

    @property
    def attitudes(self) -> np.ndarray:
        """Attitude before each slew and after the last (slews + 1, 4)."""
        # scipy's product of rotations is the Hamilton product of their quaternions.
        turns = [Rotation.from_rotvec(slew.angle * np.array(slew.axis_B)) for slew in self.slews]
        first = Rotation.from_quat(self.start_attitude)
        return np.array([q.as_quat() for q in accumulate(turns, operator.mul, initial=first)])

    def times(self, i: int) -> np.ndarray:
        """Telemetry times of one slew.

        Parameters
        ----------
        i : int
            Which slew, from 0.

        Returns
        -------
        (n,) array
            From the slew's own first row [s].

        Examples
        --------
        >>> paper_like_plan().times(0)[:3].tolist()
        [0.0, 0.25, 0.5]
        """
        steps = round(self.durations[i] / self.telemetry_period)
        return self.telemetry_period * np.arange(steps + 1)

    def fixes(self, i: int) -> tuple[np.ndarray, np.ndarray]:
        """Rows of one slew that have a star-tracker fix.

        Parameters
        ----------
        i : int
            Which slew, from 0.

        Returns
        -------
        before : (n,) array of int
            Rows before the motion.
        after : (m,) array of int
            Rows after it.

        Examples
        --------
        >>> [rows[:3].tolist() for rows in paper_like_plan().fixes(0)]
        [[32, 36, 40], [412, 416, 420]]
        """
        spacing = round(self.fix_spacing / self.telemetry_period)
        first = math.ceil(self.first_fix / self.telemetry_period - 1e-6)
        motion_start = round(self.rest_before / self.telemetry_period)
        last = len(self.times(i)) - 1
        rest_rows = math.floor(self.rest_after / self.telemetry_period + 1e-6)
        first_after = last - rest_rows // spacing * spacing
        return np.arange(first, motion_start, spacing), np.arange(first_after, last + 1, spacing)

    def fix_rows(self, i: int) -> np.ndarray:
        """Rows of one slew's telemetry with a fix: those of `fixes`, or throughout.

        Parameters
        ----------
        i : int
            Which slew, from 0.

        Returns
        -------
        (n,) array of int
            Ascending.

        Examples
        --------
        >>> len(paper_like_plan().fix_rows(0))
        25
        """
        before, after = self.fixes(i)
        spacing = round(self.fix_spacing / self.telemetry_period)
        if self.fixes_in_motion:
            return np.arange(before[0], after[-1] + 1, spacing)
        return np.concatenate([before, after])

    def at_fixes(self, i: int, values: np.ndarray) -> np.ndarray:
        """Values along one slew, as far as it has star-tracker fixes.

        Parameters
        ----------
        i : int
            Index of the slew.
        values : (n, ...) array
            One at each row of its telemetry.

        Returns
        -------
        (n, ...) array
            The values in rows with a fix, NaN elsewhere.

        Examples
        --------
        >>> plan = paper_like_plan()
        >>> int(np.isfinite(plan.at_fixes(0, plan.times(0))).sum()) == len(plan.fix_rows(0))
        True
        """
        rows, seen = self.fix_rows(i), np.full(values.shape, np.nan)
        seen[rows] = values[rows]
        return seen


def paper_like_plan() -> Plan:
    """Five slews of 30 to 60 degrees at 1 deg/s about the body axes and two diagonals.

    So Ferguson simulates MOST.

    Returns
    -------
    Plan
        With an orbit, and wheels that turn at the beginning.

    Examples
    --------
    >>> paper_like_plan().starts
    (0.0, 415.0, 845.0, 1290.0, 1715.0)
    """
    axes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (-1.0, -1.0, -1.0), (5.0, -5.0, 3.0))
    pairs = zip(axes, (30.0, 45.0, 60.0, 40.0, 55.0), strict=True)
    slews = tuple(PlannedSlew(axis, math.radians(angle)) for axis, angle in pairs)
    attitude = (0.18808936328340506, -0.42308078708425323, 0.32910669079881893, 0.8229907806822447)
    name, momentum = "five slews of a MOST-like spacecraft", (0.05, -0.03, 0.07)
    return Plan(name, slews, attitude, momentum, orbit=Orbit())
