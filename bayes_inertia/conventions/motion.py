"""Slews reduced to some sixty moments each, and the motion that their rates tell.

Quaternions are those of `maths.quaternion` (scalar last, Hamilton products); that module computes
with JAX, which takes longer to load than the whole check lasts.

At every moment stand the rate, its integral since the slew's start, the wheels' momentum, the
integral of their torque commands, and a star-tracker fix where there is one. Each is taken from the
channel's own readings at their own times.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayes_inertia.campaign.body_rates import reference_of
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.inputs import held_integral
from bayes_inertia.campaign.sensors import ATTITUDE, MOMENTUM, RATE
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.conventions.limits import LIMITS
from bayes_inertia.conventions.reading import TORQUE, Reading, ToldTorque, direction_sensors
from bayes_inertia.faults.outliers import without_outliers
from bayes_inertia.maths.quaternion_product import product_components


def composed(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Hamilton product p * q of quaternions (..., 4)."""
    return np.stack(product_components(np.moveaxis(p, -1, 0), np.moveaxis(q, -1, 0)), axis=-1)


def turned_back(q: np.ndarray) -> np.ndarray:
    """The inverse of unit quaternions (..., 4)."""
    return q * np.array([-1.0, -1.0, -1.0, 1.0])


def of_angle(vector: np.ndarray) -> np.ndarray:
    """Unit quaternions (..., 4) of rotation vectors (..., 3) [rad].

    >>> of_angle(np.array([0., 0., np.pi])).round(6).tolist()
    [0.0, 0.0, 1.0, 0.0]
    """
    angle = np.sqrt(np.einsum("...i,...i", vector, vector))[..., None]
    half = 0.5 * angle
    return np.concatenate([0.5 * np.sinc(half / np.pi) * vector, np.cos(half)], axis=-1)


def angle_of(q: np.ndarray) -> np.ndarray:
    """Rotation vectors (..., 3) [rad], at most pi long, of unit quaternions (..., 4).

    >>> angle_of(-of_angle(np.array([0.25, 0., 0.]))).round(6).tolist()
    [0.25, 0.0, 0.0]
    """
    q = np.where(q[..., 3:] < 0.0, -q, q)
    norm = np.sqrt(np.einsum("...i,...i", q[..., :3], q[..., :3]))[..., None]
    safe = np.maximum(norm, 1e-12)
    return q[..., :3] * np.where(norm > 1e-12, 2.0 * np.arctan2(norm, q[..., 3:]) / safe, 2.0)


def turn_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Rotation vectors (..., 3) [rad] from attitudes to others, both quaternions (..., 4)."""
    return angle_of(composed(turned_back(first), second))


def matrix_to_start(q: np.ndarray) -> np.ndarray:
    """C(q)^T (..., 3, 3): from body axes to the axes that q (..., 4) starts from.

    >>> np.abs(matrix_to_start(np.array([0., 0., .5**.5, .5**.5])) @ [1., 0., 0.]).round(6).tolist()
    [0.0, 1.0, 0.0]
    """
    # By hand: scipy takes long to load, and `check` needs no more of it.
    x, y, z, w = np.moveaxis(q, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    """The rotations nearest to matrices (..., 3, 3).

    >>> nearest_rotation(np.diag([3.0, 2.0, -1.0])).tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    left, _, right = np.linalg.svd(matrix)
    sense = np.ones(left.shape[:-1])
    sense[..., 2] = np.linalg.det(left @ right)
    return left * sense[..., None, :] @ right


def accumulated(steps: np.ndarray) -> np.ndarray:
    """Products steps[0] * ... * steps[k] of quaternions (..., n, 4), in log2(n) rounds."""
    product, reach = np.array(steps), 1
    while reach < product.shape[-2]:
        longer = composed(product[..., :-reach, :], product[..., reach:, :])
        product = np.concatenate([product[..., :reach, :], longer], axis=-2)
        reach *= 2
    return product


