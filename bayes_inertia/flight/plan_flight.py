"""Closed-loop slews: fly a plan with a known spacecraft, and predict the correction slew that a controller will need.

A correction slew is the rotation between the attitude that the fast slew reached and its target, as the star
tracker sees it afterwards. Here it is largely the error of the controller's scale factors times the slew's angle:
`bayes_inertia.flight.closed_loop` says why.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.inertia_prior import InertiaPrior
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.errors import CampaignError, EffectError
from bayes_inertia.flight.closed_loop import (
    TOLERANCE,
    Control,
    Flown,
    Noise,
    Script,
    Truth,
    fly_slew,
    fly_slews,
)
from bayes_inertia.flight.plan import Plan, angle_and_rate
from bayes_inertia.flight.spacecraft import Controller, Spacecraft, without_spin
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.values import Vector, array_dataclass
from bayes_inertia.physics.active_effects import ActiveEffects
from bayes_inertia.physics.effect import Effect, Trajectory
from bayes_inertia.physics.packing import pack
from bayes_inertia.physics.simulator import SlewInput, Start


@array_dataclass
class Flight:
    """A flown plan.

    Attributes
    ----------
    campaign : what telemetry shows of it. plan, spacecraft : what was flown with what (`spacecraft.bias` as drawn).
    final_error_B : (slews, 3) rotation vector from the target to the final attitude [rad].
    seen_error_B : the same from the star tracker's fixes after the slew (NaN without star tracker).
    peak_torque, peak_momentum : (slews, wheels) as a fraction of the wheel's limit (NaN where it has none).
    truth : true trajectory of each slew at the telemetry's times.
    """

    campaign: Campaign
    plan: Plan
    spacecraft: Spacecraft
    final_error_B: np.ndarray
    seen_error_B: np.ndarray
    peak_torque: np.ndarray
    peak_momentum: np.ndarray
    truth: tuple[Trajectory, ...]

    @property
    def correction_slews(self) -> np.ndarray:
        """Angle (slews,) of the correction slew needed after each slew [rad], as the star tracker sees it."""
        return np.linalg.norm(self.seen_error_B, axis=1)


def fly(
    plan: Plan,
    spacecraft: Spacecraft,
    controller: Controller,
    prior: InertiaPrior,
    seed: int | None,
    name: str | None = None,
) -> Flight:
    """Fly a plan in closed loop.

    Between slews the spacecraft is brought to the last target, at rest, with the total momentum the campaign began with.

    Parameters
    ----------
    prior : inertia tensor that the campaign states as known before flight.
    seed : of noise, bias and rest errors; None for a flight without any of them (the bias then is its prior mean).

    Raises
    ------
    CampaignError : the plan does not fit the spacecraft. EffectError : an effect lacks environment columns, or
        grows without bound together with the controller.

    >>> from bayes_inertia.flight.plan import PlannedSlew
    >>> from bayes_inertia.flight.spacecraft import most_like_prior, most_like_spacecraft
    >>> plan, craft = Plan("one", (PlannedSlew((1., 0., 0.), 0.5),)), most_like_spacecraft()
    >>> fly(plan, craft, Controller(craft.inertia_B), most_like_prior(), None).final_error_B.round(4)[0, 0].item()
    0.005
    """
    rng = None if seed is None else np.random.default_rng(seed)
    planned = planned_campaign(plan, spacecraft, prior, name)
    grid = _grid(planned, spacecraft.effects)
    spacecraft = replace(spacecraft, bias=_bias(spacecraft, rng))
    starts = _starts(plan, spacecraft, controller, rng)
    attitudes = plan.attitudes
    scripts = _stacked(
        [
            _script(plan, attitudes, i, grid.rows, spacecraft.star_tracker is not None)
            for i in range(len(plan.slews))
        ]
    )
    noise = _noise((len(plan.slews),), spacecraft, controller, plan, grid.rows, rng)
    flown = fly_slews(
        grid.slews,
        scripts,
        _truth(spacecraft, starts),
        _control(spacecraft, controller),
        noise,
        spacecraft.active_effects,
        grid.substeps,
    )
    flown = jax.tree.map(np.asarray, flown)
    _check_converged(flown, planned, spacecraft.effects)
    return _flight(plan, spacecraft, planned, flown)


def predict_final_errors(
    thetas: np.ndarray,
    plan: Plan,
    spacecraft: Spacecraft,
    controller: Controller,
    *,
    index: int = 0,
    includes_wheel_spin: bool = False,
    seed: int | None = None,
    values: Mapping[str, Mapping[str, np.ndarray]] | None = None,
) -> np.ndarray:
    """Final attitude error (n, 3) [rad] of one slew of a plan if each draw were the truth, flown with the same controller.

    Parameters
    ----------
    thetas : (n, 9) elements of J [kg m^2] (as in `inertia_tensor.ELEMENTS`) and K, such as posterior draws.
    spacecraft : sensors, wheels and effects (its own J and K are not used). index : which slew of the plan.
    values : {effect: {parameter: (n, ...)}}, parameters of the effects in each draw; None for the spacecraft's own in all.
    includes_wheel_spin : whether the drawn J is J_locked, as the campaign says. seed : of noise, None for none.

    >>> from bayes_inertia.flight.plan import PlannedSlew
    >>> from bayes_inertia.flight.spacecraft import most_like_spacecraft
    >>> plan, craft = Plan("one", (PlannedSlew((1., 0., 0.), 0.5),)), most_like_spacecraft()
    >>> draws = np.array([[1., 1., 1., 0., 0., 0., 1.02, 1., 1.]])
    >>> predict_final_errors(draws, plan, craft, Controller(np.eye(3))).round(4)[0, 0].item()
    0.01
    """
    thetas = np.atleast_2d(np.asarray(thetas, dtype=float))
    n = len(thetas)
    rng = None if seed is None else np.random.default_rng(seed)
    planned = planned_campaign(
        plan, spacecraft, InertiaPrior(spacecraft.inertia_B, 1.0, 1.0)
    ).subset([index])
    grid = _grid(planned, spacecraft.effects)
    J = np.asarray(inertia_tensor.tensor(jnp.asarray(thetas[:, :6])))
    J = without_spin(J, includes_wheel_spin, spacecraft.wheels)
    K = thetas[:, 6:9]
    bias = (
        np.stack([_bias(spacecraft, rng) for _ in range(n)])
        if spacecraft.bias is None
        else np.tile(spacecraft.bias, (n, 1))
    )
    starts = _stacked(
        [
            jax.tree.map(lambda x: x[index], _starts(plan, spacecraft, controller, rng))
            for _ in range(n if rng else 1)
        ]
    )
    starts = jax.tree.map(lambda x: jnp.broadcast_to(x, (n, *x.shape[1:])), starts)
    truth = Truth(
        jnp.asarray(J),
        jnp.asarray(K),
        jnp.asarray(bias),
        jnp.broadcast_to(spacecraft.rate_sensor.axes, (n, 3, 3)),
        starts,
    )
    script = _script(plan, plan.attitudes, index, grid.rows, spacecraft.star_tracker is not None)
    noise = _noise((n,) if rng else (1,), spacecraft, controller, plan, grid.rows, rng)
    slew = jax.tree.map(lambda x: x[0], grid.slews)
    if values is None:
        active = jax.tree.map(
            lambda x: jnp.broadcast_to(x, (n, *x.shape)), spacecraft.active_effects
        )
    else:
        drawn = {name: dict(of_effect) for name, of_effect in values.items()}
        active = ActiveEffects(spacecraft.effects, jax.tree.map(jnp.asarray, drawn))
    errors = _final_errors(
        slew,
        script,
        truth,
        _control(spacecraft, controller),
        noise,
        active,
        grid.substeps,
    )
    return np.asarray(errors)


def predict_correction_slew(
    thetas: np.ndarray, plan: Plan, spacecraft: Spacecraft, controller: Controller, **options: Any
) -> np.ndarray:
    """Angle (n,) [rad] of the correction slew needed after one slew if each draw (n, 9) were the truth; arguments as in `predict_final_errors`."""
    return np.linalg.norm(
        predict_final_errors(thetas, plan, spacecraft, controller, **options), axis=-1
    )


@partial(jax.jit, static_argnames="substeps")
def _final_errors(slew, script, truth, control, noise, active, substeps):
    def one(truth, active, noise):
        return fly_slew(
            slew, script, truth, control, noise, active, substeps=substeps
        ).final_error_B

    if len(noise.rate) == 1:
        return jax.vmap(one, in_axes=(0, 0, None))(
            truth, active, jax.tree.map(lambda x: x[0], noise)
        )
    return jax.vmap(one)(truth, active, noise)


def planned_campaign(
    plan: Plan, spacecraft: Spacecraft, prior: InertiaPrior, name: str | None = None
) -> Campaign:
    """The plan as a campaign of perfect telemetry that has not been flown: planned motion, no torques."""
    angles, rates = _planned_motion(plan)
    sensor, attitudes, starts, wheels = (
        spacecraft.rate_sensor,
        plan.attitudes,
        plan.starts,
        len(spacecraft.wheels),
    )
    slews = []
    for i, slew in enumerate(plan.slews):
        time, axis = plan.times(i), np.array(slew.axis_B)
        n = len(time)
        environment = {}
        if plan.orbit is not None:
            at = starts[i] + time
            environment = {
                "magnetic_field_N": plan.orbit.magnetic_field_N(at),
                "position_N": plan.orbit.position_N(at),
            }
        if spacecraft.star_tracker is not None:
            turned = Rotation.from_quat(attitudes[i]) * Rotation.from_rotvec(
                angles[i, :n, None] * axis
            )
            environment["attitude"] = turned.as_quat()
        slews.append(
            Slew(
                name=f"slew {i + 1}",
                start=starts[i],
                time=time,
                rate=rates[i, :n, None] * (sensor.axes @ axis) / np.array(sensor.scale_factor),
                wheel_torque=np.zeros((n, wheels)),
                wheel_momentum=np.zeros((n, wheels)),
                axis_B=slew.axis_B,
                angle=slew.angle,
                **environment,
            )
        )
    return Campaign(
        name or plan.name, prior, spacecraft.wheels, sensor, spacecraft.star_tracker, tuple(slews)
    )


def _planned_motion(plan: Plan) -> tuple[np.ndarray, np.ndarray]:
    """Angle [rad] and rate [rad/s] of all slews (slews, rows), padded at the end."""
    longest = max(len(plan.times(i)) for i in range(len(plan.slews)))
    time = (
        plan.telemetry_period * np.arange(-(-longest // 32) * 32) - plan.rest_before
    )  # few shapes, few compilations
    settings = [
        np.array([[getattr(slew, key)] for slew in plan.slews])
        for key in ("angle", "rate", "acceleration")
    ]
    smooth = np.array([[slew.profile == "smooth"] for slew in plan.slews])
    angle, rate = jax.jit(angle_and_rate)(*settings, smooth, time)
    return np.asarray(angle), np.asarray(rate)


class _Grid(NamedTuple):
    """Integration grids of all slews, `rows` rows of `substeps` points each."""

    slews: SlewInput
    rows: int
    substeps: int


def _grid(planned: Campaign, effects: Sequence[Effect]) -> _Grid:
    """The grids that a `Model` of the flown campaign will integrate on."""
    for effect in effects:
        for column in effect.needs:
            if any(getattr(slew, column) is None for slew in planned.slews):
                raise EffectError(
                    f"needs {column}",
                    where=effect.name,
                    advice="give the plan an [orbit], or leave the effect out",
                )
    steps = [step for step in (effect.max_step(planned) for effect in effects) if step is not None]
    arrays = pack(planned, max_step=min(steps) if steps else None)
    rows = arrays.telemetry.rate.shape[1]
    substeps = int(arrays.telemetry.sample[0, 1])
    missing = rows * substeps - arrays.slews.context.time.shape[1]

    if missing == 0:
        return _Grid(arrays.slews, rows, substeps)

    def to_rows(x: jnp.ndarray, *, last: bool) -> np.ndarray:
        return np.pad(
            x, [(0, 0), (0, missing)] + [(0, 0)] * (x.ndim - 2), mode="edge" if last else "constant"
        )

    slews = arrays.slews
    context = slews.context._replace(
        step=to_rows(slews.context.step, last=False),
        **{k: to_rows(getattr(slews.context, k), last=True) for k in ("time", "torque")},
    )
    longer = {
        key: to_rows(getattr(slews, key), last=True)
        for key in ("momentum", "magnetic_field_N", "position_N")
    }
    return _Grid(slews._replace(context=context, **longer), rows, substeps)


def _stacked(parts: Sequence[Any]) -> Any:
    return jax.tree.map(lambda *x: np.stack(x), *parts)


def _script(plan: Plan, attitudes: np.ndarray, i: int, rows: int, tracked: bool) -> Script:
    slew, time = plan.slews[i], plan.times(i)
    before, after = plan.fixes(i)
    gain, weight = np.zeros(rows), np.zeros(rows)
    if tracked:
        gain[before] = 1.0 / np.arange(1, len(before) + 1)
        weight[after] = 1.0 / len(after)
    numbers = (
        np.array(x)
        for x in (
            slew.axis_B,
            slew.angle,
            slew.rate,
            slew.acceleration,
            slew.profile == "smooth",
            plan.rest_before,
            len(time),
        )
    )
    padded = np.concatenate([time, np.full(rows - len(time), time[-1])])
    return Script(attitudes[i], *numbers, padded, gain, weight)


def _starts(
    plan: Plan, spacecraft: Spacecraft, controller: Controller, rng: np.random.Generator | None
) -> Start:
    """Start states of all slews: at the last target, with the total momentum of the campaign's beginning in the wheels."""
    G, attitudes = spacecraft.wheel_axes_B, Rotation.from_quat(plan.attitudes[:-1])
    h = np.array(plan.wheel_momentum or np.zeros(len(spacecraft.wheels)))
    if len(h) != len(spacecraft.wheels):
        raise CampaignError(
            f"{len(h)} momenta for {len(spacecraft.wheels)} wheels",
            where="key wheel_momentum_Nms",
            advice="give one a wheel",
        )
    total_N = attitudes[0].apply(G @ h)  # scipy's rotation takes body vectors to inertial ones
    momentum = h + (attitudes.apply(total_N, inverse=True) - G @ h) @ np.linalg.pinv(G).T
    shape = (2, len(plan.slews), 3)
    spread = np.zeros(shape) if rng is None else rng.normal(size=shape)
    aimed = attitudes * Rotation.from_rotvec(controller.rest_attitude_sigma * spread[1])
    return Start(controller.rest_rate_sigma * spread[0], aimed.as_quat(), momentum)


