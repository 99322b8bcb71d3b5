"""What is wrong with telemetry although the spacecraft is not to blame: a record of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

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
        What it is: "outliers", "gap", "stuck", "saturated", "duplicate", "clock", "quantised",
        "coloured" or "noise_level".
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