@dataclass(frozen=True, eq=False)
class SampledSlews:
    """Pieces of slews without gaps, S of them, at N moments each."""

    names: tuple[str, ...]  # Name of the slew that each piece is of
    # (S, N): moments on the slew's own clock [s], as stated; the last is repeated at the end
    time: np.ndarray
    valid: np.ndarray  # (S, N) of bool: false where a moment is a repetition
    # (S, N, n or n + 3): rates along the axes of the sensor [rad/s], as stated, and of the body
    # where it has two axes or fewer
    rate: np.ndarray
    turn: np.ndarray  # The same shape: their integrals since the first moment [rad]
    momentum: np.ndarray | None  # (S, N, wheels): wheel momentum relative to the body [N m s]
    # (S, N, wheels): integral of the torque commands since the first moment [N m s]
    impulse: np.ndarray | None
    attitude: np.ndarray  # (S, N, 4): star-tracker quaternions, NaN where there is no fix
    # (S, N, sensors, 3): what each direction sensor reads, as stated; NaN where it sees nothing
    vectors_B: np.ndarray
    # (S, N, sensors, 3): what it looks at, along inertial axes; of length one where it is no field
    vectors_N: np.ndarray

    @property
    def fixes(self) -> np.ndarray:
        """Which moments (S, N) hold a star-tracker fix."""
        return np.isfinite(self.attitude[..., 0]) & self.valid

    @property
    def with_two_fixes(self) -> np.ndarray:
        """Which slews (S,) hold two star-tracker fixes or more."""
        return self.fixes.sum(axis=1) >= 2

    def seen(self, reading: Reading) -> np.ndarray:
        """Quaternions (S, N, 4) of the star tracker under a reading, NaN where there is no fix."""
        return reading.of(ATTITUDE.field, self.attitude)


def sampled(
    campaign: Campaign, shifts: Mapping[str, float] | None = None, smoothed: int = 0
) -> SampledSlews | None:
    """The slews of a campaign at some sixty moments each; None if no slew has enough rates.

    `shifts`: what to add to the time stamps of a channel of `Slew` [s]. `smoothed`: how many axes
    of the rate sensor, the last ones, are no sensor's own: they have no stamps to shift.
    """
    shifts = shifts or {}
    pieces: list[tuple[str, dict[str, Any]]] = []
    # Tachometers too slow for a piece leave what the rates and attitudes tell.
    for slow in (False, True):
        pieces = pieces or [
            (slew.name, piece)
            for slew in campaign.slews
            for piece in _pieces(slew, campaign, shifts, smoothed, slow)
        ]
    return _side_by_side(pieces) if pieces else None


def _side_by_side(pieces: Sequence[tuple[str, dict[str, Any]]]) -> SampledSlews:
    """Pieces, the last moment of each repeated to one length; without what one of them lacks."""
    lengths = np.array([len(arrays["time"]) for _, arrays in pieces])
    count = int(lengths.max())

    def stacked(values: Sequence[np.ndarray | None]) -> np.ndarray | None:
        given = [v for v in values if v is not None]
        if len(given) < len(values):
            return None
        rows = [np.minimum(np.arange(count), len(v) - 1) for v in given]
        return np.stack([v[row] for v, row in zip(given, rows, strict=True)])

    padded: dict[str, Any] = {
        key: stacked([arrays[key] for _, arrays in pieces]) for key in pieces[0][1]
    }
    names, valid = tuple(name for name, _ in pieces), np.arange(count) < lengths[:, None]
    return SampledSlews(names=names, valid=valid, **padded)


def _pieces(
    slew: Slew,
    campaign: Campaign,
    shifts: Mapping[str, float],
    smoothed: int,
    no_tachometers: bool,
) -> list[dict[str, Any]]:
    """The pieces of a slew between gaps of its rates or tachometers."""
    rates = _believable_rates(campaign, slew).T
    own, shift = len(rates) - smoothed, shifts.get(RATE.field, 0.0)
    channels = [_Channel(slew.time + shift * (k < own), axis) for k, axis in enumerate(rates)]
    wheels: list[_Channel] = []
    if slew.wheel_momentum is not None and not no_tachometers:
        time = slew.time + shifts.get(MOMENTUM.field, 0.0)
        wheels = [_Channel(time, column) for column in slew.wheel_momentum.T]
    if any(len(wheel.time) < 2 for wheel in wheels):
        wheels = []
    every = [*channels, *wheels]
    if any(len(channel.time) < 2 for channel in every):
        return []
    first = max(channel.time[0] for channel in every)
    last = min(channel.time[-1] for channel in every)
    spans = [(first, last)] if last > first else []
    whole = list(every)
    if slew.lost_command is not None:
        known = np.where(slew.lost_command == 0, 0.0, np.nan)
        whole.append(_Channel(slew.time + shifts.get(TORQUE, 0.0), known))
    for channel in whole:
        spans = [part for span in spans for part in channel.without_gaps(*span)]
    return [
        _piece(campaign, slew, channels, wheels, (begin, end), shifts)
        for begin, end in spans
        if end - begin > LIMITS.short_piece * slew.duration
        and min(c.count(begin, end) for c in every) >= LIMITS.rows_of_piece
    ]


