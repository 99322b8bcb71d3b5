"""What a plan must respect: wheel torque and momentum, rate, angle, time, attitudes, and the star tracker's view.

`margins` says what is left of every limit for a plan, from the planned motion of a rigid body; `flown_margins` says the same
of a plan that was flown in the closed-loop simulator, with everything that control adds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.design.planned_motion import Motion, body_with, motion_of
from bayes_inertia.errors import CampaignError
from bayes_inertia.flight.plan import Plan
from bayes_inertia.flight.plan_flight import Flight
from bayes_inertia.flight.spacecraft import Spacecraft
from bayes_inertia.maths import quaternion
from bayes_inertia.maths.values import Vector

Quaternion = tuple[float, float, float, float]


@dataclass(frozen=True)
class KeepOut:
    """A cone that the star tracker's boresight must stay out of at rest.

    Parameters
    ----------
    name : what is there (Sun, Earth, Moon). direction_N : to its centre, inertial axes. half_angle : [rad].

    >>> KeepOut("Sun", (0., 0., 2.), 0.5).direction_N
    (0.0, 0.0, 1.0)
    """

    name: str
    direction_N: Vector
    half_angle: float

    def __post_init__(self):
        direction = np.asarray(self.direction_N, dtype=float)
        if (
            direction.shape != (3,)
            or not np.all(np.isfinite(direction))
            or not np.linalg.norm(direction) > 0.0
        ):
            raise CampaignError(
                f"{self.direction_N!r} is no direction",
                where=f"keep-out {self.name}",
                advice="give three inertial components, not all zero",
            )
        if not 0.0 < self.half_angle < math.pi:
            raise CampaignError(
                f"{math.degrees(self.half_angle):.6g} deg is no cone",
                where=f"keep-out {self.name}",
                advice="give a half angle below 180 deg",
            )
        object.__setattr__(
            self, "direction_N", tuple((direction / np.linalg.norm(direction)).tolist())
        )


@dataclass(frozen=True)
class Limits:
    """What a plan must respect, beyond the limits of the wheels and the rate sensor's range, which come with the spacecraft.

    Parameters
    ----------
    rate [rad/s], angle [rad], acceleration [rad/s^2] : largest of any slew; None for no limit. (Rates are true rates.)
    total_time : from the first row of telemetry to the last [s].
    start_attitude, end_attitude : (4,) where the campaign must begin and end. tolerance : of both [rad].
    keep_out : cones that the star tracker's boresight avoids at rest.
    rate_reserve, wheel_reserve : fractions of rate, and of wheel torque and momentum, that a DESIGN leaves for scale factors that
        are not what was believed, and for control. Margins always count from the limit itself.

    Raises `CampaignError` for a limit that is not positive.

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

    def __post_init__(self):
        object.__setattr__(self, "keep_out", tuple(self.keep_out))
        for key in ("rate", "angle", "acceleration", "total_time", "tolerance"):
            value = getattr(self, key)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise CampaignError(
                    f"{value!r} is not positive",
                    where=f"limit {key}",
                    advice="give a positive number in SI units, or leave it out",
                )
        for key in ("rate_reserve", "wheel_reserve"):
            if not 0.0 <= getattr(self, key) < 1.0:
                raise CampaignError(
                    f"{getattr(self, key)!r} is no fraction",
                    where=f"limit {key}",
                    advice="give a number from 0 to below 1",
                )
        for key in ("start_attitude", "end_attitude"):
            value = getattr(self, key)
            if value is None:
                continue
            attitude = np.asarray(value, dtype=float)
            if attitude.shape != (4,) or abs(np.linalg.norm(attitude) - 1.0) > 1e-3:
                raise CampaignError(
                    f"{value!r} is no unit quaternion",
                    where=f"limit {key}",
                    advice="give four numbers, scalar last",
                )
            object.__setattr__(self, key, tuple((attitude / np.linalg.norm(attitude)).tolist()))

    def to_json(self) -> dict:
        """The limits as plain values, in SI units."""
        plain = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "keep_out"}
        return plain | {
            "keep_out": [
                {"name": c.name, "direction_N": list(c.direction_N), "half_angle": c.half_angle}
                for c in self.keep_out
            ]
        }


class Hardware(NamedTuple):
    """Limits that come with a spacecraft, infinite where unknown: `torque`, `momentum` (wheels,), `range` of the rate sensor [rad/s],
    `boresight_B` (3,) of the star tracker."""

    torque: np.ndarray
    momentum: np.ndarray
    range: float
    boresight_B: np.ndarray


