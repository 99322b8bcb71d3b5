"""The hardware that a campaign was flown with, its inertia as known before, and checks of both."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, get_args

import numpy as np

from bayes_inertia import errors
from bayes_inertia.errors import is_one_of, kind_of, members, require_kind
from bayes_inertia.faults.limits import LIMITS
from bayes_inertia.maths import values
from bayes_inertia.maths.tensor_elements import COLUMNS_OF_ELEMENTS, ROWS_OF_ELEMENTS
from bayes_inertia.maths.values import Vector, array_dataclass, plain_array

# One number for each axis of a sensor.
Numbers = tuple[float, ...]


def require_key(condition: bool, key: str, what: str, advice: str) -> None:
    """Raise an error that names a key of the campaign, unless a condition holds."""
    errors.require(condition, f"key {key}", what, advice)


def numbers(
    value: Any,
    key: str,
    advice: str = "give numbers in rows of one length, NaN where there is none",
) -> np.ndarray:
    """Floats of whatever holds real numbers, or `CampaignError`."""
    return values.numbers(value, f"key {key}", advice)


def require_name(value: Any, key: str) -> None:
    """Raise an error unless a name is a text."""
    require_key(isinstance(value, str), key, f"{value!r} is no name", "give a text")


def pairs(key: str, given: Any) -> tuple[tuple[str, Any], ...]:
    """What is listed by name, or `CampaignError`."""
    found = members(given, object, f"key {key}")
    for pair in found:
        named = isinstance(pair, tuple | list) and len(pair) == 2
        named = named and isinstance(pair[0], str) and bool(pair[0])
        what = f"{kind_of(pair)} is no pair of a name and what it names"
        require_key(named, key, what, 'list each as ("NAME", ...), or give a dictionary')
    return tuple(map(tuple, found))


def unit_vector(value: Any, key: str) -> Vector:
    """Three numbers whose length is 1 to within a percent, as plain floats of length 1."""
    array = numbers(value, key)
    is_vector = array.shape == (3,) and bool(np.all(np.isfinite(array)))
    require_key(is_vector, key, f"{value!r} is not a vector", "give three finite numbers")
    norm = math.hypot(*array.tolist())
    what = f"the vector has length {norm:.6g}, not 1"
    advice = "give a unit vector in body axes"
    require_key(abs(norm - 1.0) < 0.01, key, what, advice)
    x, y, z = unit_length(array).tolist()
    return (x, y, z)


def unit_length(vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., n) over their length; one of length 1 to rounding stays, to the last digit."""
    norm = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(np.abs(norm - 1.0) < 1e-15, vectors, vectors / norm)


def one_an_axis(value: Any, axes: int, key: str, *, positive: bool = False) -> Numbers:
    """One number for each axis of a sensor, as plain floats, from one number or one an axis."""
    array = np.atleast_1d(numbers(value, key))
    fits = array.shape in ((1,), (axes,))
    what = f"{value!r} is not one number, nor one for each of {axes} axes"
    require_key(fits, key, what, f"give one number, or {axes}")
    finite = bool(np.all(np.isfinite(array)))
    require_key(finite, key, f"{value!r} is not finite", "give finite numbers")
    good = not positive or bool((array > 0.0).all())
    require_key(good, key, f"{value!r} is not positive", "give a positive number in SI units")
    return tuple(np.broadcast_to(array, (axes,)).tolist())


def require_positive(value: Any, key: str, *, optional: bool = False) -> None:
    """Raise an error unless a number is finite and positive."""
    if value is not None or not optional:
        advice = "give a positive number in SI units"
        require_number(value, key, "is not positive", advice, lambda x: x > 0.0)


def require_sd(value: Any, key: str) -> None:
    """Raise an error unless a number is an sd, or 0 where nothing is in doubt."""
    advice = "give a number, 0 where nothing is in doubt"
    require_number(value, key, "is no sd", advice, lambda x: x >= 0.0)


def require_number(
    value: Any, key: str, what: str, advice: str, fits: Callable[[float], bool]
) -> None:
    """Raise an error unless this is one finite number that fits; `what`: it is otherwise."""
    given = plain_array(value, f"key {key}", advice)
    is_number = given.ndim == 0 and given.dtype.kind in "biuf"
    good = is_number and math.isfinite(given) and fits(float(given))
    require_key(good, key, f"{value!r} {what}", advice)


