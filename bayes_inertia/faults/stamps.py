"""Stamps of a regular clock: rounded, jittering about it, or uneven.

A stamp that is off by e moves a reading y by y' e only if the reading was taken at the stamp. So
the readings themselves tell: regress their short-term part on that of y' e. A slope of 1 says that
sampling is uneven and the stamps are right; 0 says that sampling is regular and the stamps jitter.

Stamps of 32 bits, or with few digits, step from one multiple of their resolution to another. Where
one regular clock lies within half a resolution of every stamp, its times are the better ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayes_inertia.faults.fault import Dirt
from bayes_inertia.faults.gaps import is_regular
from bayes_inertia.faults.limits import LIMITS
from bayes_inertia.maths.robust_scale import SD_OVER_MAD


@dataclass(frozen=True)
class StampSlope:
    """Slope of readings against the jitter of their stamps."""

    value: float  # 1 where they were taken at the stamps, 0 where at the times of a regular clock
    sd: float  # Its standard deviation; infinite where there is no motion

    @property
    def sampling_is_regular(self) -> bool:
        """Whether the readings show that the stamps jitter, not the sampling."""
        return self.value + LIMITS.sure_sds * self.sd < 0.5

    @property
    def sampling_is_uneven(self) -> bool:
        """Whether the readings show that they were taken at their stamps."""
        return self.value - LIMITS.sure_sds * self.sd > 0.5


def clock_through(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Times (n,) of the regular clock nearest to stamps, from the first, and its rows (n,)."""
    steps = np.diff(time)
    step = float(np.median(steps))
    near = steps[np.abs(steps - step) < 0.5 * step]
    # As far as single steps tell.
    rows = np.concatenate([[0.0], np.cumsum(np.round(steps / np.mean(near)))])
    for _ in range(2):
        slope, start = np.polyfit(rows, time - time[0], 1)
        fitted = start + slope * rows
        rows = np.round((time - time[0] - start) / slope)
    return fitted, rows, slope


