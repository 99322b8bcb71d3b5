"""What slews that have not been flown would tell: the information of their telemetry, as a smooth function of the slews.

The model that will be fitted is linearised around the planned motion, flown with the torques that it needs. Each row of
the coarse grid of `motion` stands for the telemetry samples of its time, so that the information comes close to that of
the full telemetry: sds within a few per cent with tachometers. Without, fast slews tell cross terms by small gyroscopic torques
alone, and what the controller adds to the planned motion changes their sds by up to a third: `expectation` flies it and
gives the exact ones. The slew's own start state and the prior of everything are in it as in `likelihood`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.design.planned_motion import (
    PlanStart,
    PlanTimes,
    RigidBody,
    SlewArrays,
    motion_of_slews,
    plan_start,
    plan_times,
)
from bayes_inertia.design.sensitivity import (
    PlannedTrajectory,
    TelemetrySensitivity,
    telemetry_sensitivity,
)
from bayes_inertia.errors import CampaignError
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.inference.objective import N_BIAS
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.forward_model import Model, NuisanceScale, Sensors, Structure
from bayes_inertia.physics.slew_context import SlewContext, Trajectory


class Whitener(NamedTuple):
    """Inverse noise of one sample: `rate` (3,), `attitude` (3, 3) of one fix, `momentum` (wheels,); zero for what is not measured."""

    rate: Array
    attitude: Array
    momentum: Array


class Surroundings(NamedTuple):
    """Environment on a clock: `time` (k,) [s] of the campaign, `magnetic_field_N` (k, 3) [T], `position_N` (k, 3) [m]."""

    time: Array
    magnetic_field_N: Array
    position_N: Array


class World(NamedTuple):
    """Everything a slew's information depends on besides the slews and the parameters: arrays.

    `first` : index of the first of these slews in its campaign, `count` slews in all, `begin` and `middle` [s] on its clock.
    """

    sensors: Sensors
    scale: NuisanceScale
    whitener: Whitener
    surroundings: Surroundings
    wheel_axes_B: Array
    allocation: Array
    spin_inertia: Array
    boresight_B: Array
    first: Array
    count: Array
    begin: Array
    middle: Array


class Given(NamedTuple):
    """The arrays of a forecast: `world`, `origin`; `prior_sd` (d,); `prior` (d + 3, d + 3) precision of parameters and whitened
    bias before the slews."""

    world: World
    origin: PlanStart
    prior_sd: Array
    prior: Array


@dataclass(frozen=True)
class Shape:
    """What decides the compiled code of a forecast: `structure` and parameter `names` of the model that will be fitted, and the `times` of the slews."""

    structure: Structure
    names: tuple[str, ...]
    times: PlanTimes

    def slice_of(self, effect: str) -> tuple[int, int]:
        """Where an effect's parameters stand (first, behind the last); equal if it has none."""
        mine = [i for i, name in enumerate(self.names) if name.startswith(f"{effect}.")]
        return (mine[0], mine[-1] + 1) if mine else (0, 0)


@array_dataclass
class Forecast:
    """How the telemetry of slews is foreseen: `shape` and `given`."""

    shape: Shape
    given: Given

    def body(self, theta: Array) -> RigidBody:
        """The body that parameters theta (d,) describe."""
        return body_of(self.shape.structure, theta, self.given.world)


def forecast(plan: Plan, mission: Mission, effects: tuple[Effect, ...] = ()) -> Forecast:
    """The forecast for slews at the times and from the start of a plan.

    Parameters
    ----------
    plan : its slews set the scale of default priors of effects, nothing else. mission : wheels, sensors and prior; what acts in truth is not used.
    effects : fitted along, at their null.

    >>> from bayes_inertia.flight.plan import paper_like_plan
    >>> from bayes_inertia.flight.mission import most_like_mission
    >>> len(forecast(paper_like_plan(), most_like_mission()).shape.names)
    9
    """
    campaign = planned_campaign(plan, mission.without_effects())
    model = Model(campaign, effects, "commanded")
    end = campaign.span[1]
    moments = np.linspace(0.0, 2.0 * end, 200)
    none = np.zeros((len(moments), 3))
    orbit = plan.orbit
    around = (
        Surroundings(moments, none, none)
        if orbit is None
        else Surroundings(moments, orbit.magnetic_field_N(moments), orbit.position_N(moments))
    )
    world = world_of(model, around, first=0, count=len(plan.slews), begin=0.0, middle=0.5 * end)
    sd = model.space.sd
    shape = Shape(replace(model.structure, refined=False), model.space.names, plan_times(plan))
    prior_precision = np.diag(np.concatenate([sd**-2.0, np.ones(N_BIAS)]))
    return Forecast(
        shape, Given(world, plan_start(plan, len(campaign.wheels)), sd, prior_precision)
    )


