"""Random torque on the body: an Ornstein-Uhlenbeck process, in every slew another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from bayes_inertia.physics.effects.scales import torque_scale
from bayes_inertia.physics.parameters import LogNormal, scalar
from bayes_inertia.physics.random_basis import (
    hat_functions,
    on_axes,
    on_each_axis,
    ornstein_uhlenbeck_root,
    slew_duration,
    slew_fraction,
)
from bayes_inertia.physics.stochastic_effect import StochasticEffect


@dataclass(frozen=True)
class TorqueNoise(StochasticEffect):
    """A torque on the body with the covariance sd^2 exp(-|t - t'| / time) on each axis.

    Fuel or crew that moves, venting, aerodynamic gusts: whatever torque has no name. Straight lines
    between knots: a torque that changes faster than their spacing is not modelled; what it does to
    the rates is small, because they integrate it.

    Parameters
    ----------
    median_sd, median_time : float or None, optional
        Medians of the priors [N m, s]; None takes 1 % of J w / T (2e-6 N m for a microsatellite's
        slew), and a fifth of a slew.
    factor_sd : float, optional
        Sd of the logarithm of the sd. The time is known to a factor of 2 (sd 0.7).
    knots : int, optional
        On each axis, evenly over the slew.

    References
    ----------
    G. E. Uhlenbeck and L. S. Ornstein, "On the theory of the Brownian motion", Phys. Rev. 36, 1930.

    Examples
    --------
    >>> TorqueNoise(knots=9).coefficient_count(None)
    27
    """

    name: ClassVar[str] = "torque_noise"
    median_sd: float | None = None
    median_time: float | None = None
    factor_sd: float = 1.5
    knots: int = 17

    def parameters(self, campaign):
        sd = self.median_sd or 0.01 * torque_scale(campaign)
        time = self.median_time or 0.2 * campaign.scale_of_motion()[1]
        return (
            scalar("sd", unit="N m", prior=LogNormal(sd, self.factor_sd)),
            scalar("time", unit="s", prior=LogNormal(time, 0.7), null=time),
        )

    def coefficient_count(self, campaign):
        return 3 * self.knots

    def coefficient_root(self, p, slew, count):
        spacing = slew_duration(slew) / (self.knots - 1)
        return on_each_axis(ornstein_uhlenbeck_root(p["sd"], p["time"], spacing, self.knots), 3)

    def body_torque(self, p, slew, t, state):
        return on_axes(hat_functions(slew_fraction(slew, t), self.knots), p["coefficients"], 3)
