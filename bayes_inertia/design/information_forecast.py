"""Forecast of the telemetry of slews that have not been flown.

The model that will be fitted is linearised around the planned motion, flown with the torques that
it needs. Each row of the coarse grid of `planned_motion` stands for the telemetry samples of its
time. So the information comes close to that of the full telemetry: sds within a few per cent with
tachometers. Without them, fast slews tell cross terms by small gyroscopic torques alone, and what
the controller adds to the planned motion changes their sds by up to a third. `comparison`
flies the plan and gives the exact ones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.linalg import block_diag

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.sensors.rate import RATE
from bayes_inertia.design.numerics import NUMERICS
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.orbit import Orbit
from bayes_inertia.flight.plan import Plan
from bayes_inertia.flight.planned_motion import (
    PlanStart,
    PlanTimes,
    RigidBody,
    plan_start,
    plan_times,
    rigid_body,
)
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.spacecraft import Spacecraft
from bayes_inertia.maths.values import AnyArray, array_dataclass
from bayes_inertia.physics.channels import Channel
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.packing import NuisanceScale
from bayes_inertia.physics.parameters import base_count
from bayes_inertia.physics.prediction import Structure, inertia_in
from bayes_inertia.physics.processes import Process
from bayes_inertia.physics.slew_context import Environment, SlewContext
from bayes_inertia.physics.stated_noise import stated_reading_noise


class EnvironmentTable(NamedTuple):
    """The environment on a clock."""

    time: AnyArray  # (k,) time in the campaign [s], ascending
    values: Environment  # its columns (k, 3)

    def at(self, moments: Array) -> Environment:
        """The columns (n, 3) at times (n,) [s]."""
        column = jax.vmap(jnp.interp, (None, None, 1), 1)
        return Environment(*(column(moments, self.time, values) for values in self.values))


class FlightConditions(NamedTuple):
    """Everything that a slew's information depends on, besides the slews and the parameters."""

    context: SlewContext  # of the first slew, without its grid
    sensors: tuple[Any, ...]  # constants of each channel
    scale: NuisanceScale  # prior sds of bias and start states
    factors: tuple[Array, ...]  # what whitens one reading of each channel; zero where none is read
    environment: EnvironmentTable  # magnetic field and position on the campaign's clock
    body: RigidBody  # wheels and device; its J is not used


class ForecastArrays(NamedTuple):
    """The arrays of a forecast."""

    conditions: FlightConditions  # under which the slews are flown
    start: PlanStart  # where the first one begins
    prior_sd: AnyArray  # (d,) prior sds of the parameters, in their units
    # (d + b, d + b) precision of the parameters and the b whitened biases before the slews.
    prior: AnyArray


@dataclass(frozen=True)
class ForecastLayout:
    """Shapes and hooks that decide the compiled code of a forecast."""

    structure: Structure  # of the model that will be fitted
    names: tuple[str, ...]  # of its d parameters
    units: tuple[str, ...]
    times: PlanTimes  # the times that the slews share [s]
    periods: tuple[float, ...]  # from one reading to the next of each channel [s]; 0: as fixes
    wandering: tuple[Process, ...] = ()  # what is stated of the biases of gyros

    @property
    def n_base(self) -> int:
        """How many of them, the first, are J and K."""
        return base_count(self.names)

    def slice_of(self, effect: str) -> tuple[int, int]:
        """Place of an effect's parameters.

        Returns: the first, and behind the last; equal if it has none.
        """
        indices = [i for i, name in enumerate(self.names) if name.startswith(f"{effect}.")]
        return (indices[0], indices[-1] + 1) if indices else (0, 0)


@array_dataclass
class Forecast:
    """Forecast of the telemetry of slews."""

    layout: ForecastLayout  # what decides the compiled code
    arrays: ForecastArrays  # all arrays

    def body(self, theta: np.ndarray) -> RigidBody:
        """The body that parameters (d,) describe."""
        return rigid_body_at(self.layout.structure, theta, self.arrays.conditions)


def prepare_forecast(plan: Plan, mission: Mission, effects: tuple[Effect, ...] = ()) -> Forecast:
    """The forecast for slews at the times and from the start of a plan.

    `plan`: its slews set the scale of default priors of effects, nothing else. `mission`: wheels,
    sensors and prior; what acts in truth is not used.

    Examples
    --------
    >>> from bayes_inertia.flight.mission import most_like_mission
    >>> from bayes_inertia.flight.plan import paper_like_plan
    >>> len(prepare_forecast(paper_like_plan(), most_like_mission()).layout.names)
    9
    """
    model, craft = planned_model(plan, mission, effects), mission.spacecraft
    environment = last_environment(model.campaign)
    if plan.orbit is not None:
        environment = orbit_environment(plan.orbit, 2.0 * model.campaign.span[1])
    conditions = conditions_of(model, craft, environment, first=0, start_time=0.0)
    together, sd = model.space.whitening, model.space.sd
    prior = np.diag(sd**-2.0) if together is None else (together / sd).T @ (together / sd)
    prior = block_diag(prior, np.eye(model.n_bias))
    return forecast_of(model, craft, plan, conditions, prior)


