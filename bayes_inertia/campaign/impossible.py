"""Readings and commands that nothing can reach, such as the -1e31 that marks a missing value."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_inertia.campaign.dirt import Dirt
from bayes_inertia.campaign.hardware import Wheel

FASTEST_RATE = 1e3  # [rad/s]; small bodies are torn apart by a tenth of it
_LARGEST_MOMENTUM = 1e6  # [N m s]; the largest gyros of space stations hold 5e3
_LARGEST_TORQUE = 1e6  # [N m]
_FEW = 0.02  # of the commands; where more are impossible, it is their unit that is wrong
_MARKED = 0.5  # of the commands, where all of them are one number
_AGAIN = 10  # times that number must stand: fewer may be commands of a short slew
_APART = 10.0  # times larger than all other commands are those that are dirt
_TIMES_THE_LIMIT = 100.0  # of a wheel


def impossible_rates(rate: np.ndarray) -> np.ndarray:
    """Which readings of a rate sensor no spacecraft can cause.

    `rate` (n, 3) [rad/s]. Returns (n, 3).

    Examples
    --------
    >>> impossible_rates(np.array([0.1, -1e31, np.nan])).tolist()
    [False, True, False]
    """
    return np.abs(np.nan_to_num(rate)) >= FASTEST_RATE


def impossible_momentum(momentum: np.ndarray, wheels: Sequence[Wheel]) -> np.ndarray:
    """Which readings of the tachometers no wheel can cause.

    `momentum` (n, wheels): readings [N m s]; NaN where there is none. `wheels`: the wheels, with
    their limits where they are known. Returns (n, wheels).

    Examples
    --------
    >>> wheel = Wheel("x", (1.0, 0.0, 0.0), 1e-3, max_momentum=0.3)
    >>> impossible_momentum(np.array([[0.4], [1e300]]), [wheel])[:, 0].tolist()
    [False, True]
    """
    limits = [
        _LARGEST_MOMENTUM if w.max_momentum is None else _TIMES_THE_LIMIT * w.max_momentum
        for w in wheels
    ]
    return np.abs(np.nan_to_num(momentum)) > np.array(limits)


def without_impossible_torques(
    channels: dict[str, np.ndarray], wheels: Sequence[Wheel]
) -> tuple[dict[str, np.ndarray], list[tuple[Dirt, np.ndarray]]]:
    """Channels without commands that no wheel can follow: what was commanded then is unknown.

    `channels`: channels (n, width) by the name of `Slew`, with "time". `wheels`: the wheels, with
    their limits where they are known. Returns `channels`: the same with NaN for these commands;
    `dirt`: A record without slew and rows, and the times [s] that it concerns; empty if there is
    none.

    Examples
    --------
    >>> wheel = Wheel("x", (1.0, 0.0, 0.0), 1e-3, max_torque=0.02)
    >>> torque = np.full((60, 1), 0.01)
    >>> torque[7] = 1e31
    >>> given = {"time": np.arange(60.0), "wheel_torque": torque}
    >>> np.flatnonzero(np.isnan(without_impossible_torques(given, [wheel])[0]["wheel_torque"]))
    array([7])
    """
    torque = channels.get("wheel_torque")
    if torque is None:
        return channels, []
    limits = [
        _LARGEST_TORQUE if w.max_torque is None else _TIMES_THE_LIMIT * w.max_torque for w in wheels
    ]
    size = np.abs(np.nan_to_num(torque))
    absurd = size > np.array(limits)
    # The largest commands of a wrong unit go on where the others end: those are no dirt.
    absurd &= size > _APART * size[~absurd].max(initial=0.0)
    # One number again and again is no command in another unit, but a mark of "no command".
    marked = np.sum(absurd) >= _AGAIN and len(np.unique(torque[absurd])) == 1
    most = _MARKED if marked else _FEW
    if not absurd.any() or np.mean(absurd.any(axis=1)) > most:
        return channels, []
    note = f"commands up to {np.abs(torque[absurd]).max():.3g} N m, which no wheel can follow"
    record = Dirt("outliers", "torque", "", (), "masked", note)
    rows = absurd.any(axis=1)
    kept = np.where(rows[:, None], np.nan, torque)
    return {**channels, "wheel_torque": kept}, [(record, channels["time"][rows])]
