"""A mission, what follows a campaign of it, and whether a campaign flew what was planned."""

from __future__ import annotations

import math
import operator
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from bayes_inertia.campaign.body_rates import reference_of
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import (
    DirectionSensor,
    InertiaPrior,
    RateSensor,
    StarTracker,
    body_rates,
    require_key,
)
from bayes_inertia.campaign.prior import GaussianPrior
from bayes_inertia.campaign.sensors import series_of
from bayes_inertia.campaign.sensors.rate import RATE
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.errors import require_kind
from bayes_inertia.flight.numerics import NUMERICS
from bayes_inertia.flight.plan import Plan, PlannedSlew, ramp_factor, times_left_out, whole_periods
from bayes_inertia.flight.spacecraft import (
    Controller,
    Spacecraft,
    axes_of_control,
    body_tensor,
    most_like_prior,
    most_like_spacecraft,
    spin_tensor,
)
from bayes_inertia.flight.steering import FlyingDevice, flying_device
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.printed import Card, counted, parameter_card, shown_as
from bayes_inertia.physics.actuators import effects_of
from bayes_inertia.physics.forward_model import base_space
from bayes_inertia.physics.packing import bridged
from bayes_inertia.physics.parameters import ParameterSpace

# Further sensors whose readings can be foreseen.
_FLYING = (RateSensor, StarTracker, DirectionSensor)
_WITHOUT_COMMANDS = (
    "the wheels' torques are taken as telemetered, though this campaign's telemetry lacks them: "
    "a fit without them may be less sharp, above all with slow tachometers"
)


def prior_mean(campaign: Campaign) -> np.ndarray:
    """J's six elements [kg m^2] and K of a campaign's rate sensor (6 + axes,) before flight."""
    return np.array(base_space(campaign.inertia, campaign.rate_sensor, campaign.prior).mean)


def _known_after_changes(campaign: Campaign) -> GaussianPrior | None:
    """J and K before their fit, J after the changes that the campaign dates; None without either.

    The sizes of the changes are unknown: J is as much less known.
    """
    if not campaign.changes:
        return campaign.prior
    space = base_space(campaign.inertia, campaign.rate_sensor, campaign.prior)
    correlation = np.eye(space.size) if space.correlation is None else space.correlation
    covariance = correlation * np.outer(space.sd, space.sd)
    for effect in effects_of(campaign):
        if effect.acts("inertia"):
            (change,) = effect.parameters(campaign)
            covariance[:6, :6] += np.diag([prior.sd**2 for prior in change.priors])
    return GaussianPrior(tuple(space.names), space.mean, covariance)


def spacecraft_at(campaign: Campaign, theta: np.ndarray) -> Spacecraft:
    """The spacecraft that a campaign's parameters describe, with the campaign's hardware.

    `theta` (d,): J's six elements [kg m^2] as the campaign's prior names them, then K of each axis;
    the rest is not used. Returns: without effects; its bias is drawn from the sensor's prior in
    every flight. Wheels fly it where they turn it about three axes, else a device that does.
    """
    campaign = campaign.without_locked_wheels()
    wheels, sensor = campaign.wheels, campaign.rate_sensor
    why = why_no_plans(campaign)
    advice = "`observe` says what its motion determines as it is, and `fit` determines it"
    require_key(not why, "actuators", why, advice)
    return Spacecraft(
        body_tensor(np.asarray(theta[:6]), campaign.inertia, wheels),
        tuple(np.asarray(theta[6 : 6 + len(sensor.axes)], float)) if sensor else (),
        wheels,
        sensor,
        campaign.star_tracker,
        more_sensors=tuple(x for x in campaign.more_sensors if isinstance(x[1], _FLYING)),
        device=_device_in_place_of_wheels(campaign),
        names=campaign.names,
        reference=campaign.reference,
        periods=reading_periods(campaign),
        seen_N=_seen_last(campaign),
    )


def why_no_plans(campaign: Campaign) -> str:
    """Why no slew can be designed for a spacecraft, in words; empty if one can.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> why_no_plans(small_campaign())
    ''
    """
    campaign = campaign.without_locked_wheels()
    turned = axes_of_control(campaign.wheels) > 0
    if turned or _device_in_place_of_wheels(campaign) is not None:
        return ""
    told = ", ".join(x.name for x in (*campaign.wheels, *campaign.actuators))
    free = f"{told} cannot turn it as asked" if told else "nothing on board turns it"
    return f"there is no slew to design for this spacecraft, {free}"


def _device_in_place_of_wheels(campaign: Campaign) -> FlyingDevice | None:
    """The device that turns it about more axes than its wheels do; None where wheels turn all."""
    axes = axes_of_control(campaign.wheels)
    device = None if axes == 3 else flying_device(campaign)
    return device if device is not None and device.axes > axes else None