@array_dataclass
class InertiaPrior:
    """Pre-flight knowledge of the inertia tensor.

    Parameters
    ----------
    tensor : (3, 3) array
        The tensor in body axes [kg m^2]; its products are tensor elements, Jxy = J[0, 1].
    relative_sigma : float
        Standard deviation of each diagonal element, as a fraction of it.
    product_sigma : float
        Standard deviation of each product of inertia [kg m^2].
    includes_wheel_spin : bool, optional
        Whether `tensor` holds the wheels' spin inertia (J_locked) or not (J).

    Raises
    ------
    CampaignError
        If no body has the tensor, or a standard deviation is not positive.

    Examples
    --------
    >>> InertiaPrior(np.diag([3., 2., 2.]), 0.04, 0.03).sd.round(3).tolist()
    [0.12, 0.08, 0.08, 0.03, 0.03, 0.03]
    """

    tensor: np.ndarray
    relative_sigma: float
    product_sigma: float
    includes_wheel_spin: bool = False

    def __post_init__(self) -> None:
        tensor = numbers(self.tensor, "inertia.tensor")
        _require_physical(tensor)
        object.__setattr__(self, "tensor", tensor)
        require_positive(self.relative_sigma, "inertia.relative_sigma")
        require_positive(self.product_sigma, "inertia.product_sigma")

    @property
    def elements(self) -> np.ndarray:
        """Prior means (6,) of the elements Jxx, Jyy, Jzz, Jxy, Jxz, Jyz [kg m^2]."""
        return self.tensor[ROWS_OF_ELEMENTS, COLUMNS_OF_ELEMENTS]

    @property
    def sd(self) -> np.ndarray:
        """Prior standard deviations (6,) of the elements [kg m^2]."""
        return np.concatenate(
            [self.relative_sigma * np.diag(self.tensor), np.full(3, self.product_sigma)]
        )


def _require_physical(tensor: np.ndarray) -> None:
    """Raise `CampaignError` unless a body can have this tensor (3, 3)."""
    key = "inertia.tensor"
    shape = f"shape {tensor.shape} is not (3, 3)"
    require_key(tensor.shape == (3, 3), key, shape, "give three rows of three numbers")
    finite = bool(np.all(np.isfinite(tensor)))
    require_key(finite, key, "an element is not finite", "give finite numbers")
    symmetric = np.allclose(tensor, tensor.T, rtol=1e-9, atol=1e-9 * np.abs(tensor).max())
    advice = "give J[i][j] = J[j][i], products as tensor elements"
    require_key(symmetric, key, "the tensor is not symmetric", advice)
    moments = np.linalg.eigvalsh(tensor)
    body = bool(np.all(0.5 * moments.sum() > moments))  # second moments of mass are positive
    what = f"no body has principal moments {', '.join(f'{m:.6g}' for m in moments)} kg m^2"
    advice = "each must be positive and at most the sum of the other two: "
    require_key(body, key, what, f"{advice}check the sign of the products and the units")


WheelState = Literal["running", "free", "locked"]


@dataclass(frozen=True)
class Wheel:
    """One reaction or momentum wheel.

    Parameters
    ----------
    name : str
        The wheel, as printed.
    axis_B : (3,) array_like
        Unit spin axis in body axes.
    spin_inertia : float
        Moment of inertia about that axis [kg m^2].
    max_torque : float, optional
        Largest motor torque [N m]; None where unknown.
    max_momentum : float, optional
        Largest momentum relative to the body [N m s]; None where unknown.
    momentum_sigma : float, optional
        Noise of the tachometer's momentum per sample [N m s]; None without tachometer.
    state : "running", "free" or "locked", optional
        What the rotor does: its motor drives it; it spins freely; or it turns with the body, as a
        part of it: then J includes its spin inertia, and neither its tachometer nor its commands
        count.

    Raises
    ------
    CampaignError
        If the axis is no unit vector, a number is not positive, or the state unknown.

    Examples
    --------
    >>> Wheel("x", (1., 0., 0.), 1e-3).axis_B
    (1.0, 0.0, 0.0)
    """

    name: str
    axis_B: Vector
    spin_inertia: float
    max_torque: float | None = None
    max_momentum: float | None = None
    momentum_sigma: float | None = None
    state: WheelState = "running"

    def __post_init__(self) -> None:
        require_name(self.name, "wheels.name")
        known, what = is_one_of(self.state, get_args(WheelState)), f"{self.state!r} is unknown"
        advice = f"choose one of {', '.join(get_args(WheelState))}"
        require_key(known, f"wheels.{self.name}.state", what, advice)
        object.__setattr__(self, "axis_B", unit_vector(self.axis_B, f"wheels.{self.name}.axis"))
        require_positive(self.spin_inertia, f"wheels.{self.name}.spin_inertia")
        for key in ("max_torque", "max_momentum", "momentum_sigma"):
            require_positive(getattr(self, key), f"wheels.{self.name}.{key}", optional=True)