def planned_model(plan: Plan, mission: Mission, effects: tuple[Effect, ...] = ()) -> Model:
    """The model that will be fitted to the telemetry of a plan."""
    campaign = planned_campaign(plan, mission.without_effects())
    # What is planned of a star tracker is its target throughout; a fit has fixes.
    slews = tuple(
        s if s.attitude is None else replace(s, attitude=plan.at_fixes(i, s.attitude))
        for i, s in enumerate(campaign.slews)
    )
    return Model(replace(campaign, slews=slews), effects, "commanded")


def forecast_of(
    model: Model, craft: Spacecraft, plan: Plan, conditions: FlightConditions, prior: np.ndarray
) -> Forecast:
    """The forecast of slews that a model will fit.

    `plan`: its start and times; `prior` (d + b, d + b): precision of parameters and whitened bias.
    """
    structure, space = replace(model.structure, refined=False), model.space
    periods = tuple(
        craft.periods.get(_sensor_name(channel, craft), plan.telemetry_period)
        if channel.stream.is_series
        else 0.0
        for channel in model.channels
    )
    wandering = stated_reading_noise(model.campaign, structure.effects)
    times = plan_times(plan)
    layout = ForecastLayout(structure, space.names, space.units, times, periods, wandering)
    start = plan_start(plan, len(model.campaign.wheels))
    return Forecast(layout, ForecastArrays(conditions, start, space.sd, prior))


def _sensor_name(channel: Channel, craft: Spacecraft) -> str:
    return craft.names[0] if channel.stream == RATE else channel.name


def conditions_of(
    model: Model, craft: Spacecraft, environment: EnvironmentTable, *, first: int, start_time: float
) -> FlightConditions:
    """The conditions of slews flown with a model's sensors and a spacecraft's wheels or device.

    `first`: index of the first of these slews in the campaign, `start_time`: when it begins on the
    campaign's clock [s].
    """
    data = model.data
    context = jax.tree.map(lambda x: np.asarray(x)[0], data.arrays.slews.context)
    none = dict.fromkeys(("lost_command", "lost_command_sd", "fix_group"))
    on_grid = dict.fromkeys(("time", "step", "torque"), np.zeros(0))
    context = context._replace(index=np.array(first), start=np.array(start_time), **none, **on_grid)
    factors = _factors(model)
    body = rigid_body(craft)
    return FlightConditions(context, data.sensors, data.scale, factors, environment, body)


def orbit_environment(orbit: Orbit, duration: float) -> EnvironmentTable:
    """The environment along an orbit.

    `duration` [s].

    Examples
    --------
    >>> orbit_environment(Orbit(), 100.0).values.position_N.shape
    (200, 3)
    """
    time = np.linspace(0.0, duration, NUMERICS.orbit_points)
    return EnvironmentTable(time, orbit.environment(time))


def last_environment(campaign: Campaign) -> EnvironmentTable:
    """The environment that a campaign measured last, taken to stay as it was."""
    last = campaign.slews[-1]
    given = (_last_complete(getattr(last, key)) for key in Environment._fields)
    values = Environment(*(np.tile(row, (2, 1)) for row in given))
    return EnvironmentTable(np.array([0.0, 1.0]), values)


def _last_complete(values: np.ndarray | None) -> np.ndarray:
    """The last row (3,) without gaps of (n, 3); zero without any."""
    complete = np.zeros(0, bool) if values is None else np.isfinite(values).all(1)
    return values[complete][-1] if values is not None and complete.any() else np.zeros(3)


def _factors(model: Model) -> tuple[Array, ...]:
    """What whitens one reading of each channel, as in a fit at the prior's mean."""
    found = []
    for channel, readings in zip(model.channels, model.data.arrays.telemetry.readings, strict=True):
        components = np.asarray(readings.valid).shape[-1]
        noise = channel.noise(model.campaign, model.space.mean, "commanded")
        read = np.full((1, components), channel.is_read(model.campaign))
        factors = channel.factors(noise, read)[0]
        if (correlated := channel.stream.correlated(model.campaign)) is not None:
            # To slow signals it is white noise of its power at frequency zero.
            steps = channel.stream.spacings(model.campaign.slews)
            kept = np.exp(-np.median(steps) / np.array(correlated.time))
            power = 1.0 + 2.0 * np.array(correlated.share) * kept / (1.0 - kept)
            factors = factors / np.sqrt(power)[:, None]
        found.append(jnp.asarray(factors))
    return tuple(found)


def rigid_body_at(structure: Structure, theta: AnyArray, conditions: FlightConditions) -> RigidBody:
    """The body that parameters describe; JAX can differentiate it.

    `theta` (d,). `structure`: of the model; it knows whether J includes the wheels' spin.
    """
    J = inertia_in(structure, theta, conditions.context)
    return conditions.body._replace(inertia_B=J)
