"""First-order processes that a sensor's noise holds beside white noise, as a state space.

One state each: correlated noise that was measured, what a campaign states of a gyro's bias (a
random walk, RRW; a Gauss-Markov process that stands for its instability, BI), what an effect adds
to readings, all of it or what it does between knots. One filter whitens their sum
(`inference.noise_model`). Farrenkopf 1978; IEEE Std 952-1997, annexes B and C.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jax import Array

from bayes_inertia.maths.values import AnyArray
from bayes_inertia.physics.random_basis import (
    ornstein_uhlenbeck_covariance,
    ornstein_uhlenbeck_root,
    random_walk_covariance,
    random_walk_root,
    slew_duration,
)
from bayes_inertia.physics.slew_context import SlewContext


class RowTimes(NamedTuple):
    """When readings are taken.

    Parameters
    ----------
    times : (slews, n) array
        Of each row, on the slew's own clock [s].
    away : (slews,) array
        From the middle of the campaign to the slew's first row [s].
    """

    # Of numpy on the host, of JAX in compiled code.
    times: AnyArray
    away: AnyArray

    @property
    def steps(self) -> AnyArray:
        """Time (slews, n) from each row to the next [s], zero after the last."""
        n = self.times.shape[1]
        return self.times[:, np.minimum(np.arange(n) + 1, n - 1)] - self.times


class StateSpace(NamedTuple):
    """A first-order process in each of c components, in units of one reading's variance.

    Parameters
    ----------
    start : (slews, c) array
        Variance at a slew's first row.
    decay : (slews, n, c) array
        What is left at the next row.
    fresh : (slews, n, c) array
        Variance that is new by then.
    """

    start: AnyArray
    decay: AnyArray
    fresh: AnyArray


class Process(NamedTuple):
    """A Gauss-Markov process or a random walk beside the white noise of readings.

    Parameters
    ----------
    channel : str
        Of which readings; each component has a process of its own.
    size : float, () or (c,) array
        Sd of the Gauss-Markov process; of a random walk the density, its sd after one second. SI.
    time : float, () or (c,) array, optional
        Correlation time [s]; infinite: a random walk. It is zero in the middle of the campaign: a
        slew begins with what it became since (or before).
    knots : int, optional
        Where an effect's coefficients are its values on so many evenly spaced knots of each slew,
        with straight lines between; 0: they are not. What is left between knots begins and ends at
        zero there: a Brownian bridge, whose density is that of the change from knot to knot.

    Examples
    --------
    >>> Process("rate", 1e-6).time
    inf
    """

    channel: str
    size: AnyArray
    time: AnyArray = float("inf")
    knots: int = 0

    @property
    def walks(self) -> bool:
        """Whether it is a random walk."""
        return isinstance(self.time, float) and self.time == float("inf")

    def root(self, slew: SlewContext, knots: int) -> Array:
        """Root (knots, knots) of its covariance at evenly spaced knots of a slew."""
        if self.walks:
            return random_walk_root(self.size, slew, knots)
        spacing = slew_duration(slew) / (knots - 1)
        return ornstein_uhlenbeck_root(self.size, self.time, spacing, knots)

    def across_slews(self, slews: SlewContext, knots: int) -> Array:
        """Its covariance (slews knots, slews knots) at evenly spaced knots of all slews."""
        if self.walks:
            return random_walk_covariance(self.size, slews, knots)
        return ornstein_uhlenbeck_covariance(self.size, self.time, slews, knots)

    def in_rows(self, rows: RowTimes, variance: AnyArray, xp: Any = np) -> StateSpace:
        """The process at readings whose white noise has this variance (c,)."""
        power = self.size**2 / variance
        if self.knots:
            return _between_knots(rows, self.knots, float(self.time), power)
        steps = rows.steps[..., None]
        if self.walks:
            # Zero in the middle of the campaign, as in `random_walk_root`.
            before = rows.away + rows.times[:, -1] - rows.times[:, 0]
            fresh = steps * power
            return StateSpace(before[:, None] * power, xp.ones_like(fresh), fresh)
        decay = xp.exp(-steps / self.time) * xp.ones_like(variance)
        return StateSpace(xp.ones_like(rows.away)[:, None] * power, decay, power * (1.0 - decay**2))


def _between_knots(rows: RowTimes, knots: int, time: float, power: np.ndarray) -> StateSpace:
    """What straight lines between knots leave of a process: Brownian bridges from knot to knot.

    Their density is the variance of the change from one knot to the next, over the time between
    them. For a random walk that is exact. For a Gauss-Markov process the variance is, and a bridge
    is close where knots are not far apart.
    """
    times = rows.times
    spacing = np.maximum(times[:, -1:] - times[:, :1], 1e-9) / (knots - 1)
    place = (times - times[:, :1]) / spacing
    # A row at a knot must not fall into the interval before it by rounding.
    knot = np.floor(place + 1e-9)
    since = np.maximum(place - knot, 0.0) * spacing
    left = spacing - since
    # Of the change over one interval, a second.
    growth = 1.0 if np.isinf(time) else -2.0 * np.expm1(-spacing / time) / spacing
    variance = growth * since * left / spacing
    same = np.diff(knot, axis=1, append=knot[:, -1:]) == 0.0
    next_left, next_variance = (np.roll(x, -1, axis=1) for x in (left, variance))
    decay = np.where(same, next_left / left, 0.0)
    decay[:, -1] = 1.0
    fresh = np.maximum(next_variance - decay**2 * variance, 0.0)
    fresh[:, -1] = 0.0
    shape = (*times.shape, len(power))
    kept = np.broadcast_to(decay[..., None], shape)
    return StateSpace(variance[:, :1] * power, kept, fresh[..., None] * power)
