"""Wheel motors that deliver more or less torque than commanded."""

from __future__ import annotations

from dataclasses import dataclass

from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects.scales import per_wheel
from bayes_inertia.physics.parameters import Normal


@dataclass(frozen=True)
class WheelTorqueGain(Effect):
    """Every wheel's motor torque is its command times a factor of its own.

    The causes are the motor constant and the current loop.

    A gain common to all wheels is exactly degenerate with the size of J unless tachometers see
    the wheels' momentum. In the measured drive, where commands are not used, it does nothing.

    Parameters
    ----------
    sigma : float, optional
        Prior sd of the gain; 0.03 is the usual tolerance of a motor constant over temperature.

    Examples
    --------
    >>> WheelTorqueGain().sigma
    0.03
    """

    name = "wheel_torque_gain"
    sigma: float = 0.03

    def parameters(self, campaign):
        return per_wheel(campaign, "gain", unit="", prior=Normal(1.0, self.sigma), null=1.0)

    def delivered_torque(self, p, slew, torque):
        return torque * p["gain"] if p else torque
