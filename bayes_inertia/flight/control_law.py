"""The attitude controller as pure functions: the motion it wants, the torques it commands.

It follows the planned rotation about a body-fixed axis. It feeds forward the torque that its own
inertia tensor asks for, and feeds back the attitude and rate that it believes.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from bayes_inertia.flight.slew_profile import angle_and_rate
from bayes_inertia.maths import quaternion


class SlewSchedule(NamedTuple):
    """One slew as the controller is told to fly it, padded to n rows.

    Parameters
    ----------
    start_attitude : (4,) array
        Planned attitude before the slew, body from inertial, scalar last.
    axis_B : (3,) array
        Unit axis of the slew in the body frame.
    angle : float
        Angle of the slew [rad].
    rate : float
        Largest rate [rad/s].
    acceleration : float
        Limit of the angular acceleration [rad/s^2].
    smooth : bool
        Whether the ramps are versines.
    motion_start : float
        When the motion begins [s], from the first row.
    n_rows : int
        How many rows are no padding.
    time : (n,) array
        Times of the rows [s].
    fix_gain : (n,) array
        Share of each star-tracker fix before the motion in the mean attitude so far; 0 where there
        is none.
    final_fix_weight : (n,) array
        Weight of each fix after the motion in the mean final attitude.
    """

    start_attitude: Array
    axis_B: Array
    angle: Array
    rate: Array
    acceleration: Array
    smooth: Array
    motion_start: Array
    n_rows: Array
    time: Array
    fix_gain: Array
    final_fix_weight: Array


class ControlLaw(NamedTuple):
    """Beliefs and gains of the controller, as arrays.

    Parameters
    ----------
    inertia_B : (3, 3) array
        Inertia tensor that it believes, without the wheels' spin [kg m^2].
    scale_factor : (3,) array
        K by which it multiplies the readings of the rate sensor.
    rate_axes_inverse : (3, 3) array
        Inverse of C_rate: from sensor axes to body axes.
    wheel_axes_B : (3, wheels) array
        Unit spin axes as columns.
    allocation : (wheels, 3) array
        Shares of a torque among the wheels that motors drive.
    spin_inertia : (wheels,) array
        Spin inertia of each wheel [kg m^2].
    max_torque : (wheels,) array
        Torque limit of each wheel [N m].
    stiffness : float
        Gain on the attitude error [1/s^2].
    damping : float
        Gain on the rate error [1/s].
    rate_range : float
        Largest rate that the sensor reads [rad/s].
    """

    inertia_B: Array
    scale_factor: Array
    rate_axes_inverse: Array
    wheel_axes_B: Array
    allocation: Array
    spin_inertia: Array
    max_torque: Array
    stiffness: Array
    damping: Array
    rate_range: Array


class ReferenceMotion(NamedTuple):
    """The planned motion at a row, and over the control period that begins there.

    Parameters
    ----------
    attitude : (4,) array
        Planned attitude.
    rate_B : (3,) array
        Planned rate [rad/s].
    middle_rate_B : (3,) array
        Planned rate in the middle of the period [rad/s].
    acceleration_B : (3,) array
        Mean planned acceleration over the period [rad/s^2].
    fix_gain : float
        Share of this row's star-tracker fix in the mean attitude so far.
    elapsed : float
        Time since the row before [s].
    """

    attitude: Array
    rate_B: Array
    middle_rate_B: Array
    acceleration_B: Array
    fix_gain: Array
    elapsed: Array


def target_attitude(schedule: SlewSchedule) -> Array:
    """Attitude that the slew is to end in.

    Returns (4,).

    Examples
    --------
    >>> start, axis, row = jnp.array([0., 0., 0., 1.]), jnp.array([0., 0., 1.]), jnp.zeros(2)
    >>> schedule = SlewSchedule(start, axis, jnp.pi, 1., 1., False, 0., 2, row, row, row)
    >>> (target_attitude(schedule).round(6) + 0.0).tolist()
    [0.0, 0.0, 1.0, 0.0]
    """
    return quaternion.multiply(
        schedule.start_attitude, quaternion.exp(schedule.axis_B * schedule.angle)
    )


def reference_motion(schedule: SlewSchedule) -> ReferenceMotion:
    """The planned motion at all rows of a slew.

    Returns: every field with a leading axis of n rows.
    """
    t = schedule.time - schedule.motion_start
    step = jnp.append(jnp.diff(schedule.time), 0.0)
    motion = partial(
        angle_and_rate, schedule.angle, schedule.rate, schedule.acceleration, schedule.smooth
    )
    angle, rate = motion(t)
    _, middle_rate = motion(t + 0.5 * step)
    next_rate = jnp.append(rate[1:], rate[-1:])
    acceleration = jnp.where(step > 0.0, (next_rate - rate) / jnp.where(step > 0.0, step, 1.0), 0.0)
    attitude = quaternion.multiply(
        schedule.start_attitude, quaternion.exp(angle[:, None] * schedule.axis_B)
    )
    return ReferenceMotion(
        attitude=attitude,
        rate_B=rate[:, None] * schedule.axis_B,
        middle_rate_B=middle_rate[:, None] * schedule.axis_B,
        acceleration_B=acceleration[:, None] * schedule.axis_B,
        fix_gain=schedule.fix_gain,
        elapsed=jnp.concatenate([jnp.zeros(1), step[:-1]]),
    )


def wheel_command(
    law: ControlLaw, reference: ReferenceMotion, attitude: Array, rate_B: Array, momentum: Array
) -> Array:
    """Motor torques that the controller commands.

    Inverse dynamics of the planned motion (paper eq 6), and feedback of what differs from it.
    Saturation scales all wheels together, which keeps the torque's direction.

    `attitude` (4,); `rate_B` (3,) [rad/s]. `momentum` (wheels,): wheel momentum relative to the
    body, as the tachometers show it [N m s]. Returns (wheels,) [N m].
    """
    error = quaternion.error(reference.attitude, attitude)
    # The planned rate in the axes of the believed attitude.
    rate_error = rate_B - reference.rate_B + jnp.cross(error, reference.rate_B)
    wheel = momentum + law.spin_inertia * (reference.middle_rate_B @ law.wheel_axes_B)
    total = law.inertia_B @ reference.middle_rate_B + law.wheel_axes_B @ wheel
    acceleration = reference.acceleration_B - law.stiffness * error - law.damping * rate_error
    torque = -law.allocation @ (
        law.inertia_B @ acceleration + jnp.cross(reference.middle_rate_B, total)
    )
    return torque * jnp.min(
        law.max_torque / jnp.maximum(jnp.abs(torque), law.max_torque), initial=1.0
    )
