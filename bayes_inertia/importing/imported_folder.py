"""The campaign folder that an import writes: columns, tables, description, record.

Units and senses are those of the mapping, as far as the campaign format knows them. So the numbers
in the tables are those of the logs, and what `doctor` says of a key of `[columns]` holds for the
same key of the mapping.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayes_inertia.campaign.schema import FORMAT, UNITS
from bayes_inertia.campaign.streams import stated_clock
from bayes_inertia.campaign.writer import numbered, toml_text
from bayes_inertia.faults.limits import LIMITS as FAULTS
from bayes_inertia.importing.common_clock import Logs
from bayes_inertia.importing.limits import LIMITS
from bayes_inertia.importing.logged_stream import LoggedStream
from bayes_inertia.importing.mapped_lines import RECORD_FILE
from bayes_inertia.importing.mapping import rate_sensor_axes, streams_that_hold
from bayes_inertia.importing.mapping_schema import (
    STREAM_TYPES,
    AttitudeStream,
    MappedStream,
    MappingPart,
    TorqueStream,
)
from bayes_inertia.importing.rest_noise import RestNoise
from bayes_inertia.importing.slew_cutting import SlewCut, SlewWindow
from bayes_inertia.importing.unit_factors import unit_factor
from bayes_inertia.maths.values import picked
from bayes_inertia.sealing import sha256_of
from bayes_inertia.tables.stamp_parts import tai_to_utc
from bayes_inertia.tables.table import Table
from bayes_inertia.version import __version__


@dataclass(frozen=True)
class WrittenColumns:
    """Entry of one stream."""

    names: tuple[str, ...]  # The columns
    sense: dict[str, str]  # Unit and sense, as its entry in `[columns]` states them
    order: tuple[int, ...]  # Which element of the stream stands in each column
    factors: tuple[float, ...]  # What each column is multiplied by


def written_columns(mapping: MappingPart) -> dict[str, WrittenColumns]:
    """Entries of all streams that a mapping may have, by the key of `[columns]`."""
    return {
        key: _attitude(streams) if kind is AttitudeStream else _readings(key, streams, mapping)
        for key, kind in STREAM_TYPES.items()
        for streams in [streams_that_hold(mapping, key)]
    }


def _readings(key: str, streams: Sequence[MappedStream], mapping: MappingPart) -> WrittenColumns:
    """Columns in the unit and sense that the mapping states, as far as its streams agree."""
    kind, unit = STREAM_TYPES[key], _unit(key, streams)
    names = kind.columns
    if kind.of_wheels():
        names = tuple(names[0].format(k + 1) for k in range(len(mapping.wheels)))
    on_body = {s.acts_on for s in streams if isinstance(s, TorqueStream)} == {"body"}
    sense = {"unit": unit, **kind.sense, **({"acts_on": "body"} if on_body else {})}
    factor = (-1.0 if on_body else 1.0) / UNITS[key][unit]
    return WrittenColumns(names, sense, tuple(range(len(names))), (factor,) * len(names))


def _unit(key: str, streams: Sequence[MappedStream]) -> str:
    """The unit that the mapping states, spelled as the campaign format does; else SI."""
    stated = {getattr(stream, "unit", "") for stream in streams}
    si = next(iter(UNITS[key]))
    if len(stated) != 1 or "" in stated:
        return si
    factor = unit_factor(key, stated.pop())
    known = (unit for unit, size in UNITS[key].items() if math.isclose(size, factor, rel_tol=1e-9))
    return next(known, si)


def _attitude(streams: Sequence[MappedStream]) -> WrittenColumns:
    """Quaternions of the body with the scalar and the direction that the mapping states."""
    of_body = next((stream for stream in streams if getattr(stream, "frame", "") == "body"), None)
    scalar = getattr(of_body, "scalar", None) or "last"
    maps = getattr(of_body, "maps", None) or "inertial_to_body"
    first = scalar == "first"
    order = (3, 0, 1, 2) if first else (0, 1, 2, 3)
    names = ("q0", "q1", "q2", "q3") if first else AttitudeStream.columns
    sign = -1.0 if maps == "body_to_inertial" else 1.0
    factors = tuple(1.0 if element == 3 else sign for element in order)
    return WrittenColumns(names, {"scalar": scalar, "maps": maps}, order, factors)


@dataclass(frozen=True)
class SlewTables:
    """One slew, ready to be written."""

    window: SlewWindow  # The part of the log
    start: float  # Time of its first reading on the clock of the import [s]
    # Readings of the slew with times from its start, by what they hold
    streams: dict[str, LoggedStream]
    files: dict[str, str]  # Names of their tables


def tables_of_slews(
    windows: Sequence[SlewWindow], streams: dict[str, LoggedStream], mapping: MappingPart
) -> list[SlewTables]:
    """The readings of all slews."""
    named = zip(windows, numbered(len(windows), "slew_{}"), strict=True)
    return [_slew_tables(window, name, streams, mapping) for window, name in named]


def _slew_tables(
    window: SlewWindow, name: str, streams: dict[str, LoggedStream], mapping: MappingPart
) -> SlewTables:
    """The readings of one slew from its start on, with the command in force when it begins."""
    inside = {key: stream.between(window.start, window.end) for key, stream in streams.items()}
    inside = {key: stream for key, stream in inside.items() if len(stream.time)}
    start = min(float(stream.time[0]) for stream in inside.values())
    if "wheel_torque" in streams:
        torque = streams["wheel_torque"]
        if _is_regular(mapping, "wheel_torque"):
            torque = _at_regular_times(torque, start, window)
        inside["wheel_torque"] = _from_start(torque, start, window.end)
    from_start = {
        key: replace(stream, time=np.round(stream.time - start, LIMITS.decimals_of_time))
        for key, stream in inside.items()
        if len(stream.time)
    }
    of_kinds = ((key, kind.suffix) for key, kind in STREAM_TYPES.items() if key in from_start)
    files = {key: f"{name}_{suffix}.csv" for key, suffix in of_kinds}
    return SlewTables(window, start, from_start, files)


def _is_regular(mapping: MappingPart, key: str) -> bool:
    return all(stream.time.regular for stream in streams_that_hold(mapping, key))


def _at_regular_times(torque: LoggedStream, start: float, window: SlewWindow) -> LoggedStream:
    """Commands at the times of the regular clock that they have in a slew.

    The command in force at its start stands on no clock.
    """
    rows = (torque.time >= start) & (torque.time <= window.end)
    if rows.sum() < FAULTS.fewest_stamps:
        return torque
    time = torque.time.copy()
    clock = stated_clock(time[rows], "s", f"{', '.join(torque.files)}, in {window.name}")
    time[rows] = np.clip(clock, start, window.end)
    return replace(torque, time=time)


def _from_start(torque: LoggedStream, start: float, end: float) -> LoggedStream:
    """Commands of a slew, the first of which is the one in force at its start."""
    later = torque.between(start, end)
    before = torque.time[torque.time < start]
    # Of commands at every step none that is older is in force: they were lost.
    none_in_force = later.time[0] == start if len(later.time) else _at_every_step(torque)
    if not len(before) or none_in_force:
        return later
    return replace(torque.between(before[-1], end), time=np.concatenate([[start], later.time]))


def _at_every_step(torque: LoggedStream) -> bool:
    steps = np.diff(torque.time)
    few = len(steps) < LIMITS.fewest_alike_steps
    return not few and bool(np.quantile(steps, LIMITS.most_alike_steps) < 1.5 * torque.step)


RECORD_FORMAT = "bayes-inertia-import/1"
PICTURE_FILE = "slews.svg"


def description_text(
    mapping: MappingPart, slews: Sequence[SlewTables], noises: Sequence[RestNoise], logs: Logs
) -> str:
    """The text of `campaign.toml`, with what the rests show in comments."""
    tracker = mapping.star_tracker
    return toml_text(
        {
            "format": FORMAT,
            "name": mapping.name,
            "mission": {"epoch": zero_of_clock(logs)} if logs.absolute else None,
            "inertia": mapping.inertia.model_dump(),
            "wheels": [wheel.model_dump() for wheel in mapping.wheels],
            "rate_sensor": mapping.rate_sensor.model_dump() | {"axes": rate_sensor_axes(mapping)},
            "star_tracker": None if tracker is None else tracker.model_dump(),
            "columns": _columns(mapping, slews),
            "slews": [_slew(tables) for tables in slews],
        },
        f"Written by bayes-inertia import; {RECORD_FILE} says from what.",
        {noise.key: f"seen at rest: {noise.toml()} {noise.unit}" for noise in noises},
    )


def _columns(mapping: MappingPart, slews: Sequence[SlewTables]) -> dict[str, Any]:
    held = {key for tables in slews for key in tables.streams}
    entries: dict[str, Any] = {"time": {"names": ["t_s"], "unit": "s"}}
    for key, written in written_columns(mapping).items():
        if key in held:
            entries[key] = {"names": list(written.names), **written.sense}
            if key != "wheel_torque" and _is_regular(mapping, key):
                entries[key]["time"] = entries["time"] | {"regular": True}
    return entries


def _slew(tables: SlewTables) -> dict[str, Any]:
    window = tables.window
    return {
        "name": window.name,
        "files": tables.files,
        "start": round(tables.start, 9),
        "axis": window.axis,
        # 15 digits return the degrees that were stated.
        "angle_deg": None if window.angle_deg is None else float(f"{window.angle_deg:.15g}"),
    }


def tables_of(mapping: MappingPart, slews: Sequence[SlewTables]) -> dict[str, Table]:
    """The tables of all slews, by file."""
    written, made = written_columns(mapping), {}
    for tables in slews:
        for key, file in tables.files.items():
            stream, entry = tables.streams[key], written[key]
            cells = stream.values[:, list(entry.order)] * np.array(entry.factors)
            columns = {"t_s": stream.time} | dict(zip(entry.names, cells.T, strict=True))
            made[file] = Table.of(file, columns)
    return made


def raw_place(where: str, mapping: MappingPart, slews: Sequence[SlewTables]) -> str:
    """A place in a table as one in the raw logs: "wheels.csv, column RW3, in slew 1 at 12.5 s"."""
    file = where.partition(", ")[0]
    for tables in slews:
        for key in (key for key, name in tables.files.items() if name == file):
            stream, written = tables.streams[key], written_columns(mapping)[key]
            line = re.search(r"line (\d+)", where)
            # The first line holds the names.
            at = f" at {stream.time[int(line[1]) - 2] + tables.start:.6g} s" if line else ""
            column = where.rpartition("column ")[2]
            raw = ", ".join(stream.files[k] for k in np.unique(stream.file))
            name = _raw_column(mapping, key, column, written.names)
            many = "s" * (", " in name)
            return f"{raw}, column{many} {name}, in {tables.window.name}{at}"
    return where


def _raw_column(mapping: MappingPart, key: str, column: str, written: Sequence[str]) -> str:
    """The column of the raw logs that a written one comes from; all of the stream for fixes."""
    streams = streams_that_hold(mapping, key)
    place = written.index(column) if column in written else None
    if place is None or key == "attitude":
        return ", ".join(dict.fromkeys(name for stream in streams for name in stream.names))
    if not key.startswith("wheel"):
        return streams[0].names[place]
    wheel = mapping.wheels[place].name
    own = next(stream for stream in streams[::-1] if wheel in mapping.wheels_of(stream))
    return own.names[mapping.wheels_of(own).index(wheel)]


def record_text(
    files: list[Path], mapping: tuple[str, bytes], logs: Logs, cut: SlewCut, noises: list[RestNoise]
) -> str:
    """The record of an import: from what, and what was cut and converted."""
    record = {
        "format": RECORD_FORMAT,
        "version": __version__,
        "raw_files": {path.name: sha256_of(path.read_bytes()) for path in files},
        "unused_files": list(logs.unused),
        "mapping": {
            "name": mapping[0],
            "sha256": sha256_of(mapping[1]),
            "text": mapping[1].decode("utf-8", errors="replace"),
        },
        "clock": {"zero": zero_of_clock(logs), "unit": "s"},
        "streams": {
            key: {
                "files": list(stream.files),
                "readings": len(stream.time),
                "median_step_s": stream.step,
                "span_s": [float(stream.time[0]), float(stream.time[-1])],
                "notes": list(stream.notes),
            }
            for key, stream in logs.streams.items()
        },
        "cut": {
            "by": cut.by,
            "thresholds_radps": None if cut.scan is None else [cut.scan.low, cut.scan.high],
            "slews": [_window(window) for window in cut.windows],
            "dropped": [vars(part) for part in cut.dropped],
        },
        "noise_at_rest": [_noise(noise) for noise in noises],
    }
    return json.dumps(record, indent=1, allow_nan=False) + "\n"


def zero_of_clock(logs: Logs) -> str:
    """When the clock of an import was zero: a date in UTC, or that it is unknown.

    >>> zero_of_clock(Logs({}, 2_151_144_037_250_000_000, True))
    '2026-03-02T12:00:00.25Z'
    """
    if not logs.absolute:
        return "a zero of the logs, whose date is unknown"
    ns = np.timedelta64(tai_to_utc(logs.epoch_ns), "ns")
    whole, _, part = str(np.datetime64("1958-01-01", "ns") + ns).partition(".")
    return f"{whole}.{part}".rstrip("0").rstrip(".") + "Z"


def _window(window: SlewWindow) -> dict[str, Any]:
    turned = None if window.turned is None else float(np.degrees(window.turned))
    return picked(window, "name", "start", "end", "motion", "fixes") | {"turned_deg": turned}


def _noise(noise: RestNoise) -> dict[str, Any]:
    return picked(noise, "key", "unit", "stated") | {
        "white_per_sample": [fit.white for fit in noise.fits],
        "relative_error": [fit.white_error for fit in noise.fits],
        "random_walk_per_sample": [fit.random_walk for fit in noise.fits],
        "flicker": [fit.flicker for fit in noise.fits],
        "quantisation_step": [fit.quantisation for fit in noise.fits],
        "samples": [fit.samples for fit in noise.fits],
    }
