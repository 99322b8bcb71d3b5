"""Parts of a slew that was cut, and the records that belong to each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bayes_inertia.campaign.dirt import Dirt
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.errors import CampaignError


def parts_of(slew: Slew, pieces: Sequence[dict[str, np.ndarray]]) -> list[Slew]:
    """A slew for each piece of its channels.

    `pieces`: channels (rows, width) and "time" (rows,) [s] of each piece. Returns: A single piece
    keeps the name; axis and angle of the rotation are those of a whole slew.

    Examples
    --------
    >>> whole = Slew("a", 100.0, np.arange(4.0))
    >>> later = parts_of(whole, [{"time": whole.time[:2]}, {"time": whole.time[2:]}])[1]
    >>> later.name, later.start
    ('a (part 2 of 2)', 102.0)
    """
    if not pieces:
        raise CampaignError(
            "hardly any row has a known torque",
            where=f"slews.{slew.name}",
            advice="record commands or wheel momentum without gaps, or leave the slew out",
        )
    slews = []
    for i, piece in enumerate(pieces):
        later = float(piece["time"][0] - slew.time[0])
        name = f"{slew.name} (part {i + 1} of {len(pieces)})"
        start = slew.start + later if later else slew.start
        given: dict[str, Any] = {"name": name, "start": start, **piece}
        if len(pieces) == 1:
            given |= {"name": slew.name, "axis_B": slew.axis_B, "angle": slew.angle}
        slews.append(Slew(**given))
    return slews


def located(records: Sequence[tuple[Dirt, np.ndarray]], slews: Sequence[Slew]) -> list[Dirt]:
    """Records with the names and rows of the slews that hold the times they concern.

    `records`: records and the times [s] that each concerns; none if it concerns all rows. `slews`:
    the parts of one slew; a time between two of them belongs to the nearer one. Returns: one for
    each record and each slew that it concerns.

    Examples
    --------
    >>> slew = Slew("a", 0.0, np.arange(4.0))
    >>> located([(Dirt("gap", "rate", "", (), "ignored"), np.array([1.2]))], [slew])[0].rows
    (1,)
    """
    dirt = []
    for record, times in records:
        if not len(times):
            dirt += [replace(record, slew=slew.name) for slew in slews]
            continue
        distances = np.array([_distances(slew, times) for slew in slews])
        nearest = np.argmin(distances, axis=0)
        for i in np.unique(nearest).tolist():
            time = slews[i].time
            rows = np.unique(np.searchsorted(0.5 * (time[1:] + time[:-1]), times[nearest == i]))
            dirt.append(replace(record, slew=slews[i].name, rows=tuple(rows.tolist())))
    return dirt


def _distances(slew: Slew, times: np.ndarray) -> np.ndarray:
    """From times to the telemetry of a slew [s]."""
    return np.maximum(np.maximum(slew.time[0] - times, times - slew.time[-1]), 0.0)