def _bias(spacecraft: Spacecraft, rng: np.random.Generator | None) -> Vector:
    sensor = spacecraft.rate_sensor
    if spacecraft.bias is not None:
        return spacecraft.bias
    return (
        sensor.bias if rng is None else tuple(rng.normal(sensor.bias, sensor.bias_sigma).tolist())
    )


def _noise(
    batch: tuple[int, ...],
    spacecraft: Spacecraft,
    controller: Controller,
    plan: Plan,
    rows: int,
    rng: np.random.Generator | None,
) -> Noise:
    sensor, tracker, wheels = spacecraft.rate_sensor, spacecraft.star_tracker, spacecraft.wheels

    def white(*shape: int) -> np.ndarray:
        return np.zeros((*batch, *shape)) if rng is None else rng.normal(size=(*batch, *shape))

    momentum = white(rows, len(wheels)) * np.array([w.momentum_sigma or 0.0 for w in wheels])
    attitude = np.zeros((*batch, rows, 3))
    if tracker is not None:
        along = np.array(tracker.boresight_B)
        e = white(rows, 3)
        roll = (e @ along)[..., None] * along
        attitude = tracker.sigma_cross * (e - roll) + tracker.sigma_roll * roll
    readings = max(1.0, controller.snapshot_time / plan.telemetry_period)
    return Noise(
        white(rows, 3) * sensor.sigma,
        momentum,
        attitude,
        white(3) * np.array(sensor.sigma) / math.sqrt(readings),
    )


