"""Effects without a fixed shape: a Gaussian process that differs in every slew.

Such an effect writes its signal in one slew as a sum of unit inputs, c_1 f_1(t) + ... + c_k f_k(t)
(a reduced basis: values on knots, means over pieces, an offset for each group of fixes). The
coefficients have the Gaussian prior c = B(p) z, z standard normal, with a root B of their
covariance that the effect's parameters p fix (an sd, a correlation time). The likelihood integrates
z out in closed form with the other nuisances of the slew; p are sampled like J and K.

A sensor's noise may hold first-order processes beside white noise (`Process`), one state each:
correlated noise that was measured, what a campaign states of a gyro's bias (a random walk, RRW; a
Gauss-Markov process that stands for its instability, BI), what an effect adds to readings, all of
it or what it does between knots. One filter whitens their sum (`inference.noise_filter`).
Farrenkopf 1978; IEEE Std 952-1997, annexes B and C.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.errors import EffectError
from bayes_inertia.maths.values import AnyArray
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.random_basis import (
    hat_functions,
    on_axes,
    on_each_axis,
    ornstein_uhlenbeck_covariance,
    ornstein_uhlenbeck_root,
    random_walk_covariance,
    random_walk_root,
    slew_duration,
    slew_fraction,
)
from bayes_inertia.physics.slew_context import SlewContext

if TYPE_CHECKING:
    from bayes_inertia.campaign.campaign import Campaign


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
        return ornstein_uhlenbeck_root(
            self.size, self.time, slew_duration(slew) / (knots - 1), knots
        )

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
    return StateSpace(
        variance[:, :1] * power,
        np.broadcast_to(decay[..., None], shape),
        fresh[..., None] * power,
    )


@dataclass(frozen=True)
class StochasticEffect(Effect):
    """Base of effects that are different in every slew.

    The hooks of `Effect` are given `p = {"coefficients": c}`, shape (k,), the coefficients of the
    slew at hand, and nothing else: what `parameters` declares acts through `coefficient_root`
    alone. Hooks must do nothing where all coefficients are zero, and should be linear in them.

    Parameters
    ----------
    prior_scale : float, optional
        As of `Effect`; sizes and times with log-normal priors stay as they are.
    device : str, optional
        As of `Effect`; nothing here.

    Raises
    ------
    EffectError
        If an effect has a field `knots` below 2, or `pieces` below 1.

    Examples
    --------
    >>> StochasticEffect().coefficient_count(None)
    0
    """

    name: ClassVar[str] = "no_stochastic_effect"
    # What a report says of `signal`: what it is called, what is measured (short, beside an axis),
    # its unit and the name of each component.
    signal_title: ClassVar[str] = ""
    signal_quantity: ClassVar[str] = ""
    signal_unit: ClassVar[str] = ""
    signal_components: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        # Straight lines go between two knots at least.
        for setting, least in (("knots", 2), ("pieces", 1)):
            number = getattr(self, setting, least)
            if not (isinstance(number, int) and number >= least):
                raise EffectError(
                    f"{setting} is {number}",
                    where=self.name,
                    advice=f"give a whole number, {least} or more",
                )

    def coefficient_count(self, campaign: Campaign) -> int:
        """How many coefficients one slew has.

        Parameters
        ----------
        campaign : Campaign
            Tells how many wheels there are.

        Returns
        -------
        int
            k, the same in all slews.
        """
        return 0

    def coefficient_root(self, p: Mapping[str, Array], slew: SlewContext, count: int) -> Array:
        """A root of the coefficients' prior covariance in one slew.

        Parameters
        ----------
        p : mapping of str to Array
            The effect's parameters: sds, times.
        slew : SlewContext
            The slew.
        count : int
            k of this campaign.

        Returns
        -------
        (k, k) array, or (b, m, m) array with b m = k
            B; B B^T is the covariance. Zero where the parameters are null, else of full rank.
            Independent processes of one kind give the b blocks on B's diagonal: a fit then costs
            less.
        """
        return jnp.zeros((count, count))

    def covariance_across_slews(self, p: Mapping[str, Array], slews: SlewContext) -> Array | None:
        """The covariance of the coefficients of all slews, where the process goes on between them.

        A fit takes slews as independent, with `coefficient_root` in each: that is fast, and of J
        and K it says nearly the same. Naming does not: whether a bias rises steadily or walks is
        told by how its values in several slews belong together.

        Parameters
        ----------
        p : mapping of str to Array
            The effect's parameters: sds, times.
        slews : SlewContext
            With the slews as leading axis.

        Returns
        -------
        (slews m, slews m) array or None
            Of the m coefficients of one block of `coefficient_root`; those of one slew stand
            together. None where slews are independent.
        """
        return None

    def signal(self, p: Mapping[str, Array], slew: SlewContext, t: Array) -> Array | None:
        """The process over time, for reports; hooks may use it.

        Parameters
        ----------
        p : mapping of str to Array
            "coefficients" of the slew.
        slew : SlewContext
            The slew.
        t : (...) array
            Times from the slew's own zero [s].

        Returns
        -------
        (..., components) array or None
            In `signal_unit`, one column for each of `signal_components`, linear in the
            coefficients; None where there is nothing to draw.
        """
        return None

    def reading_noise(self, p: Mapping[str, Array]) -> Process | None:
        """The process, where it is noise of readings and nothing else.

        Parameters
        ----------
        p : mapping of str to Array
            The effect's parameters: sds, times.

        Returns
        -------
        Process or None
            None where it moves the body, or is no first-order process.
        """
        return None


@dataclass(frozen=True)
class ReadingNoise(StochasticEffect):
    """Base of effects that only a sensor feels: a first-order process in each of its components.

    `reading_noise` says which process, `components` in how many; derived classes add `signal` to
    what their sensor gives. Coefficients are values on knots with straight lines between. What the
    process does between knots is filtered out of the readings, at its own size. Where residuals
    are tested, and where sizes are learnt, all of it is filtered out.

    Parameters
    ----------
    knots : int, optional
        Of each component, evenly over the slew.
    """

    knots: int = field(default=17, kw_only=True)

    def components(self, campaign: Campaign) -> int:
        """How many components the sensor has; 0 where there is nothing to estimate."""
        return 0

    def reading_noise(self, p: Mapping[str, Array]) -> Process:
        """The process; asked for only where there are components."""
        raise NotImplementedError

    def coefficient_count(self, campaign):
        return self.components(campaign) * self.knots

    def coefficient_root(self, p, slew, count):
        root = self.reading_noise(p).root(slew, self.knots)
        return on_each_axis(root, count // self.knots)

    def covariance_across_slews(self, p, slews):
        return self.reading_noise(p).across_slews(slews, self.knots)

    def signal(self, p, slew, t):
        hats = hat_functions(slew_fraction(slew, t), self.knots)
        return on_axes(hats, p["coefficients"], p["coefficients"].size // self.knots)

    def looks_between_rows(self, campaign):
        return False
