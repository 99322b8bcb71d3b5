"""What was flown: a campaign of slews, the hardware it was flown with, and what was known before.

Plain frozen dataclasses in SI units and radians; they validate themselves, so a `Campaign`
built in a notebook meets the same checks as one read from files (`bayes_inertia.campaign.reader`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from bayes_inertia.errors import CampaignError
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.values import array_dataclass

Vector = tuple[float, float, float]


def _require(condition: bool, key: str, what: str, advice: str) -> None:
    if not condition:
        raise CampaignError(what, where=f"key {key}", advice=advice)


def _unit_vector(value, key: str) -> Vector:
    array = np.asarray(value, dtype=float)
    _require(
        array.shape == (3,) and bool(np.all(np.isfinite(array))),
        key,
        f"{value!r} is not a vector",
        "give three finite numbers",
    )
    norm = float(np.linalg.norm(array))
    _require(
        abs(norm - 1.0) < 0.01,
        key,
        f"the vector has length {norm:.6g}, not 1",
        "give a unit vector in body axes",
    )
    return tuple(float(x) for x in _unit_length(array))


def _triple(value, key: str) -> Vector:
    array = np.broadcast_to(np.asarray(value, dtype=float), (3,))
    _require(
        bool(np.all(np.isfinite(array))), key, f"{value!r} is not finite", "give finite numbers"
    )
    return tuple(float(x) for x in array)


def _positive(value, key: str, *, optional: bool = False) -> None:
    if value is None and optional:
        return
    good = (
        value is not None
        and bool(np.all(np.isfinite(value)))
        and bool(np.all(np.asarray(value) > 0.0))
    )
    _require(good, key, f"{value!r} is not positive", "give a positive number in SI units")


@array_dataclass
class InertiaPrior:
    """Pre-flight knowledge of the inertia tensor.

    Parameters
    ----------
    tensor : (3, 3) [kg m^2], body axes.
    relative_sigma : sd of each diagonal element, as a fraction of it.
    product_sigma : sd of each product of inertia [kg m^2].
    includes_wheel_spin : whether `tensor` is J_locked (wheels' spin inertia included) or J.

    >>> InertiaPrior(np.diag([3., 2., 2.]), 0.04, 0.03).sd.round(3).tolist()
    [0.12, 0.08, 0.08, 0.03, 0.03, 0.03]
    """

    tensor: np.ndarray
    relative_sigma: float
    product_sigma: float
    includes_wheel_spin: bool = False

    def __post_init__(self):
        array = np.array(self.tensor, dtype=float)
        _require(
            array.shape == (3, 3),
            "inertia.tensor",
            f"shape {array.shape} is not (3, 3)",
            "give three rows of three numbers",
        )
        _require(
            bool(np.all(np.isfinite(array))),
            "inertia.tensor",
            "an element is not finite",
            "give finite numbers",
        )
        symmetric = np.allclose(array, array.T, rtol=1e-9, atol=1e-9 * np.abs(array).max())
        _require(
            symmetric,
            "inertia.tensor",
            "the tensor is not symmetric",
            "give J[i][j] = J[j][i], products as tensor elements",
        )
        object.__setattr__(self, "tensor", array)
        physical = bool(inertia_tensor.is_physical(np.asarray(inertia_tensor.elements(array))))
        moments = np.linalg.eigvalsh(array)
        _require(
            physical,
            "inertia.tensor",
            f"no body has principal moments {', '.join(f'{m:.6g}' for m in moments)} kg m^2",
            "each must be positive and at most the sum of the other two: check the sign of the products and the units",
        )
        _positive(self.relative_sigma, "inertia.relative_sigma")
        _positive(self.product_sigma, "inertia.product_sigma")

    @property
    def elements(self) -> np.ndarray:
        """Prior means of the six elements (6,) [kg m^2]."""
        return np.array(inertia_tensor.elements(self.tensor))

    @property
    def sd(self) -> np.ndarray:
        """Prior standard deviations of the six elements (6,) [kg m^2]."""
        return np.concatenate(
            [self.relative_sigma * np.diag(self.tensor), np.full(3, self.product_sigma)]
        )


@dataclass(frozen=True)
class Wheel:
    """One reaction or momentum wheel.

    Parameters
    ----------
    axis_B : unit spin axis in body axes. spin_inertia : about that axis [kg m^2].
    max_torque [N m], max_momentum [N m s] : limits, None where unknown.
    momentum_sigma : noise of the tachometer momentum per sample [N m s], None without tachometer.

    >>> Wheel("x", (1., 0., 0.), 1e-3).axis_B
    (1.0, 0.0, 0.0)
    """

    name: str
    axis_B: Vector
    spin_inertia: float
    max_torque: float | None = None
    max_momentum: float | None = None
    momentum_sigma: float | None = None

    def __post_init__(self):
        object.__setattr__(self, "axis_B", _unit_vector(self.axis_B, f"wheels.{self.name}.axis"))
        _positive(self.spin_inertia, f"wheels.{self.name}.spin_inertia")
        for key in ("max_torque", "max_momentum", "momentum_sigma"):
            _positive(getattr(self, key), f"wheels.{self.name}.{key}", optional=True)


@array_dataclass
class RateSensor:
    """Three-axis rate sensor: K w_meas = C_rate w + b, K = diag(K1, K2, K3).

    Parameters
    ----------
    axes : C_rate (3, 3), row i the sensor axis i in body axes.
    sigma : white noise per sample [rad/s], one number or three. range : largest reading [rad/s], None if unlimited.
    scale_factor, scale_factor_sigma : prior of K. bias, bias_sigma : prior of b [rad/s].

    >>> RateSensor(sigma=2e-5).sigma
    (2e-05, 2e-05, 2e-05)
    """

    sigma: Vector
    axes: np.ndarray = field(default_factory=lambda: np.eye(3))
    range: float | None = None
    scale_factor: Vector = (1.0, 1.0, 1.0)
    scale_factor_sigma: Vector = (0.03, 0.03, 0.03)
    bias: Vector = (0.0, 0.0, 0.0)
    bias_sigma: Vector = (1e-5, 1e-5, 1e-5)

    def __post_init__(self):
        axes = np.array(self.axes, dtype=float)
        _require(
            axes.shape == (3, 3),
            "rate_sensor.axes",
            f"shape {axes.shape} is not (3, 3)",
            "give one row a sensor axis",
        )
        lengths = np.linalg.norm(axes, axis=1)
        _require(
            bool(np.all(np.abs(lengths - 1.0) < 0.01)),
            "rate_sensor.axes",
            f"rows have lengths {np.round(lengths, 4).tolist()}",
            "give unit vectors",
        )
        _require(
            abs(np.linalg.det(axes)) > 1e-3,
            "rate_sensor.axes",
            "the axes lie in one plane",
            "give three independent axes",
        )
        object.__setattr__(self, "axes", axes)
        for key in ("sigma", "scale_factor", "scale_factor_sigma", "bias", "bias_sigma"):
            object.__setattr__(self, key, _triple(getattr(self, key), f"rate_sensor.{key}"))
            if key not in ("bias",):
                _positive(getattr(self, key), f"rate_sensor.{key}")
        _positive(self.range, "rate_sensor.range", optional=True)


@dataclass(frozen=True)
class StarTracker:
    """Star tracker: q_meas = q * dq(e), e Gaussian with `sigma_cross` across and `sigma_roll` about the boresight [rad].

    >>> StarTracker((0., 0., 1.), 2e-5, 1e-4).sigma_roll
    0.0001
    """

    boresight_B: Vector
    sigma_cross: float
    sigma_roll: float

    def __post_init__(self):
        object.__setattr__(
            self, "boresight_B", _unit_vector(self.boresight_B, "star_tracker.boresight")
        )
        _positive(self.sigma_cross, "star_tracker.sigma_cross")
        _positive(self.sigma_roll, "star_tracker.sigma_roll")


_COLUMNS = {
    "wheel_torque": None,
    "wheel_momentum": None,
    "rate": 3,
    "attitude": 4,
    "magnetic_field_N": 3,
    "position_N": 3,
    "velocity_N": 3,
}


@array_dataclass
class Slew:
    """Telemetry of one slew (arrays of n rows; None where a column is absent, NaN where a cell is empty).

    Parameters
    ----------
    name : as printed. start : time of the slew's first row in the campaign [s].
    time : (n,) [s] from the slew's own zero, strictly increasing.
    wheel_torque : (n, wheels) motor torque ON THE WHEEL [N m], held from t_k to t_{k+1}.
    wheel_momentum : (n, wheels) momentum relative to the body [N m s], sampled at t_k.
    rate : (n, 3) rate-sensor output [rad/s]. attitude : (n, 4) quaternion, body from inertial, scalar last.
    magnetic_field_N (n, 3) [T], position_N (n, 3) [m], velocity_N (n, 3) [m/s] : environment, inertial axes.
    axis_B, angle : the commanded rotation, where known (unit vector; rad).

    >>> Slew("a", 0.0, np.arange(3.0), rate=np.zeros((3, 3))).duration
    2.0
    """

    name: str
    start: float
    time: np.ndarray
    rate: np.ndarray | None = None
    attitude: np.ndarray | None = None
    wheel_torque: np.ndarray | None = None
    wheel_momentum: np.ndarray | None = None
    magnetic_field_N: np.ndarray | None = None
    position_N: np.ndarray | None = None
    velocity_N: np.ndarray | None = None
    axis_B: Vector | None = None
    angle: float | None = None

    def __post_init__(self):
        where = f"slews.{self.name}"
        time = np.asarray(self.time, dtype=float)
        object.__setattr__(self, "time", time)
        _require(
            time.ndim == 1 and len(time) >= 2,
            f"{where}.time",
            "fewer than two rows",
            "a slew needs telemetry over time",
        )
        _require(
            bool(np.all(np.isfinite(time))),
            f"{where}.time",
            "a time is not a number",
            "remove or repair the row",
        )
        _require(
            bool(np.all(np.diff(time) > 0)),
            f"{where}.time",
            "times do not increase strictly",
            "sort the rows and drop duplicates",
        )
        for key in ("start", "angle"):
            value = getattr(self, key)
            _require(
                value is None or bool(np.isfinite(value)),
                f"{where}.{key}",
                f"{value!r} is not finite",
                "give a finite number",
            )
        for key, width in _COLUMNS.items():
            value = getattr(self, key)
            if value is None:
                continue
            array = np.asarray(value, dtype=float)
            good = array.ndim == 2 and len(array) == len(time) and width in (None, array.shape[1])
            _require(
                good,
                f"{where}.{key}",
                f"shape {array.shape} does not fit {len(time)} rows",
                f"give (rows, {width or 'wheels'})",
            )
            _require(
                not np.isinf(array).any(),
                f"{where}.{key}",
                "a value is infinite",
                "use NaN where there is no value",
            )
            object.__setattr__(self, key, array)
        if self.attitude is not None:
            object.__setattr__(self, "attitude", _normalised(self.attitude, f"{where}.attitude"))
        if self.axis_B is not None:
            object.__setattr__(self, "axis_B", _unit_vector(self.axis_B, f"{where}.axis"))

    @property
    def fixes(self) -> np.ndarray:
        """Which rows (n,) hold a star-tracker fix."""
        if self.attitude is None:
            return np.zeros(len(self.time), dtype=bool)
        return np.isfinite(self.attitude).all(axis=1)

    @property
    def duration(self) -> float:
        """Time from the first to the last row [s]."""
        return float(self.time[-1] - self.time[0])


def bad_quaternion(attitude: np.ndarray) -> tuple[int, str] | None:
    """The first row of (n, 4) that is neither empty (four NaN) nor a unit quaternion, and what is wrong; None if all are good.

    >>> bad_quaternion(np.array([[0., 0., 0., 1.], [0., 0., 0., 2.]]))
    (1, 'the quaternion has length 2, not 1')
    """
    with np.errstate(over="ignore"):
        norm = np.linalg.norm(attitude, axis=1)
    given = np.isfinite(attitude).sum(axis=1)
    bad = (given > 0) & ~(np.abs(norm - 1.0) <= 1e-3)
    if not bad.any():
        return None
    row = int(np.argmax(bad))
    return row, f"the quaternion has length {norm[row]:.6g}, not 1" if given[
        row
    ] == 4 else "the quaternion is incomplete"


def _unit_length(vectors: np.ndarray) -> np.ndarray:
    # What has unit length to rounding stays as it is, so that reading what was written changes no digit.
    norm = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(np.abs(norm - 1.0) < 1e-15, vectors, vectors / norm)


def _normalised(attitude: np.ndarray, key: str) -> np.ndarray:
    problem = bad_quaternion(attitude)
    if problem is not None:
        row, what = problem
        raise CampaignError(
            f"{what} (row {row + 1}: {attitude[row].tolist()})",
            where=f"key {key}",
            advice="repair the row or leave all four cells empty",
        )
    return _unit_length(attitude)


@dataclass(frozen=True)
class Campaign:
    """A named set of slews of one spacecraft, with its hardware and prior knowledge.

    Raises `CampaignError` where the parts do not fit each other.

    >>> slew = Slew("a", 0.0, np.arange(3.0), rate=np.zeros((3, 3)))
    >>> Campaign("c", InertiaPrior(np.eye(3), 0.1, 0.1), (), RateSensor(sigma=1e-5), None, (slew,)).has_commands
    False
    """

    name: str
    inertia: InertiaPrior
    wheels: tuple[Wheel, ...]
    rate_sensor: RateSensor
    star_tracker: StarTracker | None
    slews: tuple[Slew, ...]

    def __post_init__(self):
        object.__setattr__(self, "wheels", tuple(self.wheels))
        object.__setattr__(self, "slews", tuple(self.slews))
        _require(
            len(self.slews) > 0,
            "slews",
            "the campaign has no slew",
            "list at least one [[slews]] table",
        )
        for kind, names in (
            ("wheels", [w.name for w in self.wheels]),
            ("slews", [s.name for s in self.slews]),
        ):
            doubled = {n for n in names if names.count(n) > 1}
            _require(
                not doubled,
                kind,
                f"the name {sorted(doubled)[:1]} is used twice",
                "give each its own name",
            )
        for slew in self.slews:
            self._check_slew(slew)

    def _check_slew(self, slew: Slew) -> None:
        where = f"slews.{slew.name}"
        for key in ("wheel_torque", "wheel_momentum"):
            value = getattr(slew, key)
            if value is not None:
                _require(
                    value.shape[1] == len(self.wheels),
                    f"{where}.{key}",
                    f"{value.shape[1]} columns for {len(self.wheels)} wheels",
                    "give one a wheel",
                )
        complete = slew.wheel_torque is None or bool(np.isfinite(slew.wheel_torque).all())
        _require(
            complete,
            f"{where}.wheel_torque",
            "a torque is not a number",
            "the simulator needs every wheel at every row: repair the row or leave the columns out",
        )
        _require(
            slew.rate is not None,
            f"{where}.rate",
            "no rate-sensor columns",
            "the method needs rate telemetry: name its columns under columns.rate",
        )
        has_fix = slew.attitude is not None and bool(np.isfinite(slew.attitude).any())
        _require(
            self.star_tracker is not None or not has_fix,
            f"{where}.attitude",
            "an attitude without a star tracker",
            "add [star_tracker] with its sigmas",
        )

    @property
    def has_commands(self) -> bool:
        """Whether every slew has wheel torque commands (then the `commanded` drive is possible)."""
        return all(s.wheel_torque is not None for s in self.slews) and len(self.wheels) > 0

    @property
    def has_tachometers(self) -> bool:
        """Whether every slew has wheel momentum telemetry and every wheel its noise (then the `measured` drive is possible)."""
        read = all(
            s.wheel_momentum is not None and bool(np.isfinite(s.wheel_momentum).any(axis=0).all())
            for s in self.slews
        )
        return read and all(w.momentum_sigma is not None for w in self.wheels)

    @property
    def wheel_axes_B(self) -> np.ndarray:
        """G (3, wheels): unit spin axes as columns."""
        return np.array([w.axis_B for w in self.wheels]).reshape(-1, 3).T

    @property
    def spin_inertias(self) -> np.ndarray:
        """Js (wheels,) [kg m^2]."""
        return np.array([w.spin_inertia for w in self.wheels])

    @property
    def span(self) -> tuple[float, float]:
        """First and last moment of the campaign [s], on the clock that the slews' `start` counts."""
        return min(s.start for s in self.slews), max(s.start + s.duration for s in self.slews)

    def subset(self, indices) -> Campaign:
        """The same campaign with only the slews at `indices` (for held-out checks)."""
        return replace(self, slews=tuple(self.slews[i] for i in indices))

    def valid_readings(self, slew: Slew) -> np.ndarray:
        """Which readings (n, 3) of the rate sensor count: numbers inside its range."""
        limit = 0.999 * (self.rate_sensor.range or np.inf)
        return np.isfinite(slew.rate) & (np.abs(np.nan_to_num(slew.rate)) < limit)

    def scale_of_motion(self) -> tuple[float, float, float]:
        """Typical rate [rad/s], duration [s] and inertia [kg m^2]: what default priors of effects are measured in."""
        readings = np.concatenate([s.rate[self.valid_readings(s).all(axis=1)] for s in self.slews])
        rate = float(np.sqrt(np.mean(np.sum(readings**2, axis=1)))) if len(readings) else 0.0
        duration = float(np.median([s.duration for s in self.slews]))
        return (
            max(rate, float(np.mean(self.rate_sensor.sigma))),
            duration,
            float(np.trace(self.inertia.tensor) / 3.0),
        )
