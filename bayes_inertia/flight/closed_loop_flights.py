"""Flights in closed loop: their inputs as arrays, and how each draw of J and K would end.

A correction slew is the rotation between the attitude that the fast slew reached and its target, as
the star tracker sees it afterwards. It is largely the error of the controller's scale factors times
the slew's angle: `bayes_inertia.flight.closed_loop` says why.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.spatial.transform import Rotation

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import Numbers, axes_to_body
from bayes_inertia.campaign.sensors.rate import RATE
from bayes_inertia.campaign.slew import Slew, between_fix_groups
from bayes_inertia.flight.closed_loop import (
    ClosedLoop,
    ControlLaw,
    Plant,
    SensorNoise,
    SlewSchedule,
    fly_slew,
)
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.numerics import NUMERICS
from bayes_inertia.flight.plan import Plan
from bayes_inertia.flight.planned_motion import plan_start
from bayes_inertia.flight.planned_telemetry import planned_campaign, wandering_noise, white_share
from bayes_inertia.flight.spacecraft import Controller, Spacecraft, allocation, body_tensor
from bayes_inertia.maths.device_arrays import on_device, repeated
from bayes_inertia.maths.kept_programs import KeptProgram
from bayes_inertia.physics.channels import channels_of
from bayes_inertia.physics.effect import ActiveEffects, Effect, require_of_effect
from bayes_inertia.physics.integration_plan import integration_plan
from bayes_inertia.physics.packing import pack, with_longer_grids
from bayes_inertia.physics.slew_input import SlewInput, Start


def closed_loop_inputs(
    plan: Plan,
    mission: Mission,
    controller: Controller | None = None,
    rng: np.random.Generator | None = None,
    name: str | None = None,
) -> tuple[Campaign, ClosedLoop]:
    """The plan as a campaign that has not been flown, and the closed loop of all its slews.

    `mission`: with what. If its spacecraft states no rate bias, one is drawn from the sensor's
    prior. `rng`: of bias, rest errors and noise, drawn in this order; None for none of them.

    Examples
    --------
    >>> from bayes_inertia.flight.mission import most_like_mission
    >>> from bayes_inertia.flight.plan import PlannedSlew
    >>> plan = Plan("one", (PlannedSlew((1., 0., 0.), 0.5),))
    >>> closed_loop_inputs(plan, most_like_mission())[1].schedule.angle.tolist()
    [0.5]
    """
    craft, controller = mission.spacecraft, controller or mission.controller()
    planned = planned_campaign(plan, mission, name)
    grids, n_rows, substeps = integration_grid(planned, craft.effects)
    bias = rate_bias(craft, rng)
    starts = start_states(plan, craft, controller, rng)
    tracked = craft.star_tracker is not None
    schedules = [slew_schedule(plan, i, n_rows, tracked=tracked) for i in range(len(plan.slews))]
    return planned, ClosedLoop(
        slew=grids,
        schedule=stacked_pytrees(schedules),
        plant=Plant(
            jnp.asarray(craft.inertia_B),
            jnp.asarray(craft.scale_factor),
            jnp.asarray(bias),
            jnp.asarray(craft.gyro.axes),
            starts,
        ),
        law=control_law(craft, controller, plan.telemetry_period),
        noise=sensor_noise(planned, controller, plan, n_rows, rng),
        active=craft.active_effects,
        substeps=substeps,
    )


def integration_grid(campaign: Campaign, effects: Sequence[Effect]) -> tuple[SlewInput, int, int]:
    """The grids that a `Model` of the flown campaign will integrate on.

    `campaign`: the plan as a campaign that has not been flown. Returns grids and environment with a
    leading axis of slews; telemetry rows, padded; integration steps a row.
    """
    for effect in effects:
        for column in effect.needs:
            known = all(getattr(slew, column) is not None for slew in campaign.slews)
            advice = "give the plan an [orbit], or leave the effect out"
            require_of_effect(known, effect, f"needs {column}", advice)
    step = integration_plan(campaign, effects, "commanded").spacing
    arrays = pack(campaign, channels_of(campaign, "commanded"), max_step=step)
    n_rows = arrays.telemetry.sample.shape[1]
    substeps = int(arrays.telemetry.sample[0, 1])

    def longer(rows: Array) -> Array:
        return on_device(repeated(np.asarray(rows), n_rows * substeps))

    return with_longer_grids(arrays.slews, longer), n_rows, substeps


def stacked_pytrees(parts: Sequence[Any]) -> Any:
    """Pytrees of one structure as one pytree, with a new leading axis.

    Examples
    --------
    >>> stacked_pytrees([{"a": 1.0}, {"a": 2.0}])["a"].tolist()
    [1.0, 2.0]
    """
    return jax.tree.map(lambda *x: np.stack(x), *parts)


def slew_schedule(plan: Plan, i: int, n_rows: int, *, tracked: bool) -> SlewSchedule:
    """Slew i of a plan as the controller is told to fly it."""
    slew, time = plan.slews[i], plan.times(i)
    before, after = plan.fixes(i)
    gain, weight = np.zeros(n_rows), np.zeros(n_rows)
    if tracked:
        gain[before] = 1.0 / np.arange(1, len(before) + 1)
        weight[after] = 1.0 / len(after)
    return SlewSchedule(
        start_attitude=jnp.asarray(plan.attitudes[i]),
        axis_B=jnp.asarray(slew.axis_B),
        angle=jnp.asarray(slew.angle),
        rate=jnp.asarray(slew.rate),
        acceleration=jnp.asarray(slew.acceleration),
        smooth=jnp.asarray(slew.profile == "smooth"),
        motion_start=jnp.asarray(plan.rest_before),
        n_rows=jnp.asarray(len(time)),
        time=jnp.asarray(np.concatenate([time, np.full(n_rows - len(time), time[-1])])),
        fix_gain=jnp.asarray(gain),
        final_fix_weight=jnp.asarray(weight),
    )


def start_states(
    plan: Plan,
    spacecraft: Spacecraft,
    controller: Controller,
    rng: np.random.Generator | None = None,
) -> Start:
    """Start states of all slews: at the last target, with the campaign's first total momentum.

    `controller`: says how still and how well aimed the rest before a slew is.
    """
    G, attitudes = spacecraft.wheel_axes_B, Rotation.from_quat(plan.attitudes[:-1])
    h = plan_start(plan, len(spacecraft.wheels)).wheel_momentum
    total_N = attitudes[0].apply(G @ h)  # scipy's rotation takes body vectors to inertial ones
    left = attitudes.apply(total_N, inverse=True) - G @ h
    momentum = h + left @ allocation(spacecraft.wheels).T
    shape = (2, len(plan.slews), 3)
    rest_errors = np.zeros(shape) if rng is None else rng.normal(size=shape)
    aimed = attitudes * Rotation.from_rotvec(controller.rest_attitude_sigma * rest_errors[1])
    return Start(controller.rest_rate_sigma * rest_errors[0], aimed.as_quat(), momentum)


def rate_bias(spacecraft: Spacecraft, rng: np.random.Generator | None = None) -> Numbers:
    """The rate bias of one campaign.

    `rng`: draws a bias that is not stated; None for the mean of the sensor's prior. Returns
    [rad/s].

    Examples
    --------
    >>> from bayes_inertia.flight.spacecraft import most_like_spacecraft
    >>> rate_bias(most_like_spacecraft())
    (0.0, 0.0, 0.0)
    """
    sensor = spacecraft.rate_sensor
    if sensor is None:
        return ()
    if spacecraft.bias is not None:
        return spacecraft.bias
    if rng is None:
        return sensor.bias
    return tuple(rng.normal(sensor.bias, sensor.bias_sigma).tolist())


def sensor_noise(
    planned: Campaign,
    controller: Controller,
    plan: Plan,
    n_rows: int,
    rng: np.random.Generator | None = None,
    draws: int | None = None,
) -> SensorNoise:
    """Noise of the gyro, the star tracker and the tachometers, by slew.

    `planned`: its slews are those that are flown. `controller`: says how long readings at rest are
    averaged for the bias. `draws`: so many flights of its only slew, in place of slews.
    """
    sensor, tracker, wheels = planned.gyro, planned.star_tracker, planned.wheels
    batch = len(planned.slews) if draws is None else draws

    def white(*shape: int) -> np.ndarray:
        return np.zeros((batch, *shape)) if rng is None else rng.normal(size=(batch, *shape))

    momentum = white(n_rows, len(wheels)) * np.array([w.momentum_sigma or 0.0 for w in wheels])
    attitude = np.zeros((batch, n_rows, 3))
    if tracker is not None:
        boresight_B = np.array(tracker.boresight_B)
        rotation = white(n_rows, 3)
        roll = (rotation @ boresight_B)[..., None] * boresight_B
        attitude = tracker.sigma_cross * (rotation - roll) + tracker.sigma_roll * roll
    readings = max(1.0, controller.snapshot_time / plan.telemetry_period)
    rate = white(n_rows, 3) * (white_share(planned, RATE) * np.array(sensor.sigma))
    snapshot = white(3) * np.array(sensor.sigma) / math.sqrt(readings)
    many = () if draws is None else (draws,)
    if (wander := wandering_noise(planned, RATE, rng, many)) is not None:
        for k, values in enumerate(wander if draws is None else np.moveaxis(wander[0], 1, 0)):
            rate[k, : len(values)] += values
            snapshot[k] += values[0]
    if rng is not None and tracker is not None and tracker.low_frequency_sigma:
        for k in range(batch):
            group = _fix_groups(plan, planned.slews[k if draws is None else 0])
            offsets = tracker.low_frequency_sigma * rng.normal(size=(group.max() + 1, 3))
            attitude[k, : len(group)] += offsets[group]
    return SensorNoise(*map(jnp.asarray, (rate, momentum, attitude, snapshot)))


def _fix_groups(plan: Plan, slew: Slew) -> np.ndarray:
    """Of each row (n,) of a planned slew: the group of fixes that it belongs to."""
    fixed = np.isin(np.arange(len(slew.time)), plan.fix_rows(plan.starts.index(slew.start)))
    return np.searchsorted(between_fix_groups(slew, fixed), slew.time)


def control_law(spacecraft: Spacecraft, controller: Controller, period: float) -> ControlLaw:
    """The controller as arrays, for a spacecraft's hardware.

    `spacecraft`: wheels and rate sensor; its true J and K are not used. `period`: how long each
    command is held [s]; the loop is as much slower as that takes to be stable.

    Examples
    --------
    >>> from bayes_inertia.flight.spacecraft import most_like_spacecraft
    >>> control_law(most_like_spacecraft(), Controller(np.eye(3)), 0.25).max_torque.tolist()
    [0.02, 0.02, 0.02]
    """
    G, sensor = spacecraft.wheel_axes_B, spacecraft.gyro
    bandwidth = min(controller.bandwidth, NUMERICS.phase_of_period / period)
    return ControlLaw(
        inertia_B=jnp.asarray(controller.inertia_B),
        scale_factor=jnp.asarray(controller.scale_factor),
        rate_axes_inverse=jnp.asarray(axes_to_body(sensor.axes)),
        wheel_axes_B=jnp.asarray(G),
        allocation=jnp.asarray(allocation(spacecraft.wheels)),
        spin_inertia=jnp.asarray([w.spin_inertia for w in spacecraft.wheels]),
        max_torque=jnp.asarray([w.max_torque or NUMERICS.no_limit for w in spacecraft.wheels]),
        max_momentum=jnp.asarray([w.max_momentum or NUMERICS.no_limit for w in spacecraft.wheels]),
        period=jnp.asarray(period),
        stiffness=jnp.asarray(bandwidth**2),
        damping=jnp.asarray(2.0 * controller.damping * bandwidth),
        rate_range=jnp.asarray(sensor.range or NUMERICS.no_limit),
    )


def predict_final_errors(
    thetas: np.ndarray,
    plan: Plan,
    mission: Mission,
    controller: Controller,
    *,
    index: int = 0,
    seed: int | None = None,
    values: Mapping[str, Mapping[str, np.ndarray]] | None = None,
) -> np.ndarray:
    """Final attitude error of one slew if each draw were the truth; the controller stays the same.

    `thetas` (n, 9): Jxx Jyy Jzz Jxy Jxz Jyz [kg m^2] and K of each draw, such as draws of a
    posterior. J is J_locked where the mission's prior says so. `mission`: sensors, wheels and
    effects; its own J and K are not used. `seed`: of noise, bias and rest errors; None for none.
    `values`: {effect: {parameter: (n, ...)}}, the effects' parameters in each draw; None for the
    spacecraft's own in all draws. Returns (n, 3): rotation vectors from the target to the final
    attitude, in body axes [rad].

    Examples
    --------
    >>> from bayes_inertia.flight.mission import most_like_mission
    >>> from bayes_inertia.flight.plan import PlannedSlew
    >>> plan = Plan("one", (PlannedSlew((1., 0., 0.), 0.5),))
    >>> draws = np.array([[1., 1., 1., 0., 0., 0., 1.02, 1., 1.]])
    >>> errors = predict_final_errors(draws, plan, most_like_mission(), Controller(np.eye(3)))
    >>> errors.round(4)[0, 0].item()
    0.01
    """
    thetas = np.atleast_2d(np.asarray(thetas, dtype=float))
    rng = None if seed is None else np.random.default_rng(seed)
    craft, n = mission.spacecraft, len(thetas)
    planned = planned_campaign(plan, mission).subset([index])
    grids, n_rows, substeps = integration_grid(planned, craft.effects)
    plant = _plants(thetas, plan, mission, controller, index, rng)
    tracked = craft.star_tracker is not None
    active = _active_in_draws(values, mission, n)
    errors = _final_errors(
        _Flights(active.effects, substeps),
        jax.tree.map(lambda x: x[0], grids),
        slew_schedule(plan, index, n_rows, tracked=tracked),
        plant,
        control_law(craft, controller, plan.telemetry_period),
        sensor_noise(planned, controller, plan, n_rows, rng, n if rng else 1),
        active.values,
    )
    return np.asarray(errors)


def predict_correction_slew(
    thetas: np.ndarray, plan: Plan, mission: Mission, controller: Controller, **options: Any
) -> np.ndarray:
    """Angle of the correction slew needed after one slew if each draw were the truth.

    `thetas` (n, 9): Jxx Jyy Jzz Jxy Jxz Jyz [kg m^2] and K of each draw. `mission`: sensors, wheels
    and effects; its own J and K are not used. Returns (n,) [rad].
    """
    errors = predict_final_errors(thetas, plan, mission, controller, **options)
    return np.linalg.norm(errors, axis=-1)


def _plants(
    thetas: np.ndarray,
    plan: Plan,
    mission: Mission,
    controller: Controller,
    index: int,
    rng: np.random.Generator | None,
) -> Plant:
    """The spacecraft (n on a leading axis) that the draws describe, before slew `index`."""
    craft, n = mission.spacecraft, len(thetas)
    J = body_tensor(thetas[:, :6], mission.prior, craft.wheels)
    bias = np.stack([rate_bias(craft, rng) for _ in range(n)])
    each = [start_states(plan, craft, controller, rng) for _ in range(n if rng else 1)]
    starts = stacked_pytrees([jax.tree.map(lambda x: x[index], start) for start in each])
    starts = jax.tree.map(lambda x: jnp.broadcast_to(x, (n, *x.shape[1:])), starts)
    axes = jnp.broadcast_to(craft.gyro.axes, (n, 3, 3))
    inertia_B, scale_factor, true_bias = map(jnp.asarray, (J, thetas[:, 6:9], bias))
    return Plant(inertia_B, scale_factor, true_bias, axes, starts)


def _active_in_draws(
    values: Mapping[str, Mapping[str, np.ndarray]] | None, mission: Mission, n: int
) -> ActiveEffects:
    """What else acts, its parameters with a leading axis of n draws."""
    craft = mission.spacecraft
    if values is None:
        return jax.tree.map(lambda x: jnp.broadcast_to(x, (n, *x.shape)), craft.active_effects)
    drawn = {name: dict(by_parameter) for name, by_parameter in values.items()}
    return ActiveEffects(craft.effects, jax.tree.map(jnp.asarray, drawn))


class _Flights(NamedTuple):
    """What decides, with the shapes of arrays, the code of many flights of one slew."""

    effects: tuple[Effect, ...]
    substeps: int


@KeptProgram
def _final_errors(flights: _Flights, slew, schedule, plants, law, noise, values):
    """Final errors (n, 3) [rad] of all draws; noise of one draw serves all."""

    def of_draw(plant, values, noise):
        active = ActiveEffects(flights.effects, values)
        loop = ClosedLoop(slew, schedule, plant, law, noise, active, flights.substeps)
        return fly_slew(loop).final_error_B

    if len(noise.rate) == 1:
        shared = jax.tree.map(lambda x: x[0], noise)
        return jax.vmap(of_draw, in_axes=(0, 0, None))(plants, values, shared)
    return jax.vmap(of_draw)(plants, values, noise)