def unattainable(wheel: Wheel, what: Literal["torque", "momentum"]) -> float:
    """The size of a torque [N m] or momentum [N m s] that a wheel cannot come near."""
    limit = wheel.max_torque if what == "torque" else wheel.max_momentum
    largest = LIMITS.largest_torque if what == "torque" else LIMITS.largest_momentum
    return largest if limit is None else LIMITS.impossible_times_limit * limit


@dataclass(frozen=True)
class CorrelatedNoise:
    """The part of a sensor's noise that lasts from one reading to the next: a Gauss-Markov process.

    Two readings of one axis, t seconds apart, have the correlation share exp(-t / time). The rest
    of the noise is white.

    Parameters
    ----------
    share : (axes,) array_like
        Share of each axis' variance that is correlated, 0 to 1; one number counts for each axis.
    time : (axes,) array_like
        Correlation time of each axis [s].

    Raises
    ------
    CampaignError
        If a share is not between 0 and 1, or a time is not positive.

    Examples
    --------
    >>> CorrelatedNoise(1.0, 2.0).time
    (2.0, 2.0, 2.0)
    """

    share: Numbers
    time: Numbers

    def __post_init__(self) -> None:
        alike = np.ndim(self.share) == np.ndim(self.time) == 0
        axes = 3 if alike else max(np.size(self.share), np.size(self.time))
        for key in ("share", "time"):
            place = f"rate_sensor.correlated_noise.{key}"
            stated = one_an_axis(getattr(self, key), axes, place, positive=key == "time")
            object.__setattr__(self, key, stated)
        good, what = all(0.0 <= x <= 1.0 for x in self.share), f"{self.share} is no share"
        place = "rate_sensor.correlated_noise.share"
        require_key(good, place, what, "give numbers between 0 and 1")


def _of_axes(noise: CorrelatedNoise, axes: int) -> CorrelatedNoise:
    """The noise of a sensor with so many axes, or `CampaignError`; one number fits any."""
    place = "rate_sensor.correlated_noise"
    require_kind(noise, CorrelatedNoise, f"key {place}", "give CorrelatedNoise(share, time)")
    share, time = (x if len(set(x)) > 1 else x[0] for x in (noise.share, noise.time))
    return CorrelatedNoise(
        one_an_axis(share, axes, f"{place}.share"), one_an_axis(time, axes, f"{place}.time")
    )


@array_dataclass
class RateSensor:
    """Rate sensor of n axes: K w_meas = C_rate w + b, K = diag(K1, ..., Kn) (paper eq 12).

    Parameters
    ----------
    sigma : float or (n,) array_like
        White noise per sample [rad/s].
    axes : (n, 3) array, optional
        C_rate: row i is the sensor axis i in body axes; the three body axes by default.
    range : float, optional
        Largest reading of an axis [rad/s]; None if unlimited.
    scale_factor : float or (n,) array_like, optional
        Prior mean of K.
    scale_factor_sigma : float or (n,) array_like, optional
        Prior standard deviation of K.
    bias : float or (n,) array_like, optional
        Prior mean of b [rad/s].
    bias_sigma : float or (n,) array_like, optional
        Prior standard deviation of b [rad/s].
    correlated_noise : CorrelatedNoise, optional
        How the noise is correlated in time; None: it is white.
    rate_random_walk : float, optional
        Density of the bias' random walk, RRW [rad/s^1.5]; None: the bias is constant.
    bias_instability : float, optional
        Sd of a bias that wanders about its mean, BI [rad/s]; None: it does not.
    bias_instability_time : float, optional
        Its correlation time [s]; wanted with `bias_instability`.
    mounting_sigma : float, optional
        Of a further sensor: how far it may be turned from its axes as stated, about each body axis,
        one sd [rad]; None: it sits as stated.

    Raises
    ------
    CampaignError
        If the axes are not unit vectors, or three or more lie in one plane; a number is not
        positive; or one of `bias_instability` and its time is absent.

    Examples
    --------
    >>> RateSensor(sigma=2e-5).sigma
    (2e-05, 2e-05, 2e-05)
    """

    sigma: Numbers
    axes: np.ndarray = field(default_factory=lambda: np.eye(3))
    range: float | None = None
    scale_factor: Numbers = (1.0,)
    scale_factor_sigma: Numbers = (0.03,)
    bias: Numbers = (0.0,)
    bias_sigma: Numbers = (1e-5,)
    correlated_noise: CorrelatedNoise | None = None
    rate_random_walk: float | None = None
    bias_instability: float | None = None
    bias_instability_time: float | None = None
    mounting_sigma: float | None = None

    def __post_init__(self) -> None:
        axes = numbers(self.axes, "rate_sensor.axes")
        _require_independent_axes(axes)
        object.__setattr__(self, "axes", axes)
        for key in ("sigma", "scale_factor", "scale_factor_sigma", "bias", "bias_sigma"):
            given, place = getattr(self, key), f"rate_sensor.{key}"
            stated = one_an_axis(given, len(axes), place, positive=key != "bias")
            object.__setattr__(self, key, stated)
        if self.correlated_noise is not None:
            noise = _of_axes(self.correlated_noise, len(axes))
            object.__setattr__(self, "correlated_noise", noise)
        wandering = ("rate_random_walk", "bias_instability", "bias_instability_time")
        for key in ("range", *wandering, "mounting_sigma"):
            require_positive(getattr(self, key), f"rate_sensor.{key}", optional=True)
        both = (self.bias_instability is None) == (self.bias_instability_time is None)
        what = "the sd and its correlation time belong together"
        advice = "give bias_instability [rad/s] and bias_instability_time [s], or neither"
        require_key(both, "rate_sensor.bias_instability", what, advice)

    @property
    def columns(self) -> int:
        """How many numbers a reading has: one an axis."""
        return len(self.axes)


