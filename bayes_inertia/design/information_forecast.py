"""Forecast of the telemetry of slews that have not been flown.

The model that will be fitted is linearised around the planned motion, flown with the torques that
it needs. Each row of the coarse grid of `planned_motion` stands for the telemetry samples of its
time. So the information comes close to that of the full telemetry: sds within a few per cent with
tachometers. Without them, fast slews tell cross terms by small gyroscopic torques alone, and what
the controller adds to the planned motion changes their sds by up to a third. `expected_accuracy`
flies the plan and gives the exact ones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from bayes_inertia.design.flight_conditions import (
    FlightConditions,
    conditions_of,
    orbit_environment,
)
from bayes_inertia.design.plan_arrays import PlanStart, PlanTimes, plan_start, plan_times
from bayes_inertia.design.planned_motion import RigidBody
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.values import AnyArray, array_dataclass
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import N_BIAS
from bayes_inertia.physics.prediction import Structure


class ForecastArrays(NamedTuple):
    """The arrays of a forecast.

    Parameters
    ----------
    conditions : FlightConditions
        Under which the slews are flown.
    start : PlanStart
        Where the first one begins.
    prior_sd : (d,) array
        Prior sds of the parameters, in their units.
    prior : (d + 3, d + 3) array
        Precision of the parameters and the whitened bias before the slews.
    """

    conditions: FlightConditions
    start: PlanStart
    prior_sd: AnyArray
    prior: AnyArray


@dataclass(frozen=True)
class ForecastLayout:
    """Shapes and hooks that decide the compiled code of a forecast.

    Parameters
    ----------
    structure : Structure
        Of the model that will be fitted.
    names, units : tuple of str
        Of its d parameters.
    times : PlanTimes
        The times that the slews share [s].
    """

    structure: Structure
    names: tuple[str, ...]
    units: tuple[str, ...]
    times: PlanTimes

    def slice_of(self, effect: str) -> tuple[int, int]:
        """Place of an effect's parameters.

        Returns: the first, and behind the last; equal if it has none.
        """
        indices = [i for i, name in enumerate(self.names) if name.startswith(f"{effect}.")]
        return (indices[0], indices[-1] + 1) if indices else (0, 0)


@array_dataclass
class Forecast:
    """Forecast of the telemetry of slews.

    Parameters
    ----------
    layout : ForecastLayout
        What decides the compiled code.
    arrays : ForecastArrays
        All arrays.
    """

    layout: ForecastLayout
    arrays: ForecastArrays

    def body(self, theta: np.ndarray) -> RigidBody:
        """The body that parameters describe.

        `theta` (d,).
        """
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
    campaign = planned_campaign(plan, mission.without_effects())
    model = Model(campaign, effects, "commanded")
    end = campaign.span[1]
    environment = orbit_environment(plan.orbit, 2.0 * end)
    conditions = conditions_of(
        model, environment, first=0, slew_count=len(plan.slews), start_time=0.0, middle=0.5 * end
    )
    sd = model.space.sd
    structure = replace(model.structure, refined=False)
    space = model.space
    layout = ForecastLayout(structure, space.names, space.units, plan_times(plan))
    prior = np.diag(np.concatenate([sd**-2.0, np.ones(N_BIAS)]))
    start = plan_start(plan, len(campaign.wheels))
    return Forecast(layout, ForecastArrays(conditions, start, sd, prior))


def rigid_body_at(structure: Structure, theta: AnyArray, conditions: FlightConditions) -> RigidBody:
    """The body that parameters describe; JAX can differentiate it.

    `theta` (d,). `structure`: of the model; it knows whether J includes the wheels' spin.
    """
    J = inertia_tensor.tensor(theta[:6])
    wheels = conditions.wheel_axes_B, conditions.spin_inertia
    if structure.includes_wheel_spin:
        J = inertia_tensor.without_wheel_spin(J, *wheels)
    return RigidBody(J, conditions.wheel_axes_B, conditions.allocation, conditions.spin_inertia)
