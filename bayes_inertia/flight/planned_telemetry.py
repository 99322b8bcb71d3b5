"""A plan as the campaign that it will be before anything has been flown; readings of a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.spatial.transform import Rotation

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import RateSensor, StarTracker, require_key
from bayes_inertia.campaign.inputs import InputStream
from bayes_inertia.campaign.sensors.momentum import MOMENTUM
from bayes_inertia.campaign.sensors.sensor_stream import SensorStream
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.campaign.slew_parts import MORE
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.numerics import NUMERICS as FLIGHT
from bayes_inertia.flight.plan import Plan, angle_and_rate
from bayes_inertia.flight.planned_motion import (
    PlanStart,
    RigidBody,
    driven_path,
    plan_start,
    rigid_body,
)
from bayes_inertia.flight.spacecraft import Spacecraft
from bayes_inertia.flight.steering import FlyingDevice
from bayes_inertia.maths.device_arrays import repeated
from bayes_inertia.maths.jax_settings import require_usable_jax
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.numerics import NUMERICS
from bayes_inertia.physics.prediction import predict_all
from bayes_inertia.physics.processes import Process, RowTimes, StateSpace
from bayes_inertia.physics.slew_context import Trajectory
from bayes_inertia.physics.slew_input import Start
from bayes_inertia.physics.stated_noise import stated_noise, stated_reading_noise


class PlannedPath(NamedTuple):
    """The planned motion of one slew at the rows of its telemetry, and what drives it (numpy)."""

    motion: Trajectory  # with the input of the device, by its name
    wheel_torque: np.ndarray  # (rows, wheels) on the wheels, held from row to row [N m]


def planned_campaign(
    plan: Plan,
    mission: Mission,
    name: str | None = None,
    paths: Sequence[PlannedPath] | None = None,
) -> Campaign:
    """The plan as a campaign that has not been flown: planned motion, and what devices do for it.

    Wheels that a controller drives by a gyro have no torques: it finds them. `paths`: those of
    `planned_paths`, where they are known already. Returns: one slew for each slew of the plan, with
    environment columns where the plan has an orbit.

    Examples
    --------
    >>> from bayes_inertia.flight.mission import most_like_mission
    >>> from bayes_inertia.flight.plan import paper_like_plan
    >>> len(planned_campaign(paper_like_plan(), most_like_mission()).slews)
    5
    """
    require_usable_jax()
    craft, motions = mission.spacecraft, zip(*_planned_motion(plan), strict=True)
    slews = tuple(_planned_slew(plan, craft, i, *motion) for i, motion in enumerate(motions))
    if not craft.flies_by_gyro:
        paths = planned_paths(plan, craft) if paths is None else paths
        each = zip(slews, paths, strict=True)
        slews = tuple(_driven(plan, craft, i, *pair) for i, pair in enumerate(each))
    return Campaign(
        name or plan.name,
        mission.prior,
        craft.wheels,
        craft.rate_sensor,
        craft.star_tracker,
        slews,
        more_sensors=craft.more_sensors,
        actuators=(craft.device.record,) if craft.device else (),
        names=craft.names,
        reference=craft.reference,
        prior=mission.known,
    )


def _planned_slew(
    plan: Plan, craft: Spacecraft, i: int, attitude: np.ndarray, rate_B: np.ndarray
) -> Slew:
    """Slew i, from its padded attitude (rows, 4) and body rate (rows, 3) [rad/s]."""
    slew, time, wheels = plan.slews[i], plan.times(i), craft.wheels
    attitude, rate_B = attitude[: len(time)], rate_B[: len(time)]
    optional = _surroundings(plan, craft, i, time)
    if craft.star_tracker is not None:
        optional["attitude"] = attitude
    still = np.zeros((len(time), len(wheels)))
    planned = Slew(
        name=f"slew {i + 1}",
        start=plan.starts[i],
        time=time,
        wheel_torque=still if wheels else None,
        wheel_momentum=_by_tachometers(plan, craft, still),
        axis_B=slew.axis_B,
        angle=slew.angle,
        **optional,
    )

    def seen(name: str, sensor: Any) -> np.ndarray:
        """About what a sensor will read (n, columns), NaN in rows without a reading."""
        if isinstance(sensor, StarTracker):
            return plan.at_fixes(i, attitude)
        if isinstance(sensor, RateSensor):
            readings = rate_B @ sensor.axes.T / np.array(sensor.scale_factor)
        else:
            given = (planned.inputs or {}).get(name)
            seen_N: Any = sensor.reference_N
            if seen_N is None:
                seen_N = planned.magnetic_field_N if given is None else given.values[0]
            readings = Rotation.from_quat(attitude).inv().apply(seen_N)
        return _in_read_rows(plan, craft, name, readings)

    more = {name: seen(name, sensor) for name, sensor in craft.more_sensors}
    rate = seen(craft.names[0], craft.rate_sensor) if craft.rate_sensor else None
    return replace(planned, rate=rate, more=more or None)


def _surroundings(plan: Plan, craft: Spacecraft, i: int, time: np.ndarray) -> dict[str, Any]:
    """Environment of slew i (rows,), and what its direction sensors look at."""
    found: dict[str, Any] = {}
    for key, seen_N in craft.seen_N.items():
        if key == "magnetic_field_N":
            found[key] = np.tile(seen_N, (len(time), 1))
        else:
            stream = InputStream(np.zeros(1), np.array([seen_N]))
            found["inputs"] = {**found.get("inputs", {}), key: stream}
    if plan.orbit is not None:
        found |= plan.orbit.environment(plan.starts[i] + time)._asdict()
    return found


def _in_read_rows(plan: Plan, craft: Spacecraft, name: str, values: np.ndarray) -> np.ndarray:
    """Values (rows, columns) where a sensor is read, NaN in other rows."""
    period = craft.periods.get(name, plan.telemetry_period)
    every = max(1, round(period / plan.telemetry_period))
    return np.where((np.arange(len(values)) % every == 0)[:, None], values, np.nan)


def _by_tachometers(plan: Plan, craft: Spacecraft, momentum: np.ndarray) -> np.ndarray | None:
    """Momentum (rows, wheels) of wheels with a tachometer where that is read; None without any."""
    sensed = [wheel.momentum_sigma is not None for wheel in craft.wheels]
    told = np.where(sensed, momentum, np.nan)
    return _in_read_rows(plan, craft, MOMENTUM.name, told) if any(sensed) else None


@jax.jit
def _driven_paths(
    body: RigidBody, origin: PlanStart, time: Array, attitude: Array, rate_B: Array
) -> tuple[Trajectory, Array, Array]:
    """`driven_path` of all slews; compiled once, for a design flies a plan with many truths."""
    return jax.vmap(partial(driven_path, body, origin))(time, attitude, rate_B)


def planned_paths(plan: Plan, craft: Spacecraft) -> tuple[PlannedPath, ...]:
    """The planned motion of each slew, and what drives it."""
    body, start = rigid_body(craft), plan_start(plan, len(craft.wheels))
    every, times = _planned_motion(plan), [plan.times(i) for i in range(len(plan.slews))]
    n, counts = every[0].shape[1], [len(time) for time in times]
    attitude, rate_B = (
        np.stack([repeated(x[:count], n, 0) for x, count in zip(rows, counts, strict=True)])
        for rows in every
    )
    time = np.stack([repeated(of_slew, n, 0) for of_slew in times])
    motion, torque, wanted_B = _driven_paths(body, start, time, attitude, rate_B)
    if craft.device is not None:
        _require_reached(craft.device, motion, wanted_B)
    path = PlannedPath(motion, torque)
    each = enumerate(counts)
    return tuple(jax.tree.map(lambda x, k=k, n=n: np.asarray(x[k, :n]), path) for k, n in each)


def _require_reached(device: FlyingDevice, motion: Trajectory, wanted_B: Any) -> None:
    """`CampaignError` where a device cannot follow the motion."""
    unit = "N m s" if device.carries_momentum else "N m"
    wanted = np.reshape(np.asarray(wanted_B), (-1, 3))
    largest = float(np.linalg.norm(wanted, axis=1).max())
    name = device.record.name
    inputs = jnp.reshape((motion.inputs or {})[name], (-1, len(device.start)))
    missing = float(np.abs(np.asarray(device.array.given_B(inputs)) - wanted).max())
    what = f"it gives {missing:.3g} less than the {largest:.3g} {unit} that slews ask for"
    advice = "turn more slowly, or by smaller angles"
    require_key(missing <= FLIGHT.unreached * largest, f"actuators.{name}", what, advice)


def _driven(plan: Plan, craft: Spacecraft, i: int, slew: Slew, path: PlannedPath) -> Slew:
    """Planned slew i with what drives it, and fixes only where there will be some."""
    inputs: dict[str, Any] = dict(slew.inputs or {})
    changed: dict[str, Any] = {}
    if slew.wheel_torque is not None:
        told = _by_tachometers(plan, craft, np.asarray(path.motion.wheel_momentum))
        changed = {"wheel_torque": path.wheel_torque, "wheel_momentum": told}
    if (device := craft.device) is not None:
        values: Any = (path.motion.inputs or {})[device.record.name]
        form = "line" if device.carries_momentum else "hold"
        if device.between == "on_time":
            values, form = values * plan.telemetry_period, "on_time"
        inputs[device.record.name] = InputStream(slew.time, values, form)  # type: ignore[arg-type]
    if slew.attitude is not None:
        changed["attitude"] = plan.at_fixes(i, slew.attitude)
    return replace(slew, inputs=inputs or None, **changed)


def _planned_motion(plan: Plan) -> tuple[np.ndarray, np.ndarray]:
    """Attitude (slews, rows, 4) and body rate (slews, rows, 3) [rad/s], padded at the end."""
    longest = max(len(plan.times(i)) for i in range(len(plan.slews)))
    n_rows = -(-longest // NUMERICS.row_multiple) * NUMERICS.row_multiple
    time = plan.telemetry_period * np.arange(n_rows) - plan.rest_before
    keys = ("angle", "rate", "acceleration")
    settings = [np.array([[getattr(slew, key)] for slew in plan.slews]) for key in keys]
    smooth = np.array([[slew.profile == "smooth"] for slew in plan.slews])
    angle, rate = jax.jit(angle_and_rate)(*settings, smooth, time)
    axes_B = np.array([slew.axis_B for slew in plan.slews])[:, None]
    turns, starts = np.asarray(angle)[..., None] * axes_B, Rotation.from_quat(plan.attitudes[:-1])
    attitude = [(q * Rotation.from_rotvec(x)).as_quat() for q, x in zip(starts, turns, strict=True)]
    return np.stack(attitude), np.asarray(rate)[..., None] * axes_B


Readings = Mapping[str, list[tuple[np.ndarray, np.ndarray]]]


def model_readings(
    model: Model,
    theta: np.ndarray,
    bias: np.ndarray,
    starts: Start,
    rng: np.random.Generator | None,
) -> Readings:
    """Of each channel, by the field of `Slew`: times and readings of each slew, with noise.

    `theta` (d,); `bias` (axes,) whitened; `rng`: None for no noise. Readings stand where the
    model's campaign has some. Noise is that of the sensors, what is stated to wander included:
    `with_noisy_inputs` draws the rest.
    """
    devices: tuple[Any, ...] = model.campaign.actuators
    exact = (replace(x, angle_sigma=0.0) if hasattr(x, "angle_sigma") else x for x in devices)
    campaign = replace(model.campaign, actuators=tuple(exact))
    arrays = model.data.arrays._replace(reference=starts)
    data = replace(model.data, arrays=arrays)
    local = _stated_coefficients(model, rng)
    seen = jax.jit(predict_all, static_argnums=0)(model.structure, theta, local, bias, data)
    told = {}
    for channel, given, values in zip(model.channels, arrays.telemetry.readings, seen, strict=True):
        valid, row = np.asarray(given.valid), np.asarray(given.row)
        noise = channel.noise(campaign, theta, "commanded")
        unit = np.zeros(valid.shape) if rng is None else rng.standard_normal(valid.shape)
        change = channel.drawn(noise, unit * white_share(campaign, channel.stream))
        if (wander := wandering_noise(campaign, channel.stream, rng)) is not None:
            rows = [x[np.minimum(at, len(x) - 1)] for x, at in zip(wander, row, strict=True)]
            change = change + np.stack(rows)
        noisy = np.asarray(channel.moved(np.asarray(values), change))
        there = valid.any(axis=-1)
        told[channel.stream.field or MORE + channel.name] = [
            (slew.time[row[k][there[k]]], noisy[k][there[k]])
            for k, slew in enumerate(model.campaign.slews)
        ]
    return told


def _stated_coefficients(model: Model, rng: np.random.Generator | None) -> np.ndarray:
    """Whitened nuisances (slews, n_local): drawn of what trackers are stated to wander, else 0."""
    structure, stated = model.structure, stated_noise(model.campaign, ())
    local, start = np.zeros((model.n_slews, structure.n_local)), structure.n_start
    for effect, count in zip(structure.effects, structure.coefficients, strict=False):
        if rng is not None and effect in stated:
            local[:, start : start + count] = rng.standard_normal((len(local), count))
        start += count
    return local


def white_share(campaign: Campaign, stream: SensorStream) -> np.ndarray | float:
    """Share (components,) of the sigma of one reading that is white noise."""
    correlated = stream.correlated(campaign)
    return 1.0 if correlated is None else np.sqrt(1.0 - np.array(correlated.share))


def wandering_noise(
    campaign: Campaign,
    stream: SensorStream,
    rng: np.random.Generator | None,
    draws: tuple[int, ...] = (),
) -> list[np.ndarray] | None:
    """What the noise of one sensor holds beside white noise, (rows, ..., components) of each slew.

    Of each draw one process that goes on through the campaign; None without any. A random walk is
    zero in the middle of the campaign: the bias is that of then.
    """
    every = [x for x in stated_reading_noise(campaign, ()) if x.channel == stream.name]
    if (correlated := stream.correlated(campaign)) is not None:
        size = np.sqrt(correlated.share) * np.array(stream.sigma(campaign), float)
        every.append(Process(stream.name, size, np.array(correlated.time)))
    if rng is None or not every:
        return None
    clock = [slew.start + slew.time - slew.time[0] for slew in campaign.slews]
    times = np.concatenate([*clock, [0.5 * sum(campaign.span)]])
    shape = (*draws, len(stream.components(campaign)))
    drawn = np.sum([_drawn(process, times, shape, rng) for process in every], axis=0)
    return np.split(drawn[:-1], np.cumsum([len(x) for x in clock])[:-1])


def _drawn(
    process: Process, times: np.ndarray, shape: tuple[int, ...], rng: np.random.Generator
) -> np.ndarray:
    """A process (n, ..., components) at times (n,) [s]; a walk is zero at the last one."""
    order = np.argsort(times, kind="stable")
    rows = RowTimes(times[order][None], np.zeros(1))
    states = StateSpace(*(np.asarray(x)[0] for x in process.in_rows(rows, np.ones(shape[-1]))))
    values = rng.standard_normal((len(times), *shape))
    values[0] *= np.sqrt(states.start)
    for k in range(len(times) - 1):
        values[k + 1] = states.decay[k] * values[k] + np.sqrt(states.fresh[k]) * values[k + 1]
    drawn = np.empty_like(values)
    drawn[order] = values
    return drawn - drawn[-1] if process.walks else drawn


def with_noisy_inputs(slew: Slew, campaign: Campaign, rng: np.random.Generator | None) -> Slew:
    """A slew whose devices' inputs are told with the noise that is stated of them."""
    inputs = dict(slew.inputs or {})
    for device in campaign.actuators:
        sigma = getattr(device, "angle_sigma", 0.0)
        if rng is not None and sigma:
            told = inputs[device.name]
            error = sigma * rng.normal(size=told.values.shape)
            inputs[device.name] = replace(told, values=told.values + error)
    return replace(slew, inputs=inputs or None)


def with_effect_values(
    model: Model,
    theta: np.ndarray,
    effects: Sequence[Effect],
    values: Mapping[str, Mapping[str, Any]],
) -> np.ndarray:
    """theta (d,) with effects as strong as {effect: {parameter: value}} says."""
    theta = theta.copy()
    for effect in effects:
        told, parameters = values[effect.name], effect.parameters(model.campaign)
        parts = [np.ravel(told[p.name]) for p in parameters]
        theta[model.space.slice_of(effect.name)] = np.concatenate(parts)
    return theta


def with_readings(slew: Slew, k: int, readings: Readings) -> Slew:
    """Slew k with these readings in place of its own."""
    fields: dict[str, Any] = {}
    more = dict(slew.more or {})
    for name, told in readings.items():
        time, values = told[k]
        if not len(time):
            continue
        column = np.full((len(slew.time), values.shape[1]), np.nan)
        column[np.searchsorted(slew.time, time)] = values
        (more if name.startswith(MORE) else fields)[name.removeprefix(MORE)] = column
    return replace(slew, **fields, more=more or None)
