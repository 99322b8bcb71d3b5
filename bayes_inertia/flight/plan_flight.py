"""Fly a plan: telemetry, truth and final attitude errors of slews in closed loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.sensors.momentum import MOMENTUM
from bayes_inertia.campaign.sensors.rate import RATE
from bayes_inertia.campaign.sensors.sensor_stream import SensorStream
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.campaign.slew_parts import MORE
from bayes_inertia.errors import require_kind
from bayes_inertia.flight.closed_loop import fly_slews
from bayes_inertia.flight.closed_loop_flights import closed_loop_inputs, rate_bias
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.numerics import NUMERICS
from bayes_inertia.flight.plan import Plan
from bayes_inertia.flight.planned_telemetry import (
    Readings,
    model_readings,
    planned_campaign,
    planned_paths,
    with_effect_values,
    with_noisy_inputs,
    with_readings,
)
from bayes_inertia.flight.spacecraft import Controller, Spacecraft
from bayes_inertia.maths import quaternion
from bayes_inertia.maths.values import array_dataclass, whole_number
from bayes_inertia.physics.effect import Effect, require_of_effect
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.slew_context import Trajectory
from bayes_inertia.physics.slew_input import Start


@array_dataclass
class Flight:
    """A flown plan.

    Parameters
    ----------
    campaign : Campaign
        What telemetry shows of it.
    plan : Plan
        What was flown.
    mission : Mission
        With what it was flown; its spacecraft's bias is the one that was drawn.
    final_error_B : (slews, 3) array
        Rotation vector from the target to the final attitude [rad]; NaN where effects act on a
        spacecraft that follows its plan.
    measured_error_B : (slews, 3) array
        The same from the star tracker's fixes after the slew [rad]; NaN without star tracker.
    peak_torque : (slews, wheels) array
        Largest torque as a fraction of the wheel's limit; NaN where it has none.
    peak_momentum : (slews, wheels) array
        Largest momentum as a fraction of the wheel's limit; NaN where it has none.
    truth : tuple of Trajectory
        True trajectory of each slew at the telemetry's times.
    parameters : mapping of str to float
        {name: value} of all parameters where the forward model gave readings; else empty.
    """

    campaign: Campaign
    plan: Plan
    mission: Mission
    final_error_B: np.ndarray
    measured_error_B: np.ndarray
    peak_torque: np.ndarray
    peak_momentum: np.ndarray
    truth: tuple[Trajectory, ...]
    parameters: Mapping[str, float] = field(default_factory=dict)

    @property
    def spacecraft(self) -> Spacecraft:
        """The spacecraft that flew, with its bias as drawn."""
        return self.mission.spacecraft

    @property
    def correction_slews(self) -> np.ndarray:
        """Angle (slews,) [rad] of the correction slew after each slew, by the star tracker."""
        return np.linalg.norm(self.measured_error_B, axis=1)


def require_plan(plan: Any, mission: Any) -> None:
    """Raise `CampaignError` for what is no plan, or no mission that flies it."""
    require_kind(plan, Plan, "plan", "give a Plan: read_plan reads one, paper_like_plan() is one")
    require_kind(mission, Mission, "mission", "give a Mission: Mission.of(campaign) is one")


def fly(
    plan: Plan,
    mission: Mission,
    seed: int | None,
    *,
    controller: Controller | None = None,
    name: str | None = None,
) -> Flight:
    """Fly a plan: in closed loop where wheels and a gyro of three axes close it.

    Any other spacecraft follows its plan, by what its wheels or its device would have to do for
    that; readings are those of the forward model.

    Between slews the spacecraft is brought to the last target, at rest, with the total momentum
    that the campaign began with.

    Parameters
    ----------
    plan : Plan
        What to fly.
    mission : Mission
        The spacecraft as it is, and the inertia tensor that the campaign states as known before
        flight.
    seed : int or None
        Of noise, bias and rest errors. None for a flight without any of them; the bias then is its
        prior mean.
    controller : Controller, optional
        None for one that believes the prior.
    name : str, optional
        Name of the campaign; None for the plan's.

    Returns
    -------
    Flight
        Telemetry as a campaign, and the truth.

    Raises
    ------
    CampaignError
        If the plan does not fit the spacecraft.
    EffectError
        If an effect lacks environment columns, or grows without bound together with the controller.

    Examples
    --------
    >>> from bayes_inertia.flight.mission import most_like_mission
    >>> from bayes_inertia.flight.plan import PlannedSlew
    >>> plan = Plan("one", (PlannedSlew((1., 0., 0.), 0.5),))
    >>> fly(plan, most_like_mission(), seed=None).final_error_B.round(4)[0, 0].item()
    0.005
    """
    require_plan(plan, mission)
    rng = None if seed is None else np.random.default_rng(whole_number(seed, "seed"))
    if not mission.spacecraft.flies_by_gyro:
        return _follow(plan, mission, rng, name)
    planned, loop = closed_loop_inputs(plan, mission, controller, rng, name)
    flown: Any = jax.tree.map(np.asarray, fly_slews(loop))  # a FlownSlew of numpy arrays
    _check_converged(flown, planned, mission.spacecraft.effects)
    bias = tuple(np.asarray(loop.plant.bias).tolist())
    craft = replace(mission.spacecraft, bias=bias)
    mission, each = replace(mission, spacecraft=craft), list(enumerate(planned.slews))
    slews = tuple(_telemetry(plan, craft, i, slew, flown) for i, slew in each)
    truth = tuple(_true_path(i, slew, flown) for i, slew in each)
    campaign, parameters = replace(planned, slews=slews), dict[str, float]()
    if craft.more_sensors:
        told, parameters = _readings(campaign, mission, truth, rng)
        more = {name: values for name, values in told.items() if name.startswith(MORE)}
        slews = tuple(with_readings(slew, k, more) for k, slew in enumerate(slews))
        campaign = replace(campaign, slews=slews)
    commands = [flown.command[i, : len(slew.time)] for i, slew in each]
    measured = np.full_like(flown.final_error_B, np.nan)
    if craft.star_tracker is not None:
        measured = flown.measured_error_B
    errors = flown.final_error_B, measured
    return _flight(plan, mission, campaign, errors, commands, truth, parameters)


def _follow(
    plan: Plan, mission: Mission, rng: np.random.Generator | None, name: str | None
) -> Flight:
    """A flight that follows its plan, with readings of the forward model."""
    paths = planned_paths(plan, mission.spacecraft)
    planned, truth = planned_campaign(plan, mission, name, paths), tuple(p.motion for p in paths)
    bias = rate_bias(mission.spacecraft, rng)
    craft = replace(mission.spacecraft, bias=bias)
    mission = replace(mission, spacecraft=craft)
    told, theta = _readings(planned, mission, truth, rng)
    slews = [with_readings(slew, k, told) for k, slew in enumerate(planned.slews)]
    slews = [with_noisy_inputs(slew, planned, rng) for slew in slews]
    # What effects make of the motion only readings tell.
    final = np.full((len(truth), 3), np.nan if craft.effects else 0.0)
    errors = final, np.stack([_measured_error_B(plan, k, s) for k, s in enumerate(slews)])
    campaign, commands = replace(planned, slews=tuple(slews)), [path.wheel_torque for path in paths]
    return _flight(plan, mission, campaign, errors, commands, truth, theta)


def _measured_error_B(plan: Plan, k: int, slew: Slew) -> np.ndarray:
    """Mean rotation vector (3,) from the target of slew k to the fixes after it [rad]."""
    rows = np.flatnonzero(slew.fixes)
    if slew.attitude is None or not len(rows):
        return np.full(3, np.nan)
    after = slew.attitude[rows[rows >= min(plan.fixes(k)[1][0], rows[-1])]]
    error_B = quaternion.error(jnp.asarray(plan.attitudes[k + 1]), jnp.asarray(after))
    return np.asarray(error_B).mean(axis=0)


def _readings(
    campaign: Campaign,
    mission: Mission,
    truth: Sequence[Trajectory],
    rng: np.random.Generator | None,
) -> tuple[Readings, dict[str, float]]:
    """Readings of a flight by the forward model, and its parameters.

    Errors of further sensors and of the device are drawn from their prior; without `rng` they are
    at its mean, and there is no noise.
    """
    craft = mission.spacecraft
    model = Model(campaign, craft.effects, "commanded" if craft.wheels else None)
    theta = np.array(model.space.mean if rng is None else model.draw_prior(rng, 1)[0])
    theta[: model.n_base] = mission.theta
    theta = with_effect_values(model, theta, craft.effects, craft.values)
    bias = np.zeros(model.n_bias)
    if craft.rate_sensor is not None and craft.bias is not None:
        sensor = craft.gyro
        bias = (np.array(craft.bias) - sensor.bias) / np.array(sensor.bias_sigma)
    told = model_readings(model, theta, bias, first_states(truth), rng)
    return told, dict(zip(model.space.names, theta.tolist(), strict=True))


def first_states(truth: Sequence[Trajectory]) -> Start:
    """The state at the first row of each slew, (slews, ...) in every field."""
    paths = [[getattr(path, key)[0] for path in truth] for key in Start._fields]
    return Start(*map(np.stack, paths))  # type: ignore[arg-type]


def _check_converged(flown: Any, planned: Campaign, effects: Sequence[Effect]) -> None:
    """Raise for a slew that runs away or whose relaxation did not end."""
    bad = ~np.isfinite(flown.attitude).all(axis=(1, 2))
    if effects:
        bad |= ~(flown.relaxation_change <= NUMERICS.relaxation_tolerance)
    what, first = "the closed loop is not stable with these effects", int(np.argmax(bad))
    advice = "use smaller values, or a lower controller bandwidth"
    require_of_effect(not bad.any(), planned.slews[first].name, what, advice)


def _flight(
    plan: Plan,
    mission: Mission,
    campaign: Campaign,
    errors: tuple[np.ndarray, np.ndarray],
    commands: Sequence[np.ndarray],
    truth: tuple[Trajectory, ...],
    parameters: Mapping[str, float],
) -> Flight:
    """The flight with the peaks of its wheels; `errors` of the attitude: final and measured."""
    craft = mission.spacecraft
    torque = _peaks(commands, craft, "max_torque")
    momentum = _peaks([path.wheel_momentum for path in truth], craft, "max_momentum")
    return Flight(campaign, plan, mission, *errors, torque, momentum, truth, parameters)


def _telemetry(plan: Plan, craft: Spacecraft, i: int, slew: Slew, flown: Any) -> Slew:
    """Telemetry of slew i."""
    n = len(slew.time)
    fixes = None if craft.star_tracker is None else plan.at_fixes(i, flown.fixes[i, :n])
    return replace(
        slew,
        rate=_where_read(RATE, slew, flown.rate[i, :n]),
        attitude=fixes,
        wheel_torque=flown.command[i, :n] if craft.wheels else None,
        wheel_momentum=_where_read(MOMENTUM, slew, flown.momentum[i, :n]),
    )


def _where_read(stream: SensorStream, slew: Slew, values: np.ndarray) -> np.ndarray | None:
    """Values (rows, columns) where a planned slew has readings, NaN elsewhere; None without any."""
    planned = stream.of(slew)
    return None if planned is None else np.where(np.isfinite(planned), values, np.nan)


def _true_path(i: int, slew: Slew, flown: Any) -> Trajectory:
    """True trajectory of slew i at the telemetry's times."""
    n = len(slew.time)
    no_own_states: Any = np.zeros((n, 0))
    time: Any = slew.time
    attitude, rate_B = flown.attitude[i, :n], flown.rate_B[i, :n]
    return Trajectory(time, attitude, rate_B, flown.wheel_momentum[i, :n], no_own_states)


def _peaks(histories: Sequence[Any], craft: Spacecraft, limit: str) -> np.ndarray:
    """Largest magnitude (slews, wheels) in each slew, as a fraction of the wheels' limit."""
    limits = np.array([getattr(wheel, limit) or np.nan for wheel in craft.wheels])
    return np.stack([np.abs(history).max(axis=0) for history in histories]) / limits