def _piece(
    campaign: Campaign,
    slew: Slew,
    rates: list[_Channel],
    wheels: list[_Channel],
    span: tuple[float, float],
    shifts: Mapping[str, float],
) -> dict[str, Any]:
    """What `SampledSlews` has of one piece, at evenly spaced moments and at its fixes."""
    time = slew.time + shifts.get(ATTITUDE.field, 0.0)
    fixes = np.flatnonzero(slew.fixes & (time >= span[0]) & (time <= span[1]))
    if len(fixes) > LIMITS.fixes_per_slew:
        fixes = fixes[np.linspace(0, len(fixes) - 1, LIMITS.fixes_per_slew).astype(int)]
    grid = np.linspace(*span, LIMITS.grid_intervals + 1)
    moments = np.union1d(grid, time[fixes])
    attitude = np.full((len(moments), 4), np.nan)
    if len(fixes):
        attitude[np.searchsorted(moments, time[fixes])] = np.asarray(slew.attitude)[fixes]
    vectors_B, vectors_N = _vectors(campaign, slew, moments)
    turn = np.stack([rate.integral(moments) for rate in rates], axis=1)
    return {
        "time": moments,
        "rate": np.stack([rate.at(moments) for rate in rates], axis=1),
        "turn": turn - turn[0],
        "momentum": np.stack([w.at(moments) for w in wheels], axis=1) if wheels else None,
        "impulse": _impulse(slew, moments - shifts.get(TORQUE, 0.0)),
        "attitude": attitude,
        "vectors_B": vectors_B,
        "vectors_N": vectors_N,
    }


