"""Leap seconds: UTC on the continuous scale of TAI."""

from __future__ import annotations

from functools import cache

import numpy as np

SECOND = 10**9  # [ns]
_MJD_1958 = 36204


@cache
def leap_table() -> tuple[np.ndarray, np.ndarray]:
    """When TAI - UTC changed, from the file that comes with astropy: no network is asked.

    Returns
    -------
    start_ns : (changes,) array of int
        UTC nanoseconds since 1958, a day counted as 86400 s, from which the offset holds.
    offset_ns : (changes,) array of int
        TAI - UTC [ns].
    """
    import warnings

    from astropy.utils import iers

    with warnings.catch_warnings(), iers.conf.set_temp("auto_download", False):
        # An old table is still right for all seconds that it lists.
        warnings.simplefilter("ignore")
        table = iers.LeapSeconds.open(iers.IERS_LEAP_SECOND_FILE)
    days = np.asarray(table["mjd"], dtype=np.int64) - _MJD_1958
    return days * (86400 * SECOND), np.asarray(table["tai_utc"], dtype=np.int64) * SECOND


def utc_to_tai(utc_ns: np.ndarray) -> np.ndarray:
    """UTC on the scale of TAI.

    Parameters
    ----------
    utc_ns : (rows,) array of int
        Nanoseconds since 1958 of UTC, a day counted as 86400 s, from 1972 on.

    Returns
    -------
    (rows,) array of int
        Nanoseconds of TAI since 1958-01-01T00:00:00 TAI.

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
    """A moment of TAI on the scale of UTC.

    Parameters
    ----------
    tai_ns : int
        Nanoseconds of TAI since 1958-01-01T00:00:00 TAI.

    Returns
    -------
    int
        Nanoseconds since 1958 of UTC, a day counted as 86400 s.

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
    """Whether a UTC day ends with a second 23:59:60.

    Parameters
    ----------
    day_end_ns : int
        The midnight after it, UTC nanoseconds since 1958.

    Returns
    -------
    bool
        True on days such as 2016-12-31.
    """
    start, _ = leap_table()
    return bool(np.isin(day_end_ns, start[1:]))