def _truth(spacecraft: Spacecraft, starts: Start) -> Truth:
    sensor = spacecraft.rate_sensor
    return Truth(
        jnp.asarray(spacecraft.inertia_B),
        jnp.asarray(spacecraft.scale_factor),
        jnp.asarray(spacecraft.bias),
        jnp.asarray(sensor.axes),
        starts,
    )


def _control(spacecraft: Spacecraft, controller: Controller) -> Control:
    G, sensor = spacecraft.wheel_axes_B, spacecraft.rate_sensor
    return Control(
        inertia_B=jnp.asarray(controller.inertia_B),
        scale_factor=jnp.asarray(controller.scale_factor),
        rate_axes_inverse=jnp.asarray(np.linalg.inv(sensor.axes)),
        wheel_axes_B=jnp.asarray(G),
        allocation=jnp.asarray(np.linalg.pinv(G)),
        spin_inertia=jnp.asarray([w.spin_inertia for w in spacecraft.wheels]),
        max_torque=jnp.asarray([w.max_torque or 1e30 for w in spacecraft.wheels]),
        stiffness=jnp.asarray(controller.bandwidth**2),
        damping=jnp.asarray(2.0 * controller.damping * controller.bandwidth),
        rate_range=jnp.asarray(sensor.range or 1e30),
    )


