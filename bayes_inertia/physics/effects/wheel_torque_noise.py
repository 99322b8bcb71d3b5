"""Random torque of the wheels' motors: an Ornstein-Uhlenbeck process on each wheel."""

from __future__ import annotations

from dataclasses import dataclass

from bayes_inertia.physics.effects.torque_noise import PiecewiseTorque


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
