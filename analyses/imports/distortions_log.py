"""Raw logs of the example that can be distorted: streams, their mapping, and how they are written.

A log holds four streams in SI units with true stamps. A distortion changes readings, stamps, the
clock that writes them, the files or what the mapping says; `write` then makes files and mapping.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from analyses.imports.conventions_folder import read_raw
from analyses.imports.formats import EXAMPLE, channels_of
from analyses.imports.formats_base import utc_texts
from bayes_inertia.campaign.reader import read_campaign

FIRST = np.datetime64("2026-03-01T12:00:00", "ns")
HOLDS = ("rate", "wheel_torque", "wheel_momentum", "attitude")
# Digits of a reading and of a stamp in a text file.
_DIGITS, _STAMP_DIGITS = 9, 6

Cells = np.ndarray
Columns = dict[str, Cells]
Clock = Callable[[np.ndarray], tuple[Columns, dict[str, Any]]]


@dataclass(frozen=True, eq=False)
class Stream:
    """One stream: what it holds, and the entries of its `[[streams]]` beside files and time."""

    file: str  # stem of its file
    time: np.ndarray  # (rows,) stamps [s]
    values: np.ndarray  # (rows, width) readings; NaN where there is none
    names: tuple[str, ...]  # its columns
    sense: Mapping[str, Any]  # unit, frame and the like
    # What stands in a row without a reading, one cell a column; empty cells by default.
    mark: tuple[str, ...] = ()
    repeats: int = 1  # how often each reading stands

    def taking(self, rows: np.ndarray) -> Stream:
        """Some of its rows."""
        return replace(self, time=self.time[rows], values=self.values[rows])

    @property
    def readings(self) -> int:
        """Rows with a reading."""
        return int(np.isfinite(self.values).any(axis=1).sum())

    def cells(self) -> Columns:
        """Its columns as texts."""
        texts = np.array([[f"{v:.{_DIGITS}g}" for v in row] for row in self.values.tolist()])
        empty = np.isnan(self.values)
        texts = np.where(empty, np.array(self.mark or ("",) * len(self.names)), texts)
        return {name: texts[:, k] for k, name in enumerate(self.names)}


@dataclass(frozen=True, eq=False)
class RawLog:
    """All streams, and what is not about them."""

    streams: Mapping[str, Stream]  # by what they hold
    hardware: Mapping[str, Any]  # the mapping without streams
    clock: Clock  # writes stamps: columns, and the entry `time` of the mapping
    # Writes the files: of (log, folder) the paths and, by stream, the entries of the mapping.
    write: Callable[[RawLog, Path], tuple[list[Path], dict[str, dict[str, Any]]]]
    started: bool = False  # whether the mapping is proposed by `--start`, its questions answered
    more: Mapping[str, Any] = field(default_factory=dict)  # other tables of the mapping
    locked: bool = False  # whether the writer of the files holds them

    def changed(self, holds: str, **changes: Any) -> RawLog:
        """The log with another stream."""
        return replace(
            self, streams={**self.streams, holds: replace(self.streams[holds], **changes)}
        )

    def stating(self, holds: str, **entries: Any) -> RawLog:
        """The log with other words of a stream in the mapping."""
        return self.changed(holds, sense={**self.streams[holds].sense, **entries})

    def table(self, holds: str) -> Columns:
        """The columns of a stream, stamps first."""
        stream = self.streams[holds]
        return {**self.clock(stream.time)[0], **stream.cells()}


def seconds_clock(time: np.ndarray) -> tuple[Columns, dict[str, Any]]:
    """Seconds from a zero that all streams share."""
    texts = np.array([f"{t:.{_STAMP_DIGITS}f}".rstrip("0") + "0" for t in time.tolist()])
    return {"t": texts}, {"names": ["t"], "kind": "s", "epoch": "campaign"}


def utc_clock(time: np.ndarray) -> tuple[Columns, dict[str, Any]]:
    """Dates."""
    return {"utc": np.char.add(utc_texts(time, FIRST), "Z")}, {"names": ["utc"], "kind": "utc"}


def csv_text(columns: Columns, delimiter: str = ",", tail: str = "") -> str:
    """A table; `tail` ends the line of names alone."""
    rows = zip(*(cells.tolist() for cells in columns.values()), strict=True)
    lines = [delimiter.join(columns) + tail, *(delimiter.join(row) for row in rows)]
    return "\n".join(lines) + "\n"


def a_file_each(log: RawLog, folder: Path) -> tuple[list[Path], dict[str, dict[str, Any]]]:
    """Each stream a CSV file."""
    files, entries = [], {}
    for holds, stream in log.streams.items():
        files.append(folder / f"{stream.file}.csv")
        files[-1].write_text(csv_text(log.table(holds)), encoding="utf-8")
        entries[holds] = {"files": [files[-1].name], "time": log.clock(stream.time)[1]}
    return files, entries


def example_log() -> RawLog:
    """The example campaign, undistorted."""
    described, log = read_raw(EXAMPLE).description, channels_of(read_campaign(EXAMPLE))
    hardware = {key: described[key] for key in ("inertia", "wheels", "rate_sensor", "star_tracker")}
    hardware["rate_sensor"] = {k: v for k, v in hardware["rate_sensor"].items() if k != "axes"}
    fixed = log.fixed
    sense = {"form": "quaternion", "scalar": "last", "maps": "inertial_to_body", "frame": "body"}
    t, w = log.time, {"unit": "rad/s", "frame": "body"}
    u, h = {"unit": "N m", "acts_on": "wheel"}, {"unit": "N m s", "relative_to": "body"}
    streams = {
        "rate": Stream("gyro", t, log.rate, ("wx", "wy", "wz"), w),
        "wheel_torque": Stream("trq", t, log.torque, ("u1", "u2", "u3"), u),
        "wheel_momentum": Stream("mom", t, log.momentum, ("h1", "h2", "h3"), h),
        "attitude": Stream("st", t[fixed], log.attitude[fixed], ("q1", "q2", "q3", "q4"), sense),
    }
    return RawLog(streams, hardware, seconds_clock, a_file_each)


def mapping_text(log: RawLog, entries: Mapping[str, Mapping[str, Any]]) -> str:
    """The mapping that a user writes."""
    streams = []
    for holds, stream in log.streams.items():
        said = {"holds": holds, **entries[holds], "names": list(stream.names), **stream.sense}
        said["holds"] = said.pop("as", holds)
        streams.append(said)
    head = {"format": "bayes-inertia-mapping/1", "name": "distorted"}
    return tomlkit.dumps({**head, **log.more, **log.hardware, "streams": streams})


def answered(text: str, log: RawLog, entries: Mapping[str, Mapping[str, Any]]) -> str:
    """A mapping that `--start` proposed, its questions answered and nothing else changed."""
    proposed = tomlkit.parse(text).unwrap()
    for stream in proposed["streams"]:
        holds = "wheel_momentum" if stream["holds"] == "wheel_speed" else stream["holds"]
        known = {**log.streams[holds].sense, **entries[holds]}
        for key in [key for key, value in stream.items() if value == "?"]:
            stream[key] = known[key]
        for key in [key for key, value in stream["time"].items() if value == "?"]:
            stream["time"][key] = known["time"][key]
        if stream["time"]["kind"] in ("s", "ms", "us"):
            stream["time"]["epoch"] = "campaign"
    return tomlkit.dumps({**proposed, **log.more, **log.hardware})
