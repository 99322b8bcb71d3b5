"""Series of readings, their faults, and the record of a fault: the spacecraft is not to blame.

What reading a campaign does about each fault:

| Fault | Policy | Record |
|---|---|---|
| row sent twice, or in parts | one row a time; cells are joined | duplicate, masked |
| reading that only repeats the one before, of a slow sensor that was polled faster | counted \
once, at the first of its rows | duplicate of rate, attitude or momentum, masked |
| one time with two contents | error that names the row | |
| rows out of order | put in their place | clock, ignored |
| single wrong stamp | given the time between its neighbours if they are two steps apart | clock, \
modelled |
| single wrong stamp beside a gap | the row is left out | clock, masked |
| few stamps an hour and 100 durations away from the others | the rows are left out | clock, \
masked |
| more such stamps | error that names the first row | |
| clock set back for more than a row | error that names the row and the size | |
| clock set forward | looks like a gap | gap |
| rounded stamps (32 bits, few digits) that a regular clock fits within their resolution | the \
clock's times are taken | clock, modelled |
| times of 32 bits too coarse for their spacing, no such clock | error | |
| stamps jitter, readings show that sampling does not, or `regular = true` | the regular clock's \
times are taken | clock, modelled |
| stamps jitter, nothing decides, or sampling does too | kept; said by how much | clock, ignored |
| empty cell, "nan" | no reading; every vector but the rate as a whole | |
| infinite value | error that names the row and the column | |
| rate axis or wheel without any reading | error that names the column | |
| rate above 1000 rad/s, momentum above 100 times the wheel's limit | masked | outliers, masked |
| a few commands above 100 times the wheel's limit | unknown: a gap | outliers of torque, masked |
| reading at the sensor's range | masked | saturated, masked |
| same value to the last digit for longer than noise explains (less than once in a million slews) \
| the whole run is masked | stuck, masked |
| steps larger than the stated noise | kept; held by the noise if that is step / sqrt(12) or more \
| quantised, modelled or ignored |
| gap in rates or tachometers | kept: the motion is integrated across it | gap, ignored |
| command of one wheel is missing | the commands of that row are unknown: a gap | |
| gap in commands, same command before and after | the command is held | |
| gap in commands of 1 to 3 rows among smooth commands | a cubic fills it if all these errors \
together are less than what rates and star tracker tell | gap of torque, modelled |
| gap in commands, every wheel with tachometer | the slew's commands are left out: measured \
momentum drives the model | gap of torque, masked |
| gap in commands, no tachometers | what the wheels did there is integrated out, the slew stays \
whole | gap of torque, modelled |
| more than 48 gaps in the commands of a slew, no tachometers | the slew is cut there, each part \
has its own start | gap of torque, masked |
| gap in the tachometers that drive the model while the torque turns | the slew is cut there | gap \
of momentum, masked |
| rows before the first command | left out if they are few; else as a gap in commands | gap of \
torque, masked |

What 2 % lost rows cost (`basilisk/clean_varied`, closed loop with noise of 1.5e-5 N m at 4 Hz; and
three simulated slews whose commands are smooth):

| Commands | Tachometers | Slews become | sd of J and K grows by | Shift, in quoted sd |
|---|---|---|---|---|
| noisy | yes | 5 -> 6 | 1.02 to 1.5 | 0.1 to 1.3 |
| noisy | no | 5 -> 5 | J 1.4 to 1.9, K 1.05 to 1.10 (cut into 49: 7 to 100) | 0.0 to 2.6 |
| smooth | yes or no | 3 -> 3, filled (20 parts if cut) | 1.01 | 0.0 to 0.32 |
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

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
        "rate", "attitude", "momentum", "torque" or "time".
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
        return {
            "kind": self.kind,
            "channel": self.channel,
            "slew": self.slew,
            "rows": list(self.rows),
            "treated": self.treated,
            "note": self.note,
        }


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

    @property
    def rows(self) -> np.ndarray:
        """Rows (m,) that hold a reading."""
        return np.flatnonzero(np.isfinite(self.values).any(axis=1))


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
