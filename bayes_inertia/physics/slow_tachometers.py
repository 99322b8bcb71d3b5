"""Wheel momentum between readings of tachometers that are slower than the rates.

In the measured drive the tachometers are the input. Where seconds lie between their readings, a
straight line is wrong by what the wheels did meanwhile. Then the momentum is a cubic spline through
the readings and some free knots between them; what it is there is estimated along, slew by slew,
with a prior as wide as lines across the double distance are wrong. In long slews knots are free
where these lines are most wrong: a spline through readings alone follows what bends slowly.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.limits import LIMITS
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.faults.noise import smooth_noise
from bayes_inertia.physics.numerics import NUMERICS


class FreeMomentum(NamedTuple):
    """What is free of the wheels' momentum.

    Parameters
    ----------
    inner : int
        Free knots between two readings.
    columns : int
        Free knots of a slew, the most of all.
    sd : (wheels,) array
        Prior sd of the momentum at a free knot [N m s].
    """

    inner: int
    columns: int
    sd: np.ndarray

    def on_grid(self, slew: Slew, grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Momentum (n, wheels) where all free knots lie on lines, and a shape (n, columns) each.

        `grid` (n,): times from the slew's first row [s].
        """
        at, momentum = _readings(slew)
        knots, free = _knots(at, momentum, slew.duration, self.inner)
        cardinal = CubicSpline(knots, np.eye(len(knots)))(grid)
        on_lines = np.stack([np.interp(knots, at, column) for column in momentum.T], axis=-1)
        shapes = np.zeros((len(grid), self.columns))
        shapes[:, : int(free.sum())] = cardinal[:, free]
        return cardinal @ on_lines, shapes


def free_momentum(campaign: Campaign) -> FreeMomentum | None:
    """What is free between the readings of slow tachometers; None where lines are good enough.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> free_momentum(small_campaign()) is None
    True
    """
    if not campaign.wheels or not campaign.has_tachometers:
        return None
    readings = [_readings(slew) for slew in campaign.slews]
    if any(len(at) < NUMERICS.fewest_slow_readings for at, _ in readings):
        return None
    step = float(np.median(np.concatenate([slew.rate_steps for slew in campaign.slews])))
    between = float(np.median(np.concatenate([np.diff(at) for at, _ in readings])))
    rates_between = round(between / step)
    errors = np.concatenate([_errors_of_lines(at, h) for at, h in readings])
    noise = np.array([w.momentum_sigma for w in campaign.wheels], dtype=float)
    # Across twice the distance a smooth curve leaves its chord four times as far.
    sag = np.sqrt(np.maximum(np.mean(errors**2, axis=0) - 1.5 * noise**2, 0.0)) / 4.0
    inertia = float(np.linalg.eigvalsh(campaign.inertia.tensor)[0])
    seen = campaign.with_body_rates
    finest = min(*seen.gyro.sigma, campaign.rate_noise)
    allowed = LIMITS.momentum_line_of_rate_noise * inertia * finest
    if rates_between < NUMERICS.slow_tachometer or not (sag > allowed).any():
        return None
    most = rates_between // 2 - 1
    if most < 1:
        return None
    longest = max(slew.duration for slew in campaign.slews)
    most = min(most, max(1, int(NUMERICS.most_free_knots * between / longest)))
    counts = sorted({min(count, most) for count in NUMERICS.free_knots})
    follow = (c for c in counts if _misfit_of_rates(seen, c) < NUMERICS.rates_followed)
    inner = next(follow, counts[-1])
    free = [_knots(*_readings(slew), slew.duration, inner)[1] for slew in campaign.slews]
    bent = (_bent(at, h, inner) for at, h in readings)
    errors = errors[np.concatenate([each[1:] | each[:-1] for each in bent])]
    sd = np.maximum(np.sqrt(np.mean(errors**2, axis=0)), noise)
    return FreeMomentum(inner, max(int(each.sum()) for each in free), sd)


def _readings(slew: Slew) -> tuple[np.ndarray, np.ndarray]:
    """Times (m,) from the slew's first row [s] and momenta (m, wheels) where all are read."""
    momentum = np.asarray(slew.wheel_momentum)
    rows = np.isfinite(momentum).all(axis=1)
    return slew.time[rows] - slew.time[0], momentum[rows]


def _bent(at: np.ndarray, momentum: np.ndarray, inner: int) -> np.ndarray:
    """Between which readings (m - 1,) knots are free: where lines are most wrong, if not in all."""
    most = NUMERICS.most_free_knots // inner
    errors = np.linalg.norm(_errors_of_lines(at, momentum), axis=1)
    beside = np.maximum(np.append(errors, 0.0), np.append(0.0, errors))
    bent = np.zeros(len(beside), dtype=bool)
    bent[np.argsort(-beside, kind="stable")[:most]] = True
    return bent


def _knots(
    at: np.ndarray, momentum: np.ndarray, duration: float, inner: int
) -> tuple[np.ndarray, np.ndarray]:
    """Knots (k,) of the spline, and which of them are free (k,) because nothing was read there."""
    shares = np.arange(inner + 1) / (inner + 1.0)
    inside = at[:-1, None] + np.diff(at)[:, None] * shares
    inside = inside[_bent(at, momentum, inner)[:, None] | (shares == 0.0)]
    spacing = float(np.median(np.diff(at))) / (inner + 1)
    ends = [(0.0, at[0]), (at[-1], duration)]
    counts = [int(np.ceil((b - a) / spacing - 1e-9)) for a, b in ends]
    before, after = (np.linspace(a, b, n + 1) for (a, b), n in zip(ends, counts, strict=True))
    knots = np.concatenate([before[:-1], inside, after])
    return knots, ~np.isin(knots, at)


def _errors_of_lines(at: np.ndarray, momentum: np.ndarray) -> np.ndarray:
    """By how much (m - 2, wheels) each reading is off the line through those beside it [N m s]."""
    share = ((at[1:-1] - at[:-2]) / (at[2:] - at[:-2]))[:, None]
    return momentum[1:-1] - (1.0 - share) * momentum[:-2] - share * momentum[2:]


def _misfit_of_rates(campaign: Campaign, inner: int) -> float:
    """Mean square of what splines with such knots leave of the rates, over their noise's."""
    ratios = []
    for slew in campaign.slews:
        knots, _ = _knots(*_readings(slew), slew.duration, inner)
        rows, rates = slew.complete_rates(campaign.valid_readings(slew))
        if len(rows) <= len(knots):
            continue
        shapes = CubicSpline(knots, np.eye(len(knots)))(slew.time[rows] - slew.time[0])
        rest = rates - shapes @ np.linalg.lstsq(shapes, rates, rcond=None)[0]
        noise = np.array([smooth_noise(axis) for axis in rates.T])
        # An outlier is no motion.
        square = np.minimum((rest / noise) ** 2, 36.0).sum(axis=0)
        ratios.append(square / (len(rows) - len(knots)))
    return float(np.nanmean(ratios)) if ratios else 0.0
