"""Groups of star-tracker fixes: runs without a gap, usually one before and one after each slew."""

from __future__ import annotations

import numpy as np

from bayes_inertia.campaign.slew import Slew

# Two fixes further apart than this share of the slew, or than so many usual spacings, are of two
# groups.
_OF_SLEW, _SPACINGS = 0.1, 5.0


def fix_groups(slew: Slew) -> np.ndarray:
    """The group of every star-tracker fix.

    Returns (fixes,): numbers of groups from 0, in the order of time; empty without fixes.

    Examples
    --------
    >>> attitude = np.tile([0.0, 0.0, 0.0, 1.0], (90, 1))
    >>> attitude[2:88] = np.nan
    >>> fix_groups(Slew("a", 0.0, np.arange(90.0), attitude=attitude)).tolist()
    [0, 0, 1, 1]
    """
    time = slew.time[slew.fixes]
    if not len(time):
        return np.zeros(0, dtype=int)
    steps = np.diff(time)
    usual = float(np.median(steps)) if len(steps) else 0.0
    apart = (steps > _OF_SLEW * slew.duration) | (steps > _SPACINGS * usual)
    return np.concatenate([[0], np.cumsum(apart)])
