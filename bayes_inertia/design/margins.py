"""Margins of a plan to every limit.

`planned_margins` takes the planned motion of a rigid body. `flown_margins` takes a flight in the
closed loop, with everything that control adds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.design.limits import Limits, hardware_limits
from bayes_inertia.design.numerics import NUMERICS
from bayes_inertia.flight.plan import Plan
from bayes_inertia.flight.plan_flight import Flight
from bayes_inertia.flight.planned_motion import (
    PlannedMotion,
    SlewArrays,
    motion_of_plan,
    rigid_body,
    slew_arrays,
)
from bayes_inertia.flight.spacecraft import Spacecraft
from bayes_inertia.flight.steering import share_of_reach
from bayes_inertia.maths import quaternion
from bayes_inertia.maths.device_arrays import repeated
from bayes_inertia.maths.values import AnyArray


@dataclass(frozen=True)
class Margin:
    """What is left of one limit where it is tightest.

    Parameters
    ----------
    limit : str
        The limit's name.
    where : str
        The slew or rest where it is tightest.
    used : float
        What the plan needs there, in `unit`; for a keep-out cone the boresight's distance from its
        centre.
    allowed : float
        The limit, in `unit`.
    unit : str
        Unit of `used` and `allowed`.
    left : float
        (allowed - used) / allowed; for a keep-out cone (used - allowed) / allowed. Negative where
        the limit is broken.
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
        return self.left >= -NUMERICS.rounding_tolerance

    @property
    def says(self) -> str:
        """The margin in words.

        Examples
        --------
        >>> Margin("rate", "slew 2", 0.0209, 0.0174, "rad/s", -0.2).says
        'rate: 1.197 deg/s in slew 2, 0.9969 deg/s allowed (20 % too much)'
        """
        degrees = self.unit.startswith("rad")
        used, allowed = (
            f"{math.degrees(x) if degrees else x:.4g} {self.unit.replace('rad', 'deg')}"
            for x in (self.used, self.allowed)
        )
        if self.limit.startswith("keep-out"):
            left = self._left_in_words("outside", "inside")
            distance = f"boresight {used} from the centre {self.where}"
            return f"{self.limit}: {distance}, {allowed} is the cone ({left})"
        place = "" if self.where == "the campaign" else f" in {self.where}"
        left = self._left_in_words("left", "too much")
        return f"{self.limit}: {used}{place}, {allowed} allowed ({left})"

    def _left_in_words(self, kept: str, broken: str) -> str:
        return f"{100 * abs(self.left):.3g} % {kept if self.kept else broken}"


def demands(
    motion: PlannedMotion,
    slews: SlewArrays,
    boresight_B: np.ndarray,
    cones_N: np.ndarray,
    reach: np.ndarray,
) -> dict[str, Array]:
    """Demands of the motion of slews on spacecraft and sky; JAX can differentiate them.

    `boresight_B` (3,). `cones_N` (cones, 3): unit vectors to the centres of keep-out cones,
    inertial axes. Returns `torque` [N m] and `momentum` [N m s] (n, wheels), `rate` [rad/s],
    `angle` [rad] and `acceleration` [rad/s^2] (n,), `time` () [s], `distance` (n + 1, cones) [rad]
    of the boresight at rest from each cone's centre, and of a device `reach` (n,): what it must
    give, as a fraction of `reach` (m,), the most along each of `directions_B`; (0,) without one.

    Examples
    --------
    >>> from bayes_inertia.flight.plan import paper_like_plan
    >>> from bayes_inertia.flight.planned_motion import slew_arrays
    >>> from bayes_inertia.flight.spacecraft import most_like_spacecraft
    >>> craft, slews = most_like_spacecraft(), slew_arrays(paper_like_plan())
    >>> motion = motion_of_plan(paper_like_plan(), rigid_body(craft))
    >>> used = demands(motion, slews, np.eye(3)[2], np.zeros((0, 3)), np.zeros(0))
    >>> float(used["rate"].max().round(6))
    0.017453
    """
    boresight_N = quaternion.to_inertial(
        motion.rest_attitudes, jnp.broadcast_to(boresight_B, (len(motion.rest_attitudes), 3))
    )
    cosine = boresight_N @ jnp.asarray(cones_N).reshape(-1, 3).T
    sine = jnp.linalg.norm(
        jnp.cross(boresight_N[:, None], jnp.asarray(cones_N).reshape(1, -1, 3)) + 1e-15, axis=-1
    )
    asked = {}
    if len(reach):
        asked["reach"] = jnp.max(share_of_reach(motion.wanted_B, reach), axis=1)
    return asked | {
        "torque": jnp.max(jnp.abs(motion.wheel_torque), axis=1),
        "momentum": jnp.max(jnp.abs(motion.path.wheel_momentum), axis=1),
        "rate": jnp.sqrt(jnp.max(jnp.sum(motion.path.rate_B**2, -1), axis=1)),
        "angle": jnp.sqrt(jnp.sum(slews.rotation_B**2, -1)),
        "acceleration": jnp.asarray(slews.acceleration),
        "time": motion.total_time,
        "distance": jnp.arctan2(sine, cosine),
    }


