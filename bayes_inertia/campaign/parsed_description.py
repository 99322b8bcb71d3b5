"""From the text of `campaign.toml` to what it says."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from bayes_inertia.campaign import actuators, format_1, format_2
from bayes_inertia.campaign.checked_toml import advice_on_key, formed, toml_document
from bayes_inertia.campaign.description import FIELDS, Description, Entry, built, stated_keys
from bayes_inertia.campaign.format_2 import SlewPart
from bayes_inertia.campaign.hardware import (
    DirectionSensor,
    InertiaPrior,
    RateSensor,
    StarTracker,
    Wheel,
    require_key,
)
from bayes_inertia.campaign.schema import FORMAT_2
from bayes_inertia.campaign.sensors import FIRST
from bayes_inertia.errors import CampaignError


def parse_description(text: str, label: str) -> Description:
    """The content of a `campaign.toml` of either format, every key checked."""
    document = toml_document(text, label)
    try:
        return _described(document) if document.get("format") == FORMAT_2 else _upgraded(document)
    except CampaignError as error:
        raise error.inside(label) from None


def _upgraded(document: dict[str, Any]) -> Description:
    """The content of a document of format 1; errors and entries have its own keys."""
    formed(document, format_1.Tables)
    document = format_1.upgrade(document)
    said = format_1.keys_as_written(document)
    try:
        description = _described(document)
    except CampaignError as error:
        what, where, advice = map(said, (error.what, error.where, error.advice))
        raise CampaignError(what, where=where, advice=advice) from None
    entries = (replace(e, paths=tuple(map(said, e.paths))) for e in description.entries)
    return replace(description, entries=tuple(entries), devices={})


def _described(document: dict[str, Any]) -> Description:
    """The content of a document of format 2."""
    parsed = formed(document, format_2.CampaignPart)
    _require_different(parsed)
    of_kinds = reversed([part for part in parsed.sensors if part.type in FIRST])
    first: dict[str, Any] = {part.type: part for part in of_kinds}
    wheels = [part for part in parsed.actuators if isinstance(part, format_2.WheelDevice)]
    others = [part for part in parsed.actuators if not isinstance(part, format_2.WheelDevice)]
    description = Description(
        name=parsed.name,
        time=parsed.time,
        entries=(
            *_sensor_entries(parsed, first),
            *_wheel_entries(wheels),
            *map(_input_entry, others),
            *_environment_entries(parsed),
        ),
        slews=tuple(parsed.slews),
        inertia=built(InertiaPrior, parsed.inertia),
        wheels=tuple(map(_wheel, wheels)),
        mission=() if parsed.mission is None else tuple(stated_keys(parsed.mission).items()),
        prior=parsed.prior,
        reference=_reference(parsed),
        actuators=tuple(map(_actuator, others)),
        changes=tuple(_change(part, parsed.slews) for part in parsed.changes),
        orbit=_orbit(parsed),
        **_sensors(parsed, first),
    )
    _check_told_once(description.entries)
    for slew in parsed.slews:
        _check_tables(slew, description.entries)
        _check_names(slew, description)
    return description


def _require_different(parsed: format_2.CampaignPart) -> None:
    what, advice = "the name is used twice", "give each its own name"
    for key in ("actuators", "sensors", "environment", "changes", "slews"):
        names = [part.name for part in getattr(parsed, key)]
        for name in names:
            require_key(names.count(name) == 1, f"{key}.{name}", what, advice)


def _sensors(parsed: format_2.CampaignPart, first: Mapping[str, Any]) -> dict[str, Any]:
    """The hardware of all sensors, as fields of a description, and how the file calls it."""
    built_of = {part.name: _sensor(part) for part in parsed.sensors}
    named = {kind: part.name for kind, part in first.items()}
    usual = zip(FIRST, Description.names, strict=True)
    return {
        **{FIRST[k]: built_of[named[k]] if k in named else None for k in FIRST},
        "more_sensors": tuple(x for x in built_of.items() if x[0] not in named.values()),
        "names": tuple(named.get(kind, name) for kind, name in usual),
        "devices": {"wheels": "actuators"}
        | {FIRST[kind]: f"sensors.{name}" for kind, name in named.items()},
    }


def _check_told_once(entries: Sequence[Entry]) -> None:
    """One entry for each quantity, of a wheel for each wheel."""
    told: dict[tuple[str, int], str] = {}
    for entry in entries:
        for k, wheel in enumerate(entry.wheels or (0,)):
            path = entry.path_of(k)
            other = told.setdefault((entry.field, wheel), path)
            advice = "keep one of the two, they are the same measurement"
            require_key(other == path, path, f"{other} is given too", advice)


def _check_names(slew: SlewPart, description: Description) -> None:
    """In one table each column has one meaning; only columns of time may be shared."""
    used: dict[tuple[str | None, str], str] = {}
    times: dict[tuple[str | None, str], str] = {}
    for entry in description.entries:
        file = slew.file_of(entry.columns)
        own = entry.columns.time is not None
        times[file, description.clock(entry).names[0]] = f"{entry.path}.time" if own else "time"
        for k, name in enumerate(entry.columns.names):
            _require_unused((file, name), used, entry.path_of(k))
            used[file, name] = entry.path_of(k)
    for place, path in used.items():
        _require_unused(place, times, path)


def _require_unused(place: tuple[Any, str], used: Mapping[tuple[Any, str], str], path: str) -> None:
    what = f"the column {place[1]!r} is already used by {used.get(place)}"
    require_key(place not in used, f"{path}.names", what, "name each column once")


def _reference(parsed: format_2.CampaignPart) -> str | None:
    """The sensor that says it is the reference of frames."""
    given = [s for s in parsed.sensors if isinstance(s, format_2.ReferenceDevice) and s.reference]
    for part in given:
        place, what = f"sensors.{part.name}", f"{given[0].name} is the reference of frames too"
        only = part is given[0]
        require_key(only, f"{place}.reference", what, "keep one: its axes are the body's")
        what = "the reference of frames sits as it is stated"
        advice = "leave mounting_sigma out: its axes are the body's"
        require_key(part.mounting_sigma is None, f"{place}.mounting_sigma", what, advice)
    return given[0].name if given else None


def _orbit(parsed: format_2.CampaignPart) -> tuple[str, str] | None:
    """The file of two-line elements and the epoch, if position and field come from them."""
    orbits = [part for part in parsed.environment if isinstance(part, format_2.OrbitDevice)]
    others = [p for p in parsed.environment if not isinstance(p, format_2.InputDevice)]
    for part in orbits:
        what, advice = "position and magnetic field are given twice", "keep the orbit or columns"
        require_key(len(others) == 1, f"environment.{part.name}", what, advice)
    return (orbits[0].tle, orbits[0].epoch) if orbits else None


def _sensor(part: format_2.RateDevice | format_2.AttitudeDevice | format_2.DirectionDevice) -> Any:
    """The hardware of a sensor."""
    place = f"sensors.{part.name}"
    if isinstance(part, format_2.DirectionDevice):
        return _direction_sensor(part, place)
    if isinstance(part, format_2.AttitudeDevice):
        return built(StarTracker, part, "star_tracker", place)
    names, axes = len(part.rate.names), 3 if part.axes is None else len(part.axes)
    what, advice = f"{names} column(s) for {axes} axes", "name one column an axis, in their order"
    require_key(names == axes, f"{place}.rate.names", what, advice)
    return built(RateSensor, part, "rate_sensor", place)


def _direction_sensor(part: format_2.DirectionDevice, place: str) -> DirectionSensor:
    """A sensor of directions, or of a field where its columns have a unit."""
    unit, reference, fixed = part.direction.unit, part.reference, part.reference_N
    advice = "keep reference_N where it does not change, reference where it does"
    alone = reference is None or fixed is None
    require_key(alone, f"{place}.reference", "reference_N is given too", advice)
    what = "only one of reading and reference has it"
    advice = "give both in a unit such as T (a field), or none (a direction)"
    alike = reference is None or (unit is None) == (reference.unit is None)
    require_key(alike, f"{place}.reference.unit", what, advice)
    advice = "add reference_N = what it sees in inertial axes, or reference = { ... }"
    known = unit is not None or reference is not None or fixed is not None
    require_key(known, f"{place}.reference_N", "missing key", advice)
    is_field = "" if unit is None else "T"
    return built(DirectionSensor, part, "sensors.direction", place, unit=is_field)


def _sensor_entries(parsed: format_2.CampaignPart, first: Mapping[str, Any]) -> list[Entry]:
    entries = []
    for part in parsed.sensors:
        key = part.type
        field = key if part is first.get(key) else f"more.{part.name}"
        path = f"sensors.{part.name}"
        if getattr(part, key) is not None:
            entries.append(Entry(key, field, getattr(part, key), (f"{path}.{key}",)))
        if isinstance(part, format_2.DirectionDevice) and part.reference is not None:
            place, field = (f"{path}.reference",), f"inputs.{part.name}"
            entries.append(Entry("magnetic_field", field, part.reference, place))
    return entries


def _environment_entries(parsed: format_2.CampaignPart) -> list[Entry]:
    entries, devices = [], {part.name for part in (*parsed.actuators, *parsed.sensors)}
    for part in parsed.environment:
        place = f"environment.{part.name}"
        if isinstance(part, format_2.InputDevice):
            what, advice = "the name is that of a device", "give each its own name"
            require_key(part.name not in devices, place, what, advice)
            advice = "write letters, digits and _: formulas are called by it"
            word = re.fullmatch(r"\w+", part.name) is not None
            require_key(word, place, "the name is no single word", advice)
            entries.append(Entry("input", f"inputs.{part.name}", part.values, (f"{place}.values",)))
        elif not isinstance(part, format_2.OrbitDevice):
            columns = part.vector
            entries.append(Entry(part.type, FIELDS[part.type], columns, (f"{place}.vector",)))
    return entries


def _actuator(part: format_2.OtherActuator) -> actuators.Actuator:
    """A device beside wheels."""
    more: dict[str, Any] = {}
    if isinstance(part, format_2.TorqueDevice):
        more = {"frame": part.torque.frame}
    if isinstance(part, format_2.RotorsDevice):
        more = {"angle_sigma": part.gimbal_angle.sigma}
    device = built(_RECORDS[part.type], part, **more)
    entry = _input_entry(part)
    names, columns = len(entry.columns.names), device.columns
    what, advice = f"{names} column(s) for {columns} of the device", "name one each, in their order"
    require_key(names == columns, f"{entry.path}.names", what, advice)
    return device


def _change(part: format_2.ChangePart, slews: Sequence[SlewPart]) -> actuators.Change:
    """A change, dated by the first slew after it or by a time."""
    place, starts = f"changes.{part.name}", {slew.name: slew.start for slew in slews}
    advice = "write slew = the name of the first slew after it, or time on the campaign's clock"
    one = (part.slew is None) != (part.time is None)
    require_key(one, f"{place}.slew", "give one of slew and time", advice)
    what, advice = f"no slew is called {part.slew!r}", f"slews here: {', '.join(starts)}"
    require_key(part.slew is None or part.slew in starts, f"{place}.slew", what, advice)
    time = part.time if part.time is not None else starts[part.slew or ""]
    what = "all slews are on one side of the change"
    advice = "give the first slew after the change; at least one must come before it"
    inside = min(starts.values()) < time <= max(starts.values())
    require_key(inside, f"{place}.{'time' if part.slew is None else 'slew'}", what, advice)
    return actuators.Change(part.name, time, part.sigma_fraction, part.part)


# Record of each type of device, and what its input is measured in.
_RECORDS: Mapping[str, Any] = {told.type: kind for kind, told in actuators.DEVICE_INPUTS.items()}
# Thrusters may be told by on-times, too.
_QUANTITIES: Mapping[str, str] = {"on_time": "time"} | {
    told.key: told.quantity for told in actuators.DEVICE_INPUTS.values()
}


def _input_entry(part: format_2.OtherActuator) -> Entry:
    """The one stream of a device beside wheels."""
    place = f"actuators.{part.name}"
    keys = [key for key in _QUANTITIES if getattr(part, key, None) is not None]
    advice = 'add on_time = { names = [...], unit = "s" }, or level = { ... }'
    require_key(len(keys) > 0, f"{place}.on_time", "missing key", advice)
    key, what = keys[0], f"{keys[0]} is given too"
    require_key(len(keys) == 1, f"{place}.{keys[-1]}", what, "keep one of the two")
    return Entry(_QUANTITIES[key], f"inputs.{part.name}", getattr(part, key), (f"{place}.{key}",))


def _wheel(part: format_2.WheelDevice) -> Wheel:
    place, more = f"actuators.{part.name}", {}
    if part.momentum is not None and part.momentum.sigma is not None:
        more = {"momentum_sigma": part.momentum.sigma}
    if part.speed is not None and part.speed.sigma is not None:
        more = {"momentum_sigma": part.speed.sigma * part.spin_inertia}
    once, advice = not more or part.momentum_sigma is None, "keep sigma of momentum or speed"
    require_key(once, f"{place}.momentum_sigma", "the noise is given twice", advice)
    return built(Wheel, part, f"wheels.{part.name}", place, **more)


def _wheel_entries(wheels: Sequence[format_2.WheelDevice]) -> list[Entry]:
    """Commands and tachometers; wheels that say the same of their columns share an entry."""
    entries = []
    for kind in ("torque", "momentum", "speed"):
        key, alike = f"wheel_{kind}", dict[str, list[tuple[int, str, Any]]]()
        for i, part in enumerate(wheels):
            columns = getattr(part, kind)
            if columns is not None:
                said = columns.model_dump_json(exclude={"names", "sigma"})
                alike.setdefault(said, []).append((i, f"actuators.{part.name}.{kind}", columns))
        for members in alike.values():
            where, paths, told = zip(*members, strict=True)
            columns = told[0].model_copy(update={"names": [each.names[0] for each in told]})
            entries.append(Entry(key, FIELDS.get(key, key), columns, paths, where))
    _check_wheels(wheels)
    return entries


def _check_wheels(wheels: Sequence[format_2.WheelDevice]) -> None:
    """Commands of all wheels or none, in one table."""
    commanded = [(part.name, part.torque.stream) for part in wheels if part.torque is not None]
    for part in wheels:
        place, (first, stream) = f"actuators.{part.name}.torque", (*commanded, ("", None))[0]
        told = part.torque is not None or part.state in ("locked", "free") or not commanded
        what = f"missing key, but {first} has it"
        advice = "give the commands of every wheel, or leave all out: tachometers drive then"
        require_key(told, place, what, advice)
        what = f"another table than that of {first}"
        advice = "put the commands of all wheels into one table, a row for each time"
        alike = part.torque is None or part.torque.stream == stream
        require_key(alike, f"{place}.stream", what, advice)


_TEMPLATE = 'write files = "slew_01_{stream}.csv", or files = { gyro = "gyro_01.csv", ... }'


def _check_tables(part: SlewPart, entries: Sequence[Entry]) -> None:
    """One table for all entries, or that of the stream of each."""
    place, files = f"slews.{part.name}", part.files
    advice = f'add file = the table of the slew, such as "slew_01.csv", or {_TEMPLATE}'
    given = part.file is not None or files is not None
    require_key(given, f"{place}.file", "missing key", advice)
    advice = "keep file (one table) or files (one table a stream)"
    once = part.file is None or files is None
    require_key(once, f"{place}.files", "file is given too", advice)
    what = f"{files!r} does not say where the stream's name goes"
    named = not isinstance(files, str) or "{stream}" in files
    require_key(named, f"{place}.files", what, f"{_TEMPLATE}; one table of all is file = ...")
    advice = f"add stream = what {{stream}} in the files of {part.name} stands for"
    for entry in entries:
        known = files is None or entry.columns.stream is not None
        require_key(known, f"{entry.path}.stream", "missing key", advice)
    _check_streams(part, entries, f"{place}.files")


def _check_streams(part: SlewPart, entries: Sequence[Entry], place: str) -> None:
    """Only streams that a device has, and those of what every slew needs."""
    known = list(dict.fromkeys(entry.columns.stream for entry in entries))
    for stream in part.files if isinstance(part.files, dict) else ():
        what, advice = "nothing is read from this table", advice_on_key(stream, known)
        require_key(stream in known, f"{place}.{stream}", what, advice)
    read = [entry for entry in entries if part.file_of(entry.columns) is not None]
    sensed = any(entry.path.startswith("sensors.") for entry in read)
    advice = "add the table of a sensor, or leave the slew out"
    require_key(sensed, place, "no sensor has a table", advice)
    for entry in entries:
        optional = entry.field != "rate" and not entry.field.startswith("inputs.")
        advice = f"add the table of {entry.path}, or leave the slew out"
        there = optional or entry in read
        require_key(there, f"{place}.{entry.columns.stream}", "missing key", advice)
