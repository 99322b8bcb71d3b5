"""What `design` is asked for, in the words of a command line: degrees, texts, files."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.design.limits import KeepOut, Limits
from bayes_inertia.errors import CampaignError


@dataclass(frozen=True)
class DesignRequest:
    """What `design` is asked for; None where nothing was asked.

    Parameters
    ----------
    goal : str
        Name of the goal.
    slews : int
        How many.
    total_time : float or None
        From first to last telemetry [s].
    max_rate : float or None
        Largest true rate [deg/s].
    max_angle : float or None
        Largest angle of a slew [deg].
    max_acceleration : float or None
        Largest angular acceleration [deg/s^2].
    end_attitude : str or None
        "q1,q2,q3,q4", scalar last.
    keep_out : tuple of str
        Cones or files of cones, see `keep_outs`.
    after : bool
        Whether the campaign's telemetry counts.
    seed : int
        Of the search.
    effects : tuple of str
        Names of effects that are fitted along.
    """

    goal: str = "cross_terms"
    slews: int = 5
    total_time: float | None = None
    max_rate: float | None = None
    max_angle: float | None = None
    max_acceleration: float | None = None
    end_attitude: str | None = None
    keep_out: tuple[str, ...] = ()
    after: bool = False
    seed: int = 0
    effects: tuple[str, ...] = ()

    def limits(self, campaign: Campaign) -> Limits:
        """The limits that are asked for; the largest rate is the campaign's own where none is
        given.
        """
        usual = Limits()
        own_rate = campaign.largest_rate() / (1.0 - usual.rate_reserve)
        return Limits(
            rate=_radians(self.max_rate, own_rate),
            angle=_radians(self.max_angle, usual.angle),
            acceleration=_radians(self.max_acceleration, usual.acceleration),
            total_time=self.total_time,
            end_attitude=_quaternion(self.end_attitude),
            keep_out=keep_outs(self.keep_out),
        )


def _radians(degrees: float | None, otherwise: float | None) -> Any:
    return otherwise if degrees is None else math.radians(degrees)


def _quaternion(text: str | None) -> tuple[float, float, float, float] | None:
    if text is None:
        return None
    try:
        q1, q2, q3, q4 = (float(part) for part in text.split(","))
    except ValueError:
        raise CampaignError(
            f"{text!r} is no quaternion",
            where="end_attitude",
            advice="give q1,q2,q3,q4, scalar last",
        ) from None
    return q1, q2, q3, q4


def keep_outs(texts: Sequence[str]) -> tuple[KeepOut, ...]:
    """Keep-out cones from texts or files.

    `texts`: each `name,x,y,z,half_angle_deg` (inertial direction), or a TOML file with [[keep_out]]
    tables of the keys name, direction_N, half_angle_deg.

    Examples
    --------
    >>> keep_outs(["Sun,1,0,0,30"])[0].name
    'Sun'
    """
    cones: list[KeepOut] = []
    for text in texts:
        cones += _cones_in(Path(text)) if Path(text).is_file() else [_cone(text)]
    return tuple(cones)


def _cone(text: str) -> KeepOut:
    name, *numbers = (part.strip() for part in text.split(","))
    try:
        x, y, z, angle = (float(number) for number in numbers)
    except ValueError:
        raise CampaignError(
            "neither a file nor name,x,y,z,half_angle_deg",
            where=f"keep-out {text!r}",
            advice="write for example Sun,0.8,0.5,0.3,35",
        ) from None
    return KeepOut(name, (x, y, z), math.radians(angle))


def _cones_in(path: Path) -> list[KeepOut]:
    advice = 'write [[keep_out]] with name = "Sun", direction_N = [x, y, z], half_angle_deg = 35'
    try:
        cones = []
        for table in tomllib.loads(path.read_text())["keep_out"]:
            x, y, z = (float(component) for component in table["direction_N"])
            cones.append(KeepOut(table["name"], (x, y, z), math.radians(table["half_angle_deg"])))
        return cones
    except KeyError as error:
        missing = f"the key {error.args[0]} is missing"
        raise CampaignError(missing, where=str(path), advice=advice) from error
    except (TypeError, ValueError, RecursionError) as error:
        raise CampaignError(
            f"no keep-out cones: {error}", where=str(path), advice=advice
        ) from error