def planned_margins(plan: Plan, spacecraft: Spacecraft, limits: Limits) -> tuple[Margin, ...]:
    """Margins of a plan, from the planned motion of a rigid body.

    The wheels give J a + w x (J w + h).

    Examples
    --------
    >>> from bayes_inertia.flight.plan import paper_like_plan
    >>> from bayes_inertia.flight.spacecraft import most_like_spacecraft
    >>> found = planned_margins(paper_like_plan(), most_like_spacecraft(), Limits(rate=0.01))
    >>> [margin.limit for margin in found if not margin.kept]
    ['rate']
    """
    return _margins(motion_of_plan(plan, rigid_body(spacecraft)), plan, spacecraft, limits)


def flown_margins(flight: Flight, limits: Limits) -> tuple[Margin, ...]:
    """Margins of a flight: peaks over all rows of its truth and its commands.

    `flight`: A plan that was flown. `limits`: what had to be respected beside the hardware's own
    limits. Returns: one for each limit that there is. Start and end attitude are those of the plan:
    what a slew misses is corrected afterwards; a device follows the plan.
    """
    n = max(len(path.time) for path in flight.truth)

    def in_one(*of_slews: AnyArray) -> Any:
        return np.stack([repeated(np.asarray(x), n, 0) for x in of_slews])

    first = [path.attitude[0] for path in flight.truth]
    rests: Any = np.stack([*first, flight.truth[-1].attitude[-1]])
    none = np.zeros((1, len(flight.spacecraft.wheels)))
    torques = (slew.wheel_torque for slew in flight.campaign.slews)
    motion = motion_of_plan(flight.plan, rigid_body(flight.spacecraft))._replace(
        path=jax.tree.map(in_one, *flight.truth),
        wheel_torque=in_one(*(none if x is None else x for x in torques)),
        rest_attitudes=rests,
    )
    return _margins(motion, flight.plan, flight.spacecraft, limits)


def broken_limits(margins: Sequence[Margin]) -> tuple[Margin, ...]:
    """The margins of violated limits.

    Examples
    --------
    >>> broken_limits([])
    ()
    """
    return tuple(sorted((m for m in margins if not m.kept), key=lambda m: m.left))


def _margins(
    motion: PlannedMotion, plan: Plan, spacecraft: Spacecraft, limits: Limits
) -> tuple[Margin, ...]:
    """Margins of a motion, planned or flown, of a plan's slews."""
    hardware = hardware_limits(spacecraft)
    cones_N = np.array([cone.direction_N for cone in limits.keep_out]).reshape(-1, 3)
    asked = demands(motion, slew_arrays(plan), hardware.boresight_B, cones_N, hardware.reach)
    used = {key: np.asarray(values) for key, values in asked.items()}
    total = np.array(plan.starts[-1] + plan.durations[-1])
    upper: list[tuple[str, np.ndarray, float | None, str]] = []
    for key, limit, unit in (
        ("torque", hardware.wheel_torque, "N m"),
        ("momentum", hardware.wheel_momentum, "N m s"),
    ):
        for i, wheel in enumerate(spacecraft.wheels):
            upper.append((f"{key} of {wheel.name}", used[key][:, i], float(limit[i]), unit))
    if (device := spacecraft.device) is not None:
        unit = f"of what it can give ({'N m s' if device.carries_momentum else 'N m'})"
        upper.append((f"reach of {device.record.name}", used["reach"], 1.0, unit))
    upper += [
        ("rate", used["rate"], limits.rate, "rad/s"),
        ("rate sensor range", used["rate"], hardware.sensor_range, "rad/s"),
        ("angle", used["angle"], limits.angle, "rad"),
        ("acceleration", used["acceleration"], limits.acceleration, "rad/s^2"),
        ("total time", total, limits.total_time, "s"),
    ]
    return (
        *(
            _upper_margin(name, values, allowed, unit)
            for name, values, allowed, unit in upper
            if allowed is not None and math.isfinite(allowed)
        ),
        *_attitude_margins(plan.attitudes, limits),
        *_keep_out_margins(used["distance"], limits),
    )


def _upper_margin(name: str, values: np.ndarray, allowed: float, unit: str) -> Margin:
    """The margin of an upper limit on values by slew (n,), or on one of the whole campaign ()."""
    k = int(np.argmax(values))
    place = f"slew {k + 1}" if np.size(values) > 1 or name != "total time" else "the campaign"
    left = float(1.0 - np.max(values) / allowed)
    return Margin(name, place, float(np.max(values)), allowed, unit, left)


def _attitude_margins(rests: np.ndarray, limits: Limits) -> list[Margin]:
    """Margins of the attitudes (slews + 1, 4) at the beginning and the end."""
    out = []
    for name, wanted, k in (
        ("start attitude", limits.start_attitude, 0),
        ("end attitude", limits.end_attitude, -1),
    ):
        if wanted is not None:
            error = quaternion.error(jnp.asarray(wanted), jnp.asarray(rests[k]))
            off = float(np.linalg.norm(error))
            left = 1.0 - off / limits.tolerance
            out.append(Margin(name, "the campaign", off, limits.tolerance, "rad", left))
    return out


def _keep_out_margins(distance: np.ndarray, limits: Limits) -> list[Margin]:
    """Margins of the cones from distances (slews + 1, cones) of the boresight at rest [rad]."""
    out = []
    for c, cone in enumerate(limits.keep_out):
        k = int(np.argmin(distance[:, c]))
        where = "at the start" if k == 0 else f"after slew {k}"
        near = float(distance[k, c])
        left = near / cone.half_angle - 1.0
        out.append(Margin(f"keep-out {cone.name}", where, near, cone.half_angle, "rad", left))
    return out
