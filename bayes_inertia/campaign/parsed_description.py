"""From the text of `campaign.toml` to what it says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from bayes_inertia.campaign import actuators, format_1, format_2
from bayes_inertia.campaign.checked_toml import checked_document, toml_document
from bayes_inertia.campaign.description import (
    FIELDS,
    Description,
    Entry,
    built,
    stated_keys,
)
from bayes_inertia.campaign.format_2 import SlewPart
from bayes_inertia.campaign.hardware import (
    DirectionSensor,
    InertiaPrior,
    RateSensor,
    StarTracker,
    Wheel,
)
from bayes_inertia.campaign.schema import FORMAT_2, refuse
from bayes_inertia.campaign.sensors import FIRST
from bayes_inertia.errors import CampaignError


def parse_description(text: str, label: str) -> Description:
    """The content of a `campaign.toml` of either format, every key checked."""
    document = toml_document(text, label)
    if document.get("format") == FORMAT_2:
        return _described(document, label)
    checked_document(document, label, format_1.Tables)
    try:
        upgraded = format_1.upgrade(document)
    except CampaignError as error:
        raise error.inside(label) from None
    said = format_1.keys_as_written(upgraded)
    try:
        description = _described(upgraded, label)
    except CampaignError as error:
        what, where, advice = map(said, (error.what, error.where, error.advice))
        raise CampaignError(what, where=where, advice=advice) from None
    entries = (replace(entry, paths=tuple(map(said, entry.paths))) for entry in description.entries)
    return replace(description, entries=tuple(entries), devices={})


def _described(document: dict[str, Any], label: str) -> Description:
    """The content of a document of format 2."""
    parsed = checked_document(document, label, format_2.CampaignPart)
    _require_different(parsed, label)
    of_kinds = reversed([part for part in parsed.sensors if part.type in FIRST])
    first: dict[str, Any] = {part.type: part for part in of_kinds}
    wheels = [part for part in parsed.actuators if isinstance(part, format_2.WheelDevice)]
    others = [part for part in parsed.actuators if not isinstance(part, format_2.WheelDevice)]
    description = Description(
        name=parsed.name,
        time=parsed.time,
        entries=(
            *_sensor_entries(parsed, first),
            *_wheel_entries(wheels, label),
            *(_input_entry(part, label) for part in others),
            *_environment_entries(parsed),
        ),
        slews=tuple(parsed.slews),
        inertia=built(InertiaPrior, parsed.inertia, label),
        wheels=tuple(_wheel(part, label) for part in wheels),
        mission=() if parsed.mission is None else tuple(stated_keys(parsed.mission).items()),
        prior=parsed.prior,
        reference=_reference(parsed, label),
        actuators=tuple(_actuator(part, label) for part in others),
        changes=tuple(_change(part, parsed.slews, label) for part in parsed.changes),
        orbit=_orbit(parsed, label),
        **_sensors(parsed, first, label),
    )
    _check_told_once(description.entries, label)
    for slew in parsed.slews:
        _check_tables(slew, description.entries, label)
        _check_names(slew, description, label)
    return description


def _sensors(parsed: format_2.CampaignPart, first: Mapping[str, Any], label: str) -> dict[str, Any]:
    """The hardware of all sensors, as fields of a description, and how the file calls it."""
    built_of = {part.name: _sensor(part, label) for part in parsed.sensors}
    named = {kind: part.name for kind, part in first.items()}
    usual = zip(FIRST, Description.names, strict=True)
    return {
        **{FIRST[k]: built_of[named[k]] if k in named else None for k in FIRST},
        "more_sensors": tuple(x for x in built_of.items() if x[0] not in named.values()),
        "names": tuple(named.get(kind, name) for kind, name in usual),
        "devices": {"wheels": "actuators"}
        | {FIRST[kind]: f"sensors.{name}" for kind, name in named.items()},
    }


def _check_told_once(entries: Sequence[Entry], label: str) -> None:
    """One entry for each quantity, of a wheel for each wheel."""
    told: dict[tuple[str, int], str] = {}
    for entry in entries:
        for k, wheel in enumerate(entry.wheels or (0,)):
            path = entry.paths[min(k, len(entry.paths) - 1)]
            other = told.setdefault((entry.field, wheel), path)
            advice = "keep one of the two, they are the same measurement"
            if other != path:
                refuse(label, path, f"{other} is given too", advice)


def _check_names(slew: SlewPart, description: Description, label: str) -> None:
    """In one table each column has one meaning; only columns of time may be shared."""
    used: dict[tuple[str | None, str], str] = {}
    times: dict[tuple[str | None, str], str] = {}
    for entry in description.entries:
        file = slew.file_of(entry.columns)
        own = entry.columns.time is not None
        times[file, description.clock(entry).names[0]] = f"{entry.path}.time" if own else "time"
        for k, name in enumerate(entry.columns.names):
            path = entry.paths[min(k, len(entry.paths) - 1)]
            if (file, name) in used:
                _refuse_twice(label, path, name, used[file, name])
            used[file, name] = path
    for place, path in times.items():
        if place in used:
            _refuse_twice(label, used[place], place[1], path)


def _refuse_twice(label: str, path: str, name: str, other: str) -> None:
    what = f"the column {name!r} is already used by {other}"
    refuse(label, f"{path}.names", what, "name each column once")


def _require_different(parsed: format_2.CampaignPart, label: str) -> None:
    for key in ("actuators", "sensors", "environment", "changes", "slews"):
        names = [part.name for part in getattr(parsed, key)]
        for name in (name for name in names if names.count(name) > 1):
            refuse(label, f"{key}.{name}", "the name is used twice", "give each its own name")


def _reference(parsed: format_2.CampaignPart, label: str) -> str | None:
    """The sensor that says it is the reference of frames."""
    stated = [
        s for s in parsed.sensors if not isinstance(s, format_2.DirectionDevice) and s.reference
    ]
    for part in stated[1:]:
        what = f"{stated[0].name} is the reference of frames too"
        refuse(label, f"sensors.{part.name}.reference", what, "keep one: its axes are the body's")
    for part in stated:
        if part.mounting_sigma is not None:
            advice = "leave mounting_sigma out: its axes are the body's"
            what = "the reference of frames sits as it is stated"
            refuse(label, f"sensors.{part.name}.mounting_sigma", what, advice)
    return stated[0].name if stated else None


def _orbit(parsed: format_2.CampaignPart, label: str) -> tuple[str, str] | None:
    """The file of two-line elements and the epoch, if position and field come from them."""
    orbits = [part for part in parsed.environment if isinstance(part, format_2.OrbitDevice)]
    if not orbits:
        return None
    if len(parsed.environment) > 1:
        what = "position and magnetic field are given twice"
        advice = "keep the orbit alone, or the columns"
        refuse(label, f"environment.{orbits[0].name}", what, advice)
    return orbits[0].tle, orbits[0].epoch


def _sensor(
    part: format_2.RateDevice | format_2.AttitudeDevice | format_2.DirectionDevice, label: str
) -> Any:
    """The hardware of a sensor."""
    place = f"sensors.{part.name}"
    if isinstance(part, format_2.DirectionDevice):
        return _direction_sensor(part, label, place)
    if isinstance(part, format_2.AttitudeDevice):
        return built(StarTracker, part, label, "star_tracker", place)
    axes = 3 if part.axes is None else len(part.axes)
    if len(part.rate.names) != axes:
        what = f"{len(part.rate.names)} column(s) for {axes} axes"
        refuse(label, f"{place}.rate.names", what, "name one column an axis, in the same order")
    return built(RateSensor, part, label, "rate_sensor", place)


def _direction_sensor(part: format_2.DirectionDevice, label: str, place: str) -> DirectionSensor:
    """A sensor of directions, or of a field where its columns have a unit."""
    unit, reference = part.direction.unit, part.reference
    if reference is not None and part.reference_N is not None:
        advice = "keep reference_N where it does not change, reference where it does"
        refuse(label, f"{place}.reference", "reference_N is given too", advice)
    if reference is not None and (unit is None) != (reference.unit is None):
        advice = "give both in a unit such as T (a field), or none (a direction)"
        refuse(label, f"{place}.reference.unit", "only one of reading and reference has it", advice)
    if unit is None and reference is None and part.reference_N is None:
        advice = "add reference_N = what it sees in inertial axes, or reference = { ... }"
        refuse(label, f"{place}.reference_N", "missing key", advice)
    is_field = "" if unit is None else "T"
    return built(DirectionSensor, part, label, "sensors.direction", place, unit=is_field)


def _sensor_entries(parsed: format_2.CampaignPart, first: Mapping[str, Any]) -> list[Entry]:
    entries = []
    for part in parsed.sensors:
        key = part.type
        field = key if part is first.get(key) else f"more.{part.name}"
        path = f"sensors.{part.name}"
        if getattr(part, key) is not None:
            entries.append(Entry(key, field, getattr(part, key), (f"{path}.{key}",)))
        if isinstance(part, format_2.DirectionDevice) and part.reference is not None:
            seen = Entry(
                "magnetic_field", f"inputs.{part.name}", part.reference, (f"{path}.reference",)
            )
            entries.append(seen)
    return entries


def _environment_entries(parsed: format_2.CampaignPart) -> list[Entry]:
    return [
        Entry(part.type, FIELDS[part.type], part.vector, (f"environment.{part.name}.vector",))
        for part in parsed.environment
        if not isinstance(part, format_2.OrbitDevice)
    ]


def _actuator(part: format_2.OtherActuator, label: str) -> actuators.Actuator:
    """A device beside wheels."""
    more: dict[str, Any] = {}
    if isinstance(part, format_2.TorqueDevice):
        more = {"frame": part.torque.frame}
    if isinstance(part, format_2.RotorsDevice):
        more = {"angle_sigma": part.gimbal_angle.sigma}
    device = built(_RECORDS[part.type], part, label, **more)
    entry = _input_entry(part, label)
    names, columns = entry.columns.names, device.columns
    if len(names) != columns:
        what = f"{len(names)} column(s) for {columns} of the device"
        refuse(label, f"{entry.path}.names", what, "name one column each, in the same order")
    return device


def _change(part: format_2.ChangePart, slews: Sequence[SlewPart], label: str) -> actuators.Change:
    """A change, dated by the first slew after it or by a time."""
    place = f"changes.{part.name}"
    if (part.slew is None) == (part.time is None):
        advice = "write slew = the name of the first slew after it, or time on the campaign's clock"
        refuse(label, f"{place}.slew", "give one of slew and time", advice)
    starts = {slew.name: slew.start for slew in slews}
    if part.slew is not None and part.slew not in starts:
        advice = f"slews here: {', '.join(starts)}"
        refuse(label, f"{place}.slew", f"no slew is called {part.slew!r}", advice)
    time = part.time if part.time is not None else starts[part.slew or ""]
    if not min(starts.values()) < time <= max(starts.values()):
        advice = "give the first slew after the change; at least one must come before it"
        key = "time" if part.slew is None else "slew"
        refuse(label, f"{place}.{key}", "all slews are on one side of the change", advice)
    try:
        return actuators.Change(part.name, time, part.sigma_fraction, part.part)
    except CampaignError as error:
        raise error.inside(label) from None


# Record of each type of device, and what its input is measured in.
_RECORDS: Mapping[str, Any] = {told.type: kind for kind, told in actuators.DEVICE_INPUTS.items()}
# Thrusters may be told by on-times, too.
_QUANTITIES: Mapping[str, str] = {"on_time": "time"} | {
    told.key: told.quantity for told in actuators.DEVICE_INPUTS.values()
}


def _input_entry(part: format_2.OtherActuator, label: str) -> Entry:
    """The one stream of a device beside wheels."""
    place = f"actuators.{part.name}"
    keys = [key for key in _QUANTITIES if getattr(part, key, None) is not None]
    if not keys:
        advice = 'add on_time = { stream = "...", names = [...], unit = "s" }, or level = { ... }'
        refuse(label, f"{place}.on_time", "missing key", advice)
    if len(keys) > 1:
        refuse(label, f"{place}.{keys[1]}", f"{keys[0]} is given too", "keep one of the two")
    key = keys[0]
    return Entry(_QUANTITIES[key], f"inputs.{part.name}", getattr(part, key), (f"{place}.{key}",))


def _wheel(part: format_2.WheelDevice, label: str) -> Wheel:
    place, more = f"actuators.{part.name}", {}
    if part.momentum is not None and part.momentum.sigma is not None:
        more = {"momentum_sigma": part.momentum.sigma}
    if part.speed is not None and part.speed.sigma is not None:
        more = {"momentum_sigma": part.speed.sigma * part.spin_inertia}
    if more and part.momentum_sigma is not None:
        advice = "keep sigma of momentum or speed"
        refuse(label, f"{place}.momentum_sigma", "the noise is given twice", advice)
    return built(Wheel, part, label, f"wheels.{part.name}", place, **more)


def _wheel_entries(wheels: Sequence[format_2.WheelDevice], label: str) -> list[Entry]:
    """Commands and tachometers; wheels that say the same of their columns share an entry."""
    entries = []
    for kind in ("torque", "momentum", "speed"):
        alike: dict[Any, list[tuple[int, format_2.WheelDevice]]] = {}
        for i, part in enumerate(wheels):
            columns = getattr(part, kind)
            if columns is not None:
                said = columns.model_dump_json(exclude={"names", "sigma"})
                alike.setdefault(said, []).append((i, part))
        for members in alike.values():
            names = [getattr(part, kind).names[0] for _, part in members]
            columns = getattr(members[0][1], kind).model_copy(update={"names": names})
            paths = tuple(f"actuators.{part.name}.{kind}" for _, part in members)
            key = f"wheel_{kind}"
            where = tuple(i for i, _ in members)
            entries.append(Entry(key, FIELDS.get(key, key), columns, paths, where))
    _check_wheels(wheels, label)
    return entries


def _check_wheels(wheels: Sequence[format_2.WheelDevice], label: str) -> None:
    """Commands of all wheels or none, in one table."""
    commanded = [(part.name, part.torque.stream) for part in wheels if part.torque is not None]
    for part in wheels:
        place = f"actuators.{part.name}"
        if part.torque is None and commanded and part.state not in ("locked", "free"):
            what = f"missing key, but {commanded[0][0]} has it"
            advice = "give the commands of every wheel, or leave all out: tachometers drive then"
            refuse(label, f"{place}.torque", what, advice)
        if part.torque is not None and part.torque.stream != commanded[0][1]:
            what = f"another table than that of {commanded[0][0]}"
            advice = "put the commands of all wheels into one table, a row for each time"
            refuse(label, f"{place}.torque.stream", what, advice)


_TEMPLATE = 'write files = "slew_01_{stream}.csv", or files = { gyro = "gyro_01.csv", ... }'


def _check_tables(part: SlewPart, entries: Sequence[Entry], label: str) -> None:
    """One table for all entries, or that of the stream of each."""
    place = f"slews.{part.name}"
    if part.file is None and part.files is None:
        advice = f'add file = the table of the slew, such as "slew_01.csv", or {_TEMPLATE}'
        refuse(label, f"{place}.file", "missing key", advice)
    if part.file is not None and part.files is not None:
        advice = "keep file (one table) or files (one table a stream)"
        refuse(label, f"{place}.files", "file is given too", advice)
    if isinstance(part.files, str) and "{stream}" not in part.files:
        what = f"{part.files!r} does not say where the stream's name goes"
        refuse(label, f"{place}.files", what, f"{_TEMPLATE}; one table of all is file = ...")
    for entry in entries if part.files is not None else ():
        if entry.columns.stream is None:
            advice = f"add stream = what {{stream}} in the files of {part.name} stands for"
            refuse(label, f"{entry.path}.stream", "missing key", advice)
    _check_streams(part, entries, label)


def _check_streams(part: SlewPart, entries: Sequence[Entry], label: str) -> None:
    """Only streams that a device has, and those of what every slew needs."""
    known = list(dict.fromkeys(entry.columns.stream for entry in entries))
    for stream in part.files if isinstance(part.files, dict) else ():
        if stream not in known:
            what, advice = "nothing is read from this table", f"known here: {', '.join(known)}"
            refuse(label, f"slews.{part.name}.files.{stream}", what, advice)
    read = [entry for entry in entries if part.file_of(entry.columns) is not None]
    if not any(entry.path.startswith("sensors.") for entry in read):
        advice = "add the table of a sensor, or leave the slew out"
        refuse(label, f"slews.{part.name}.files", "no sensor has a table", advice)
    for entry in entries:
        needed = entry.field == "rate" or entry.field.startswith("inputs.")
        if needed and entry not in read:
            place = f"slews.{part.name}.files.{entry.columns.stream}"
            advice = f"add the table of {entry.path}, or leave the slew out"
            refuse(label, place, "missing key", advice)
