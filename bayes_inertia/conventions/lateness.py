"""Clocks of streams against each other: by how much is one late, and is that still physical?

A sensor's exposure, processing and transport make it late by a fraction of a second: the library
has effects for that (`star_tracker_time_offset`, `rate_sensor_delay`, `wheel_command_lag`), and a
lateness of that size is no wrong convention. A lateness far beyond it is a wrong clock.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.known_offsets import KNOWN_OFFSETS
from bayes_inertia.conventions import limits
from bayes_inertia.conventions.laws import CLOSURE, DRIVE, LawData
from bayes_inertia.conventions.linear_fit import fitted
from bayes_inertia.conventions.misfits import Misfits
from bayes_inertia.conventions.reading import Reading
from bayes_inertia.conventions.sampled_slews import sampled

# A lateness beyond this [s] is no delay of a sensor, but perhaps a known offset.
_NO_DELAY = 5.0
# A known offset that leaves at most this much more is meant: fixes at rest tell a range.
_AS_GOOD = 1.1
_ROUNDS = 6
# A shift that changes by less than this share of itself has converged.
_CONVERGED = 0.02
# Sd of the prior of a lateness [s]: it only keeps the fit finite.
_WIDE_SECONDS = 1e3


@dataclass(frozen=True)
class Lateness:
    """By how much a stream is late, as one law tells it.

    Parameters
    ----------
    law : str
        Which law.
    seconds : float
        What must be added to the time stamps of the law's second stream [s]; negative where it is
        late.
    before, after : float
        Residual of the law without and with it [sd of the sensors' stated noise].
    moments : int
        How many moments were compared.
    """

    law: str
    seconds: float
    before: float
    after: float
    moments: int

    @property
    def explains(self) -> bool:
        """Whether the lateness is what breaks the law, rather than one of many things.

        Nearly nothing but the stated noise is left, or a third of what was there at most; and chi^2
        falls by far more than chance lets it.
        """
        excess_before, excess_after = (max(x**2 - 1.0, 0.0) for x in (self.before, self.after))
        fall = (self.before**2 - self.after**2) * self.moments
        share = limits.IMPROVEMENT**2
        most = excess_after * share < excess_before or self.after**2 * share < self.before**2
        return most and fall > limits.LATE_CHI2


def lateness(misfits: Misfits, reading: Reading, law: str) -> Lateness | None:
    """The shift of a stream that makes one law hold best.

    Closure shifts the star tracker, conservation the wheels, the drive the torque commands.

    Parameters
    ----------
    misfits : Misfits
        The telemetry.
    reading : Reading
        Conventions that agree with the data.
    law : str
        "closure", "conservation" or "drive".

    Returns
    -------
    Lateness or None
        None if the law cannot be tested, or no shift is better than none.
    """
    channels = channels_of(misfits, law)
    data = misfits.law(law, reading)
    if data is None or not data.early.any():
        return None
    first = data
    before, step = _shift(first)
    if before < limits.NOTABLE:
        return None
    shift, after = 0.0, before
    best = (0.0, before)
    for _ in range(_ROUNDS):
        shift += step
        if abs(shift) > 0.3 * float(misfits.motion(reading).duration.min()):
            break
        slews = sampled(misfits.campaign, dict.fromkeys(channels, shift))
        data = None if slews is None else Misfits(misfits.campaign, slews).law(law, reading)
        if data is None:
            break
        after, step = _shift(data)
        if after < best[1]:
            best = (shift, after)
        if abs(step) < _CONVERGED * abs(shift):
            break
    if not best[0]:
        return None
    # From shares of the motion to the noise that the campaign states.
    noises = np.sqrt(np.mean(first.sigma**2)) * limits.SHARP / max(first.noise, 1e-30)
    scale = float(noises) if first.noise > 0.0 else 1.0
    moments = int(first.mask.sum())
    return Lateness(law, best[0], before * scale, best[1] * scale, moments)


def with_known_offset(misfits: Misfits, reading: Reading, late: Lateness) -> Lateness:
    """The offset that clocks are known for, where it explains a law as well as a lateness does.

    Parameters
    ----------
    misfits : Misfits
        The telemetry.
    reading : Reading
        Conventions that agree with the data.
    late : Lateness
        As the law tells it; fixes at rest tell only a range.

    Returns
    -------
    Lateness
        With a known offset, or as it is.
    """
    if abs(late.seconds) <= _NO_DELAY:
        return late
    best = _left(misfits, reading, late.law, late.seconds)
    for offset in KNOWN_OFFSETS:
        seconds = float(np.copysign(offset, late.seconds))
        left = _left(misfits, reading, late.law, seconds)
        if left < _AS_GOOD * best:
            return replace(late, seconds=seconds, after=late.after * left / best)
    return late


def _left(misfits: Misfits, reading: Reading, law: str, seconds: float) -> float:
    """Residual of a law whose second stream is moved."""
    slews = sampled(misfits.campaign, dict.fromkeys(channels_of(misfits, law), seconds))
    data = None if slews is None else Misfits(misfits.campaign, slews).law(law, reading)
    return np.inf if data is None else _shift(data)[0]


def channels_of(misfits: Misfits, law: str) -> tuple[str, ...]:
    """The channels that a law holds against its first stream.

    Parameters
    ----------
    misfits : Misfits
        The telemetry.
    law : str
        Which law.

    Returns
    -------
    tuple of str
        Fields of `Slew`.
    """
    if law == CLOSURE:
        return ("attitude",)
    if law == DRIVE:
        return ("wheel_torque",)
    return ("wheel_momentum",) if misfits.slews.momentum is not None else ("wheel_torque",)


def _shift(data: LawData) -> tuple[float, float]:
    """Residual of the law, and the shift that would lower it, to first order."""
    sharp = replace(data, sigma=data.sigma * limits.SHARP)
    left = sharp.fit()
    regressors = np.concatenate([sharp.regressors, _WIDE_SECONDS * data.early[..., None]], axis=-1)
    fit = fitted(data.data, regressors, data.free, sharp.sigma, data.mask)
    rms = float(np.sqrt(np.mean(left.misfit**2)))
    return rms, float(fit.values[-1] * _WIDE_SECONDS)


def gross_lateness(campaign: Campaign, lag: bool) -> float:
    """The lateness beyond which a clock is wrong [s].

    Parameters
    ----------
    campaign : Campaign
        Its slews' duration is what the library measures lateness in.
    lag : bool
        Whether wheels follow their commands late, which they do more than sensors.

    Returns
    -------
    float
        Lateness [s].

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> gross_lateness(small_campaign(), True) > gross_lateness(small_campaign(), False)
    True
    """
    sd = (limits.LAG_SHARE if lag else limits.LATE_SHARE) * campaign.scale_of_motion()[1]
    if lag:
        return limits.LATE_SDS * sd
    return min(limits.LATE_SDS * sd, max(limits.LONGEST_LATENESS, limits.LEAST_LATE_SDS * sd))