def axis_names(sensor: RateSensor | None) -> tuple[str, ...]:
    """Names of a rate sensor's axes: x, y and z of three, else 1 to n; none without a sensor."""
    axes = len(sensor.axes) if sensor else 0
    return tuple("xyz") if axes == 3 else tuple(str(i + 1) for i in range(axes))


def body_rates(
    sensor: RateSensor, readings: np.ndarray, scale_factor: Sequence[float] | np.ndarray
) -> np.ndarray:
    """Rates along body axes (..., 3) [rad/s] of readings (..., n), with the prior's bias.

    By least squares where there are more than three axes; zero across all where there are fewer.
    """
    rate_S = np.asarray(scale_factor) * readings - np.asarray(sensor.bias)
    return rate_S @ axes_to_body(sensor.axes).T


def axes_to_body(axes: np.ndarray) -> np.ndarray:
    """Matrix (3, n) from rates along axes (n, 3) to the body's, by least squares."""
    return np.linalg.inv(axes) if len(axes) == 3 else np.linalg.pinv(axes)


def _require_independent_axes(axes: np.ndarray) -> None:
    """Raise `CampaignError` unless rows are unit vectors, and three or more span space."""
    key = "rate_sensor.axes"
    shape = f"shape {axes.shape} is not (axes, 3)"
    is_list = axes.ndim == 2 and axes.shape[1] == 3 and len(axes) > 0
    require_key(is_list, key, shape, "give one row of three numbers a sensor axis")
    lengths = np.hypot.reduce(axes, axis=1)
    what = f"rows have lengths {np.round(lengths, 4).tolist()}"
    advice = "give unit vectors"
    require_key(bool(np.all(np.abs(lengths - 1.0) < 0.01)), key, what, advice)
    # The volume that the axes span: of three, |det|.
    volume = float(np.sqrt(np.abs(np.linalg.det(axes.T @ axes)))) if len(axes) > 3 else 1.0
    volume = float(abs(np.linalg.det(axes))) if len(axes) == 3 else volume
    require_key(volume > 1e-3, key, "the axes lie in one plane", "give three independent axes")


@dataclass(frozen=True)
class StarTracker:
    """Star tracker: q_meas = q * dq(e), e a small Gaussian rotation in body axes.

    Parameters
    ----------
    boresight_B : (3,) array_like
        Unit vector of the boresight in body axes.
    sigma_cross : float
        Noise across the boresight [rad].
    sigma_roll : float
        Noise about the boresight [rad].
    low_frequency_sigma : float, optional
        Sd of the error that all fixes of a group share, another in each group, on each axis [rad];
        None: there is none.
    mounting_sigma : float, optional
        As of `RateSensor`.

    Raises
    ------
    CampaignError
        If the boresight is no unit vector, or a noise is not positive.

    Examples
    --------
    >>> StarTracker((0., 0., 1.), 2e-5, 1e-4).sigma_roll
    0.0001
    """

    boresight_B: Vector
    sigma_cross: float
    sigma_roll: float
    low_frequency_sigma: float | None = None
    mounting_sigma: float | None = None
    columns: ClassVar[int] = 4  # numbers of a reading: a quaternion's

    def __post_init__(self) -> None:
        boresight_B = unit_vector(self.boresight_B, "star_tracker.boresight")
        object.__setattr__(self, "boresight_B", boresight_B)
        for key in ("sigma_cross", "sigma_roll", "low_frequency_sigma", "mounting_sigma"):
            optional = not key.startswith("sigma")
            require_positive(getattr(self, key), f"star_tracker.{key}", optional=optional)


