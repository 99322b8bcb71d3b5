"""From raw files and a mapping to a campaign folder: the whole way."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from bayes_inertia.campaign.block_means import reduced
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.reader import campaign_of
from bayes_inertia.campaign.sensors import BY_KEY
from bayes_inertia.campaign.writer import content_of, files_of
from bayes_inertia.errors import CampaignError, OutputError, members, require
from bayes_inertia.faults.held import held_readings
from bayes_inertia.faults.impossible import no_readings
from bayes_inertia.faults.known_offsets import known_offset
from bayes_inertia.faults.limits import LIMITS as FAULTS
from bayes_inertia.files import path_of, read_bytes, text_of, write_new_files
from bayes_inertia.importing import imported_folder, mapped_lines
from bayes_inertia.importing.common_clock import Logs
from bayes_inertia.importing.cut_picture import cut_picture
from bayes_inertia.importing.limits import LIMITS
from bayes_inertia.importing.log_reader import read_logs
from bayes_inertia.importing.logged_stream import LoggedStream
from bayes_inertia.importing.mapping import parse_mapping, streams_that_hold
from bayes_inertia.importing.mapping_schema import MappingPart
from bayes_inertia.importing.rest_noise import RestNoise, rest_noise
from bayes_inertia.importing.slew_cutting import SlewCut, cut_into_slews
from bayes_inertia.progress import Progress, silent
from bayes_inertia.tables.stamp_parts import SECOND
from bayes_inertia.tables.table import Table
from bayes_inertia.tables.time_stamps import COUNTED_CLOCKS, moved_s


@dataclass(frozen=True)
class ImportedCampaign:
    """A campaign folder that was written from raw logs; it can be used as its path.

    Parameters
    ----------
    folder : Path
        The folder.
    logs : Logs
        The streams that were read, each reading once.
    cut : SlewCut
        The slews, and what was left out.
    noises : tuple of RestNoise
        What the rests show.
    campaign : Campaign
        The campaign as it reads back; its `dirt` says what of the telemetry is faulty.
    """

    folder: Path
    logs: Logs
    cut: SlewCut
    noises: tuple[RestNoise, ...]
    campaign: Campaign

    def __fspath__(self) -> str:
        return str(self.folder)


def import_logs(
    files: Sequence[str | Path],
    mapping: str | Path,
    folder: str | Path,
    *,
    progress: Progress | None = None,
) -> ImportedCampaign:
    """Write a campaign folder from raw logs.

    Parameters
    ----------
    files : sequence of str or Path
        The raw files, in any order; one alone may stand for itself.
    mapping : str or Path
        The `mapping.toml` that says what they hold.
    folder : str or Path
        Where the campaign goes; made if absent. Nothing in it is overwritten.
    progress : callable or None, optional
        Called with (stage, done, of); `of` is 0 where a stage is not counted.

    Returns
    -------
    ImportedCampaign
        What was written, and what was seen on the way.

    Raises
    ------
    CampaignError
        If the mapping has an open question or says something that the files contradict, if a file
        cannot be read, or if a noise is stated nowhere; the error then quotes the noise at rest.
    OutputError
        If the folder holds another campaign, or cannot be written.

    Examples
    --------
    The files are yours, so this is no doctest::

        imported = import_logs(["tm.csv"], "mapping.toml", "my_campaign")
        imported.campaign.name, len(imported.campaign.slews)
    """
    say = progress or silent
    paths = sorted({path_of(file, "key files") for file in _listed(files)})
    mapping, folder = path_of(mapping, "key mapping"), path_of(folder, "key folder")
    label, data = str(mapping), read_bytes(mapping)
    parsed = parse_mapping(text_of(data, label), label)
    _refuse_occupied(folder, data)
    written = read_logs(paths, parsed, label, say)
    say("cutting the log into slews", 0, 0)
    counted = {key: _once(_attainable(stream)) for key, stream in written.streams.items()}
    logs = replace(written, streams=counted)
    _refuse_other_unit_of_time(logs, label)
    cut = cut_into_slews(logs, parsed, label)
    for stream in written.streams.values():
        _refuse_outside(stream, cut, parsed, label, logs)
    logs = replace(logs, streams=_saying_beside(logs, cut))
    say("measuring the noise at rest", 0, 0)
    noises = rest_noise(logs, cut.scan, parsed)
    _require_noises(parsed, noises, label)
    say("writing the campaign", 0, 0)
    # Tables keep the rows of the logs: the campaign counts each reading once, and says so.
    slews = imported_folder.tables_of_slews(cut.windows, written.streams, parsed)
    tables = imported_folder.tables_of(parsed, slews)
    description = imported_folder.description_text(parsed, slews, noises, logs)
    zero = imported_folder.zero_of_clock(logs) if logs.absolute else "the zero of the logs"
    picture = {} if cut.scan is None else {imported_folder.PICTURE_FILE: cut_picture(cut, zero)}
    record = imported_folder.record_text(paths, (mapping.name, data), logs, cut, noises)
    beside = picture | {mapped_lines.RECORD_FILE: record}
    campaign = _read_back(description, label, tables, parsed, slews)
    if parsed.reduce == "block_means":
        description, tables, campaign = reduced_content(description, tables, campaign)
    *tables_first, last = files_of(description, tables).items()
    encoded = [(name, text.encode("utf-8")) for name, text in beside.items()]
    # The description comes last: an interrupted import leaves no campaign.
    target = write_new_files(folder, dict([*tables_first, *encoded, last]), holds="campaign")
    return ImportedCampaign(target, logs, cut, tuple(noises), campaign)


def _listed(files: Any) -> tuple[Any, ...]:
    """Files as a list; one alone counts as one."""
    return (files,) if isinstance(files, str | os.PathLike) else members(files, object, "key files")


def _read_back(
    description: str,
    label: str,
    tables: dict[str, Table],
    mapping: MappingPart,
    slews: Sequence[imported_folder.SlewTables],
) -> Campaign:
    """The campaign that is written; what is wrong with it is said of its place in the raw logs."""
    try:
        return campaign_of(description, label, tables)
    except CampaignError as error:
        where = imported_folder.raw_place(error.where, mapping, slews)
        raise CampaignError(error.what, where=where, advice=error.advice) from None


def _refuse_occupied(folder: Path, mapping: bytes) -> None:
    """Refuse a folder that holds an import by another mapping before the logs are read."""
    free, where = not mapped_lines.other_mapping(folder, mapping), folder / mapped_lines.RECORD_FILE
    advice = "write to a new folder, or remove this one first"
    require(free, str(where), "would overwrite another campaign", advice, error=OutputError)


def _attainable(stream: LoggedStream) -> LoggedStream:
    """A stream without rates that no body reaches: a mark of "no reading" is no motion."""
    if stream.holds != "rate":
        return stream
    marks = no_readings(stream.values, FAULTS.fastest_rate)
    return replace(stream, values=np.where(marks, np.nan, stream.values))


def _once(stream: LoggedStream) -> LoggedStream:
    """A stream without rows that only repeat a reading; commands are held by nature."""
    if stream.holds not in BY_KEY:
        return stream
    (held,) = held_readings([(stream.time, stream.values)], by_axis=BY_KEY[stream.holds].is_series)
    if held is None:
        return stream
    values = np.where(held.repeats, np.nan, stream.values)
    return replace(stream, values=values).rows(np.isfinite(values).any(axis=1), str(held))


def _refuse_other_unit_of_time(logs: Logs, label: str) -> None:
    """Refuse a stream whose stamps span a unit's ratio less, or more, than those of the others."""
    several = {key: stream for key, stream in logs.streams.items() if len(stream.time) > 2}
    spans = {key: float(np.ptp(stream.time)) for key, stream in several.items()}
    for key, stream in several.items():
        others = [other for other in several if other != key]
        if not others:
            return
        span = float(np.median([spans[other] for other in others]))
        step = float(np.median([several[other].step for other in others]))
        size, steps = (max(x, 1.0 / x) for x in (span / spans[key], step / stream.step))
        ratio = min(LIMITS.unit_factors_of_time, key=lambda unit: abs(size / unit - 1.0))
        wrong = abs(size / ratio - 1.0) < LIMITS.alike_spans and steps > LIMITS.different_steps
        what = f"the stamps of {_names(stream)} span {spans[key]:.6g} s, those of the other "
        what += f"streams {span:.6g} s: {ratio:g} times as much or as little"
        advice = "a unit of time is wrong, such as s for ms"
        require(not wrong, f"{label}, key streams.{key}.time.kind", what, advice)


