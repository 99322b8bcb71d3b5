"""Devices beside wheels that turn the spacecraft, and changes of it, as known before a fit.

What each device was told to do, or did, is in `Slew.inputs` by the device's name.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from bayes_inertia.campaign.hardware import (
    numbers,
    one_an_axis,
    require_key,
    require_name,
    require_positive,
    require_sd,
    unit_length,
)
from bayes_inertia.campaign.slew import on_campaign_clock
from bayes_inertia.errors import is_one_of
from bayes_inertia.maths.values import array_dataclass


@dataclass(frozen=True)
class KnownTorque:
    """A torque that telemetry tells, whatever makes it; input: three components [N m].

    Parameters
    ----------
    name : str
        The device, as printed, and the name of its input.
    gain_sigma : float, optional
        Prior sd of the factor, near 1, by which the true torque is larger; 0: it is known.
    frame : "body" or "inertial", optional
        The axes that its components belong to.

    Raises
    ------
    CampaignError
        If the sd is negative or the frame unknown.

    Examples
    --------
    >>> KnownTorque("jets", gain_sigma=0.02).columns
    3
    """

    name: str
    gain_sigma: float = 0.0
    frame: Literal["body", "inertial"] = "body"
    columns: ClassVar[int] = 3  # numbers of a reading of its input

    def __post_init__(self) -> None:
        _check(self)
        known = is_one_of(self.frame, ("body", "inertial"))
        what = f"{self.frame!r} is unknown"
        require_key(known, f"actuators.{self.name}.frame", what, "choose body or inertial")


@array_dataclass
class Magnetorquer:
    """Torquers of one gain; input: the dipole of each [A m^2].

    The torque is the dipole's cross product with `Slew.magnetic_field_N`.

    Parameters
    ----------
    name : str
        The device, as printed, and the name of its input.
    axes_B : (k, 3) array, optional
        Unit vector of each torquer's dipole in body axes; by default the three body axes.
    gain_sigma : float, optional
        Prior sd of the factor, near 1, by which the true dipole is larger; 0: it is known.

    Raises
    ------
    CampaignError
        If an axis is no unit vector or the sd is negative.

    Examples
    --------
    >>> Magnetorquer("torquers").columns
    3
    """

    name: str
    axes_B: np.ndarray = field(default_factory=lambda: np.eye(3))
    gain_sigma: float = 0.0

    def __post_init__(self) -> None:
        _check(self)
        axes = _unit_vectors(self.axes_B, f"actuators.{self.name}.axes")
        object.__setattr__(self, "axes_B", axes)

    @property
    def columns(self) -> int:
        """How many numbers a reading of its input has: one a torquer."""
        return len(self.axes_B)


@array_dataclass
class Thruster:
    """Thrusters; input: of each the level, 0 to 1 of full thrust, or the on-time [s].

    Parameters
    ----------
    name : str
        The device, as printed, and the name of its input.
    torque_B : (k, 3) array
        Torque of each thruster about the centre of mass at full thrust, body axes [N m].
    gain_sigma : float, optional
        Prior sd of the factor, near 1, by which all torques are larger; 0: they are known.
    each_gain_sigma : float, optional
        Prior sd of a further factor of each thruster alone; 0: all are alike.
    direction_sigma : float, optional
        Prior sd of a small rotation of all torques about each body axis [rad]; 0: the directions
        are known.

    Raises
    ------
    CampaignError
        If torques do not have three components each, or an sd is negative.

    Examples
    --------
    >>> Thruster("jets", np.eye(3)).columns
    3
    """

    name: str
    torque_B: np.ndarray
    gain_sigma: float = 0.0
    each_gain_sigma: float = 0.0
    direction_sigma: float = 0.0

    def __post_init__(self) -> None:
        _check(self)
        torque_B = _vectors(self.torque_B, f"actuators.{self.name}.torque")
        object.__setattr__(self, "torque_B", torque_B)

    @property
    def columns(self) -> int:
        """How many numbers a reading of its input has: one a thruster."""
        return len(self.torque_B)


@array_dataclass
class GimballedRotors:
    """Rotors of constant speed on gimbals (control-moment gyros); input: gimbal angles [rad].

    At the gimbal angle a a rotor's momentum lies along cos(a) s + sin(a) g x s, with the gimbal
    axis g and the spin axis s at angle zero.

    Parameters
    ----------
    name : str
        The device, as printed, and the name of its input.
    momentum : float or (k,) array_like
        Momentum of each rotor [N m s].
    gimbal_axes_B : (k, 3) array
        Unit vector of each gimbal's axis, body axes.
    spin_axes_at_zero_B : (k, 3) array
        Unit vector of each spin axis at gimbal angle zero, at right angles to the gimbal's.
    angle_sigma : float, optional
        Noise of a reading of the gimbal angles [rad]; 0: they are exact.
    gain_sigma : float, optional
        Prior sd of the factor, near 1, by which all momenta are larger; 0: they are known.

    Raises
    ------
    CampaignError
        If an axis is no unit vector, two axes of a rotor are not at right angles, or a number is
        negative.

    Examples
    --------
    >>> GimballedRotors("cmg", 1.0, np.eye(3), np.eye(3)[[1, 2, 0]]).momentum.tolist()
    [1.0, 1.0, 1.0]
    """

    name: str
    momentum: np.ndarray | float
    gimbal_axes_B: np.ndarray
    spin_axes_at_zero_B: np.ndarray
    angle_sigma: float = 0.0
    gain_sigma: float = 0.0

    def __post_init__(self) -> None:
        _check(self)
        key = f"actuators.{self.name}"
        gimbal = _unit_vectors(self.gimbal_axes_B, f"{key}.gimbal_axes")
        spin = _unit_vectors(self.spin_axes_at_zero_B, f"{key}.spin_axes_at_zero")
        pairs = f"{len(gimbal)} gimbal axes and {len(spin)} spin axes"
        require_key(len(gimbal) == len(spin), f"{key}.spin_axes_at_zero", pairs, "give one a rotor")
        lean = np.sum(gimbal * spin, axis=1, keepdims=True)
        slanted = float(np.abs(lean).max())
        what = f"a spin axis leans {np.degrees(np.arcsin(slanted)):.2g} deg towards its gimbal axis"
        advice = "give each at right angles to its gimbal axis"
        require_key(slanted < 0.01, f"{key}.spin_axes_at_zero", what, advice)
        object.__setattr__(self, "gimbal_axes_B", gimbal)
        object.__setattr__(self, "spin_axes_at_zero_B", unit_length(spin - lean * gimbal))
        momentum = one_an_axis(self.momentum, len(gimbal), f"{key}.momentum", positive=True)
        object.__setattr__(self, "momentum", np.array(momentum))

    @property
    def columns(self) -> int:
        """How many numbers a reading of its input has: one a gimbal."""
        return len(self.gimbal_axes_B)


Actuator = KnownTorque | Magnetorquer | Thruster | GimballedRotors


class DeviceInput(NamedTuple):
    """How a description names a device and its input, which a campaign holds in this unit."""

    type: str
    key: str
    quantity: str  # whose units are those of the input
    unit: str


DEVICE_INPUTS: Mapping[type, DeviceInput] = MappingProxyType(
    {
        KnownTorque: DeviceInput("torque", "torque", "wheel_torque", "N m"),
        Magnetorquer: DeviceInput("magnetorquer", "dipole", "dipole", "A m^2"),
        Thruster: DeviceInput("thruster", "level", "level", "1"),
        GimballedRotors: DeviceInput("gimballed_rotors", "gimbal_angle", "angle", "rad"),
    }
)


@dataclass(frozen=True)
class Change:
    """A change of the spacecraft at a known time, of unknown size: every model has it.

    Parameters
    ----------
    name : str
        The change, as printed; its parameters are called "NAME.change_Jxx" and so on.
    time : float or datetime
        When, on the campaign's clock [s]; of a datetime, since 1970 (UTC). Slews that start then or
        later have what came after.
    sigma_fraction : float, optional
        Prior sd of the change of each tensor element, as a fraction of the mean moment of inertia.
    part : "inertia", optional
        What changed.

    Raises
    ------
    CampaignError
        If the time is not finite, the sd not positive or the part unknown.

    Examples
    --------
    >>> Change("fuel", 1900.0).sigma_fraction
    0.03
    """

    name: str
    time: float
    sigma_fraction: float = 0.03
    part: Literal["inertia"] = "inertia"

    def __post_init__(self) -> None:
        key = f"changes.{self.name}"
        require_name(self.name, "changes.name")
        object.__setattr__(self, "time", on_campaign_clock(self.time, f"{key}.time"))
        require_positive(self.sigma_fraction, f"{key}.sigma_fraction")
        known = is_one_of(self.part, ("inertia",))
        require_key(known, f"{key}.part", f"{self.part!r} is unknown", 'write "inertia"')


def _check(device: Any) -> None:
    """Raise `CampaignError` unless the device has a name and its sds are possible."""
    require_name(device.name, "actuators.name")
    for key in ("gain_sigma", "each_gain_sigma", "direction_sigma", "angle_sigma"):
        require_sd(getattr(device, key, 0.0), f"actuators.{device.name}.{key}")


def _vectors(value: Any, key: str) -> np.ndarray:
    """Vectors (k, 3), at least one, or `CampaignError`."""
    vectors = numbers(value, key)
    good = vectors.shape[1:] == (3,) and len(vectors) > 0 and bool(np.isfinite(vectors).all())
    what = f"shape {vectors.shape} is no list of vectors"
    require_key(good, key, what, "give three numbers each")
    return vectors


def _unit_vectors(value: Any, key: str) -> np.ndarray:
    """Unit vectors (k, 3), or `CampaignError`."""
    vectors = _vectors(value, key)
    lengths = np.linalg.norm(vectors, axis=1)
    alike = bool((abs(lengths - 1.0) < 0.01).all())
    what = f"vectors of lengths {np.round(lengths, 4).tolist()}"
    require_key(alike, key, what, "give unit vectors in body axes")
    return unit_length(vectors)
