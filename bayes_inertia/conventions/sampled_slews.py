"""Slews reduced to some sixty moments each, all slews in the same arrays.

At every moment stand the rate, its integral since the slew's start, the wheels' momentum, the
integral of their torque commands, and a star-tracker fix where there is one. Each is taken from the
channel's own readings at their own times.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.conventions.limits import LIMITS
from bayes_inertia.faults.outliers import without_outliers


@dataclass(frozen=True, eq=False)
class SampledSlews:
    """Pieces of slews without gaps, S of them, at N moments each.

    Parameters
    ----------
    names : tuple of str
        Name of the slew that each piece is of.
    time : (S, N) array
        Moments on the slew's own clock [s], as stated; the last is repeated at the end.
    valid : (S, N) array of bool
        False where a moment is a repetition.
    rate : (S, N, 3) array
        Rate sensor's readings [rad/s], as stated.
    turn : (S, N, 3) array
        Their integrals since the first moment [rad].
    momentum : (S, N, wheels) array or None
        Wheel momentum relative to the body [N m s].
    impulse : (S, N, wheels) array or None
        Integral of the torque commands since the first moment [N m s].
    attitude : (S, N, 4) array
        Star-tracker quaternions, NaN where there is no fix.
    """

    names: tuple[str, ...]
    time: np.ndarray
    valid: np.ndarray
    rate: np.ndarray
    turn: np.ndarray
    momentum: np.ndarray | None
    impulse: np.ndarray | None
    attitude: np.ndarray

    @property
    def fixes(self) -> np.ndarray:
        """Which moments (S, N) hold a star-tracker fix."""
        return np.isfinite(self.attitude[..., 0]) & self.valid


def sampled(campaign: Campaign, shifts: Mapping[str, float] | None = None) -> SampledSlews | None:
    """The slews of a campaign at some sixty moments each.

    `shifts`: what to add to the time stamps of a channel of `Slew` [s], such as "attitude".
    Returns: none if no slew has enough readings of the rate.

    Examples
    --------
    >>> from bayes_inertia.campaign.hardware import RateSensor
    >>> from bayes_inertia.campaign.inertia_prior import InertiaPrior
    >>> slew = Slew("a", 0.0, np.arange(50.0), rate=np.ones((50, 3)))
    >>> prior, sensor = InertiaPrior(np.eye(3), 0.1, 0.1), RateSensor(sigma=1e-5)
    >>> float(sampled(Campaign("c", prior, (), sensor, None, (slew,))).turn[0, -1, 0])
    49.0
    """
    shifts = shifts or {}
    pieces = [piece for slew in campaign.slews for piece in _pieces(campaign, slew, shifts)]
    if not pieces:
        return None
    count = max(len(piece["time"]) for piece in pieces)
    padded: dict[str, Any] = {
        key: _stacked([piece[key] for piece in pieces], count)
        for key in ("time", "rate", "turn", "momentum", "impulse", "attitude")
    }
    valid = np.array([np.arange(count) < len(piece["time"]) for piece in pieces])
    names = tuple(piece["name"] for piece in pieces)
    return SampledSlews(names=names, valid=valid, **padded)


def _stacked(arrays: list, count: int) -> np.ndarray | None:
    """Arrays side by side, their last row repeated to the same length; None if one is absent."""
    if any(array is None for array in arrays):
        return None
    return np.stack([np.concatenate([a, np.repeat(a[-1:], count - len(a), 0)]) for a in arrays])


def _pieces(campaign: Campaign, slew: Slew, shifts: Mapping[str, float]) -> list[dict]:
    """The pieces of a slew between gaps of its rates or tachometers."""
    time = slew.time + shifts.get("rate", 0.0)
    channels = [_Channel(time, axis) for axis in _believable_rates(campaign, slew).T]
    wheels = None
    if slew.wheel_momentum is not None and slew.wheel_momentum.shape[1]:
        time = slew.time + shifts.get("wheel_momentum", 0.0)
        wheels = [_Channel(time, column) for column in slew.wheel_momentum.T]
        if any(len(wheel.time) < 2 for wheel in wheels):
            wheels = None
    every = [*channels, *(wheels or [])]
    if any(len(channel.time) < 2 for channel in every):
        return []
    first = max(channel.time[0] for channel in every)
    last = min(channel.time[-1] for channel in every)
    spans = [(first, last)] if last > first else []
    for channel in [*every, *_commands(slew, shifts)]:
        spans = [part for span in spans for part in channel.without_gaps(*span)]
    return [
        _piece(slew, channels, wheels, (begin, end), shifts)
        for begin, end in spans
        if end - begin > LIMITS.short_piece * slew.duration
        and min(c.count(begin, end) for c in every) >= LIMITS.rows_of_piece
    ]


def _commands(slew: Slew, shifts: Mapping[str, float]) -> list[_Channel]:
    """The torque commands that are known, where some were lost."""
    if slew.lost_command is None or slew.wheel_torque is None:
        return []
    time = slew.time + shifts.get("wheel_torque", 0.0)
    known = np.where(slew.lost_command == 0, 0.0, np.nan)
    return [_Channel(time, known)]


def _piece(
    slew: Slew,
    rates: list[_Channel],
    wheels: list[_Channel] | None,
    span: tuple[float, float],
    shifts: Mapping[str, float],
) -> dict:
    """One piece, at evenly spaced moments and at its fixes."""
    time = slew.time + shifts.get("attitude", 0.0)
    fixes = np.flatnonzero(slew.fixes & (time >= span[0]) & (time <= span[1]))
    if len(fixes) > LIMITS.fixes_per_slew:
        fixes = fixes[np.linspace(0, len(fixes) - 1, LIMITS.fixes_per_slew).astype(int)]
    grid = np.linspace(*span, LIMITS.grid_intervals + 1)
    moments = np.union1d(grid, time[fixes])
    attitude = np.full((len(moments), 4), np.nan)
    if len(fixes):
        attitude[np.searchsorted(moments, time[fixes])] = np.asarray(slew.attitude)[fixes]
    turn = np.stack([rate.integral(moments) for rate in rates], axis=1)
    return {
        "name": slew.name,
        "time": moments,
        "rate": np.stack([rate.at(moments) for rate in rates], axis=1),
        "turn": turn - turn[0],
        "momentum": None if wheels is None else np.stack([w.at(moments) for w in wheels], axis=1),
        "impulse": _impulse(slew, moments - shifts.get("wheel_torque", 0.0)),
        "attitude": attitude,
    }


def _impulse(slew: Slew, moments: np.ndarray) -> np.ndarray | None:
    """Integral of the held torque commands since the first moment [N m s]."""
    if slew.wheel_torque is None or not slew.wheel_torque.shape[1]:
        return None
    held = np.nan_to_num(slew.wheel_torque[:-1]) * np.diff(slew.time)[:, None]
    running = np.concatenate([np.zeros((1, held.shape[1])), np.cumsum(held, axis=0)])
    at = np.stack([np.interp(moments, slew.time, column) for column in running.T], axis=1)
    return at - at[0]


def _believable_rates(campaign: Campaign, slew: Slew) -> np.ndarray:
    """Readings of the rate sensor, NaN where it is saturated.

    Readings far beyond the range are not saturated but in another unit, or the range is.
    """
    rate = np.array(slew.rate)
    limit = campaign.rate_sensor.range
    if limit:
        pinned = np.abs(np.abs(np.nan_to_num(rate)) / limit - 1.0) < 0.01
        rate[pinned] = np.nan
    return rate


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