def _names(stream: LoggedStream) -> str:
    """The files of a stream, for a message."""
    return ", ".join(PurePath(file).name for file in stream.files)


def _other_clocks(
    stream: LoggedStream, mapping: MappingPart, logs: Logs
) -> Iterator[tuple[float, str]]:
    """By how much a stream moves against the rates [s] if one of both counts by another clock."""
    for holds, sign in ((stream.holds, 1.0), ("rate", -1.0)):
        kind = streams_that_hold(mapping, holds)[0].time.kind
        unit = kind.rpartition("_")[2]
        first = logs.epoch_ns + round(float(logs.streams[holds].time[0]) * SECOND)
        for other in COUNTED_CLOCKS if kind in COUNTED_CLOCKS else ():
            if other != kind and other.endswith(f"_{unit}"):
                why = f'streams.{holds}.time.kind = "{other}", not "{kind}"'
                yield sign * moved_s(first, kind, other), why


def _refuse_outside(
    stream: LoggedStream, cut: SlewCut, mapping: MappingPart, label: str, logs: Logs
) -> None:
    """Refuse a stream of which no reading lies in a slew, and name what explains it."""
    spans = [(window.start, window.end) for window in cut.windows]
    start, end = np.array(spans).T[..., None]
    away = np.maximum(start - stream.time, stream.time - end)
    nearest, count = max(float(np.min(away)), 0.0), len(stream.time)
    in_force = stream.holds == "wheel_torque" and count == 1 and stream.time[0] < spans[-1][1]
    if nearest == 0.0 or in_force:
        return
    at = [(stream.time, spans)]
    known = known_offset(at)
    clock = known or known_offset(at, _other_clocks(stream, mapping, logs))
    stated = streams_that_hold(mapping, stream.holds)[0].offset_s
    size = nearest if known is None else abs(known[0])
    if known is not None:
        seconds, why, inside = known
        advice = f"write offset_s = {stated + seconds:.9g} ({why}), which puts {inside} in a slew; "
        advice += "or leave the stream out"
    elif clock is not None:
        _, why, inside = clock
        advice = f"{why} may be meant: it puts {inside} in a slew; or leave the stream out"
    else:
        first = spans[0][0] - float(stream.time[0])
        advice = f"its first reading and the first slew are {abs(first):.6g} s apart: state the "
        advice += "offset of its clock, correct time.kind or time.epoch, or leave the stream out"
    readings, lie = (f"all {count} readings", "lie") if count > 1 else ("the only reading", "lies")
    what = f"{readings} of {_names(stream)} {lie} outside every slew, by {size:.6g} s"
    raise CampaignError(what, where=f"{label}, key streams.{stream.holds}.offset_s", advice=advice)


