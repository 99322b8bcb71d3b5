"""Inputs and outputs of the closed loop of a slew: the plant, noise, the slew as flown."""

from __future__ import annotations

from typing import NamedTuple

from jax import Array

from bayes_inertia.physics.slew_input import Start


class Plant(NamedTuple):
    """The spacecraft as it is, as arrays.

    Parameters
    ----------
    inertia_B : (3, 3) array
        Inertia tensor without the wheels' spin [kg m^2].
    scale_factor : (3,) array
        True K of the rate sensor.
    bias : (3,) array
        True bias of the rate sensor, in its own axes [rad/s].
    rate_axes : (3, 3) array
        C_rate, from body axes to sensor axes.
    start : Start
        State at the first row.
    """

    inertia_B: Array
    scale_factor: Array
    bias: Array
    rate_axes: Array
    start: Start


class SensorNoise(NamedTuple):
    """Noise of one slew of n rows.

    Parameters
    ----------
    rate : (n, 3) array
        Of the rate readings [rad/s].
    momentum : (n, wheels) array
        Of the tachometers [N m s].
    attitude : (n, 3) array
        Small rotation of each star-tracker fix, in body axes [rad].
    bias_snapshot : (3,) array
        Of the mean reading at rest that gives the controller its bias [rad/s].
    """

    rate: Array
    momentum: Array
    attitude: Array
    bias_snapshot: Array


class FlownSlew(NamedTuple):
    """One slew as flown, n rows: first what telemetry shows, then the truth.

    Parameters
    ----------
    command : (n, wheels) array
        Commanded torque on each wheel [N m].
    rate : (n, 3) array
        Readings of the rate sensor [rad/s].
    momentum : (n, wheels) array
        Wheel momentum as the tachometers show it [N m s].
    fixes : (n, 4) array
        What the star tracker would show in every row.
    attitude : (n, 4) array
        True attitude.
    rate_B : (n, 3) array
        True rate [rad/s].
    wheel_momentum : (n, wheels) array
        True wheel momentum relative to the body [N m s].
    final_error_B : (3,) array
        Rotation vector from the target to the true final attitude [rad].
    measured_error_B : (3,) array
        The same as the star tracker measures it [rad].
    relaxation_change : float
        Largest change of a command in the last round, as a fraction of the largest command.
    """

    command: Array
    rate: Array
    momentum: Array
    fixes: Array
    attitude: Array
    rate_B: Array
    wheel_momentum: Array
    final_error_B: Array
    measured_error_B: Array
    relaxation_change: Array
