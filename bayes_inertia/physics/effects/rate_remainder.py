"""What remains: an error of the rate sensor of free shape, in every slew another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from bayes_inertia.physics.effects.rate_bias_instability import RateBiasInstability


@dataclass(frozen=True)
class RateRemainder(RateBiasInstability):
    """A rate error without a name: `rate_bias_instability` whose size is known to a factor of 90.

    For fits that stay honest although the model is incomplete: what errors of the rate sensor
    nobody thought of did is taken from the information on J and K.

    Parameters
    ----------
    median_sd, median_time, factor_sd, knots
        As `RateBiasInstability`.

    Examples
    --------
    >>> RateRemainder().factor_sd
    2.3
    """

    name: ClassVar[str] = "rate_remainder"
    signal_title: ClassVar[str] = "rate error without a name"
    factor_sd: float = 2.3