def _saying_beside(logs: Logs, cut: SlewCut) -> dict[str, LoggedStream]:
    """Streams with notes on slews in which they have no reading, and on readings beside rates."""
    said = {}
    for key, stream in logs.streams.items():
        lacking = [w.name for w in cut.windows if not len(stream.between(w.start, w.end).time)]
        notes = [f"no reading in {', '.join(lacking)}"] if lacking else []
        notes += _beside(stream, logs.streams["rate"], cut)
        said[key] = replace(stream, notes=(*stream.notes, *notes))
    return said


def _beside(stream: LoggedStream, rate: LoggedStream, cut: SlewCut) -> list[str]:
    """A note if more than 5 % of a stream's readings lie where no rate was logged."""
    spans = [(window.start, window.end) for window in cut.windows]
    start, end = np.array(spans).T[..., None]
    inside = ((stream.time >= start) & (stream.time <= end)).any(axis=0)
    after = np.clip(np.searchsorted(rate.time, stream.time), 1, len(rate.time) - 1)
    away = np.abs(stream.time - rate.time[[after - 1, after]]).min(axis=0)
    count = len(stream.time)
    beside = int((~inside & (away > 2.0 * rate.step)).sum())
    if beside <= max(1.0, LIMITS.most_left_out * count):
        return []
    said = f"{beside} of {count} readings {mapped_lines.BESIDE_RATES} and are left out"
    known = known_offset([(stream.time, spans)])
    if known is None or known[2] < LIMITS.meant_offset_share * count:
        return [said]
    seconds, why, there = known
    key = mapped_lines.OFFSET_OF.format(stream.holds)
    return [f"{said}; {there} lie in a slew with {seconds:+.9g} s in {key} ({why})"]


def _require_noises(mapping: MappingPart, noises: Sequence[RestNoise], label: str) -> None:
    """Refuse a sensor without a stated noise, and quote what the rests show."""
    stated: dict[str, object] = {"rate_sensor.sigma": mapping.rate_sensor.sigma}
    tracker = mapping.star_tracker
    if tracker is not None:
        keys = ("sigma_cross", "sigma_roll")
        stated |= {f"star_tracker.{key}": getattr(tracker, key) for key in keys}
    seen = {noise.key: noise for noise in noises}
    missing = [key for key, value in stated.items() if value is None]
    if not missing:
        return
    lines = [f"[{key.partition('.')[0]}] {seen[key].toml()}" for key in missing if key in seen]
    # Tachometers are not used without theirs: said now, it spares another import.
    lines += [
        f'[[wheels]] "{wheel.name}" {seen[key].toml()}'
        for wheel in mapping.wheels
        if wheel.momentum_sigma is None and (key := f"wheels.{wheel.name}.momentum_sigma") in seen
    ]
    advice = "take it from the data sheet: the rests of the log do not show it"
    if lines:
        advice = f"the rests of the log show {', '.join(lines)}: paste it if the data sheet agrees"
    raise CampaignError("missing key", where=f"{label}, key {missing[0]}", advice=advice)


def reduced_content(
    description: str, tables: dict[str, Table], campaign: Campaign
) -> tuple[str, dict[str, Table], Campaign]:
    """Description, tables and campaign with block means of high-rate readings, if possible."""
    means = reduced(campaign)
    if means is campaign:
        return description, tables, campaign
    sigma = campaign.gyro.sigma[0] / means.gyro.sigma[0]
    said = f"# Rates and wheel momentum are means of {round(sigma**2)} readings each, because the "
    said += 'mapping\n# says reduce = "block_means"; their noise is smaller by the root of that.\n'
    description, tables = content_of(means)
    return said + description, tables, campaign_of(description, means.name, tables)
