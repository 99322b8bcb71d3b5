"""A stated rate bias that is stale: the bias that telemetry itself tells, under any conventions.

The bias is linear in every law (`laws`), but a stale one turns the integrated rate by more than a
linear law bears. So it is estimated, taken off the readings, and estimated again (Gauss-Newton),
first from closure, then, with what closure leaves of its sd, from conservation of momentum.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_inertia.conventions import limits
from bayes_inertia.conventions.hypothesis import Mistake
from bayes_inertia.conventions.laws import CLOSURE, CONSERVATION, DRIVE
from bayes_inertia.conventions.misfits import Misfits
from bayes_inertia.conventions.reading import Reading

_ROUNDS = 4
# A step shorter than this share of the bias's sd has converged.
_CONVERGED = 0.05
# Bias along body axes and its sd [rad/s].
_Told = tuple[np.ndarray, np.ndarray]


def with_own_bias(misfits: Misfits, reading: Reading) -> Reading:
    """A reading with the constant rate bias that the telemetry tells under it.

    Parameters
    ----------
    misfits : Misfits
        The telemetry and its laws.
    reading : Reading
        Conventions, stated or supposed.

    Returns
    -------
    Reading
        With another bias; the reading itself where no bias makes it agree with the data.
    """
    drive = misfits.fit(DRIVE, reading)
    if drive is not None and drive.worst > limits.ORDINARY:
        return reading
    rate_B = misfits.motion(reading).rate_B[misfits.slews.valid]
    rms = float(np.sqrt(np.mean(np.sum(rate_B**2, axis=-1))))
    told: _Told = (reading.bias_B, np.full(3, limits.STALE_SHARE * rms))
    for law in (CLOSURE, CONSERVATION):
        more = _kept(misfits, law, reading, told)
        if more is None:
            return reading
        told = more
    off = np.sqrt(((told[0] - reading.bias_B) ** 2).sum())
    return replace(reading, bias_B=told[0]) if off < limits.STALEST_SHARE * rms else reading


def _kept(misfits: Misfits, law: str, reading: Reading, before: _Told) -> _Told | None:
    """What a law tells, remembered by all that it depends on."""
    used = (getattr(reading, name) for name in misfits.parts_of(law))
    key = ("bias", law, reading.time, *(x.tobytes() for x in (*used, *before)))
    if key not in misfits.kept:
        misfits.kept[key] = _told_by(misfits, law, reading, before)
    return misfits.kept[key]


def _told_by(misfits: Misfits, law: str, reading: Reading, before: _Told) -> _Told | None:
    """Bias and sd as a law tells them; None if it is broken whatever the bias is."""
    bias_B, sd = before
    last = 2.0 * limits.HOPELESS
    for _ in range(_ROUNDS):
        data = misfits.law(law, replace(reading, bias_B=bias_B), sd)
        if data is None:
            return before
        fit = data.fit()
        misfit = float(fit.misfit.max(initial=0.0))
        if misfit > max(limits.ORDINARY, 0.5 * last):
            return None
        which = slice(data.bias_from, data.bias_from + 3)
        step = sd * fit.values[which]
        bias_B, last = bias_B + step, misfit
        if np.abs(step).max() < _CONVERGED * sd.max():
            break
    return bias_B, sd * fit.sds[which]


def beside_stale_bias(misfits: Misfits, mistake: Mistake) -> Mistake:
    """A mistake in a campaign whose stated rate bias is stale as well.

    Parameters
    ----------
    misfits : Misfits
        The telemetry and its laws.
    mistake : Mistake
        What else is wrong.

    Returns
    -------
    Mistake
        With the same changes; the bias stands in the reading that it mends to.
    """
    return replace(
        mistake,
        mend=lambda reading: with_own_bias(misfits, mistake.mend(reading)),
        words=f"{mistake.words}, and the stated rate bias is stale",
    )
