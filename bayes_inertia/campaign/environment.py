"""Position and magnetic field of a spacecraft whose telemetry has none, from two-line elements.

SGP4 gives the position (Vallado et al., AIAA 2006-6753), the International Geomagnetic Reference
Field the field. Inertial axes are those of SGP4 (true equator, mean equinox of date).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.limits import LIMITS
from bayes_inertia.campaign.slew import Slew, utc_of
from bayes_inertia.errors import library_of_extra, require, require_kind
from bayes_inertia.files import path_of, read_bytes, text_of

_DAY = 86_400.0  # [s]
_UNIX_DAY = 2_440_587.5  # Julian date of 1970-01-01


def with_orbit(campaign: Campaign, tle: str | Path, epoch: datetime | str) -> Campaign:
    """A campaign with position and magnetic field from two-line elements.

    Effects that need them (`magnetic_dipole`, `gravity_gradient`) and magnetometers then have them.

    Parameters
    ----------
    campaign : Campaign
        Its slews need `start` on one clock.
    tle : str or Path
        A file of two-line elements, one set or many; each slew takes the set nearest in time.
    epoch : datetime or str
        UTC at time zero of that clock, such as `"2023-09-04T14:48:23"`; also of numpy or astropy.

    Returns
    -------
    Campaign
        The same with `magnetic_field_N` [T] and `position_N` [m] in every row of every slew.

    Raises
    ------
    CampaignError
        If the file holds no elements, none is near enough in time, SGP4 finds no orbit, or the
        packages `sgp4` and `ppigrf` (the extra `orbit`) are not installed.

    Examples
    --------
    >>> from bayes_inertia.physics.small_campaign import small_campaign
    >>> with_orbit(small_campaign(), "no.tle", "2023-09-04")
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: no.tle: cannot be read ...
    """
    require_kind(campaign, Campaign, "campaign", "give a Campaign: read_campaign reads one")
    return replace(campaign, slews=slews_with_orbit(campaign.slews, tle, epoch))


def slews_with_orbit(
    slews: Sequence[Slew], tle: str | Path, epoch: datetime | str, where: str = "key epoch"
) -> tuple[Slew, ...]:
    """The same slews with position and magnetic field; `where`: who says the epoch."""
    path = path_of(tle, "tle")
    satellites = _satellites(text_of(read_bytes(path), str(path)), str(path))
    zero = utc_of(epoch, where)
    flown = []
    for slew in slews:
        utc = zero + slew.start + slew.time - slew.time[0]
        satellite = _nearest(satellites, float(utc[0]), str(path))
        position_N = _position_N(satellite, utc, str(path))
        field_N = _magnetic_field_N(position_N, utc)
        flown.append(replace(slew, position_N=position_N, magnetic_field_N=field_N))
    return tuple(flown)


def _satellites(text: str, label: str) -> Sequence[Any]:
    """Orbits of all sets of elements in a text."""
    lines = [line.rstrip() for line in text.splitlines()]
    pairs = [
        (one, two) for one, two in pairwise(lines) if one.startswith("1 ") and two.startswith("2 ")
    ]
    advice = "each set is a line that begins with 1 and a line that begins with 2"
    require(bool(pairs), label, "holds no two-line elements", advice)
    api = library_of_extra("sgp4.api", "orbit", where=label)
    return [api.Satrec.twoline2rv(one, two) for one, two in pairs]


def _nearest(satellites: Sequence[Any], utc: float, label: str) -> Any:
    """The orbit whose elements are nearest to a time [s since 1970]."""

    def age(satellite: Any) -> float:
        return float(satellite.jdsatepoch + satellite.jdsatepochF - _UNIX_DAY) * _DAY - utc

    nearest = min(satellites, key=lambda satellite: abs(age(satellite)))
    days = abs(age(nearest)) / _DAY
    what = f"the nearest elements are {days:.0f} days away from the slews"
    advice = "add elements of these days, or mend the epoch"
    require(days <= LIMITS.oldest_elements, label, what, advice)
    return nearest


def _position_N(satellite: Any, utc: np.ndarray, label: str) -> np.ndarray:
    """Position (n, 3) [m] at times (n,) [s since 1970]."""
    day = np.floor(utc / _DAY)
    error, position_km, _ = satellite.sgp4_array(day + _UNIX_DAY, utc / _DAY - day)
    what = "these elements give no orbit at the time of the slews"
    require(not np.any(error), label, what, "add elements of these days")
    return 1e3 * np.asarray(position_km)


def _magnetic_field_N(position_N: np.ndarray, utc: np.ndarray) -> np.ndarray:
    """Field (n, 3) [T] at positions (n, 3) [m] and times (n,) [s since 1970]."""
    import erfa

    day = np.floor(utc / _DAY)
    turned = erfa.gmst82(day + _UNIX_DAY, utc / _DAY - day)
    radius = np.linalg.norm(position_N, axis=1)
    from_pole = np.arccos(position_N[:, 2] / radius)
    from_equinox = np.arctan2(position_N[:, 1], position_N[:, 0])
    middle = datetime.fromtimestamp(float(np.mean(utc)), UTC).replace(tzinfo=None)
    parts = library_of_extra("ppigrf", "orbit").igrf_gc(
        radius / 1e3, np.degrees(from_pole), np.degrees(from_equinox - turned), middle
    )
    up, south, east = (1e-9 * np.ravel(part) for part in parts)  # nT
    sin_t, cos_t = np.sin(from_pole), np.cos(from_pole)
    sin_p, cos_p = np.sin(from_equinox), np.cos(from_equinox)
    axes = np.array(
        [
            [sin_t * cos_p, sin_t * sin_p, cos_t],
            [cos_t * cos_p, cos_t * sin_p, -sin_t],
            [-sin_p, cos_p, np.zeros_like(sin_p)],
        ]
    )
    return np.einsum("kn,kin->ni", np.array([up, south, east]), axes)