def world_of(
    model: Model, around: Surroundings, *, first: int, count: int, begin: float, middle: float
) -> World:
    """The world of slews flown with a model's hardware in the commanded drive.

    Raises `CampaignError` where the campaign has no wheels: there is nothing to fly with.
    """
    campaign = model.campaign
    if not campaign.wheels:
        raise CampaignError(
            "no wheels to fly slews with",
            where="key wheels",
            advice="describe the wheels in campaign.toml",
        )
    boresight = (
        (0.0, 0.0, 1.0) if campaign.star_tracker is None else campaign.star_tracker.boresight_B
    )
    return World(
        sensors=model.data.sensors,
        scale=model.data.scale,
        whitener=_whitener(campaign),
        surroundings=around,
        wheel_axes_B=campaign.wheel_axes_B,
        allocation=np.linalg.pinv(campaign.wheel_axes_B),
        spin_inertia=campaign.spin_inertias,
        boresight_B=np.array(boresight),
        first=np.array(first),
        count=np.array(count),
        begin=np.array(begin),
        middle=np.array(middle),
    )


def _whitener(campaign: Campaign) -> Whitener:
    attitude, tracker = np.zeros((3, 3)), campaign.star_tracker
    if tracker is not None:
        along = np.outer(tracker.boresight_B, tracker.boresight_B)
        attitude = (np.eye(3) - along) / tracker.sigma_cross + along / tracker.sigma_roll
    momentum = np.array([1.0 / (w.momentum_sigma or np.inf) for w in campaign.wheels])
    return Whitener(1.0 / np.array(campaign.rate_sensor.sigma), attitude, momentum)


def body_of(structure: Structure, theta: Array, world: World) -> RigidBody:
    """The body that parameters theta (d,) describe, J without the wheels' spin."""
    J = inertia_tensor.tensor(theta[:6])
    if structure.includes_wheel_spin:
        J = J - inertia_tensor.wheel_spin_tensor(world.wheel_axes_B, world.spin_inertia)
    return RigidBody(J, world.wheel_axes_B, world.allocation, world.spin_inertia)


def covariance(shape: Shape, given: Given, theta: Array, slews: SlewArrays) -> Array:
    """Expected covariance (d, d) of the parameters after these slews, if theta (d,) is the truth; JAX can differentiate it."""
    return posterior(given, information(shape, given, theta, slews))


def posterior(given: Given, told: Array) -> Array:
    """Covariance (d, d) of the parameters from the prior and the information of slews (n, d + 3, d + 3)."""
    d = len(given.prior_sd)
    unit = jnp.concatenate([jnp.asarray(given.prior_sd), jnp.ones(N_BIAS)])
    precision = (given.prior + told.sum(0)) * unit * unit[:, None]
    # Unit diagonal first: what is sharply known and what is not stand side by side.
    scale = 1.0 / jnp.sqrt(jnp.diag(precision))
    inverse = jnp.linalg.inv(precision * scale * scale[:, None]) * scale * scale[:, None]
    return (inverse * unit * unit[:, None])[:d, :d]


def information(shape: Shape, given: Given, theta: Array, slews: SlewArrays) -> Array:
    """Information (n, d + 3, d + 3) of each of n slews on (theta, whitened bias), its own start state integrated out."""
    structure, times, world = shape.structure, shape.times, given.world
    flown = motion_of_slews(slews, times, body_of(structure, theta, world), given.origin)
    index = jnp.arange(len(slews.rate))
    one = partial(_one_slew, structure, times, world, theta)
    return jax.vmap(one)(
        index,
        *(
            getattr(flown, key)
            for key in ("time", "start", "attitude", "rate_B", "wheel_momentum", "wheel_torque")
        ),
    )