def _check_converged(flown: Flown, planned: Campaign, effects: Sequence[Effect]) -> None:
    bad = ~np.isfinite(flown.attitude).all(axis=(1, 2))
    if effects:
        bad |= ~(flown.change <= TOLERANCE)
    if bad.any():
        worst = planned.slews[int(np.argmax(bad))].name
        raise EffectError(
            "the closed loop is not stable with these effects",
            where=worst,
            advice="use smaller values, or a lower controller bandwidth",
        )


def _flight(plan: Plan, spacecraft: Spacecraft, planned: Campaign, flown: Flown) -> Flight:
    sensed = all(w.momentum_sigma is not None for w in spacecraft.wheels)
    slews, truth = [], []
    for i, slew in enumerate(planned.slews):
        n = len(slew.time)
        fixes = None
        if spacecraft.star_tracker is not None:
            rows = np.concatenate(plan.fixes(i))
            fixes = np.full((n, 4), np.nan)
            fixes[rows] = flown.fixes[i, rows]
        momentum = flown.momentum[i, :n] if sensed and spacecraft.wheels else None
        torque = flown.command[i, :n] if spacecraft.wheels else None
        slews.append(
            replace(
                slew,
                rate=flown.rate[i, :n],
                attitude=fixes,
                wheel_torque=torque,
                wheel_momentum=momentum,
            )
        )
        truth.append(
            Trajectory(
                slew.time,
                flown.attitude[i, :n],
                flown.rate_B[i, :n],
                flown.wheel_momentum[i, :n],
                np.zeros((n, 0)),
            )
        )
    limits = [
        np.array([getattr(w, key) or np.nan for w in spacecraft.wheels])
        for key in ("max_torque", "max_momentum")
    ]
    peaks = [
        np.stack([np.abs(x).max(axis=0) for x in parts])
        for parts in ([s.wheel_torque for s in slews], [x.wheel_momentum for x in truth])
    ]
    seen = (
        flown.seen_error_B
        if spacecraft.star_tracker is not None
        else np.full_like(flown.final_error_B, np.nan)
    )
    campaign = replace(planned, slews=tuple(slews))
    return Flight(
        campaign,
        plan,
        spacecraft,
        flown.final_error_B,
        seen,
        peaks[0] / limits[0],
        peaks[1] / limits[1],
        tuple(truth),
    )
