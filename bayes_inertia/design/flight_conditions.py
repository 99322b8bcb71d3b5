"""Conditions under which slews will be flown: sensors, noise, environment, clock."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.design.numerics import NUMERICS
from bayes_inertia.errors import CampaignError
from bayes_inertia.flight.orbit import Orbit
from bayes_inertia.maths.values import AnyArray
from bayes_inertia.physics.channels.rate import RateConstants
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.nuisances import NuisanceScale
from bayes_inertia.physics.slew_context import Environment


class InverseNoise(NamedTuple):
    """Inverse noise of one sample; zero for what is not measured.

    Parameters
    ----------
    rate : (3,) array
        Inverse sds of the rate sensor's readings [s/rad].
    attitude : (3, 3) array
        Inverse root of the covariance of one fix [1/rad].
    momentum : (wheels,) array
        Inverse sds of the tachometers' readings [1/(N m s)].
    """

    rate: AnyArray
    attitude: AnyArray
    momentum: AnyArray


class EnvironmentTable(NamedTuple):
    """The environment on a clock.

    Parameters
    ----------
    time : (k,) array
        Time in the campaign [s], ascending.
    values : Environment
        Its columns (k, 3).
    """

    time: AnyArray
    values: Environment


class FlightConditions(NamedTuple):
    """Everything that a slew's information depends on, besides the slews and the parameters.

    Parameters
    ----------
    sensors : RateConstants
        Axes and bias of the rate sensor.
    scale : NuisanceScale
        Prior sds of bias and start states.
    noise : InverseNoise
        Inverse noise of one sample.
    environment : EnvironmentTable
        Magnetic field and position on the campaign's clock.
    wheel_axes_B : (3, wheels) array
        Unit spin axes as columns.
    allocation : (wheels, 3) array
        Pseudo-inverse of `wheel_axes_B`.
    spin_inertia : (wheels,) array
        Spin inertia of each wheel [kg m^2].
    boresight_B : (3,) array
        The star tracker's boresight.
    first : () array of int
        Index of the first of these slews in its campaign.
    slew_count : () array of int
        Slews in that campaign.
    start_time : () array
        When these slews begin on its clock [s].
    middle : () array
        The middle of the campaign on that clock [s].
    """

    sensors: RateConstants
    scale: NuisanceScale
    noise: InverseNoise
    environment: EnvironmentTable
    wheel_axes_B: AnyArray
    allocation: AnyArray
    spin_inertia: AnyArray
    boresight_B: AnyArray
    first: AnyArray
    slew_count: AnyArray
    start_time: AnyArray
    middle: AnyArray


def conditions_of(
    model: Model,
    environment: EnvironmentTable,
    *,
    first: int,
    slew_count: int,
    start_time: float,
    middle: float,
) -> FlightConditions:
    """The conditions of slews flown with a model's hardware in the commanded drive.

    `start_time` [s]. `model`: it tells the hardware, and the prior sds of bias and start states.
    `first`: index of the first of these slews in the campaign. `middle`: the middle of the campaign
    on that clock [s].
    """
    campaign = model.campaign
    if not campaign.wheels:
        raise CampaignError(
            "no wheels to fly slews with",
            where="key wheels",
            advice="describe the wheels in campaign.toml",
        )
    tracker = campaign.star_tracker
    boresight_B = (0.0, 0.0, 1.0) if tracker is None else tracker.boresight_B
    return FlightConditions(
        sensors=model.data.sensors[model.structure.place("rate")],
        scale=model.data.scale,
        noise=_inverse_noise(campaign),
        environment=environment,
        wheel_axes_B=campaign.wheel_axes_B,
        allocation=np.linalg.pinv(campaign.wheel_axes_B),
        spin_inertia=campaign.spin_inertias,
        boresight_B=np.array(boresight_B),
        first=np.array(first),
        slew_count=np.array(slew_count),
        start_time=np.array(start_time),
        middle=np.array(middle),
    )


def orbit_environment(orbit: Orbit | None, duration: float) -> EnvironmentTable:
    """The environment along an orbit.

    `duration` [s].

    Examples
    --------
    >>> orbit_environment(None, 100.0).values.position_N.shape
    (200, 3)
    """
    time = np.linspace(0.0, duration, NUMERICS.orbit_points)
    none = np.zeros((len(time), 3))
    nothing = Environment(*(none for _ in Environment._fields))
    return EnvironmentTable(time, nothing if orbit is None else orbit.environment(time))


def last_environment(campaign: Campaign) -> EnvironmentTable:
    """The environment that a campaign measured last, taken to stay as it was.

    Returns: two equal rows; zero for what the last slew did not measure.
    """
    last = campaign.slews[-1]
    given = (_last_complete(getattr(last, key)) for key in Environment._fields)
    values = Environment(*(np.tile(row, (2, 1)) for row in given))
    return EnvironmentTable(np.array([0.0, 1.0]), values)


def environment_at(table: EnvironmentTable, moments: Array) -> Environment:
    """The environment at given times, its columns (n, 3).

    `moments` (n,) [s].
    """

    def at(values: AnyArray) -> Array:
        return jnp.stack([jnp.interp(moments, table.time, values[:, i]) for i in range(3)], -1)

    return Environment(*map(at, table.values))


def _inverse_noise(campaign: Campaign) -> InverseNoise:
    """The inverse noise of a campaign's sensors."""
    attitude, tracker = np.zeros((3, 3)), campaign.star_tracker
    if tracker is not None:
        along = np.outer(tracker.boresight_B, tracker.boresight_B)
        attitude = (np.eye(3) - along) / tracker.sigma_cross + along / tracker.sigma_roll
    momentum = np.array([1.0 / (wheel.momentum_sigma or np.inf) for wheel in campaign.wheels])
    return InverseNoise(1.0 / np.array(campaign.three_axis_gyro.sigma), attitude, momentum)


def _last_complete(values: np.ndarray | None) -> np.ndarray:
    """The last row (3,) without gaps of (n, 3); zero without any."""
    complete = np.zeros(0, bool) if values is None else np.isfinite(values).all(1)
    return values[complete][-1] if values is not None and complete.any() else np.zeros(3)
