"""The campaign folder that an import writes: description, tables, record, picture."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bayes_inertia.campaign.schema import FORMAT
from bayes_inertia.campaign.writer import numbered, toml_text
from bayes_inertia.importing.common_clock import Logs
from bayes_inertia.importing.mapped_lines import RECORD_FILE
from bayes_inertia.importing.mapping import rate_sensor_axes, streams_that_hold
from bayes_inertia.importing.mapping_schema import MappingPart
from bayes_inertia.importing.rest_noise import RestNoise
from bayes_inertia.importing.slew_cutting import SlewCut
from bayes_inertia.importing.slew_tables import SlewTables
from bayes_inertia.importing.written_columns import written_columns
from bayes_inertia.tables.leap_seconds import tai_to_utc
from bayes_inertia.tables.number_table import Table
from bayes_inertia.version import __version__

RECORD_FORMAT = "bayes-inertia-import/1"
PICTURE_FILE = "slews.svg"


def description_text(
    mapping: MappingPart, slews: Sequence[SlewTables], noises: Sequence[RestNoise]
) -> str:
    """The text of `campaign.toml`.

    `noises`: what the rests show; it stands in comments beside what is stated.
    """
    tracker = mapping.star_tracker
    return toml_text(
        {
            "format": FORMAT,
            "name": mapping.name,
            "inertia": mapping.inertia.model_dump(),
            "wheels": [wheel.model_dump() for wheel in mapping.wheels],
            "rate_sensor": mapping.rate_sensor.model_dump() | {"axes": rate_sensor_axes(mapping)},
            "star_tracker": None if tracker is None else tracker.model_dump(),
            "columns": _columns(mapping, slews),
            "slews": [
                _slew(tables, files)
                for tables, files in zip(slews, _file_names(mapping, slews), strict=True)
            ],
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
            if all(stream.time.regular for stream in streams_that_hold(mapping, key)):
                entries[key]["time"] = entries["time"] | {"regular": True}
    return entries


def _slew(tables: SlewTables, files: Mapping[str, str]) -> dict[str, Any]:
    window = tables.window
    return {
        "name": window.name,
        "files": dict(files),
        "start": round(tables.start, 9),
        "axis": window.axis,
        # 15 digits return the degrees that were stated.
        "angle_deg": None if window.angle_deg is None else float(f"{window.angle_deg:.15g}"),
    }


def _file_names(mapping: MappingPart, slews: Sequence[SlewTables]) -> list[dict[str, str]]:
    """For each slew the name of the table of each stream."""
    written = written_columns(mapping)
    return [
        {key: f"{slew}_{w.suffix}.csv" for key, w in written.items() if key in tables.streams}
        for slew, tables in zip(numbered(len(slews), "slew_{}"), slews, strict=True)
    ]


def tables_of(mapping: MappingPart, slews: Sequence[SlewTables]) -> dict[str, Table]:
    """The tables of all slews, by file."""
    written, made = written_columns(mapping), {}
    for tables, files in zip(slews, _file_names(mapping, slews), strict=True):
        for key, file in files.items():
            stream = tables.streams[key]
            cells = written[key].cells(stream.values).T
            columns = {"t_s": stream.time} | dict(zip(written[key].names, cells, strict=True))
            made[file] = Table(file, columns, lines=np.arange(len(stream.time)) + 2)
    return made


def raw_place(where: str, mapping: MappingPart, slews: Sequence[SlewTables]) -> str:
    """A place in a table of an import as a place in the raw logs.

    Returns: such as "wheels.csv, column RW3, in slew 1 at 12.5 s"; what is no such place stays.
    """
    file = where.partition(", ")[0]
    for tables, files in zip(slews, _file_names(mapping, slews), strict=True):
        for key in (key for key, name in files.items() if name == file):
            stream, written = tables.streams[key], written_columns(mapping)[key]
            line = re.search(r"line (\d+)", where)
            # The first line holds the names.
            moment = stream.time[int(line[1]) - 2] + tables.start if line else None
            column = where.rpartition("column ")[2]
            raw = ", ".join(stream.files[k] for k in np.unique(stream.file))
            at = "" if moment is None else f" at {moment:.6g} s"
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
    wheels = [wheel.name for wheel in mapping.wheels]
    columns = {
        wheel: name
        for stream in streams
        for wheel, name in zip(getattr(stream, "wheels", None) or wheels, stream.names, strict=True)
    }
    return columns[wheels[place]]


def record_text(
    files: Sequence[Path],
    mapping_data: tuple[str, bytes],
    logs: Logs,
    cut: SlewCut,
    noises: Sequence[RestNoise],
) -> str:
    """The record of an import: from what, and what was cut and converted."""
    record = {
        "format": RECORD_FORMAT,
        "version": __version__,
        "raw_files": {path.name: _sha256(path.read_bytes()) for path in files},
        "unused_files": list(logs.unused),
        "mapping": {
            "name": mapping_data[0],
            "sha256": _sha256(mapping_data[1]),
            "text": mapping_data[1].decode("utf-8", errors="replace"),
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


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def zero_of_clock(logs: Logs) -> str:
    """When the clock of an import was zero.

    Returns: A date in UTC, as `[[slews]]` of a mapping writes it, or that it is unknown.

    Examples
    --------
    >>> zero_of_clock(Logs({}, 2_151_144_037_250_000_000, True))
    '2026-03-02T12:00:00.25Z'
    """
    if not logs.absolute:
        return "a zero of the logs, whose date is unknown"
    ns = np.timedelta64(tai_to_utc(logs.epoch_ns), "ns")
    whole, _, part = str(np.datetime64("1958-01-01", "ns") + ns).partition(".")
    return f"{whole}.{part}".rstrip("0").rstrip(".") + "Z"


def _window(window: Any) -> dict[str, Any]:
    return {
        "name": window.name,
        "start": window.start,
        "end": window.end,
        "motion": None if window.motion is None else list(window.motion),
        "fixes": None if window.fixes is None else list(window.fixes),
        "turned_deg": None if window.turned is None else float(np.degrees(window.turned)),
    }


def _noise(noise: RestNoise) -> dict[str, Any]:
    return {
        "key": noise.key,
        "unit": noise.unit,
        "stated": None if noise.stated is None else list(noise.stated),
        "white_per_sample": [fit.white for fit in noise.fits],
        "relative_error": [fit.white_error for fit in noise.fits],
        "random_walk_per_sample": [fit.random_walk for fit in noise.fits],
        "flicker": [fit.flicker for fit in noise.fits],
        "quantisation_step": [fit.quantisation for fit in noise.fits],
        "samples": [fit.samples for fit in noise.fits],
    }
