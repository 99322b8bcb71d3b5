"""What remains: a torque on the body of free shape, in every slew another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from bayes_inertia.physics.effects.torque_noise import TorqueNoise


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

    name: ClassVar[str] = "torque_remainder"
    signal_title: ClassVar[str] = "torque without a name"
    factor_sd: float = 2.3
