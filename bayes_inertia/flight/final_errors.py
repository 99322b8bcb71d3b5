"""Final attitude errors and correction slews if each draw of J and K were the truth.

A correction slew is the rotation between the attitude that the fast slew reached and its target, as
the star tracker sees it afterwards. It is largely the error of the controller's scale factors times
the slew's angle: `bayes_inertia.flight.closed_loop` says why.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from bayes_inertia.flight.closed_loop import ClosedLoop, Plant, fly_slew
from bayes_inertia.flight.closed_loop_inputs import (
    control_law,
    integration_grid,
    rate_bias,
    sensor_noise,
    slew_schedule,
    stacked_pytrees,
    start_states,
)
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.plan import Plan
from bayes_inertia.flight.planned_telemetry import planned_campaign
from bayes_inertia.flight.spacecraft import Controller, without_spin
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.kept_programs import KeptProgram
from bayes_inertia.physics.active_effects import ActiveEffects
from bayes_inertia.physics.effect import Effect


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
    grid = integration_grid(planned_campaign(plan, mission).subset([index]), craft.effects)
    plant = _plants(thetas, plan, mission, controller, index, rng)
    tracked = craft.star_tracker is not None
    active = _active_in_draws(values, mission, n)
    errors = _final_errors(
        _Flights(active.effects, grid.substeps),
        jax.tree.map(lambda x: x[0], grid.slews),
        slew_schedule(plan, index, grid.n_rows, tracked=tracked),
        plant,
        control_law(craft, controller),
        sensor_noise((n,) if rng else (1,), craft, controller, plan, grid.n_rows, rng),
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
    return np.linalg.norm(
        predict_final_errors(thetas, plan, mission, controller, **options), axis=-1
    )


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
    J = inertia_tensor.tensor(thetas[:, :6])
    J = without_spin(J, mission.prior.includes_wheel_spin, craft.wheels)
    if craft.bias is None:
        bias = np.stack([rate_bias(craft, rng) for _ in range(n)])
    else:
        bias = np.tile(craft.bias, (n, 1))
    starts = stacked_pytrees(
        [
            jax.tree.map(lambda x: x[index], start_states(plan, craft, controller, rng))
            for _ in range(n if rng else 1)
        ]
    )
    return Plant(
        jnp.asarray(J),
        jnp.asarray(thetas[:, 6:9]),
        jnp.asarray(bias),
        jnp.broadcast_to(craft.gyro.axes, (n, 3, 3)),
        jax.tree.map(lambda x: jnp.broadcast_to(x, (n, *x.shape[1:])), starts),
    )


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
        return jax.vmap(of_draw, in_axes=(0, 0, None))(
            plants, values, jax.tree.map(lambda x: x[0], noise)
        )
    return jax.vmap(of_draw)(plants, values, noise)


# What is compiled for each set of effects.
PROGRAMS = (_final_errors,)
