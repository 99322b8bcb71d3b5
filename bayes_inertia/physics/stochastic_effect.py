"""Effects without a fixed shape: a Gaussian process that differs in every slew.

Such an effect writes its signal in one slew as a sum of unit inputs, c_1 f_1(t) + ... + c_k f_k(t)
(a reduced basis: values on knots, means over pieces, an offset for each group of fixes). The
coefficients have the Gaussian prior c = B(p) z, z standard normal, with a root B of their
covariance that the effect's parameters p fix (an sd, a correlation time). The likelihood integrates
z out in closed form with the other nuisances of the slew; p are sampled like J and K.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.physics.effect import Effect, RowByRow, require_of_effect
from bayes_inertia.physics.processes import Process
from bayes_inertia.physics.random_basis import hat_functions, on_axes, on_each_axis, slew_fraction
from bayes_inertia.physics.slew_context import SlewContext


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
        As of `Effect`; nothing where there is no `kind`.

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
        super().__post_init__()
        # Straight lines go between two knots at least.
        for setting, least in (("knots", 2), ("pieces", 1)):
            number = getattr(self, setting, least)
            whole, advice = isinstance(number, int), f"give a whole number, {least} or more"
            require_of_effect(whole and number >= least, self, f"{setting} is {number}", advice)

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
class ReadingNoise(RowByRow, StochasticEffect):
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
