"""Series of readings, their faults, and the record of a fault: the spacecraft is not to blame.

What is done about each fault, and what lost rows cost: `docs/how_to/dirty_telemetry.md`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from bayes_inertia.maths.values import json_ready

DirtKind = Literal[
    "outliers",
    "gap",
    "stuck",
    "saturated",
    "duplicate",
    "clock",
    "quantised",
    "coloured",
    "noise_level",
]
Treatment = Literal["masked", "modelled", "ignored"]


@dataclass(frozen=True)
class Dirt:
    """One fault of the telemetry, and what was done about it.

    Parameters
    ----------
    kind : str
        What it is: "outliers", "gap", "stuck", "saturated", "duplicate" (a row sent twice, or a
        reading held), "clock", "quantised", "coloured" or "noise_level".
    channel : str
        Of the sensor, such as "rate"; "torque" of commands, "time" of stamps.
    slew : str
        Name of the slew; "" where it concerns all slews.
    rows : tuple of int
        Rows of the slew's telemetry, counted from 0; empty where it concerns all rows.
    treated : {"masked", "modelled", "ignored"}
        What was done: readings were left out, the noise was given their shape, or nothing.
    note : str, optional
        A short sentence with numbers, for people.

    Examples
    --------
    >>> Dirt("stuck", "rate", "slew_01", (7, 8), "masked").json()["rows"]
    [7, 8]
    """

    kind: DirtKind
    channel: str
    slew: str
    rows: tuple[int, ...]
    treated: Treatment
    note: str = ""

    def json(self) -> dict[str, Any]:
        """The record as `dirt` of summary.json and diagnosis.json lists it.

        Returns
        -------
        dict
            With the keys kind, channel, slew, rows, treated and note.
        """
        return json_ready(self)


@dataclass(frozen=True, eq=False)
class Series:
    """Readings of one sensor in the order of time, as every detector takes them.

    `time` (n,) [s]; `values` (n, k), NaN where there is none; `valid` (n, k): which count, those in
    the sensor's range. `sigma` (k,): stated noise, None where it is not stated. `unattainable`
    (k,): sizes that nothing passes. `limit`: the range in words. `whole`: whether a row is one
    reading, as a fix is.
    """

    time: np.ndarray
    values: np.ndarray
    valid: np.ndarray
    sigma: Sequence[float | None]
    unattainable: float | np.ndarray = np.inf
    unit: str = ""
    limit: str = ""
    whole: bool = False


@dataclass(frozen=True, eq=False)
class Fault:
    """A fault of the readings of a series that `mask` (n, k) marks; `masks`: whether they go."""

    kind: DirtKind
    mask: np.ndarray
    treated: Treatment
    note: str
    masks: bool = False

    def record(self, channel: str, slew: str) -> Dirt:
        """The record of the fault in a channel of a slew."""
        rows = tuple(np.flatnonzero(self.mask.any(axis=1)).tolist())
        return Dirt(self.kind, channel, slew, rows, self.treated, self.note)
