"""What a campaign states: the columns of its streams and its hardware, by keys of its description.

Columns are those of the description's own list, in keys of its own format. A campaign in memory
states what `write_campaign` writes of it, in SI units and with the package's senses.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.description import Description, Entry
from bayes_inertia.campaign.hardware import Wheel
from bayes_inertia.campaign.parsed_description import parse_description
from bayes_inertia.campaign.sensors import BY_KEY, KINDS, STREAMS, SensorStream
from bayes_inertia.campaign.sensors.rate import RATE
from bayes_inertia.campaign.slew_parts import MORE
from bayes_inertia.campaign.writer import content_of
from bayes_inertia.conventions.reading import TORQUE, KeyChange, direction_sensors
from bayes_inertia.errors import CampaignError, OutputError

# What a stream and its readings are called, where it is not called as its entry.
_SAID: Mapping[str, tuple[str, str]] = {
    "time": ("time", "time stamps"),
    "rate": ("the rate", "rates"),
    "attitude": ("the star tracker", "star-tracker fixes"),
    "wheel_torque": ("the wheel torque", "torque commands"),
    "wheel_momentum": ("the wheel momentum", "tachometer readings"),
    "wheel_speed": ("the wheel speed", "tachometer readings"),
    "magnetic_field": ("the magnetic field", "fields"),
}


def said_of(key: str) -> tuple[str, str]:
    """What the stream of an entry and its readings are called."""
    return _SAID.get(key, (f"the {key}", f"readings of {key}"))


@dataclass(frozen=True)
class Stated:
    """Columns of a campaign, and how its description calls its hardware."""

    entries: tuple[Entry, ...]  # That of the campaign's time is the first
    devices: Mapping[str, str]  # What the file calls "wheels", "rate_sensor" and "star_tracker"

    def of(self, stream: str) -> list[Entry]:
        """Entries of a field of `Slew`; of wheels there may be several."""
        return [entry for entry in self.entries if entry.field == stream]

    @property
    def held(self) -> list[Entry]:
        """Entries that the laws hold against each other, but for directions; fixes first."""
        held = {stream.field for stream in STREAMS} | {TORQUE}
        entries = [entry for entry in self.entries if entry.field in held]
        return sorted(entries, key=lambda entry: BY_KEY.get(entry.key, RATE).is_series)

    def key(self, table: str, *words: str) -> str:
        """A key of the hardware, which format 1 has in a table of this name."""
        return ".".join([self.devices.get(table, table), *words])

    def spin_inertias(self, mended: Sequence[tuple[Wheel, float]]) -> tuple[KeyChange, ...]:
        """What other spin inertias of some wheels change in the file."""
        keys = [self.key("wheels", wheel.name, "spin_inertia") for wheel, _ in mended]
        changed = zip(keys, mended, strict=True)
        return tuple(KeyChange(key, wheel.spin_inertia, new) for key, (wheel, new) in changed)

    def column(self, stream: str, k: int, name: str) -> str:
        """Key and name of the column (from 0) of a field of `Slew`, as messages say it."""
        for entry in self.of(stream):
            of = list(entry.wheels) or list(range(len(entry.columns.names)))
            if k in of:
                return f"{path_of(entry)}.names, {entry.columns.names[of.index(k)]}"
        return f"columns.{stream}.names, {name}"

    def by(self, sensor: SensorStream) -> Stated:
        """The same whose first sensor of a kind is a further one."""
        kind = sensor.written[0]
        own = self.of(f"{MORE}{sensor.name}")
        rest = [e for e in self.entries if e not in own and e.field != kind]
        devices = {**self.devices, sensor.first: f"sensors.{sensor.name}"}
        return Stated((*rest, *(replace(entry, field=kind) for entry in own)), devices)

    def of_wheels(self, wheels: Sequence[int]) -> Stated:
        """The same of some of the wheels."""
        entries = []
        for entry in self.entries:
            kept = [k for k, wheel in enumerate(entry.wheels) if wheel in wheels]
            if len(kept) < len(entry.wheels):
                names = [entry.columns.names[k] for k in kept]
                columns = entry.columns.model_copy(update={"names": names})
                paths = tuple(entry.paths[k] for k in kept)
                of = tuple(wheels.index(entry.wheels[k]) for k in kept)
                entry = replace(entry, columns=columns, paths=paths, wheels=of)
            entries += [entry] if entry.columns.names else []
        return replace(self, entries=tuple(entries))


def stated_by(campaign: Campaign, description: Description | None = None) -> Stated:
    """What a campaign states, by its description; of one in memory by that of its folder."""
    if description is None:
        try:
            text, _ = content_of(_writable(campaign))
            description = parse_description(text, campaign.name)
        except (CampaignError, OutputError):  # No keys state what no folder can hold.
            return Stated((), {})
    path = "time" if description.devices else "columns.time"
    time = Entry("time", "time", description.time, (path,))
    return Stated((time, *description.entries), description.devices)


def _writable(campaign: Campaign) -> Campaign:
    """A campaign without what has no keys: measured noise, sensors and inputs of other kinds."""
    sensors = tuple((n, s) for n, s in campaign.more_sensors if type(s) in KINDS)
    known = {*dict(sensors), *(device.name for device in campaign.actuators)}
    slews = []
    for slew in campaign.slews:
        inputs = {name: x for name, x in (slew.inputs or {}).items() if name in known}
        slews.append(replace(slew, inputs=inputs or None))
    sensor = campaign.rate_sensor and replace(campaign.rate_sensor, correlated_noise=None)
    kept: dict[str, Any] = {"more_sensors": sensors, "slews": tuple(slews), "rate_sensor": sensor}
    return replace(campaign, **kept, reference=None, prior=None)


def path_of(entry: Entry) -> str:
    """The key of an entry; of several wheels' one for all."""
    if len(set(entry.paths)) == 1:
        return entry.path
    return f"actuators.*.{entry.path.rpartition('.')[2]}"


def key_changes(entry: Entry, key: str, mended: Any) -> tuple[KeyChange, ...]:
    """What another value of a key of some columns changes in the file; of names, each column's."""
    stated = getattr(entry.columns, key)
    paths = dict.fromkeys(entry.paths)
    if key == "names" and len(paths) > 1:
        of_columns = zip(entry.paths, stated, mended, strict=True)
        return tuple(KeyChange(f"{p}.names", [a], [b]) for p, a, b in of_columns if a != b)
    return tuple(KeyChange(f"{path}.{key}", stated, mended) for path in paths)


def further_sensors(campaign: Campaign) -> Iterator[tuple[SensorStream, Campaign]]:
    """Each further sensor of a kind that has a first one, and a campaign that has it in its place.

    Sensors of directions stay.
    """
    beside = direction_sensors(campaign)
    for name, hardware in campaign.more_sensors:
        kind = KINDS.get(type(hardware))
        if kind is None or not kind.first:
            continue
        stream, slews = kind(name), []
        for slew in campaign.slews:
            readings = stream.of(slew)
            more = {n: v for n, v in (slew.more or {}).items() if n in dict(beside)}
            changed: dict[str, Any] = {"more": more or None, kind.written[0]: readings}
            known = readings is not None and np.isfinite(readings).any(axis=1).sum() > 1
            slews += [replace(slew, **changed)] if known else []
        if slews:
            # The first of a kind sits as it is stated, and no other is there to refer to.
            alone: dict[str, Any] = {kind.first: replace(hardware, mounting_sigma=None)}
            alone |= {"slews": tuple(slews), "dirt": (), "reference": None}
            yield stream, replace(campaign, more_sensors=tuple(beside), **alone)
