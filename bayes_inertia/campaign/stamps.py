"""Stamps of a regular clock that were rounded, and stamps that are uneven by more than that.

Stamps of 32 bits, or with few digits, step from one multiple of their resolution to another. Where
one regular clock lies within half a resolution of every stamp, its times are the better ones.
"""

from __future__ import annotations

import math

import numpy as np

from bayes_inertia.campaign.dirt import Dirt
from bayes_inertia.campaign.gaps import is_regular
from bayes_inertia.campaign.uneven_stamps import clock_through

# Rounding matters if the resolution is this share of the step; beyond the second share nothing can
# be told of the clock.
_FINE, _COARSE = 0.01, 0.4
# Stamps are uneven if this share of steps differs from the median by that share of it: a few other
# stamps between those of a regular clock are no jitter.
_MANY, _UNEVEN = 0.25, 0.01
_HALF = 0.55  # of a resolution: how far a rounded stamp is from its time, with some allowance
_FEWEST_ROWS = 20


def regular_stamps(time: np.ndarray, unit: str = "s") -> tuple[np.ndarray, Dirt | None]:
    """Times of the regular clock that rounded stamps show; else the stamps.

    `time` (n,): stamps, in the unit they were written in, strictly increasing. Returns `time` (n,):
    the clock's times if its steps are lost in rounding, else the stamps; `dirt`: what was done,
    without slew; None if stamps are even, or come from several clocks.

    Examples
    --------
    >>> stamps, record = regular_stamps(np.round(0.48 * np.arange(99), 1))
    >>> bool(np.abs(np.diff(stamps) - 0.48).max() < 1e-3), record.treated
    (True, 'modelled')
    """
    if len(time) < _FEWEST_ROWS:
        return time, None
    steps = np.diff(time)
    step = float(np.median(steps))
    if _alternate(steps, step):
        return time, None
    resolution = _resolution(time, step)
    grid = None if resolution is None else _grid(time, step, resolution)
    if grid is not None:
        note = f"stamps are multiples of {resolution:.4g} {unit}; a regular clock's times are taken"
        return grid, Dirt("clock", "time", "", (), "modelled", note)
    deviation = np.abs(steps - step)
    if not is_regular(time) or np.mean(deviation > _UNEVEN * step) < _MANY:
        return time, None
    uneven = float(np.sqrt(np.mean(deviation[deviation < 0.5 * step] ** 2)))
    note = f"stamps are uneven: steps of {step:.4g} {unit} vary by {uneven:.3g} {unit} rms"
    return time, Dirt("clock", "time", "", (), "ignored", note)


def _alternate(steps: np.ndarray, step: float) -> bool:
    """Whether long and short steps take turns: rounding or a true pattern, nobody can tell."""
    return bool(np.mean(np.abs(steps[2:] - steps[:-2]) < 1e-6 * step) > 0.9) and bool(
        np.mean(np.abs(steps[1:] - steps[:-1]) > 1e-6 * step) > 0.9
    )


def _resolution(time: np.ndarray, step: float) -> float | None:
    """The decimal or binary unit of which all stamps are multiples, if it is coarse enough.

    Stamps of 32 bits have the finest unit at their smallest times and the coarsest at their
    largest; the latter is the one that every stamp is rounded to at least as well as.
    """
    largest = float(np.abs(time).max())
    # A wild stamp overflows, and is none of 32 bits.
    with np.errstate(over="ignore"):
        single = time.astype(np.float32).astype(float)
    if np.array_equal(single, time):
        resolution = float(np.spacing(np.float32(largest)))
        if resolution > _FINE * step:
            return resolution if resolution <= _COARSE * step else None
    fuzz = 4.0 * float(np.spacing(largest)) + 1e-9 * step
    for resolution in _round_numbers(_FINE * step, _COARSE * step):
        if np.all(np.abs(time - resolution * np.round(time / resolution)) <= fuzz):
            return resolution
    return None


def _round_numbers(least: float, most: float) -> list[float]:
    """Powers of ten and of two between two numbers, the largest first."""
    powers = [
        base ** float(n)
        for base in (2.0, 10.0)
        for n in range(math.ceil(math.log(least, base)), math.floor(math.log(most, base)) + 1)
    ]
    return sorted(powers, reverse=True)


def _grid(time: np.ndarray, step: float, resolution: float) -> np.ndarray | None:
    """Times of the regular clock within half a resolution of every stamp; None without one.

    Rows may be missing. An even clock whose steps are multiples of the resolution is left alone.
    """
    steps = np.diff(time)
    near = steps[np.abs(steps - step) < 0.5 * step]
    if np.ptp(near) < 0.5 * resolution:
        return None
    fitted, rows, _ = clock_through(time)
    if np.any(np.diff(rows) < 1.0) or np.abs(fitted + time[0] - time).max() > _HALF * resolution:
        return None
    return fitted + time[0]
