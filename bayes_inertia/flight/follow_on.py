"""What follows a campaign: its spacecraft by a fit, and a plan that begins where it ended."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import require
from bayes_inertia.flight.plan import Plan, PlannedSlew
from bayes_inertia.flight.spacecraft import Spacecraft, axes_of_control, without_spin


def spacecraft_at(campaign: Campaign, theta: np.ndarray) -> Spacecraft:
    """The spacecraft that a campaign's parameters describe, with the campaign's hardware.

    `theta` (d,): J's six elements [kg m^2] as the campaign's prior names them, then K1, K2, K3; the
    rest is not used. Returns: without effects; its bias is drawn from the sensor's prior in every
    flight.
    """
    campaign = campaign.without_locked_wheels()
    turned_by = ", ".join(device.name for device in campaign.actuators) or "nothing"
    what = f"plans fly wheels that motors drive; what turns this spacecraft: {turned_by}"
    advice = "`fit`, `observe` and `simulate` without a plan take whatever turns it"
    require(axes_of_control(campaign.wheels) > 0, "wheels", what, advice)
    J = np.array(
        [
            [theta[0], theta[3], theta[4]],
            [theta[3], theta[1], theta[5]],
            [theta[4], theta[5], theta[2]],
        ]
    )
    J = without_spin(J, campaign.inertia.includes_wheel_spin, campaign.wheels)
    return Spacecraft(
        J,
        tuple(np.asarray(theta[6:9], float)),
        campaign.wheels,
        campaign.three_axis_gyro,
        campaign.star_tracker,
    )


def flies_plans(campaign: Campaign) -> bool:
    """Whether wheels and a gyro of three axes can fly a plan."""
    gyro = campaign.rate_sensor is not None and len(campaign.rate_sensor.axes) == 3
    return gyro and axes_of_control(campaign.wheels) > 0


def devices_at_rest(campaign: Campaign) -> tuple[str, ...]:
    """What of a campaign's devices and changes no plan flies, in a sentence; none if all fly.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> devices_at_rest(small_campaign())
    ()
    """
    names = [wheel.name for wheel in campaign.wheels if wheel.state == "locked"]
    names += [name for name, _ in campaign.more_sensors]
    names += [device.name for device in (*campaign.actuators, *campaign.changes)]
    sensors = ", the first rate sensor and the first star tracker"
    flying = f"wheels{sensors if campaign.star_tracker else ' and the first rate sensor'} fly; "
    return (f"{flying}left out: {', '.join(names)}",) if names else ()


def following_plan(campaign: Campaign, wheel_momentum: np.ndarray | None = None) -> Plan:
    """A plan of one slew, yet to be chosen, that begins where a campaign ended.

    It has the campaign's telemetry period and the usual rests.

    `wheel_momentum` (wheels,): wheel momentum relative to the body at the campaign's end [N m s].
    It is used where no tachometer tells. None: the wheels are then taken to be at rest. Returns: it
    starts at the last star-tracker fix (no rotation from inertial axes if there is none) and with
    the last complete tachometer reading of the last slew.
    """
    campaign = campaign.without_locked_wheels()
    last = campaign.slews[-1]
    # Without the rounding of times read from a file, so that alike campaigns share compiled code.
    period = float(f"{np.median(np.concatenate([s.rate_steps for s in campaign.slews])):.9g}")
    attitude = (0.0, 0.0, 0.0, 1.0)
    if last.attitude is not None and last.fixes.any():
        attitude = tuple(last.attitude[last.fixes][-1].tolist())
    if last.wheel_momentum is not None and np.isfinite(last.wheel_momentum).all(1).any():
        wheel_momentum = last.wheel_momentum[np.isfinite(last.wheel_momentum).all(1)][-1]
    momentum = () if wheel_momentum is None else tuple(np.asarray(wheel_momentum).tolist())
    base = Plan("next", (PlannedSlew((1.0, 0.0, 0.0), 1.0),), attitude, momentum)
    rest, spacing = (
        max(1, round(x / period)) * period for x in (base.rest_before, base.fix_spacing)
    )
    return replace(
        base,
        telemetry_period=period,
        rest_before=rest,
        fix_spacing=spacing,
        first_fix=min(base.first_fix, 0.5 * rest),
    )