def _vectors(campaign: Campaign, slew: Slew, moments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What direction sensors read and look at, (n, sensors, 3) each."""
    sensors = direction_sensors(campaign)
    read = np.full((len(moments), len(sensors), 3), np.nan)
    there = np.zeros(read.shape)
    for k, (name, sensor) in enumerate(sensors):
        values = (slew.more or {}).get(name, np.zeros((0, 3)))
        rows = np.flatnonzero(np.isfinite(values).all(axis=1))
        if len(rows) < 2:
            continue
        columns = [_Channel(slew.time[rows], column) for column in values[rows].T]
        time, reference_N = reference_of(name, sensor, slew)
        for i, column in enumerate(columns):
            there[:, k, i] = np.interp(moments - slew.time[0], time, reference_N[:, i])
            for begin, end in column.without_gaps(column.time[0], column.time[-1]):
                near = (moments >= begin) & (moments <= end)
                read[near, k, i] = column.at(moments[near])
        # Between two directions that are far apart a straight line says nothing.
        length = _Channel(slew.time[rows], np.linalg.norm(values[rows], axis=1)).at(moments)
        read[np.linalg.norm(read[:, k], axis=1) < LIMITS.chord * length, k] = np.nan
    return read, there


def _impulse(slew: Slew, moments: np.ndarray) -> np.ndarray | None:
    """Integral of the held torque commands since the first moment [N m s]."""
    if slew.wheel_torque is None or not slew.wheel_torque.shape[1]:
        return None
    at = held_integral(slew.time, np.nan_to_num(slew.wheel_torque), moments)
    return at - at[0]


def _believable_rates(campaign: Campaign, slew: Slew) -> np.ndarray:
    """Readings of the rate sensor, NaN where it is saturated.

    Readings far beyond the range are not saturated but in another unit, or the range is.
    """
    rate, limit = np.array(slew.rate), campaign.gyro.range or np.inf
    pinned = np.abs(np.abs(np.nan_to_num(rate)) / limit - 1.0) < 0.01
    return np.where(pinned, np.nan, rate)


class _Channel:
    """One column of telemetry at its own times, outliers mended."""

    def __init__(self, time: np.ndarray, values: np.ndarray):
        rows = np.flatnonzero(np.isfinite(values))
        self.time, self.values = time[rows], without_outliers(values[rows])
        steps = np.diff(self.time)
        mean = 0.5 * (self.values[1:] + self.values[:-1])
        self.running = np.concatenate([[0.0], np.cumsum(mean * steps)])
        self.gap = LIMITS.gap_steps * float(np.median(steps)) if len(steps) else 0.0

    def at(self, moments: np.ndarray) -> np.ndarray:
        return np.interp(moments, self.time, self.values)

    def integral(self, moments: np.ndarray) -> np.ndarray:
        row = np.clip(np.searchsorted(self.time, moments, side="right") - 1, 0, len(self.time) - 2)
        since = moments - self.time[row]
        slope = (self.values[row + 1] - self.values[row]) / (self.time[row + 1] - self.time[row])
        return self.running[row] + since * (self.values[row] + 0.5 * slope * since)

    def count(self, begin: float, end: float) -> int:
        return int(((self.time >= begin) & (self.time <= end)).sum())

    def without_gaps(self, begin: float, end: float) -> list[tuple[float, float]]:
        """The parts of a span that this channel covers."""
        wide = max(self.gap, LIMITS.gap_share * (self.time[-1] - self.time[0]))
        holes = np.flatnonzero(np.diff(self.time) > wide)
        parts, left = [], begin
        for hole in holes:
            parts.append((left, min(end, float(self.time[hole]))))
            left = max(begin, float(self.time[hole + 1]))
        parts.append((left, end))
        return [(a, b) for a, b in parts if b > a]


@dataclass(frozen=True, eq=False)
class Motion:
    """The motion of all slews under one reading of rate and time."""

    rate_B: np.ndarray  # (S, N, 3): rate of the body [rad/s]
    path: np.ndarray  # (S, N, 4): attitude relative to that at the slew's first moment
    to_start: np.ndarray  # (S, N, 3, 3): from body axes to those of the first moment
    # (S, N, 3, 9): rotation, in the axes of the first moment, that an error of 1 in each element of
    # the matrix from readings to rates adds
    by_scale: np.ndarray
    by_bias: np.ndarray  # (S, N, 3, 3): the same for a bias of 1 rad/s
    duration: np.ndarray  # (S,): of each slew [s]


def motion_of(slews: SampledSlews, reading: Reading) -> Motion:
    """The motion that the rates of a reading tell."""
    shift, body_rate = reading.bias_B, reading.body_rate
    steps = reading.time * np.diff(slews.time, axis=1)[..., None]
    turns = reading.time * np.diff(slews.turn, axis=1) @ body_rate.T - shift * steps
    path = accumulated(of_angle(turns))
    start = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (*path.shape[:1], 1, 4))
    path = np.concatenate([start, path], axis=1)
    to_start = matrix_to_start(path)
    middle = 0.5 * (to_start[:, 1:] + to_start[:, :-1])
    scale = np.einsum("snia,snb->sniab", middle, turns)
    return Motion(
        rate_B=slews.rate @ body_rate.T - shift,
        path=path,
        to_start=to_start,
        by_scale=_running(scale.reshape(*scale.shape[:3], 9)),
        by_bias=_running(middle * steps[..., None]),
        duration=reading.time * (slews.time[:, -1] - slews.time[:, 0]),
    )


def without_mean(values: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Values (S, N, ...) less their mean in each slew, 0 where `mask` (S, N) is False."""
    weight = mask.reshape(*mask.shape, *[1] * (values.ndim - 2))
    count = np.maximum(weight.sum(axis=1, keepdims=True), 1)
    return (values - (values * weight).sum(axis=1, keepdims=True) / count) * weight


def _running(steps: np.ndarray) -> np.ndarray:
    """Sums along the moments (axis 1), from zero."""
    return np.concatenate([np.zeros_like(steps[:, :1]), np.cumsum(steps, axis=1)], axis=1)


def told_impulse(
    slews: SampledSlews, moving: Motion, torques: Mapping[str, ToldTorque]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Momentum (S, N, 3) that told torques add in inertial axes, its doubt, and what is carried."""
    at = np.zeros((*slews.time.shape, 7))
    for k, name in enumerate(slews.names):
        if name in torques:
            at[k] = torques[name].at(slews.time[k])
    middle = 0.5 * (moving.to_start[:, 1:] + moving.to_start[:, :-1])
    steps = np.einsum("snij,snj->sni", middle, np.diff(at[..., :3], axis=1))
    carried = np.einsum("snij,snj->sni", moving.to_start, at[..., 4:])
    return _running(steps), at[..., 3] - at[:, :1, 3], carried
