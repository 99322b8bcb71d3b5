"""Whether a campaign's telemetry shows the slews of a plan."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import RateSensor, body_rates
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.flight.numerics import NUMERICS
from bayes_inertia.flight.plan import Plan, PlannedSlew, ramp_factor


def other_slews(plan: Plan, campaign: Campaign) -> str:
    """Signs that a campaign flew other slews than a plan's.

    Compared are the number of slews, the rotation of each from beginning to end, and its peak rate.

    Returns: the first difference in words; empty where the telemetry may be that of the plan.

    Examples
    --------
    >>> from bayes_inertia.flight.mission import most_like_mission
    >>> from bayes_inertia.flight.plan import paper_like_plan
    >>> from bayes_inertia.flight.planned_telemetry import planned_campaign
    >>> plan = paper_like_plan()
    >>> other_slews(plan, planned_campaign(plan, most_like_mission()))
    ''
    """
    if len(plan.slews) != len(campaign.slews):
        return f"it has {_counted(len(plan.slews))}, the campaign {_counted(len(campaign.slews))}"
    seen = campaign.with_body_rates
    for planned, flown in zip(plan.slews, seen.slews, strict=True):
        rate_B = _rate_B(flown, seen.gyro)
        difference = _other_rotation(planned, flown, rate_B) or _other_peak(
            planned, rate_B, seen.gyro
        )
        if difference:
            return f"{flown.name} {difference}"
    return ""


def _counted(n: int) -> str:
    return f"{n} slew{'s' if n != 1 else ''}"


def _other_rotation(planned: PlannedSlew, flown: Slew, rate_B: np.ndarray | None) -> str:
    rotation = _rotation(flown, rate_B)
    if rotation is None:
        return ""
    wanted = Rotation.from_rotvec(planned.angle * np.array(planned.axis_B))
    if (
        wanted.inv() * rotation
    ).magnitude() <= NUMERICS.rotation_off + NUMERICS.rotation_off_share * planned.angle:
        return ""
    return f"turned by {_rotation_text(rotation)}, the plan says {_rotation_text(wanted)}"


def _rotation_text(rotation: Rotation) -> str:
    angle = rotation.magnitude()
    axis = rotation.as_rotvec() / angle if angle > 0.0 else np.zeros(3)
    components = ", ".join(f"{x:+.2f}" for x in axis)
    return f"{math.degrees(angle):.1f} deg about ({components})"


def _other_peak(planned: PlannedSlew, rate_B: np.ndarray | None, sensor: RateSensor) -> str:
    if rate_B is None:
        return ""
    reached = math.sqrt(planned.acceleration * planned.angle / ramp_factor(planned.profile))
    wanted, peak = min(planned.rate, reached), float(np.linalg.norm(rate_B, axis=1).max())
    if abs(
        peak - wanted
    ) <= NUMERICS.peak_rate_off_share * wanted + NUMERICS.peak_rate_off_sigmas * max(sensor.sigma):
        return ""
    flown, said = (f"{math.degrees(x):.3g} deg/s" for x in (peak, wanted))
    return f"reached {flown}, the plan says {said}"


def _rate_B(slew: Slew, sensor: RateSensor) -> np.ndarray | None:
    """Rates in body axes (n, 3) [rad/s] with the prior's K and bias, gaps filled."""
    if slew.rate is None or not np.isfinite(slew.rate).any(axis=0).all():
        return None
    filled = np.column_stack(
        [np.interp(slew.time, slew.time[np.isfinite(x)], x[np.isfinite(x)]) for x in slew.rate.T]
    )
    return body_rates(sensor, filled, sensor.scale_factor)


def _rotation(slew: Slew, rate_B: np.ndarray | None) -> Rotation | None:
    """From the first fix to the last; without two fixes, what the rates integrate to."""
    rows = np.flatnonzero(slew.fixes)
    if slew.attitude is not None and len(rows) > 1:
        first, last = Rotation.from_quat(slew.attitude[rows[[0, -1]]])
        return first.inv() * last
    if rate_B is None:
        return None
    steps = 0.5 * (rate_B[1:] + rate_B[:-1]) * np.diff(slew.time)[:, None]
    rotation = Rotation.identity()
    for step in Rotation.from_rotvec(steps):
        rotation = rotation * step
    return rotation
