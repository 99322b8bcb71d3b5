"""What the simulator is given: one slew's inputs on its grid, and the state that it begins in."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.physics.slew_context import Environment, SlewContext

Drive = Literal["commanded", "measured"]


class TachometerError(NamedTuple):
    """Errors of the tachometers, as far as the integration needs them apart from readings.

    Parameters
    ----------
    readings : (n, wheels) array
        Momentum as it was read, errors included [N m s].
    shapes : (n, k) array
        Shapes of the errors, none faster than the motion that an integration step follows.
    size : (wheels, k) array
        How much of each shape each wheel's readings contain [N m s].
    """

    readings: Array
    shapes: Array
    size: Array


class InputRows(NamedTuple):
    """What a device does over each step of the grid: a straight line from one value to another.

    Parameters
    ----------
    first : (n, k) array
        At the beginning of each step.
    last : (n, k) array
        At its end; not the `first` of the next step where the input jumps.
    """

    first: Array
    last: Array


class SlewInput(NamedTuple):
    """Everything the simulator needs of one slew, on its grid of n points.

    Parameters
    ----------
    context : SlewContext
        Grid, commanded torques, hardware.
    momentum : (n, wheels) array
        Wheel momentum relative to the body that drives the `measured` mode [N m s]; the
        `commanded` drive does not use it.
    environment : Environment
        Its columns (n, 3).
    tachometer_error : TachometerError, optional
        What was taken off the readings to give `momentum`; draws of one slew then share what the
        integration makes of the readings.
    fixes : (f,) array of int, optional
        Grid points at which the attitude is wanted; all by default. Heeded where nothing but the
        attitude changes during the slew, in steps of several rows.
    inputs : mapping of str to InputRows, optional
        What devices do, by the names of `Slew.inputs`, as far as effects ask for it. The grid then
        has a point wherever one of them jumps or bends.
    """

    context: SlewContext
    momentum: Array
    environment: Environment
    tachometer_error: TachometerError | None = None
    fixes: Array | None = None
    inputs: Mapping[str, InputRows] | None = None


def without_tachometer_error(slew: SlewInput, shapes: Array, size: Array) -> SlewInput:
    """A slew whose tachometer readings are freed of errors.

    `shapes` (n, k). `size` (wheels, k): how much of each shape each wheel's readings contain [N m
    s].

    Examples
    --------
    >>> slew = idle_slew([0.0, 1.0], wheels=1)
    >>> without_tachometer_error(slew, np.ones((2, 1)), np.array([[0.5]])).momentum.tolist()
    [[-0.5], [-0.5]]
    """
    return slew._replace(
        momentum=slew.momentum - shapes @ size.T,
        tachometer_error=TachometerError(slew.momentum, shapes, size),
    )


class Start(NamedTuple):
    """The state at a slew's first row.

    Parameters
    ----------
    rate_B : (3,) array
        Body rate [rad/s].
    attitude : (4,) array
        Quaternion, body from inertial, scalar last.
    wheel_momentum : (wheels,) array
        Wheel momentum relative to the body [N m s].
    """

    rate_B: Array
    attitude: Array
    wheel_momentum: Array


def idle_slew(
    time: np.ndarray,
    wheels: int = 0,
    wheel_axes_B: np.ndarray | None = None,
    spin_inertia: np.ndarray | None = None,
    torque: np.ndarray | None = None,
) -> SlewInput:
    """A slew whose wheels are left alone, unless torques are given.

    `time` (n,) [s]; `wheel_axes_B` (3, wheels); `spin_inertia` (wheels,) [kg m^2]. `wheels`: how
    many wheels, where `wheel_axes_B` does not say it. `torque` (n, wheels): motor torques on the
    wheels [N m]; zero by default. Returns: the only slew of a campaign, without magnetic field or
    position.

    Examples
    --------
    >>> idle_slew([0.0, 1.0]).context.step.tolist()
    [1.0, 0.0]
    """
    grid = np.asarray(time, dtype=float)
    n = len(grid)
    axes = np.zeros((3, wheels)) if wheel_axes_B is None else np.asarray(wheel_axes_B, dtype=float)
    wheels = axes.shape[1]
    # Of numpy first: each operation of JAX would be compiled for each number of rows.
    context = {
        "index": 0,
        "slews": 1,
        "start": 0.0,
        "middle": 0.5 * (grid[0] + grid[-1]),
        "time": grid,
        "step": np.append(np.diff(grid), 0.0),
        "torque": np.zeros((n, wheels)) if torque is None else np.asarray(torque, dtype=float),
        "wheel_axes_B": axes,
        "spin_inertia": np.zeros(wheels) if spin_inertia is None else np.asarray(spin_inertia),
        "boresight_B": np.array([0.0, 0.0, 1.0]),
        "rate_axes": np.eye(3),
    }
    known, momentum, nothing = jax.tree.map(
        jnp.asarray, (context, np.zeros((n, wheels)), np.zeros((n, 3)))
    )
    environment = Environment(*(nothing for _ in Environment._fields))
    return SlewInput(SlewContext(**known), momentum, environment)