def reading_periods(campaign: Campaign) -> dict[str, float]:
    """Time from one reading to the next [s] of each sensor whose readings are a series."""
    named = ((campaign.names[0] if s == RATE else s.name, s) for s in series_of(campaign))
    steps = {name: stream.spacings(campaign.slews) for name, stream in named}
    return {name: _usual(x) for name, x in steps.items() if len(x)}


def _usual(steps: np.ndarray) -> float:
    """Their median without the rounding of times read from a file: alike campaigns share code."""
    return float(f"{np.median(steps):.9g}")


def _seen_last(campaign: Campaign) -> dict[str, tuple[float, ...]]:
    """Directions and fields that direction sensors saw last, in inertial axes."""
    last, seen = campaign.slews[-1], {}
    for name, sensor in campaign.more_sensors:
        if isinstance(sensor, DirectionSensor) and sensor.reference_N is None:
            key = name if name in (last.inputs or {}) else "magnetic_field_N"
            seen[key] = tuple(reference_of(name, sensor, last)[1][-1].tolist())
    return seen


def devices_at_rest(campaign: Campaign) -> tuple[str, ...]:
    """What of a campaign's devices and changes no plan flies, or flies otherwise, in sentences.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> devices_at_rest(small_campaign())
    ()
    """
    craft = spacecraft_at(campaign, prior_mean(campaign))
    flying = "wheels" if craft.device is None else craft.device.record.name
    names = [wheel.name for wheel in campaign.wheels if wheel.state == "locked"]
    names += [name for name, x in campaign.more_sensors if not isinstance(x, _FLYING)]
    names += [x.name for x in (*campaign.actuators, *campaign.changes) if x.name != flying]
    turns = f"{flying} turn{'s' if craft.device else ''} the spacecraft, all sensors fly; "
    said = [f"{turns}left out: {', '.join(names)}"] if names else []
    told = campaign.has_commands or not craft.wheels
    return tuple(said if told else [*said, _WITHOUT_COMMANDS])


def following_plan(campaign: Campaign, wheel_momentum: np.ndarray | None = None) -> Plan:
    """A plan of one slew, yet to be chosen, that begins where a campaign ended.

    It has the campaign's telemetry period, its fixes as far apart, and the usual rests.

    `wheel_momentum` (wheels,): wheel momentum relative to the body at the campaign's end [N m s].
    It is used where no tachometer tells. None: the wheels are then taken to be at rest. Returns: it
    starts at the last star-tracker fix (no rotation from inertial axes if there is none) and with
    the last complete tachometer reading of the last slew.
    """
    campaign = campaign.without_locked_wheels()
    rows = _usual(np.concatenate([s.rate_steps for s in campaign.slews]))
    period = min((*reading_periods(campaign).values(), rows))
    attitude, told = _attitude_and_momentum(campaign.slews[-1], -1)
    momentum = (
        told if told or wheel_momentum is None else tuple(np.asarray(wheel_momentum).tolist())
    )
    base = Plan("next", (PlannedSlew((1.0, 0.0, 0.0), 1.0),), attitude, momentum)
    between, throughout = _fix_spacing(campaign)
    given: dict[str, Any] = {"telemetry_period": period, "fixes_in_motion": throughout}
    given |= {"fix_spacing": whole_periods(between, period)} if between else {}
    given |= {"first_fix": 0.0} if throughout else {}
    return replace(base, **(given | times_left_out(base, given)))


def repeating_plan(campaign: Campaign) -> Plan:
    """As `following_plan`, but it begins where the campaign began.

    It starts at the first star-tracker fix and with the first complete tachometer reading of the
    first slew.
    """
    attitude, momentum = _attitude_and_momentum(campaign.without_locked_wheels().slews[0], 0)
    return replace(following_plan(campaign), start_attitude=attitude, wheel_momentum=momentum)


def _attitude_and_momentum(slew: Slew, which: int) -> tuple[Any, tuple[float, ...]]:
    """One fix of a slew, first or last, and one complete tachometer reading.

    Without fixes no rotation from inertial axes; without readings empty.
    """
    attitude, momentum = (0.0, 0.0, 0.0, 1.0), ()
    if slew.attitude is not None and slew.fixes.any():
        attitude = tuple(slew.attitude[slew.fixes][which].tolist())
    if slew.wheel_momentum is not None:
        complete = slew.wheel_momentum[np.isfinite(slew.wheel_momentum).all(1)]
        momentum = tuple(complete[which].tolist()) if len(complete) else ()
    return attitude, momentum


