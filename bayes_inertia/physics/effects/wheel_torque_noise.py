"""Random torque of the wheels' motors: an Ornstein-Uhlenbeck process on each wheel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

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
class WheelTorqueNoise(StochasticEffect):
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

    name: ClassVar[str] = "wheel_torque_noise"
    median_sd: float | None = None
    median_time: float | None = None
    factor_sd: float = 1.5
    pieces: int = 16

    def parameters(self, campaign):
        if not campaign.wheels:
            return ()
        sd = self.median_sd or 0.01 * torque_scale(campaign)
        return sd_and_time(campaign, "N m", sd, self.median_time, self.factor_sd)

    def coefficient_count(self, campaign):
        return len(campaign.wheels) * self.pieces

    def coefficient_root(self, p, slew, count):
        width = slew_duration(slew) / self.pieces
        root = ornstein_uhlenbeck_mean_root(p["sd"], p["time"], width, self.pieces)
        return on_each_axis(root, count // self.pieces)

    def delivered_torque(self, p, slew, torque):
        # The mean over each interval of the grid, as the commands are.
        middle = slew_fraction(slew, slew.time + 0.5 * slew.step)
        return torque + on_pieces(middle, p["coefficients"], torque.shape[1])
