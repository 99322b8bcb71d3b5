"""The slew simulator: attitude, body rate and wheel momentum from torque commands or tachometers.

The state is the attitude and the TOTAL momentum in inertial axes M_N, not the body rate: without
external torque M_N is constant to rounding, and the rate follows from
`J w = C(q) M_N - G H` (commanded drive, H' = u) or `J_locked w = C(q) M_N - G h` (measured drive,
h the tachometer momentum). This is the integral of Ferguson's eq 6. Butcher's Runge-Kutta method of
sixth order takes steps of as many telemetry rows as the motion allows; what the wheels do within a
step is told by its moments (`step_drive`), and rows within a step come from dense output, all at
once.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from bayes_inertia.physics.active_effects import ActiveEffects
from bayes_inertia.physics.components import Components, stacked
from bayes_inertia.physics.equations_of_motion import internal_momentum, prepare
from bayes_inertia.physics.integrated_paths import attitude_path, full_path
from bayes_inertia.physics.slew_context import Trajectory
from bayes_inertia.physics.slew_input import Drive, SlewInput, Start
from bayes_inertia.physics.step_drive import at_output, known_momentum

# Hooks that make more than the attitude change during a slew.
MOVING_HOOKS = ("wheel_torque", "body_torque", "initial_state", "internal_momentum")
# Hooks that decide how the body and its wheels move: all that the simulator calls.
BODY_HOOKS = ("inertia", "wheel_axes", "delivered_torque", *MOVING_HOOKS, "state_rate")
# Hooks that are given the whole slew, and may look between its rows.
LOOKING_BACK = ("rate_output", "attitude_output", "momentum_output")


def simulate_slew(
    slew: SlewInput,
    start: Start,
    inertia_B: Array,
    active: ActiveEffects | None = None,
    drive: Drive = "commanded",
    rows_per_step: int = 1,
) -> tuple[Trajectory, Components]:
    """Simulate one slew; a pure function that JAX can batch and differentiate.

    Parameters
    ----------
    slew : SlewInput
        What was commanded or measured.
    start : Start
        The state at the first row.
    inertia_B : (3, 3) array
        J of everything except the wheels' spin [kg m^2].
    active : ActiveEffects, optional
        What else acts; nothing by default.
    drive : "commanded" or "measured", optional
        Commanded: torques are the input, wheel momentum is an output. Measured: wheel momentum
        is the input.
    rows_per_step : int, optional
        Grid points that one integration step spans; the grid's length is a multiple of it
        (`integration_plan` finds how many the motion allows).

    Returns
    -------
    trajectory : Trajectory
        The slew on the grid, or where `slew.output` wants it (its `time` is always the grid's);
        its `effect_states` is empty.
    effect_states : tuple of (n, k) arrays
        Each effect's own states.

    Examples
    --------
    >>> from bayes_inertia.physics.slew_input import idle_slew
    >>> slew, q = idle_slew([0.0, 1.0, 2.0]), jnp.array([0.0, 0.0, 0.0, 1.0])
    >>> start = Start(jnp.array([0.1, 0.0, 0.0]), q, jnp.zeros(0))
    >>> simulate_slew(slew, start, jnp.eye(3))[0].rate_B[:, 0].round(9).tolist()
    [0.1, 0.1, 0.1]
    """
    active = ActiveEffects() if active is None else active
    context = slew.context
    mass, state, torque = prepare(slew, start, inertia_B, active, drive)
    known = known_momentum(slew, torque, drive, rows_per_step)
    if active.act(*MOVING_HOOKS):
        path = full_path(slew, mass, state, known, active, drive)
    else:
        known = at_output(known, slew)
        path = attitude_path(mass, state, known, drive)
    wheel = known.at_rows
    if drive == "commanded":
        wheel = wheel + stacked(path.wheel)
    internal = internal_momentum(active, context, path.effect_states)
    momentum_B = path.momentum_B - wheel @ mass.axes_B.T - internal
    rate = momentum_B @ mass.inverse.T
    momentum = wheel if drive == "measured" else wheel - mass.spin_inertia * (rate @ mass.axes_B)
    no_states = jnp.zeros((len(context.time), 0))
    trajectory = Trajectory(context.time, path.attitude, rate, momentum, no_states)
    return trajectory, path.effect_states
