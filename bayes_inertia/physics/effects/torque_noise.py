"""Random torque on the body or of the wheels: an Ornstein-Uhlenbeck process in each slew."""

from __future__ import annotations

from dataclasses import dataclass

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.physics.effects.scales import sd_and_time, torque_scale
from bayes_inertia.physics.random_basis import (
    on_each_axis,
    on_pieces,
    ornstein_uhlenbeck_mean_root,
    slew_duration,
    slew_fraction,
)
from bayes_inertia.physics.stochastic_effect import StochasticEffect


@dataclass(frozen=True)
class PiecewiseTorque(StochasticEffect):
    """Base of torques with covariance sd^2 exp(-|t - t'| / time), constant over pieces of a slew.

    They have the covariance that the means of the process have over the pieces: what it does to the
    rate is exact between pieces, what it does within one is left out. Derived classes say in how
    many components, and where `signal` acts. Fields: see `TorqueNoise`.
    """

    median_sd: float | None = None
    median_time: float | None = None
    factor_sd: float = 1.5
    pieces: int = 16

    def components(self, campaign: Campaign) -> int:
        """How many independent torques there are; 0 where there is nothing to estimate."""
        return 3

    def parameters(self, campaign):
        if not self.components(campaign):
            return ()
        sd = self.median_sd or 0.01 * torque_scale(campaign)
        return sd_and_time(campaign, "N m", sd, self.median_time, self.factor_sd)

    def coefficient_count(self, campaign):
        return self.components(campaign) * self.pieces

    def coefficient_root(self, p, slew, count):
        width = slew_duration(slew) / self.pieces
        root = ornstein_uhlenbeck_mean_root(p["sd"], p["time"], width, self.pieces)
        return on_each_axis(root, count // self.pieces)

    def signal(self, p, slew, t):
        components = p["coefficients"].size // self.pieces
        return on_pieces(slew_fraction(slew, t), p["coefficients"], components)


@dataclass(frozen=True)
class TorqueNoise(PiecewiseTorque):
    """A torque on the body with the covariance sd^2 exp(-|t - t'| / time) on each axis.

    Fuel or crew that moves, venting, aerodynamic gusts: whatever torque has no name. It is
    constant over pieces of the slew, with the covariance that the means of the process have there:
    what it does to the rate is exact between pieces, what it does within one is left out.

    Parameters
    ----------
    median_sd, median_time : float or None, optional
        Medians of the priors [N m, s]; None takes 1 % of J w / T (2e-6 N m for a microsatellite's
        slew), and a fifth of a slew.
    factor_sd : float, optional
        Sd of the logarithm of the sd. The time is known to a factor of 2 (sd 0.7).
    pieces : int, optional
        On each axis, of equal length.

    References
    ----------
    G. E. Uhlenbeck and L. S. Ornstein, "On the theory of the Brownian motion", Phys. Rev. 36, 1930.

    Examples
    --------
    >>> TorqueNoise(pieces=9).coefficient_count(None)
    27
    """

    name = "torque_noise"
    signal_title = "random torque on the body"
    signal_quantity = "torque"
    signal_unit = "N m"
    signal_components = ("x", "y", "z")
    steps_a_piece = 4  # integration steps in each piece, at least

    def max_step(self, campaign):
        # An edge between pieces is displaced by less than a step.
        shortest = min(float(slew.time[-1] - slew.time[0]) for slew in campaign.slews)
        return shortest / (self.steps_a_piece * self.pieces)

    def body_torque(self, p, slew, t, state):
        return self.signal(p, slew, t)


@dataclass(frozen=True)
class TorqueRemainder(TorqueNoise):
    """A torque without a name: `torque_noise` whose size is known to a factor of 90 either way.

    For fits that stay honest although the model is incomplete: what torques nobody thought of did
    is taken from the information on J and K.

    Parameters
    ----------
    median_sd, median_time, factor_sd, pieces
        As `TorqueNoise`.

    Examples
    --------
    >>> TorqueRemainder().factor_sd
    2.3
    """

    name = "torque_remainder"
    signal_title = "torque without a name"
    factor_sd: float = 2.3


@dataclass(frozen=True)
class WheelTorqueNoise(PiecewiseTorque):
    """What a motor delivers beyond its command, with covariance sd^2 exp(-|t - t'| / time).

    Body and wheel push against each other: the momentum of both together is kept, and tachometers
    see it. In the measured drive, where torques are not used, it does nothing.

    Parameters
    ----------
    median_sd, median_time : float or None, optional
        Medians of the priors [N m, s]; None takes 1 % of J w / T, and a fifth of a slew.
    factor_sd : float, optional
        Sd of the logarithm of the sd. The time is known to a factor of 2 (sd 0.7).
    pieces : int, optional
        On each wheel, of equal length.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> WheelTorqueNoise(pieces=9).coefficient_count(small_campaign())
    27
    """

    name = "wheel_torque_noise"

    def components(self, campaign):
        return len(campaign.wheels)

    def delivered_torque(self, p, slew, torque):
        # The mean over each interval of the grid, as the commands are.
        return torque + self.signal(p, slew, slew.time + 0.5 * slew.step)


@dataclass(frozen=True)
class WheelTorqueRemainder(WheelTorqueNoise):
    """A torque of the wheels without a name: `wheel_torque_noise`, known to a factor of 90.

    A diagnosis fits it along where a shape without a name explains the data best as a torque of the
    wheels: a torque on the body alone would contradict their tachometers.

    Parameters
    ----------
    median_sd, median_time, factor_sd, pieces
        As `WheelTorqueNoise`.

    Examples
    --------
    >>> WheelTorqueRemainder().factor_sd
    2.3
    """

    name = "wheel_torque_remainder"
    signal_title = "torque of the wheels without a name"
    factor_sd: float = 2.3
