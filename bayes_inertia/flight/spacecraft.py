"""A spacecraft as it really is, and the attitude controller that flies it with what it believes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Any

import jax.numpy as jnp
import numpy as np

from bayes_inertia.campaign.hardware import (
    InertiaPrior,
    Numbers,
    RateSensor,
    StarTracker,
    Wheel,
    numbers,
    one_an_axis,
    require_positive,
)
from bayes_inertia.errors import members, require_kind
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.values import AnyArray, array_dataclass
from bayes_inertia.physics.effect import ActiveEffects, Effect, require_of_effect
from bayes_inertia.physics.named_effects import effects_named
from bayes_inertia.physics.stochastic_effect import StochasticEffect


@array_dataclass
class Spacecraft:
    """The spacecraft as it really is.

    Parameters
    ----------
    inertia_B : (3, 3) array
        Inertia tensor of everything except the wheels' spin [kg m^2].
    scale_factor : tuple of float
        True K of the rate sensor, one an axis.
    wheels : tuple of Wheel
        Reaction wheels.
    rate_sensor : RateSensor or None
        Its axes and noise, and what was known of K and bias before flight; None without one.
    star_tracker : StarTracker, optional
        None for a spacecraft without one.
    bias : tuple of float, optional
        True rate bias [rad/s]; None draws it from the sensor's prior in every flight.
    effects : tuple of Effect or str
        What else acts, or its names as at the command line.
    values : dict
        {effect: {parameter: value}}, how strongly.
    more_sensors, names, reference : optional
        Further sensors, and what they are called, as in `Campaign`.
    device : optional
        What turns it in place of wheels, as `Mission.of` finds it; None where wheels do.
    periods : dict
        {sensor: time from one reading to the next [s]}; of a sensor that is not named a reading
        stands in every row.
    seen_N : dict
        {direction sensor or field of `Slew`: what is seen, inertial axes}, where no orbit tells.

    Raises
    ------
    CampaignError
        If no body has this inertia tensor, or a wheel or sensor is none.
    EffectError
        If the name of an effect is unknown, or an effect has no values.

    Examples
    --------
    >>> craft = Spacecraft(np.diag([3., 2., 2.]), (1.01, 1.0, 1.0), (), RateSensor(sigma=2e-5))
    >>> craft.scale_factor
    (1.01, 1.0, 1.0)
    """

    inertia_B: np.ndarray
    scale_factor: Numbers
    wheels: tuple[Wheel, ...]
    rate_sensor: RateSensor | None
    star_tracker: StarTracker | None = None
    bias: Numbers | None = None
    effects: tuple[Effect, ...] = ()
    values: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    more_sensors: tuple[tuple[str, Any], ...] = ()
    device: Any = None  # a FlyingDevice
    names: tuple[str, str] = ("rate sensor", "star tracker")
    reference: str | None = None
    periods: Mapping[str, float] = field(default_factory=dict)
    seen_N: Mapping[str, Numbers] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "inertia_B", InertiaPrior(self.inertia_B, 1.0, 1.0).tensor)
        require_kind(self.rate_sensor, RateSensor | None, "rate_sensor")
        require_kind(self.star_tracker, StarTracker | None, "star_tracker")
        axes = len(self.rate_sensor.axes) if self.rate_sensor else 0
        factors = one_an_axis(self.scale_factor, axes, "scale_factor") if axes else ()
        object.__setattr__(self, "scale_factor", factors)
        if self.bias is not None and axes:
            object.__setattr__(self, "bias", one_an_axis(self.bias, axes, "bias"))
        object.__setattr__(self, "wheels", members(self.wheels, Wheel, "wheels"))
        object.__setattr__(self, "effects", effects_named(self.effects))
        for effect in self.effects:
            advice = "give values = {effect name: {parameter: value}}"
            require_of_effect(effect.name in self.values, effect, "has no values", advice)
        require_shape(self.effects)

    @property
    def flies_by_gyro(self) -> bool:
        """Whether wheels and a gyro of three axes close the attitude loop.

        Otherwise a flight follows its plan, however the loop is closed on board.
        """
        gyro = self.rate_sensor is not None and len(self.rate_sensor.axes) == 3
        return gyro and self.device is None

    @property
    def gyro(self) -> RateSensor:
        """The rate sensor of a spacecraft that has one."""
        assert self.rate_sensor is not None
        return self.rate_sensor

    @property
    def axes_of_control(self) -> int:
        """About how many axes it can be turned."""
        return self.device.axes if self.device else axes_of_control(self.wheels)

    @property
    def active_effects(self) -> ActiveEffects:
        """`effects` and `values` as one object, the values as JAX arrays."""
        values = {
            effect.name: {
                k: jnp.asarray(v, dtype=float) for k, v in self.values[effect.name].items()
            }
            for effect in self.effects
        }
        return ActiveEffects(self.effects, values)

    @property
    def wheel_axes_B(self) -> np.ndarray:
        """G (3, wheels): unit spin axes as columns."""
        return _as_columns([w.axis_B for w in self.wheels])


@array_dataclass
class Controller:
    """What the attitude control believes, and how firmly it acts.

    Parameters
    ----------
    inertia_B : (3, 3) array
        Inertia tensor without the wheels' spin [kg m^2], for feedforward and gains.
    scale_factor : tuple of 3 floats
        K by which it multiplies the readings of the rate sensor.
    bandwidth : float
        Natural frequency of the attitude loop [rad/s].
    damping : float
        Damping ratio of the attitude loop.
    snapshot_time : float
        How long before each slew readings at rest are averaged for the bias [s]; 0 takes a single
        reading.
    rest_rate_sigma : float
        How still the rest before a slew is [rad/s].
    rest_attitude_sigma : float
        How well aimed the rest before a slew is [rad].

    Raises
    ------
    CampaignError
        If bandwidth or damping is not positive.

    Examples
    --------
    >>> Controller(np.eye(3)).scale_factor
    (1.0, 1.0, 1.0)
    """

    inertia_B: np.ndarray
    scale_factor: Numbers = (1.0, 1.0, 1.0)
    bandwidth: float = 0.17
    damping: float = math.sqrt(0.5)
    snapshot_time: float = 20.0
    rest_rate_sigma: float = 1e-5
    rest_attitude_sigma: float = 5e-5

    def __post_init__(self) -> None:
        inertia_B = numbers(self.inertia_B, "controller.inertia_B")
        object.__setattr__(self, "inertia_B", inertia_B)
        for key in ("bandwidth", "damping"):
            require_positive(getattr(self, key), f"controller.{key}")


def most_like_spacecraft() -> Spacecraft:
    """A microsatellite like MOST in Ferguson's simulations.

    It has three wheels, and a star tracker with 5" across and 30" about its boresight.

    Returns
    -------
    Spacecraft
        With the true J and K of Ferguson's Table 1.

    Examples
    --------
    >>> most_like_spacecraft().scale_factor
    (1.01, 1.02, 0.98)
    """
    J = np.array([[3.3311, -0.0119, 0.0027], [-0.0119, 2.2024, 0.0161], [0.0027, 0.0161, 1.8033]])
    axes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    limits = 0.02, 0.3, 5e-6  # max_torque [N m], max_momentum, momentum_sigma [N m s]
    wheels = tuple(
        Wheel(f"wheel_{name}", axis, 1e-3, *limits) for name, axis in zip("xyz", axes, strict=True)
    )
    sensor = RateSensor(sigma=(2e-5, 2e-5, 2e-5), bias_sigma=(2e-6, 2e-6, 2e-6))
    tracker = StarTracker((0.0, 0.0, 1.0), math.radians(5.0 / 3600.0), math.radians(30.0 / 3600.0))
    return Spacecraft(J, (1.01, 1.02, 0.98), wheels, sensor, tracker)


def most_like_prior() -> InertiaPrior:
    """Prior of the MOST-like spacecraft: each moment is 2 to 4 % wrong.

    Returns
    -------
    InertiaPrior
        Of `most_like_spacecraft`.

    Examples
    --------
    >>> most_like_prior().relative_sigma
    0.04
    """
    tensor = most_like_spacecraft().inertia_B * np.array(
        [[0.97, 1.02, 0.97], [1.02, 0.98, 0.98], [0.97, 0.98, 1.04]]
    )
    return InertiaPrior(tensor, 0.04, 0.03)


def require_shape(effects: Sequence[Effect]) -> None:
    """`EffectError` for an effect that a simulated flight cannot have."""
    for effect in effects:
        shaped = not isinstance(effect, StochasticEffect)
        what = "is stochastic, which simulated flights do not draw"
        require_of_effect(shaped, effect, what, "fly without it")


def allocation(wheels: Sequence[Wheel]) -> np.ndarray:
    """Shares of a torque among the wheels: the pseudo-inverse of the axes that motors drive.

    Returns (wheels, 3): zero for a wheel that spins freely or is locked.

    Examples
    --------
    >>> bool(allocation([Wheel("y", (0., 1., 0.), 1e-3, state="free")]).any())
    False
    """
    return np.linalg.pinv(_driven_axes_B(wheels))


def axes_of_control(wheels: Sequence[Wheel]) -> int:
    """About how many axes the wheels that motors drive turn a spacecraft.

    Examples
    --------
    >>> axes_of_control([Wheel("x", (1.0, 0.0, 0.0), 1e-3)]), axes_of_control(())
    (1, 0)
    """
    return int(np.linalg.matrix_rank(_driven_axes_B(wheels), tol=1e-6)) if wheels else 0


def _driven_axes_B(wheels: Sequence[Wheel]) -> np.ndarray:
    """Spin axes (3, wheels) as columns, zero for a wheel that no motor drives."""
    return _as_columns([w.axis_B if w.state == "running" else (0.0, 0.0, 0.0) for w in wheels])


def _as_columns(vectors: Sequence[Sequence[float]]) -> np.ndarray:
    return np.array(vectors).reshape(-1, 3).T


def spin_tensor(wheels: Sequence[Wheel]) -> np.ndarray:
    """Difference of J_locked and J: the sum of Js g g^T over all wheels.

    Returns (3, 3) [kg m^2].

    Examples
    --------
    >>> spin_tensor([Wheel("x", (1., 0., 0.), 1e-3)])[0, 0].item()
    0.001
    """
    axes, spin = _as_columns([w.axis_B for w in wheels]), [w.spin_inertia for w in wheels]
    return np.array(inertia_tensor.wheel_spin_tensor(axes, np.array(spin)))


def body_tensor(elements: AnyArray, prior: InertiaPrior, wheels: Sequence[Wheel]) -> np.ndarray:
    """J of everything except the wheels' spin, from elements of the tensor that a prior is of.

    `elements` (..., 6) [kg m^2]. Returns (..., 3, 3) [kg m^2].

    Examples
    --------
    >>> prior = InertiaPrior(np.eye(3), 0.1, 0.1, includes_wheel_spin=True)
    >>> body_tensor(prior.elements, prior, [Wheel("x", (1., 0., 0.), 1e-3)])[0, 0].item()
    0.999
    """
    tensor = np.array(inertia_tensor.tensor(elements))
    return tensor - spin_tensor(wheels) if prior.includes_wheel_spin else tensor
