"""Which stream's clock is wrong, from the lateness that each law tells."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayes_inertia.conventions import limits
from bayes_inertia.conventions.hypothesis import KeyChange, Mistake
from bayes_inertia.conventions.lateness import Lateness, channels_of, gross_lateness, lateness
from bayes_inertia.conventions.laws import CLOSURE, CONSERVATION, DRIVE
from bayes_inertia.conventions.linear_fit import worst
from bayes_inertia.conventions.misfits import Misfits
from bayes_inertia.conventions.reading import Reading
from bayes_inertia.conventions.sampled_slews import sampled
from bayes_inertia.conventions.search import Remedy

Columns = Mapping[str, Mapping[str, Any]]

_RARITY = 2
# Two latenesses are one if they differ by less than this share.
_SAME = 0.25
_STREAM = {CLOSURE: "star tracker", CONSERVATION: "wheels", DRIVE: "torque commands"}
_EFFECT = {
    CLOSURE: "star_tracker_time_offset or rate_sensor_delay",
    CONSERVATION: "rate_sensor_delay",
    DRIVE: "wheel_command_lag",
}


@dataclass(frozen=True)
class Clocks:
    """What the laws say of the streams' clocks.

    Parameters
    ----------
    remedies : tuple of Remedy
        Clocks that are wrong by more than any sensor is late, the best proposal first.
    remarks : tuple of str
        Latenesses that are physical.
    """

    remedies: tuple[Remedy, ...] = ()
    remarks: tuple[str, ...] = ()


def clocks(misfits: Misfits, reading: Reading, columns: Columns) -> Clocks:
    """Look for streams that are late against each other.

    Parameters
    ----------
    misfits : Misfits
        The telemetry.
    reading : Reading
        Conventions as stated.
    columns : mapping
        The campaign's `[columns]`.

    Returns
    -------
    Clocks
        What is wrong, and what is physical.
    """
    told = {
        law: late
        for law in (CLOSURE, CONSERVATION, DRIVE)
        if (late := lateness(misfits, reading, law)) is not None and late.explains
    }
    gross = {law: late for law, late in told.items() if _is_gross(misfits, late)}
    remarks = tuple(
        f"the {_STREAM[law]} are {_sense(late.seconds)} against the rate: as little as a physical "
        f"effect can be ({_EFFECT[law]}); `diagnose` fits it, unless you know of a clock error"
        "".replace("star tracker are", "star tracker is")
        for law, late in told.items()
        if law not in gross
    )
    proposals = [
        Remedy(_mistake(columns, shifts), late.before, late.after)
        for shifts, late in _proposals(misfits, gross, told, columns)
    ]
    return Clocks(tuple(proposals), remarks)


def shifted_misfit(misfits: Misfits, reading: Reading, remedy: Remedy) -> float:
    """The worst misfit of all laws with a proposal's offsets.

    Parameters
    ----------
    misfits : Misfits
        The telemetry.
    reading : Reading
        Conventions as stated.
    remedy : Remedy
        A proposal of `clocks`.

    Returns
    -------
    float
        In standard deviations.
    """
    shifts = {}
    for change in remedy.mistake.changes:
        entry = change.key.split(".")[1]
        channel = "wheel_momentum" if entry == "wheel_speed" else entry
        shifts[channel] = change.mended - (change.stated or 0.0)
    slews = sampled(misfits.campaign, shifts)
    return np.inf if slews is None else worst(Misfits(misfits.campaign, slews).of(reading))


def _is_gross(misfits: Misfits, late: Lateness) -> bool:
    # A wheel that lags its command makes the command look early.
    lag = "wheel_torque" in channels_of(misfits, late.law) and late.seconds > 0.0
    limit = gross_lateness(misfits.campaign, lag)
    steps = [float(np.median(np.diff(slew.time))) for slew in misfits.campaign.slews]
    return abs(late.seconds) > max(limit, limits.LATE_STEPS * float(np.median(steps)))


def _proposals(
    misfits: Misfits,
    gross: Mapping[str, Lateness],
    told: Mapping[str, Lateness],
    columns: Columns,
) -> Iterator[tuple[dict[str, float], Lateness]]:
    """Offsets by entry of `[columns]` that explain what the laws say, the simplest first."""
    momentum = "wheel_speed" if "wheel_speed" in columns else "wheel_momentum"
    both = [entry for entry in ("wheel_torque", momentum) if entry in columns]
    tracker, wheels, commands = (told.get(law) for law in (CLOSURE, CONSERVATION, DRIVE))
    if tracker is not None and wheels is not None and _one(tracker.seconds, wheels.seconds):
        # Star tracker and wheels agree with each other: the gyro is late.
        if CLOSURE in gross or CONSERVATION in gross:
            yield {"rate": -wheels.seconds}, wheels
        return
    if wheels is None or CONSERVATION not in gross:
        for law, entry in ((CLOSURE, "attitude"), (DRIVE, "wheel_torque")):
            if law in gross:
                yield {entry: gross[law].seconds}, gross[law]
                return
        return
    of_wheels = dict.fromkeys(both, wheels.seconds)
    if commands is not None and _one(commands.seconds, -wheels.seconds):
        of_wheels = {momentum: wheels.seconds}
    elif tracker is not None or not fixes_in_motion(misfits):
        yield {"rate": -wheels.seconds}, wheels
    yield of_wheels, wheels


def _one(first: float, second: float) -> bool:
    return abs(first - second) < _SAME * max(abs(first), abs(second))


def fixes_in_motion(misfits: Misfits) -> bool:
    """Whether some star-tracker fixes are taken while the body turns.

    Parameters
    ----------
    misfits : Misfits
        The telemetry.

    Returns
    -------
    bool
        True if there are at least two in a slew with a fifth of its largest rate.
    """
    slews = misfits.slews
    speed = np.sqrt((slews.rate**2).sum(axis=-1))
    moving = speed > limits.IN_MOTION * speed.max(axis=1, keepdims=True)
    return bool(((moving & slews.fixes).sum(axis=1) >= 2).any())


def _sense(seconds: float) -> str:
    return f"{abs(seconds):.2g} s {'late' if seconds < 0.0 else 'early'}"


def _mistake(columns: Columns, shifts: Mapping[str, float]) -> Mistake:
    changes = []
    for entry, seconds in shifts.items():
        stated = float(columns.get(entry, {}).get("offset_s", 0.0))
        mended = float(f"{stated + seconds:.3g}")
        changes.append(KeyChange(f"columns.{entry}.offset_s", stated, mended))
    what = " and ".join(f"the time stamps of {_NAMES[entry]}" for entry in shifts)
    seconds = next(iter(shifts.values()))
    words = f"{what} are {_sense(seconds)}"
    return Mistake(tuple(changes), _RARITY, lambda reading: reading, words)


_NAMES = {
    "attitude": "the star tracker",
    "rate": "the rate",
    "wheel_torque": "the torque commands",
    "wheel_momentum": "the wheel momentum",
    "wheel_speed": "the wheel speed",
}