def _fix_spacing(campaign: Campaign) -> tuple[float, bool]:
    """Time between fixes [s] in the last slew, 0 without two; whether it has them throughout."""
    last = campaign.slews[-1]
    times = last.time[last.fixes]
    steps = np.diff(times)
    if not len(steps):
        return 0.0, False
    spacing = float(np.median(steps))
    throughout = len(steps) > 1 and steps.max() <= NUMERICS.longest_gap_of_fixes * spacing
    return spacing, bool(throughout and np.ptp(times) > 0.5 * last.duration)


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
        it_has, has = (counted(len(x.slews), "slew") for x in (plan, campaign))
        return f"it has {it_has}, the campaign {has}"
    seen = campaign.with_body_rates
    for planned, flown in zip(plan.slews, seen.slews, strict=True):
        rate_B = _rate_B(flown, seen.gyro)
        difference = _other_rotation(planned, flown, rate_B) or _other_peak(
            planned, rate_B, seen.gyro
        )
        if difference:
            return f"{flown.name} {difference}"
    return ""


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
    filled = np.stack([bridged(slew.time, slew.time, x) for x in slew.rate.T], axis=-1)
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
    return reduce(operator.mul, Rotation.from_rotvec(steps), Rotation.identity())


def _card(mission: Mission) -> Card:
    """J and K as they are known before flight."""
    space, wheels = mission.base, len(mission.spacecraft.wheels)
    values = zip(space.names, space.units, space.mean, space.sd, strict=True)
    return parameter_card(f"Mission with {wheels} wheels; before flight:", "mean ± sd", values)


@shown_as(_card)
@dataclass(frozen=True)
class Mission:
    """A spacecraft, and what was known of its inertia tensor before flight.

    Parameters
    ----------
    spacecraft : Spacecraft
        The spacecraft as it is: J, K, hardware, and what else acts.
    prior : InertiaPrior
        The inertia tensor as the campaign states it: what was known before flight, and how well.
    known : GaussianPrior, optional
        J and K as a former result has them; None where `prior` and the rate sensor say it all.

    Examples
    --------
    >>> mission = Mission(most_like_spacecraft(), most_like_prior())
    >>> mission.theta[3].item()
    -0.0119
    """

    spacecraft: Spacecraft
    prior: InertiaPrior
    known: GaussianPrior | None = None

    @classmethod
    def of(cls, campaign: Campaign | Mission) -> Mission:
        """The mission that a campaign's hardware and prior describe.

        Parameters
        ----------
        campaign : Campaign or Mission
            What was flown; a mission is handed back.

        Returns
        -------
        Mission
            Its spacecraft has J and K at the mean of their prior, and no effects.

        Raises
        ------
        CampaignError
            If it is neither.

        Examples
        --------
        >>> from bayes_inertia.physics.small_campaign import small_campaign
        >>> Mission.of(small_campaign()).spacecraft.scale_factor
        (1.0, 1.0, 1.0)
        """
        if isinstance(campaign, Mission):
            return campaign
        require_kind(campaign, Campaign | Mission, "key mission")
        craft = spacecraft_at(campaign, prior_mean(campaign))
        return cls(craft, campaign.inertia, _known_after_changes(campaign))

    @property
    def base(self) -> ParameterSpace:
        """J and K as they are known before flight."""
        return base_space(self.prior, self.spacecraft.rate_sensor, self.known)

    @property
    def theta(self) -> np.ndarray:
        """Jxx Jyy Jzz Jxy Jxz Jyz [kg m^2] and K (6 + axes,) as a fit of the campaign names them.

        J is J_locked where the prior's tensor includes the wheels' spin.
        """
        craft = self.spacecraft
        spin = spin_tensor(craft.wheels) if self.prior.includes_wheel_spin else 0.0
        return np.array([*inertia_tensor.elements(craft.inertia_B + spin), *craft.scale_factor])

    def at_prior_mean(self) -> Mission:
        """The mission if what was known before flight were exactly right, and nothing else acted.

        Returns
        -------
        Mission
            With J and K at the mean of their prior, and without effects.

        Examples
        --------
        >>> most_like_mission().at_prior_mean().spacecraft.scale_factor
        (1.0, 1.0, 1.0)
        """
        craft, theta = self.spacecraft, np.array(self.base.mean)
        J = body_tensor(theta[:6], self.prior, craft.wheels)
        mean = replace(craft, inertia_B=J, scale_factor=tuple(theta[6:]))
        return replace(self, spacecraft=mean).without_effects()

    def without_effects(self) -> Mission:
        """The mission if nothing acted beside the wheels.

        Returns
        -------
        Mission
            The same J, K and hardware.
        """
        return replace(self, spacecraft=replace(self.spacecraft, effects=(), values={}))

    def controller(self, **settings: Any) -> Controller:
        """A controller that believes what was known before flight.

        Parameters
        ----------
        **settings : float
            Further fields of `Controller`, such as `bandwidth`.

        Returns
        -------
        Controller
            With J and K at the mean of their prior.

        Examples
        --------
        >>> most_like_mission().controller(bandwidth=0.1).bandwidth
        0.1
        """
        craft = self.at_prior_mean().spacecraft
        return Controller(craft.inertia_B, craft.scale_factor, **settings)


def most_like_mission() -> Mission:
    """A microsatellite like MOST in Ferguson's simulations (his Table 1), J known to 2 to 4 %.

    Examples
    --------
    >>> most_like_mission().spacecraft.scale_factor
    (1.01, 1.02, 0.98)
    """
    return Mission(most_like_spacecraft(), most_like_prior())