def _one_slew(
    structure: Structure,
    times: PlanTimes,
    world: World,
    theta: Array,
    index,
    time,
    start,
    attitude,
    rate_B,
    wheel,
    torque,
) -> Array:
    begin = world.begin + start
    context = SlewContext(
        index=world.first + index,
        slews=world.count,
        start=begin,
        middle=world.middle,
        time=time,
        step=jnp.append(jnp.diff(time), 0.0),
        torque=torque,
        wheel_axes_B=world.wheel_axes_B,
        spin_inertia=world.spin_inertia,
        boresight_B=world.boresight_B,
        rate_axes=world.sensors.axes,
    )
    field, position = (
        _on(world.surroundings, key, begin + time) for key in ("magnetic_field_N", "position_N")
    )
    planned = PlannedTrajectory(
        Trajectory(time, attitude, rate_B, wheel, jnp.zeros((len(time), 0))), field, position
    )
    moved = telemetry_sensitivity(structure, theta, context, planned, world.sensors, world.scale)
    samples = _samples(time) / times.telemetry_period
    columns = _columns(world.whitener, moved, samples, _fixes_by_row(times, time))
    return marginal_information(columns.T @ columns, len(theta) + N_BIAS)


def marginal_information(matrix: Array, shared: int) -> Array:
    """What a slew tells about the first `shared` unknowns when its whitened start state, all that follows, is not known but for a unit prior."""
    local = matrix[shared:, shared:] + jnp.eye(len(matrix) - shared)
    scale = 1.0 / jnp.sqrt(jnp.diag(local))
    factor = jnp.linalg.cholesky(local * scale * scale[:, None])
    across = jax.scipy.linalg.solve_triangular(
        factor, scale[:, None] * matrix[shared:, :shared], lower=True
    )
    return matrix[:shared, :shared] - across.T @ across


def _columns(white: Whitener, moved: TelemetrySensitivity, samples: Array, fixes: Array) -> Array:
    """Whitened derivatives (numbers, p) of everything measured; a row counts as many times as it stands for samples or fixes."""
    rate = moved.rate * (white.rate[:, None] * jnp.sqrt(samples)[:, None, None])
    momentum = moved.momentum * (white.momentum[:, None] * jnp.sqrt(samples)[:, None, None])
    attitude = (
        jnp.einsum("ij,njp->nip", white.attitude, moved.attitude) * jnp.sqrt(fixes)[:, None, None]
    )
    return jnp.concatenate([x.reshape(-1, x.shape[-1]) for x in (rate, attitude, momentum)])


def _samples(time: Array) -> Array:
    """Time (n,) that each row stands for: half of each step beside it."""
    half = 0.5 * jnp.diff(time)
    return jnp.append(half, 0.0) + jnp.concatenate([jnp.zeros(1), half])


def _fixes_by_row(times: PlanTimes, time: Array) -> Array:
    """How many star-tracker fixes each row stands for (n,): a fix between two rows is shared by them."""
    before = np.arange(times.first_fix, times.rest_before - 1e-9, times.fix_spacing)
    after = np.arange(0.0, times.rest_after + 1e-9, times.fix_spacing)
    moments = jnp.concatenate([jnp.asarray(before), time[-1] - jnp.asarray(after)])
    right = jnp.clip(jnp.searchsorted(time, moments), 1, len(time) - 1)
    share = jnp.clip((moments - time[right - 1]) / (time[right] - time[right - 1]), 0.0, 1.0)
    # A floor, because a root has no derivative at zero.
    return jnp.full(len(time), 1e-12).at[right].add(share).at[right - 1].add(1.0 - share)


def _on(around: Surroundings, key: str, moments: Array) -> Array:
    values = getattr(around, key)
    return jnp.stack([jnp.interp(moments, around.time, values[:, i]) for i in range(3)], -1)
