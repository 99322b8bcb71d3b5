"""What a campaign states, and readings of telemetry under stated or supposed conventions.

Every convention acts linearly on what was read: units are factors, orders permutations, signs
signs, frames rotations. So a wrong convention is undone without reading the files again.

Stated are columns and hardware, by keys of the description: columns are those of its own list, in
keys of its own format. A campaign in memory states what `write_campaign` writes of it, in SI units
and with the package's senses.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from bayes_inertia.campaign.actuators import Actuator, Magnetorquer
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.description import FIELDS, Description, Entry
from bayes_inertia.campaign.hardware import DirectionSensor, Wheel, axes_to_body
from bayes_inertia.campaign.parsed_description import parse_description
from bayes_inertia.campaign.sensors import ATTITUDE, BY_KEY, KINDS, RATE, STREAMS, SensorStream
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.campaign.slew_parts import INPUTS, MORE
from bayes_inertia.campaign.writer import content_of
from bayes_inertia.errors import CampaignError, OutputError

# Fields of `Slew` that are no sensor's: commands of the wheels, and the magnetic field.
TORQUE, FIELD = "wheel_torque", FIELDS["magnetic_field"]


def direction_sensors(campaign: Campaign) -> list[tuple[str, DirectionSensor]]:
    """The direction sensors of a campaign, by their names."""
    return [(n, s) for n, s in campaign.more_sensors if isinstance(s, DirectionSensor)]


def readings_of(campaign: Campaign, channel: str) -> list[np.ndarray]:
    """Readings (n, columns) of a channel of `Slew`, of each slew that has them."""
    given = [getattr(slew, channel) for slew in campaign.slews]
    return [np.asarray(values) for values in given if values is not None]


@dataclass(frozen=True, eq=False)
class Reading:
    """Conversion of telemetry, as the campaign states it, into physics."""

    time: float  # Factor on time
    # By field of `Slew`: (k, k), from a reading as stated to what it is; as stated where none is
    matrices: Mapping[str, np.ndarray]
    rate_axes_B: np.ndarray  # (n, 3): axes of the rate sensor, as rows
    axes_B: np.ndarray  # (3, wheels): spin axes of the wheels, as columns
    inertia: np.ndarray  # (3, 3): inertia with locked wheels [kg m^2]
    bias_B: np.ndarray  # (3,): what the rate still shows of a body at rest, along body axes [rad/s]
    actuators: tuple[Actuator, ...]  # Devices beside wheels

    def of(self, stream: str, values: np.ndarray) -> np.ndarray:
        """Readings (..., k) of a field of `Slew` as they are, from those as stated."""
        return values @ self.matrices[stream].T if stream in self.matrices else values

    def matrix(self, stream: str, columns: int) -> np.ndarray:
        """(k, k): from a reading of a field of `Slew`, of k columns, to what it is."""
        return self.matrices.get(stream, np.eye(columns))

    def with_matrix(self, stream: str, matrix: np.ndarray) -> Reading:
        """The same with another matrix of a field of `Slew`."""
        return replace(self, matrices={**self.matrices, stream: matrix})

    def key(self, *parts: str) -> tuple[bytes, ...]:
        """What fields of this reading, and matrices of fields of `Slew`, are known by."""
        found = (self.matrices.get(part, getattr(self, part, None)) for part in parts)
        return tuple(b"" if part is None else part.tobytes() for part in found)

    @property
    def devices(self) -> np.ndarray:
        """What the records of the actuators, and no others, are known by."""
        return np.array([id(device) for device in self.actuators])

    @property
    def axes_to_body(self) -> np.ndarray:
        """(3, n), of two axes and fewer (3, n + 3): from rates along axes to the body's rate.

        The last three are rates of the body as other sensors tell them, where no axis reads.
        """
        along_axes = axes_to_body(self.rate_axes_B)
        if len(self.rate_axes_B) > 2:
            return along_axes
        return np.column_stack([along_axes, np.eye(3) - along_axes @ self.rate_axes_B])

    @property
    def body_rate(self) -> np.ndarray:
        """The same from the columns of `SampledSlews.rate`."""
        along_axes, own = self.axes_to_body, len(self.rate_axes_B)
        return np.column_stack(
            [along_axes[:, :own] @ self.matrices[RATE.field], along_axes[:, own:]]
        )


def stated_reading(campaign: Campaign, smoothed: int = 0) -> Reading:
    """The reading that a campaign states: scale factors, axes and records of its hardware.

    `smoothed`: how many axes of the rate sensor, the last ones, are no sensor's own.
    """
    sensor, axes_B = campaign.gyro, campaign.wheel_axes_B
    own = len(sensor.axes) - smoothed
    spin = (axes_B * campaign.spin_inertias) @ axes_B.T
    prior = campaign.inertia
    return Reading(
        time=1.0,
        matrices={RATE.field: np.diag(sensor.scale_factor[:own])},
        rate_axes_B=sensor.axes[:own],
        axes_B=axes_B,
        inertia=prior.tensor + (0.0 if prior.includes_wheel_spin else 1.0) * spin,
        bias_B=axes_to_body(sensor.axes[:own]) @ np.asarray(sensor.bias[:own]),
        actuators=tuple(campaign.actuators),
    )


Mend = Callable[[Reading], Reading]
"""From a reading with a mistake to the reading without it."""


def unmended(reading: Reading) -> Reading:
    """The reading as it is: that of a mistake of no convention."""
    return reading


def followed(stream: str, matrix: np.ndarray) -> Mend:
    """A reading in which a matrix, as of a unit or sense, follows that of a field of `Slew`."""
    if stream == "time":
        return lambda reading: replace(reading, time=float(matrix[0, 0]) * reading.time)
    return lambda reading: reading.with_matrix(stream, matrix @ reading.matrix(stream, len(matrix)))


def preceded(stream: str, matrix: np.ndarray) -> Mend:
    """A reading in which a matrix, as of columns in their order, precedes that of a field."""
    return lambda reading: reading.with_matrix(stream, reading.matrix(stream, len(matrix)) @ matrix)


@dataclass(frozen=True, eq=False)
class ToldTorque:
    """The torque on the body in one slew that effects told, in body axes."""

    time: np.ndarray  # (n,): moments on the slew's own clock [s]
    # (n, 3): integral of the torque since the first of them, at the priors' means [N m s]
    impulse_B: np.ndarray
    doubt: np.ndarray  # (n,): integral of the size by which the priors' sds may change it [N m s]
    carried_B: np.ndarray  # (n, 3): momentum that devices carry inside [N m s]

    def at(self, moments: np.ndarray) -> np.ndarray:
        """Impulse, doubt and carried momentum (N, 7) at moments (N,) [s]."""
        columns = np.column_stack([self.impulse_B, self.doubt, self.carried_B])
        return np.stack([np.interp(moments, self.time, column) for column in columns.T], axis=-1)


Teller = Callable[[Campaign], Mapping[str, ToldTorque]]
"""What effects do to the body of a campaign, by the name of a slew."""


def untold(campaign: Campaign) -> Mapping[str, ToldTorque]:
    """Of a campaign without devices or effects of its own."""
    return {}


@dataclass(frozen=True, eq=False)
class ToldTorques:
    """What devices and named effects do to the body; told once for each reading of theirs."""

    campaign: Campaign
    teller: Teller = untold
    kept: dict = field(default_factory=dict)

    @property
    def parts(self) -> tuple[str, ...]:
        """Which parts of a reading they depend on."""
        devices = self.campaign.actuators
        turned = [FIELD] if any(isinstance(device, Magnetorquer) for device in devices) else []
        return ("devices", *turned, *(f"{INPUTS}{device.name}" for device in devices))

    def under(self, reading: Reading) -> Mapping[str, ToldTorque]:
        """Torques by the name of a slew, under a reading of what devices were told."""
        key = reading.key(*self.parts)
        if key not in self.kept:
            self.kept[key] = self._told(reading)
        return self.kept[key]

    def _told(self, reading: Reading) -> Mapping[str, ToldTorque]:
        try:
            slews = tuple(_told_otherwise(slew, reading) for slew in self.campaign.slews)
            return self.teller(replace(self.campaign, slews=slews, actuators=reading.actuators))
        except CampaignError:  # Such as a pulse that is on when the next begins: no such mistake.
            return self.teller(self.campaign)


def as_read(campaign: Campaign, reading: Reading, noise: Mapping[str, np.ndarray]) -> Campaign:
    """A campaign whose fixes and vectors, and what these look at, are those of a reading.

    `noise`: believed sd of the readings of each stream, in the units stated.
    """
    sensors, slews = dict(campaign.more_sensors), []
    for name, sensor in direction_sensors(campaign):
        changed: dict[str, Any] = {}
        if (constant := f"{MORE}{name}.reference_N") in reading.matrices:
            changed["reference_N"] = reading.of(constant, np.array(sensor.reference_N))
        if sensor.is_field and noise[name].all():
            changed["sigma"] = np.abs(reading.matrix(f"{MORE}{name}", 3)) @ noise[name]
        sensors[name] = replace(sensor, **changed)
    for slew in campaign.slews:
        seen = {name: reading.of(f"{MORE}{name}", x) for name, x in (slew.more or {}).items()}
        fixes = None if slew.attitude is None else reading.of(ATTITUDE.field, slew.attitude)
        slews.append(replace(_told_otherwise(slew, reading), attitude=fixes, more=seen or None))
    return replace(campaign, more_sensors=tuple(sensors.items()), slews=tuple(slews))


def _told_otherwise(slew: Slew, reading: Reading) -> Slew:
    """A slew whose inputs and magnetic field are those of a reading."""
    inputs = dict(slew.inputs or {})
    for name, stream in inputs.items():
        if f"{INPUTS}{name}" in reading.matrices:
            inputs[name] = replace(stream, values=reading.of(f"{INPUTS}{name}", stream.values))
    field_N = slew.magnetic_field_N
    if field_N is not None and FIELD in reading.matrices:
        slew = replace(slew, magnetic_field_N=reading.of(FIELD, field_N))
    return replace(slew, inputs=inputs) if inputs else slew


@dataclass(frozen=True)
class KeyChange:
    """One key of campaign.toml and the value it should have."""

    key: str  # Path of the key, such as "sensors.gyro.rate.unit" or "actuators.x.axis"
    # stated, mended: its value as written, and the value that it should have
    stated: Any
    mended: Any


@dataclass(frozen=True)
class Mistake:
    """One mistake that somebody may have made."""

    changes: tuple[KeyChange, ...]  # What mends it; several keys where one mistake shows in several
    # How seldom the mistake is made, from 1; of two that explain the data alike the more common one
    # is proposed
    rarity: int
    mend: Mend
    words: str  # What went wrong, as the end of a sentence that begins with "It looks as if"
    # What must be added to the time stamps of fields of `Slew` [s]
    shifts: Mapping[str, float] = field(default_factory=dict)


def both(first: Mistake, second: Mistake) -> Mistake:
    """Two mistakes at once."""
    return Mistake(
        changes=first.changes + second.changes,
        rarity=first.rarity + second.rarity,
        mend=lambda reading: second.mend(first.mend(reading)),
        words=f"{first.words}, and {second.words}",
    )


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
            if entry.wheels:
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
