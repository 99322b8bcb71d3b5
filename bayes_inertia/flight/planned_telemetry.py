"""A plan as the campaign that it will be, before anything has been flown."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
from scipy.spatial.transform import Rotation

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan
from bayes_inertia.flight.slew_profile import angle_and_rate
from bayes_inertia.flight.spacecraft import Spacecraft
from bayes_inertia.maths.jax_settings import require_usable_jax
from bayes_inertia.physics.numerics import NUMERICS


def planned_campaign(plan: Plan, mission: Mission, name: str | None = None) -> Campaign:
    """The plan as a campaign that has not been flown: planned motion, no torques.

    Returns: one slew for each slew of the plan, with environment columns where the plan has an
    orbit.

    Examples
    --------
    >>> from bayes_inertia.flight.mission import most_like_mission
    >>> from bayes_inertia.flight.plan import paper_like_plan
    >>> len(planned_campaign(paper_like_plan(), most_like_mission()).slews)
    5
    """
    require_usable_jax()
    craft, (angles, rates), attitudes = mission.spacecraft, _planned_motion(plan), plan.attitudes
    slews = tuple(
        _planned_slew(plan, craft, i, attitudes[i], angles[i], rates[i])
        for i in range(len(plan.slews))
    )
    return Campaign(
        name or plan.name, mission.prior, craft.wheels, craft.rate_sensor, craft.star_tracker, slews
    )


def _planned_slew(
    plan: Plan,
    craft: Spacecraft,
    i: int,
    start_attitude: np.ndarray,
    angle: np.ndarray,
    rate: np.ndarray,
) -> Slew:
    """Slew i, from its padded angle [rad] and rate [rad/s] (rows,)."""
    slew, time, sensor = plan.slews[i], plan.times(i), craft.rate_sensor
    n, axis = len(time), np.array(slew.axis_B)
    optional: dict[str, Any] = {}
    if plan.orbit is not None:
        optional |= plan.orbit.environment(plan.starts[i] + time)._asdict()
    if craft.star_tracker is not None:
        turned = Rotation.from_rotvec(angle[:n, None] * axis)
        optional["attitude"] = (Rotation.from_quat(start_attitude) * turned).as_quat()
    return Slew(
        name=f"slew {i + 1}",
        start=plan.starts[i],
        time=time,
        rate=rate[:n, None] * (sensor.axes @ axis) / np.array(sensor.scale_factor),
        wheel_torque=np.zeros((n, len(craft.wheels))),
        wheel_momentum=np.zeros((n, len(craft.wheels))),
        axis_B=slew.axis_B,
        angle=slew.angle,
        **optional,
    )


def _planned_motion(plan: Plan) -> tuple[np.ndarray, np.ndarray]:
    """Angle [rad] and rate [rad/s] of all slews (slews, rows), padded at the end."""
    longest = max(len(plan.times(i)) for i in range(len(plan.slews)))
    n_rows = -(-longest // NUMERICS.row_multiple) * NUMERICS.row_multiple
    time = plan.telemetry_period * np.arange(n_rows) - plan.rest_before
    settings = [
        np.array([[getattr(slew, key)] for slew in plan.slews])
        for key in ("angle", "rate", "acceleration")
    ]
    smooth = np.array([[slew.profile == "smooth"] for slew in plan.slews])
    angle, rate = jax.jit(angle_and_rate)(*settings, smooth, time)
    return np.asarray(angle), np.asarray(rate)