@dataclass(frozen=True)
class Margin:
    """What is left of one limit where it is tightest.

    Attributes
    ----------
    limit : its name. where : the slew or rest. used, allowed : in `unit`. left : (allowed - used) / allowed; for a keep-out cone,
        whose `used` is the distance from its centre, (used - allowed) / allowed. Negative: violated.
    """

    limit: str
    where: str
    used: float
    allowed: float
    unit: str
    left: float

    @property
    def kept(self) -> bool:
        """Whether the limit is respected (to rounding)."""
        return self.left >= -1e-9

    @property
    def says(self) -> str:
        """The margin in words.

        >>> Margin("rate", "slew 2", 0.0209, 0.0174, "rad/s", -0.2).says
        'rate: 1.197 deg/s in slew 2, 0.9969 deg/s allowed (20 % too much)'
        """
        degrees = self.unit.startswith("rad")
        shown = [
            f"{math.degrees(x) if degrees else x:.4g} {self.unit.replace('rad', 'deg')}"
            for x in (self.used, self.allowed)
        ]
        if self.limit.startswith("keep-out"):
            return f"{self.limit}: boresight {shown[0]} from the centre {self.where}, {shown[1]} is the cone ({self._left_words('outside', 'inside')})"
        place = "" if self.where == "the campaign" else f" in {self.where}"
        return f"{self.limit}: {shown[0]}{place}, {shown[1]} allowed ({self._left_words('left', 'too much')})"

    def _left_words(self, good: str, bad: str) -> str:
        return f"{100 * abs(self.left):.3g} % {good if self.kept else bad}"


def hardware(spacecraft: Spacecraft) -> Hardware:
    """The limits of a spacecraft's wheels and sensors."""
    torque, momentum = (
        np.array([getattr(w, key) or np.inf for w in spacecraft.wheels])
        for key in ("max_torque", "max_momentum")
    )
    tracker = spacecraft.star_tracker
    return Hardware(
        torque,
        momentum,
        spacecraft.rate_sensor.range or np.inf,
        np.array(tracker.boresight_B if tracker else (0.0, 0.0, 1.0)),
    )


def demands(
    motion: Motion, turns: Array, acceleration: Array, boresight_B: Array, cones_N: Array
) -> dict[str, Array]:
    """What a motion demands, for search and gradients: `torque`, `momentum` (slews, wheels), `rate`, `angle`, `acceleration` (slews,),
    `time` (), `distance` (slews + 1, cones) of the boresight at rest from each cone's centre [rad].

    >>> from bayes_inertia.flight.plan import paper_like_plan
    >>> from bayes_inertia.design.planned_motion import slews_of
    >>> from bayes_inertia.flight.spacecraft import most_like_spacecraft
    >>> craft, plan = most_like_spacecraft(), paper_like_plan()
    >>> flown = motion_of(plan, body_with(craft.inertia_B, craft.wheel_axes_B, np.full(3, 1e-3)))
    >>> slews = slews_of(plan)
    >>> float(demands(flown, slews.turn_B, slews.acceleration, np.array([0., 0., 1.]), np.zeros((0, 3)))["rate"].max().round(6))
    0.017453
    """
    boresight_N = quaternion.to_inertial(
        motion.rests, jnp.broadcast_to(boresight_B, (len(motion.rests), 3))
    )
    cosine = boresight_N @ jnp.asarray(cones_N).reshape(-1, 3).T
    sine = jnp.linalg.norm(
        jnp.cross(boresight_N[:, None], jnp.asarray(cones_N).reshape(1, -1, 3)) + 1e-15, axis=-1
    )
    return {
        "torque": jnp.max(jnp.abs(motion.torque), axis=1),
        "momentum": jnp.max(jnp.abs(motion.wheel), axis=1),
        "rate": jnp.sqrt(jnp.max(jnp.sum(motion.rate_B**2, -1), axis=1)),
        "angle": jnp.sqrt(jnp.sum(turns**2, -1)),
        "acceleration": acceleration,
        "time": motion.total,
        "distance": jnp.arctan2(sine, cosine),
    }