def regular_clock(time: np.ndarray) -> tuple[np.ndarray | None, str]:
    """Times (n,) of the regular clock about which stamps jitter; or None, and why there is none."""
    if len(time) < LIMITS.fewest_stamps:
        return None, f"there are only {len(time)} rows"
    fitted, rows, slope = clock_through(time)
    away = time - time[0] - fitted
    if np.any(np.diff(rows) < 1.0) or np.abs(away).max() > LIMITS.largest_jitter * slope:
        return None, f"a stamp is {np.abs(away).max():.3g} off a clock with steps of {slope:.4g}"
    block = LIMITS.jitter_block
    means = away[: len(away) // block * block].reshape(-1, block).mean(axis=1)
    wander = float(np.sqrt(np.mean(means**2)))
    white = float(np.sqrt(np.mean(away**2) / block))
    if wander > max(LIMITS.jitter_wander * white, LIMITS.exact_stamp * slope):
        return None, f"the stamps wander by {wander:.3g} about a clock with steps of {slope:.4g}"
    return fitted + time[0], ""


def slope_of_readings(slews: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> StampSlope:
    """Whether readings (n, width) of slews move with the jitter of stamps about a clock's times."""
    products, squares = [], []
    for stamps, clock, readings in slews:
        for column in readings.T:
            x, y = _short_term(stamps, clock, column)
            if len(x):
                # A column counts by its own scatter; the slope is small beside the readings' noise.
                scale = np.sqrt(np.mean(y**2)) or 1.0
                products.append((x / scale, y / scale))
                squares.append(float(np.sum((x / scale) ** 2)))
    total = sum(squares)
    if not total > 0.0:
        return StampSlope(0.0, np.inf)
    value = sum(float(x @ y) for x, y in products) / total
    scores = [x * (y - value * x) for x, y in products]
    # Neighbours share readings: sums of blocks are nearly independent.
    size = LIMITS.jitter_block
    blocks = [x[k : k + size].sum() for x in scores for k in range(0, len(x), size)]
    return StampSlope(value, float(np.sqrt(np.sum(np.square(blocks))) / total))


def _short_term(
    stamps: np.ndarray, clock: np.ndarray, readings: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Change of readings by jitter, and the readings, both less a curve through neighbours."""
    present = np.isfinite(readings)
    stamps, clock, readings = stamps[present], clock[present], readings[present]
    if len(readings) < LIMITS.line_rows + LIMITS.curve_rows:
        return np.zeros(0), np.zeros(0)
    step = float(np.median(np.diff(clock)))
    even = np.abs(np.diff(clock) - step) < 1e-3 * step
    rate = np.convolve(readings, _weights(LIMITS.line_rows, 1)[::-1], "valid") / step
    trim = LIMITS.line_rows // 2
    moved = rate * (stamps - clock)[trim:-trim]
    residual = -_weights(LIMITS.curve_rows, 0)
    residual[LIMITS.curve_rows // 2] += 1.0
    x, y = (np.convolve(v, residual[::-1], "valid") for v in (moved, readings[trim:-trim]))
    width = LIMITS.line_rows + LIMITS.curve_rows - 2
    whole = np.convolve(even, np.ones(width), "valid") > width - 0.5
    x, y = x[whole], y[whole]
    spread = SD_OVER_MAD * float(np.median(np.abs(y))) if len(y) else 0.0
    most = LIMITS.most_counted_sds * spread
    return x, np.clip(y, -most, most) if spread > 0.0 else y


def _weights(width: int, order: int) -> np.ndarray:
    """Weights of a least-squares parabola (order 0) or line (order 1: its slope) at the middle."""
    at = np.arange(width) - width // 2
    powers = np.stack([at**p for p in range(3 - order)], axis=1).astype(float)
    return np.asarray(np.linalg.pinv(powers)[order])


def regular_stamps(time: np.ndarray, unit: str = "s") -> tuple[np.ndarray, Dirt | None]:
    """Times (n,) of the regular clock that rounded stamps show, else the stamps; and a record.

    >>> stamps, record = regular_stamps(np.round(0.48 * np.arange(99), 1))
    >>> bool(np.abs(np.diff(stamps) - 0.48).max() < 1e-3), record.treated
    (True, 'modelled')
    """
    if len(time) < LIMITS.fewest_stamps:
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
    if not is_regular(time) or np.mean(deviation > LIMITS.uneven_step * step) < LIMITS.uneven_share:
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
    """The unit of which all steps between stamps are multiples, if it is coarse enough.

    Stamps of 32 bits have the finest unit at their smallest times and the coarsest at their
    largest; the latter is the one that every stamp is rounded to at least as well as. Others step
    by two neighbouring multiples of their unit, be it 10 ms or a millionth of a day.
    """
    largest = float(np.abs(time).max())
    # A wild stamp overflows, and is none of 32 bits.
    with np.errstate(over="ignore"):
        single = np.array_equal(time.astype(np.float32).astype(float), time)
    least, most = LIMITS.fine_resolution * step, LIMITS.coarse_resolution * step
    resolution = float(np.spacing(np.float32(largest))) if single else 0.0
    if not resolution > least:
        steps = np.sort(np.diff(time))
        gaps = np.diff(steps[np.abs(steps - step) < 0.5 * step])
        # Smaller gaps are of no use, or rounding of the numbers: of Julian days some microseconds.
        resolution = float(gaps[gaps >= least].min(initial=np.inf))
        multiples = steps / resolution
        if np.abs(multiples - np.round(multiples)).max() > LIMITS.on_a_multiple:
            return None
    return resolution if resolution <= most else None


def _grid(time: np.ndarray, step: float, resolution: float) -> np.ndarray | None:
    """Times of the regular clock within half a resolution of every stamp; None without one.

    Rows may be missing. An even clock whose steps are multiples of the resolution is left alone.
    """
    steps = np.diff(time)
    near = steps[np.abs(steps - step) < 0.5 * step]
    if np.ptp(near) < 0.5 * resolution:
        return None
    fitted, rows, _ = clock_through(time)
    clock = fitted + time[0]
    strays = np.abs(clock - time).max() > LIMITS.half_resolution * resolution
    return None if strays or np.any(np.diff(rows) < 1.0) else clock