@array_dataclass
class DirectionSensor:
    """Sun sensor, magnetometer or horizon sensor: sees in body axes what is known in inertial ones.

    A unit vector is compared by the angle between measured and predicted direction; a field in
    tesla by its components, m = (1 + S) C(q) B_N + offset, S symmetric: scale and soft iron.

    Parameters
    ----------
    sigma : float or (3,) array_like
        White noise per sample: of a direction about each axis across it [rad], one number; of a
        field's components [T].
    reference_N : (3,) array_like, optional
        What is seen, in inertial axes, where it does not change: any length counts for a direction;
        [T] for a field. None: `Slew.inputs` of the sensor's name, or the slew's `magnetic_field_N`.
    unit : {"", "T"}, optional
        Of the readings: "" for a direction, "T" for a field.
    offset_sigma, scale_sigma, soft_iron_sigma : float, optional
        Prior sds of a magnetometer's own errors [T, 1, 1]; what has none is not estimated.
    mounting_sigma : float, optional
        As of `RateSensor`.

    Raises
    ------
    CampaignError
        If a noise is not positive, the unit unknown, or a direction is said to have errors of a
        magnetometer.

    Examples
    --------
    >>> DirectionSensor(0.01, (0.0, 0.0, 2.0)).reference_N
    (0.0, 0.0, 1.0)
    """

    sigma: Numbers
    reference_N: Vector | None = None
    unit: Literal["", "T"] = ""
    offset_sigma: float = 0.0
    scale_sigma: float = 0.0
    soft_iron_sigma: float = 0.0
    mounting_sigma: float | None = None
    columns: ClassVar[int] = 3  # numbers of a reading

    def __post_init__(self) -> None:
        key = "sensors.direction"
        known, what = is_one_of(self.unit, ("", "T")), f"{self.unit!r} is no unit of a direction"
        require_key(known, f"{key}.unit", what, 'give "T" for a field, else nothing')
        sigma = one_an_axis(self.sigma, 3, f"{key}.sigma", positive=True)
        alike = self.is_field or len(set(sigma)) == 1
        what = "a direction has one noise about all axes across it"
        require_key(alike, f"{key}.sigma", what, "give one number [rad]")
        object.__setattr__(self, "sigma", sigma)
        require_positive(self.mounting_sigma, f"{key}.mounting_sigma", optional=True)
        for name in ("offset_sigma", "scale_sigma", "soft_iron_sigma"):
            size = getattr(self, name)
            require_sd(size, f"{key}.{name}")
            advice = 'leave it out, or give unit = "T"'
            own = self.is_field or size == 0.0
            require_key(own, f"{key}.{name}", "only a magnetometer has it", advice)
        if self.reference_N is not None:
            vector = np.array(one_an_axis(self.reference_N, 3, f"{key}.reference_N"))
            require_positive(float(np.linalg.norm(vector)), f"{key}.reference_N")
            x, y, z = (vector if self.is_field else unit_length(vector)).tolist()
            object.__setattr__(self, "reference_N", (x, y, z))

    @property
    def is_field(self) -> bool:
        """Whether it reads a field in tesla, not a direction."""
        return self.unit == "T"


def rate_noise(sensors: Iterable[Any]) -> float:
    """Noise of the best axis of all rate sensors [rad/s]; infinite without one."""
    return min((min(x.sigma) for x in sensors if isinstance(x, RateSensor)), default=math.inf)


def attitude_noise(seen: Iterable[tuple[Any, Sequence[np.ndarray]]]) -> float:
    """Noise of the sensor that sees best where the body points [rad]; infinite without one.

    `seen`: sensors, and the readings (n, columns) that tell how large a field is.
    """
    noises = [math.inf]
    for sensor, readings in seen:
        if isinstance(sensor, StarTracker):
            noises += [sensor.sigma_cross, sensor.sigma_roll]
        elif isinstance(sensor, DirectionSensor):
            field = max((float(np.nanmax(np.abs(x), initial=0.0)) for x in readings), default=0.0)
            size = field if sensor.is_field else 1.0
            noises += [min(sensor.sigma) / size] if size else []
    return min(noises)