def margins(plan: Plan, spacecraft: Spacecraft, limits: Limits) -> tuple[Margin, ...]:
    """What a plan leaves of every limit, from its planned motion: wheel torque J a + w x (J w + h), momentum, rate, angle, time, attitudes.

    >>> from bayes_inertia.flight.plan import paper_like_plan
    >>> from bayes_inertia.flight.spacecraft import most_like_spacecraft
    >>> [m.limit for m in margins(paper_like_plan(), most_like_spacecraft(), Limits(rate=0.01)) if not m.kept]
    ['rate']
    """
    spin = np.array([w.spin_inertia for w in spacecraft.wheels])
    flown = motion_of(plan, body_with(spacecraft.inertia_B, spacecraft.wheel_axes_B, spin))
    turns = np.array([s.angle * np.array(s.axis_B) for s in plan.slews])
    cones = np.array([c.direction_N for c in limits.keep_out]).reshape(-1, 3)
    used = demands(
        flown,
        turns,
        np.array([s.acceleration for s in plan.slews]),
        hardware(spacecraft).boresight_B,
        cones,
    )
    total = plan.starts[-1] + plan.durations[-1]
    return _margins(
        {k: np.asarray(v) for k, v in used.items()} | {"time": np.array(total)},
        plan.attitudes,
        spacecraft,
        limits,
    )


def flown_margins(flight: Flight, limits: Limits) -> tuple[Margin, ...]:
    """What a flight left of every limit: peaks over all rows of its truth and its commands."""
    campaign = flight.campaign
    rests = np.stack([*(path.attitude[0] for path in flight.truth), flight.truth[-1].attitude[-1]])
    cones = np.array([c.direction_N for c in limits.keep_out]).reshape(-1, 3)
    boresight_N = np.asarray(
        quaternion.to_inertial(
            jnp.asarray(rests),
            jnp.broadcast_to(hardware(flight.spacecraft).boresight_B, (len(rests), 3)),
        )
    )
    used = {
        "torque": np.stack([np.abs(slew.wheel_torque).max(0) for slew in campaign.slews]),
        "momentum": np.stack([np.abs(path.wheel_momentum).max(0) for path in flight.truth]),
        "rate": np.array([np.linalg.norm(path.rate_B, axis=1).max() for path in flight.truth]),
        "angle": np.array([slew.angle for slew in flight.plan.slews]),
        "acceleration": np.array([slew.acceleration for slew in flight.plan.slews]),
        "time": np.array(campaign.slews[-1].start + campaign.slews[-1].duration),
        "distance": np.arccos(np.clip(boresight_N @ cones.T, -1.0, 1.0)),
    }
    # Where it begins and ends is what the plan aims at: what a slew misses is corrected afterwards.
    return _margins(used, flight.plan.attitudes, flight.spacecraft, limits)


def _margins(
    used: dict[str, np.ndarray], rests: np.ndarray, spacecraft: Spacecraft, limits: Limits
) -> tuple[Margin, ...]:
    own = hardware(spacecraft)
    out = []

    def most(name: str, values: np.ndarray, allowed: float | None, unit: str) -> None:
        if allowed is None or not math.isfinite(allowed):
            return
        k = int(np.argmax(values))
        place = f"slew {k + 1}" if np.size(values) > 1 or name != "total time" else "the campaign"
        out.append(
            Margin(
                name,
                place,
                float(np.max(values)),
                allowed,
                unit,
                float(1.0 - np.max(values) / allowed),
            )
        )

    for key, unit in (("torque", "N m"), ("momentum", "N m s")):
        for w, wheel in enumerate(spacecraft.wheels):
            most(f"{key} of {wheel.name}", used[key][:, w], float(getattr(own, key)[w]), unit)
    most("rate", used["rate"], limits.rate, "rad/s")
    most("rate sensor range", used["rate"], own.range, "rad/s")
    most("angle", used["angle"], limits.angle, "rad")
    most("acceleration", used["acceleration"], limits.acceleration, "rad/s^2")
    most("total time", used["time"], limits.total_time, "s")
    for name, wanted, k in (
        ("start attitude", limits.start_attitude, 0),
        ("end attitude", limits.end_attitude, -1),
    ):
        if wanted is not None:
            off = float(
                np.linalg.norm(quaternion.error(jnp.asarray(wanted), jnp.asarray(rests[k])))
            )
            out.append(
                Margin(
                    name, "the campaign", off, limits.tolerance, "rad", 1.0 - off / limits.tolerance
                )
            )
    for c, cone in enumerate(limits.keep_out):
        k = int(np.argmin(used["distance"][:, c]))
        near = float(used["distance"][k, c])
        out.append(
            Margin(
                f"keep-out {cone.name}",
                _rest(k),
                near,
                cone.half_angle,
                "rad",
                near / cone.half_angle - 1.0,
            )
        )
    return tuple(out)


def _rest(k: int) -> str:
    return "at the start" if k == 0 else f"after slew {k}"


def broken(found: Sequence[Margin]) -> tuple[Margin, ...]:
    """The violated limits, worst first.

    >>> broken([])
    ()
    """
    return tuple(sorted((m for m in found if not m.kept), key=lambda m: m.left))
