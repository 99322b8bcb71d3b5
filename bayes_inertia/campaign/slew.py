"""The telemetry of one slew."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from datetime import datetime
from functools import cached_property
from typing import Any

import numpy as np

from bayes_inertia import errors
from bayes_inertia.campaign.hardware import (
    numbers,
    one_an_axis,
    require_key,
    require_name,
    unit_length,
    unit_vector,
)
from bayes_inertia.campaign.inputs import InputStream
from bayes_inertia.campaign.limits import LIMITS
from bayes_inertia.errors import kind_of, require_kind
from bayes_inertia.maths.printed import Card, shown_as
from bayes_inertia.maths.values import Vector, array_dataclass, moments, plain_array
from bayes_inertia.sealing import sha256_of

# What stands in the name of a part behind that of its slew.
PART = " (part "
_EPOCH = np.datetime64(0, "s")
# Columns of each channel; None: one a wheel, or one a sensor axis.
_COLUMNS_OF_CHANNEL = {
    "wheel_torque": None,
    "wheel_momentum": None,
    "rate": None,
    "attitude": 4,
    "magnetic_field_N": 3,
    "position_N": 3,
    "lost_command_sd": None,
}


def _card(slew: Slew) -> Card:
    """Which channels a slew has, and how many readings of each."""
    channels: dict[str, Any] = {key: getattr(slew, key) for key in _COLUMNS_OF_CHANNEL}
    channels |= slew.more or {}
    rows = tuple(
        (name, str(values.shape[1]), f"{np.isfinite(values).any(axis=1).sum()}")
        for name, values in channels.items()
        if values is not None
    )
    size = f"{len(slew.time)} rows in {slew.duration:.4g} s"
    names = ", ".join(f"{name} ({count})" for name, _, count in rows)
    return Card((f'Slew "{slew.name}": {size}', names), ("channel", "columns", "readings"), rows)


@shown_as(_card)
@array_dataclass
class Slew:
    """Telemetry of one slew: arrays of n rows.

    A channel is None where its columns are absent; NaN, or a mask, stands where a cell is empty.
    Numbers that carry a unit are refused.

    Parameters
    ----------
    name : str
        The slew, as printed.
    start : float or datetime
        Time of the slew's first row on the campaign's clock [s]; of a datetime, since 1970 (UTC).
        Dates may be of Python, numpy, pandas or astropy.
    time : (n,) array
        Time from the slew's own zero [s], strictly increasing; of datetimes, from the first row.
    rate : (n, axes) array, optional
        Output of the rate sensor [rad/s], one column a sensor axis.
    attitude : (n, 4) array, optional
        Star-tracker quaternion, body from inertial, scalar last; four NaN where there is no fix.
    wheel_torque : (n, wheels) array, optional
        Motor torque ON THE WHEEL [N m], held from t_k to t_{k+1}.
    wheel_momentum : (n, wheels) array, optional
        Momentum relative to the body [N m s], sampled at t_k.
    magnetic_field_N : (n, 3) array, optional
        Magnetic field in inertial axes [T].
    position_N : (n, 3) array, optional
        Position in inertial axes [m].
    axis_B : (3,) array_like, optional
        Unit axis of the commanded rotation in body axes.
    angle : float, optional
        Angle of the commanded rotation [rad].
    lost_command : (n,) array of int, optional
        Number from 1 of the piece of a gap in which a row's command was lost, 0 where it is known.
        In a lost row `wheel_torque` is a guess. None if all are known.
    lost_command_sd : (n, wheels) array, optional
        How far that guess may be off, one sd [N m]; wanted where `lost_command` is given.
    more : mapping of (n, columns) arrays, optional
        Readings of further sensors, by the names under `Campaign.more_sensors`.
    inputs : mapping of InputStream, optional
        What the devices under `Campaign.actuators` were told to do, or did, by their names; times
        on the slew's own clock, as `time`. Names of no device are for effects of your own.

    Raises
    ------
    CampaignError
        If times do not increase, shapes do not fit, a value is infinite or no unit quaternion, or
        dates of start and first row differ.

    Examples
    --------
    >>> Slew("a", 0.0, np.arange(3.0), rate=np.zeros((3, 3))).duration
    2.0
    >>> stamps = np.array(["2026-01-01T00:00:00", "2026-01-01T00:00:02.5"], "datetime64[ms]")
    >>> Slew("a", stamps[0], stamps, rate=np.zeros((2, 3))).time
    array([0. , 2.5])
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
    axis_B: Vector | None = None
    angle: float | None = None
    lost_command: np.ndarray | None = None
    lost_command_sd: np.ndarray | None = None
    more: Mapping[str, np.ndarray] | None = None
    inputs: Mapping[str, InputStream] | None = None

    def __post_init__(self) -> None:
        require_name(self.name, "slews.name")
        where = f"slews.{self.name}"
        time = _seconds(self.time, f"{where}.time")
        start = on_campaign_clock(self.start, f"{where}.start")
        _require_increasing(time, f"{where}.time")
        _require_one_date(self.start, self.time, start, where)
        object.__setattr__(self, "start", start)
        object.__setattr__(self, "time", time)
        if self.angle is not None:
            (angle,) = one_an_axis(self.angle, 1, f"{where}.angle")
            object.__setattr__(self, "angle", angle)
        for key, width in _COLUMNS_OF_CHANNEL.items():
            if getattr(self, key) is not None:
                array = _channel(getattr(self, key), len(time), width, f"{where}.{key}")
                object.__setattr__(self, key, array)
        for key in ("more", "inputs"):
            given = getattr(self, key)
            what = f"{kind_of(given)} does not say whose they are"
            named = given is None or isinstance(given, Mapping)
            require_key(named, f"{where}.{key}", what, "give a dictionary, with names as keys")
        if self.more is not None:
            n, given = len(time), self.more.items()
            more = {key: _channel(x, n, None, f"{where}.more.{key}") for key, x in given}
            object.__setattr__(self, "more", more)
        for key, stream in (self.inputs or {}).items():
            advice = "give one of times, values and what is between them"
            require_kind(stream, InputStream, f"key {where}.inputs.{key}", advice)
        if self.lost_command is not None:
            object.__setattr__(self, "lost_command", self._lost_pieces(where))
        if self.attitude is not None:
            require_quaternions(self.attitude, f"{where}.attitude")
            object.__setattr__(self, "attitude", unit_length(self.attitude))
        if self.axis_B is not None:
            object.__setattr__(self, "axis_B", unit_vector(self.axis_B, f"{where}.axis"))

    def _lost_pieces(self, where: str) -> np.ndarray | None:
        """`lost_command` as whole numbers, None if no command was lost, or `CampaignError`."""
        given = numbers(self.lost_command, f"{where}.lost_command")
        pieces = np.nan_to_num(given, nan=-1.0, posinf=-1.0).astype(int)
        whole = given.shape == self.time.shape and bool(((pieces >= 0) & (pieces == given)).all())
        what = f"shape {given.shape}, or no whole number from 0"
        advice = "give a whole number for each row, 0 where the command is known"
        require_key(whole, f"{where}.lost_command", what, advice)
        known = self.wheel_torque is not None and self.lost_command_sd is not None
        what = "nothing says what the wheels may have done"
        advice = "give wheel_torque and lost_command_sd too"
        require_key(known, f"{where}.lost_command", what, advice)
        sd = np.asarray(self.lost_command_sd)[pieces > 0]
        what, advice = "an sd is below 0 or no number", "give one of each wheel in each lost row"
        require_key(bool((sd >= 0.0).all()), f"{where}.lost_command_sd", what, advice)
        return pieces if pieces.any() else None

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

    @cached_property
    def digest(self) -> str:
        """Digest of what its sensors read: the same telemetry in two campaigns is known by it."""
        read = (self.time, self.rate, self.attitude, self.wheel_momentum)
        arrays = (*read, *(self.more or {}).values())
        return sha256_of(*(array.tobytes() for array in arrays if array is not None))[:16]

    @property
    def rate_steps(self) -> np.ndarray:
        """Spacings (m,) of the rows that hold a rate [s]; of all rows if hardly any does."""
        rated = np.ones(len(self.time), dtype=bool)
        if self.rate is not None:
            rated = np.isfinite(self.rate).any(axis=1)
        return np.diff(self.time[rated] if rated.sum() > 1 else self.time)

    @cached_property
    def rate_step(self) -> float:
        """Median of `rate_steps` [s]."""
        return float(np.median(self.rate_steps))

    def complete_rates(self, valid: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Rows at which the rates about all sensor axes are known, and the rates there.

        These are the rows in which every reading is valid. Where such rows are rare, because the
        axes are telemetered in turn, straight lines between the readings of each axis fill the
        rows between its first and its last.

        Parameters
        ----------
        valid : (n, axes) array of bool, optional
            Which readings count; by default all that are numbers.

        Returns
        -------
        rows : (m,) array of int
            The rows, ascending; none if an axis has no valid reading.
        rates : (m, axes) array
            The sensor's readings there [rad/s].

        Examples
        --------
        >>> x, y = [0., np.nan, 2.], [np.nan, 5., np.nan]
        >>> slew = Slew("a", 0.0, np.arange(3.0), rate=np.array([x, y, x]).T)
        >>> rows, rates = slew.complete_rates()
        >>> rows.tolist(), rates.tolist()
        ([1], [[1.0, 5.0, 1.0]])
        """
        if self.rate is None:
            return np.zeros(0, dtype=int), np.zeros((0, 3))
        valid = np.isfinite(self.rate) if valid is None else valid
        rows = np.flatnonzero(valid.all(axis=1))
        enough = LIMITS.enough_complete_rows * valid.any(axis=1).sum()
        if len(rows) > enough or not valid.any(axis=0).all():
            return rows, self.rate[rows]
        given = [np.flatnonzero(axis) for axis in valid.T]
        rows = np.arange(max(k[0] for k in given), min(k[-1] for k in given) + 1)
        time, both = self.time, zip(given, self.rate.T, strict=True)
        bridged = [np.interp(time[rows], time[k], readings[k]) for k, readings in both]
        return rows, np.stack(bridged, axis=1)


def bad_quaternion(attitude: np.ndarray) -> tuple[int, str] | None:
    """The first row (n, 4) that is neither empty nor a unit quaternion, and what is wrong."""
    with np.errstate(over="ignore"):
        norm = np.linalg.norm(attitude, axis=1)
    given = np.isfinite(attitude).sum(axis=1)
    bad = (given > 0) & ~(np.abs(norm - 1.0) <= 1e-3)
    if not bad.any():
        return None
    row = int(np.argmax(bad))
    if given[row] == 4:
        return row, f"the quaternion has length {norm[row]:.6g}, not 1"
    return row, "the quaternion is incomplete"


def on_campaign_clock(moment: Any, key: str) -> float:
    """A moment on the campaign's clock [s], or `CampaignError`; a datetime counts from 1970 (UTC).

    >>> on_campaign_clock(np.datetime64("1970-01-02"), "start")
    86400.0
    """
    given = np.atleast_1d(plain_array(moment, f"key {key}"))
    what, advice = f"these are {given.size} moments", "give one, of the first row"
    require_key(given.size == 1, key, what, advice)
    (second,) = _seconds(given.ravel(), key, since=_EPOCH)
    require_key(bool(np.isfinite(second)), key, f"{moment!r} is not finite", "give a finite number")
    return float(second)


def utc_of(epoch: datetime | str, where: str) -> float:
    """A date in UTC as seconds since 1970, or `CampaignError`.

    >>> utc_of("1970-01-02T00:00:00Z", "epoch")
    86400.0
    """
    advice, date = "give UTC as year-month-dayThour:minute:second", epoch
    with suppress(ValueError):
        date = datetime.fromisoformat(epoch) if isinstance(epoch, str) else epoch
    is_date = moments(date, where, advice).dtype.kind == "M"
    errors.require(is_date, where, f"{epoch!r} is no date", advice)
    return on_campaign_clock(date, where)


def _seconds(time: Any, key: str, since: np.datetime64 | None = None) -> np.ndarray:
    """Times (n,) in seconds; datetimes count from `since`, or from the first of them."""
    array = moments(time, f"key {key}")
    if array.dtype.kind == "M" and array.size:
        array = array - (array[0] if since is None else since)
    if array.dtype.kind == "m":
        return array / np.timedelta64(1, "s")
    return numbers(array, key, "give seconds or datetimes")


def _require_one_date(start: Any, time: Any, start_s: float, where: str) -> None:
    """Raise `CampaignError` if `start` and `time` are dates of which the first ones differ."""
    if not all(moments(given, where).dtype.kind == "M" for given in (start, time)):
        return
    later = on_campaign_clock(plain_array(time, where)[0], where) - start_s
    advice = "give the date of the first row, as time[0]"
    what = f"the first row is of {abs(later):.6g} s {'later' if later > 0.0 else 'earlier'}"
    require_key(abs(later) < LIMITS.one_moment_s, f"{where}.start", what, advice)


def _require_increasing(time: np.ndarray, key: str) -> None:
    """Raise `CampaignError` unless times (n,) increase strictly."""
    flat, what = time.ndim == 1, f"shape {time.shape} is not (rows,)"
    require_key(flat, key, what, "give one time a row: of a table one column, as table['t']")
    require_key(len(time) >= 2, key, "fewer than two rows", "a slew needs telemetry over time")
    finite = bool(np.all(np.isfinite(time)))
    require_key(finite, key, "a time is not a number", "remove or repair the row")
    increasing = bool(np.all(np.diff(time) > 0))
    advice = "sort the rows and drop duplicates"
    require_key(increasing, key, "times do not increase strictly", advice)


def _channel(value: Any, rows: int, width: int | None, key: str) -> np.ndarray:
    """A channel as floats (rows, width), or `CampaignError`."""
    array = numbers(value, key)
    fits = array.ndim == 2 and len(array) == rows and width in (None, array.shape[1])
    what = f"shape {array.shape} does not fit {rows} rows"
    require_key(fits, key, what, f"give (rows, {width or 'columns'})")
    finite = not bool(np.isinf(array).any())
    require_key(finite, key, "a value is infinite", "use NaN where there is no value")
    return array


def require_quaternions(attitude: np.ndarray, key: str) -> None:
    """Raise `CampaignError` unless rows (n, 4) are empty or unit quaternions."""
    problem = bad_quaternion(attitude)
    row, what = problem or (0, "")
    what = f"{what} (row {row + 1}: {attitude[row].tolist()})"
    require_key(problem is None, key, what, "repair the row or leave all four cells empty")


def between_fix_groups(slew: Slew, fixed: np.ndarray) -> np.ndarray:
    """Times (groups - 1,) halfway between groups of star-tracker fixes, from the first row [s].

    `fixed` (n,): rows that hold a fix.

    >>> fixed = np.isin(np.arange(90), [0, 1, 88, 89])
    >>> between_fix_groups(Slew("a", 0.0, np.arange(90.0)), fixed).tolist()
    [44.5]
    """
    time = slew.time[fixed] - slew.time[0]
    steps = np.diff(time)
    usual = float(np.median(steps)) if len(steps) else 0.0
    longest = min(LIMITS.fix_group_share * slew.duration, LIMITS.fix_group_spacings * usual)
    apart = steps > longest
    return time[1:][apart] - 0.5 * steps[apart]
