"""Leap seconds: UTC on the continuous scale of TAI."""

from __future__ import annotations

from functools import cache

import numpy as np

SECOND = 10**9  # [ns]
_MJD_1958 = 36204


@cache
def leap_table() -> tuple[np.ndarray, np.ndarray]:
    """UTC [ns since 1958] at each change of TAI - UTC [ns], and that, (changes,), of astropy."""
    import warnings

    from astropy.utils import iers

    with warnings.catch_warnings(), iers.conf.set_temp("auto_download", False):
        # An old table is still right for all seconds that it lists.
        warnings.simplefilter("ignore")
        table = iers.LeapSeconds.open(iers.IERS_LEAP_SECOND_FILE)
    days = np.asarray(table["mjd"], dtype=np.int64) - _MJD_1958
    return days * (86400 * SECOND), np.asarray(table["tai_utc"], dtype=np.int64) * SECOND


def utc_to_tai(utc_ns: np.ndarray) -> np.ndarray:
    """TAI of UTC from 1972 on, (rows,) array of ns since 1958 each; a day of UTC has 86400 s.

    Examples
    --------
    >>> new_year = np.array([21550 * 86400 * SECOND])  # 2017-01-01
    >>> ((utc_to_tai(new_year) - utc_to_tai(new_year - 1)) / SECOND).round(6).tolist()
    [1.0]
    """
    start, offset = leap_table()
    held = np.searchsorted(start, utc_ns, side="right") - 1
    return utc_ns + np.where(held >= 0, offset[np.maximum(held, 0)], 0)


def tai_to_utc(tai_ns: int) -> int:
    """UTC of TAI [ns since 1958]; a day of UTC has 86400 s.

    Examples
    --------
    >>> moment = 21550 * 86400 * SECOND
    >>> tai_to_utc(int(utc_to_tai(np.array(moment)))) == moment
    True
    """
    start, offset = leap_table()
    held = int(np.searchsorted(start + offset, tai_ns, side="right")) - 1
    return tai_ns - (int(offset[held]) if held >= 0 else 0)


def has_leap_second(day_end_ns: int) -> bool:
    """Whether the UTC day before this midnight [ns since 1958] ends with a second 23:59:60."""
    start, _ = leap_table()
    return bool(np.isin(day_end_ns, start[1:]))
