"""Readings of telemetry under stated or supposed conventions, and a supposed mistake.

Every convention acts linearly on what was read: units are factors, orders permutations, signs
signs, frames rotations. So a wrong convention is undone without reading the files again.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.description import Description, Entry
from bayes_inertia.campaign.hardware import (
    DirectionSensor,
    RateSensor,
    StarTracker,
    axes_to_body,
    axis_names,
)
from bayes_inertia.campaign.slew_parts import INPUTS, MORE

Columns = Mapping[str, Mapping[str, Any]]
"""What `[columns]` of campaign.toml states, by its entries."""


class Stream(NamedTuple):
    """Channel of `Slew` and field of `Reading` that hold an entry of `[columns]`, and its names."""

    channel: str
    field: str
    quantity: str
    readings: str


STREAMS: Mapping[str, Stream] = {
    "attitude": Stream("attitude", "attitude", "the star tracker", "star-tracker fixes"),
    "rate": Stream("rate", "rate", "the rate", "rates"),
    "wheel_torque": Stream("wheel_torque", "torque", "the wheel torque", "torque commands"),
    "wheel_momentum": Stream(
        "wheel_momentum", "momentum", "the wheel momentum", "tachometer readings"
    ),
    "wheel_speed": Stream("wheel_momentum", "momentum", "the wheel speed", "tachometer readings"),
}
"""Streams that the laws are held against, by their entry of `[columns]`."""


def direction_sensors(campaign: Campaign) -> list[tuple[str, DirectionSensor]]:
    """The direction sensors of a campaign, by their names."""
    return [(n, s) for n, s in campaign.more_sensors if isinstance(s, DirectionSensor)]


def readings_of(campaign: Campaign, channel: str) -> list[np.ndarray]:
    """Readings (n, columns) of a channel of `Slew`, of each slew that has them."""
    given = [getattr(slew, channel) for slew in campaign.slews]
    return [np.asarray(values) for values in given if values is not None]


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
    """What devices and named effects do to the body; told when it is first asked for."""

    campaign: Campaign
    teller: Teller = untold

    @cached_property
    def by_slew(self) -> Mapping[str, ToldTorque]:
        """By the name of a slew."""
        return self.teller(self.campaign)

    def tobytes(self) -> bytes:
        """What these torques, and no others, are kept under."""
        return id(self).to_bytes(8, "little")


@dataclass(frozen=True, eq=False)
class Reading:
    """Conversion of telemetry, as the campaign states it, into physics."""

    rate: np.ndarray  # (n, n): from the rate sensor's columns to the rates along its axes
    rate_axes_B: np.ndarray  # (n, 3): those axes, as rows
    time: float  # Factor on time
    attitude: np.ndarray  # (4, 4): from the quaternion as stated to body from inertial, scalar last
    # torque, momentum: (wheels, wheels): from the columns to the torque and momentum of each wheel
    torque: np.ndarray
    momentum: np.ndarray
    axes_B: np.ndarray  # (3, wheels): spin axes of the wheels, as columns
    inertia: np.ndarray  # (3, 3): inertia with locked wheels [kg m^2]
    directions: np.ndarray  # (sensors, 3, 3): from each direction sensor's columns to its vector
    references: np.ndarray  # (sensors, 3, 3): from what each is said to look at to what is there
    bias_B: np.ndarray  # (3,): what the rate still shows of a body at rest, along body axes [rad/s]
    torques: ToldTorques  # on the body, by what is not a wheel

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
        along_axes, own = self.axes_to_body, len(self.rate)
        return np.column_stack([along_axes[:, :own] @ self.rate, along_axes[:, own:]])


def stated_reading(
    campaign: Campaign, torques: ToldTorques | None = None, smoothed: int = 0
) -> Reading:
    """The reading that a campaign states: scale factors and axes of its hardware, told torques.

    `smoothed`: how many axes of the rate sensor, the last ones, are no sensor's own.
    """
    sensor, axes_B = campaign.gyro, campaign.wheel_axes_B
    own = len(sensor.axes) - smoothed
    same = np.eye(len(campaign.wheels))
    vectors = np.tile(np.eye(3), (len(direction_sensors(campaign)), 1, 1))
    spin = (axes_B * campaign.spin_inertias) @ axes_B.T
    prior = campaign.inertia
    return Reading(
        rate=np.diag(sensor.scale_factor[:own]),
        rate_axes_B=sensor.axes[:own],
        time=1.0,
        attitude=np.eye(4),
        torque=same,
        momentum=same,
        axes_B=axes_B,
        inertia=prior.tensor + (0.0 if prior.includes_wheel_spin else 1.0) * spin,
        directions=vectors,
        references=vectors,
        bias_B=axes_to_body(sensor.axes[:own]) @ np.asarray(sensor.bias[:own]),
        torques=torques or ToldTorques(campaign),
    )


@dataclass(frozen=True)
class KeyChange:
    """One key of campaign.toml and the value it should have."""

    key: str  # Path of the key, such as "columns.rate.unit" or "wheels.x.axis"
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
    # From the reading as stated to the reading without the mistake
    mend: Callable[[Reading], Reading]
    words: str  # What went wrong, as the end of a sentence that begins with "It looks as if"


def changed(**how: Callable[[Any], Any]) -> Callable[[Reading], Reading]:
    """A reading some of whose fields are what functions make of them."""
    return lambda reading: replace(
        reading, **{field: change(getattr(reading, field)) for field, change in how.items()}
    )


def both(first: Mistake, second: Mistake) -> Mistake:
    """Two mistakes at once."""
    return Mistake(
        changes=first.changes + second.changes,
        rarity=first.rarity + second.rarity,
        mend=lambda reading: second.mend(first.mend(reading)),
        words=f"{first.words}, and {second.words}",
    )


# A campaign built in memory is in SI units and has the package's senses.
_IN_MEMORY: dict[str, dict[str, Any]] = {
    "time": {"names": ["time"], "unit": "s"},
    "wheel_torque": {"unit": "N m", "acts_on": "wheel"},
    "wheel_momentum": {"unit": "N m s", "relative_to": "body"},
    "attitude": {
        "names": ["q1", "q2", "q3", "q4"],
        "scalar": "last",
        "maps": "inertial_to_body",
    },
}


def stated_columns(
    campaign: Campaign, description: Description | None = None
) -> dict[str, Mapping[str, Any]]:
    """What a campaign states of its columns, under the keys of `[columns]`.

    A campaign in memory is in SI units. Wheels whose columns are in several units or tables are
    left out.
    """
    rates = [f"rate_{axis}" for axis in axis_names(campaign.rate_sensor)]
    columns: dict[str, Mapping[str, Any]] = {
        "time": description.time.model_dump() if description else _IN_MEMORY["time"],
        "rate": {"names": rates, "unit": "rad/s"},
    }
    for entry in () if description is None else _first(description):
        if not entry.wheels or len(entry.wheels) == len(campaign.wheels):
            columns[entry.key] = entry.columns.model_dump()
    for key in () if description else ("wheel_torque", "wheel_momentum", "attitude"):
        if any(getattr(slew, key) is not None for slew in campaign.slews):
            names = [f"{key}.{wheel.name}" for wheel in campaign.wheels]
            columns[key] = {"names": names, **_IN_MEMORY[key]}
    return columns | _direction_columns(campaign, description)


def _direction_columns(
    campaign: Campaign, description: Description | None
) -> dict[str, Mapping[str, Any]]:
    """Columns of each direction sensor and of a reference of its own, by keys of format 2.

    `path` is the key under which the file has them.
    """
    entries = () if description is None else description.entries
    columns: dict[str, Mapping[str, Any]] = {}
    for name, sensor in direction_sensors(campaign):
        in_memory = {"names": ["x", "y", "z"], "unit": sensor.unit or None}
        keys = {"direction": f"{MORE}{name}"}
        if any(name in (slew.inputs or {}) for slew in campaign.slews):
            keys["reference"] = f"{INPUTS}{name}"
        for key, field in keys.items():
            of_file = [e for e in entries if e.field == field]
            path = of_file[0].path if of_file else f"sensors.{name}.{key}"
            written = of_file[0].columns.model_dump() if of_file else in_memory
            columns[f"sensors.{name}.{key}"] = {**written, "path": path}
    return columns


def of_wheels(description: Description, names: Sequence[str]) -> Description:
    """A description of format 2 whose columns are of some of the wheels only."""
    entries = []
    for entry in description.entries:
        of = [description.wheels[i].name for i in entry.wheels]
        kept = [k for k, name in enumerate(of) if name in names]
        if len(kept) < len(of):
            columns = [entry.columns.names[k] for k in kept]
            entry = replace(
                entry,
                columns=entry.columns.model_copy(update={"names": columns}),
                paths=tuple(entry.paths[k] for k in kept),
                wheels=tuple(names.index(of[k]) for k in kept),
            )
        entries += [entry] if kept or not of else []
    return replace(description, entries=tuple(entries))


# Keys of the readings in a slew and of the hardware, for sensors that the laws are held against.
LIKE_THE_FIRST = {RateSensor: ("rate", "rate_sensor"), StarTracker: ("attitude", "star_tracker")}


def in_place_of_the_first(campaign: Campaign) -> Iterator[tuple[str, Campaign]]:
    """For each further rate sensor and star tracker, its name and a campaign that has it alone.

    Sensors of directions stay.
    """
    beside = direction_sensors(campaign)
    for name, hardware in campaign.more_sensors:
        if type(hardware) not in LIKE_THE_FIRST:
            continue
        key, of_hardware = LIKE_THE_FIRST[type(hardware)]
        slews = []
        for slew in campaign.slews:
            readings = (slew.more or {}).get(name)
            more = {n: v for n, v in (slew.more or {}).items() if n in dict(beside)}
            changed: dict[str, Any] = {"more": more or None, key: readings}
            known = readings is not None and np.isfinite(readings).any(axis=1).sum() > 1
            slews += [replace(slew, **changed)] if known else []
        if slews:
            # The first of a kind sits as it is stated, and no other is there to refer to.
            alone: dict[str, Any] = {of_hardware: replace(hardware, mounting_sigma=None)}
            alone |= {"slews": tuple(slews), "dirt": (), "reference": None}
            yield name, replace(campaign, more_sensors=tuple(beside), **alone)


def description_for(description: Description | None, name: str) -> Description | None:
    """What the description says of a further sensor, as if it were the first of its kind."""
    if description is None:
        return None
    entry = next(e for e in description.entries if e.field == f"{MORE}{name}")
    first = replace(entry, field=entry.key)
    others = [e for e in description.entries if e.field != entry.key and e is not entry]
    table = "rate_sensor" if entry.key == "rate" else "star_tracker"
    devices = {**description.devices, table: f"sensors.{name}"}
    return replace(description, entries=(first, *others), devices=devices)


def _first(description: Description) -> Iterator[Entry]:
    """Entries of the sensors, wheels and environment that format 1 knows."""
    return (entry for entry in description.entries if "." not in entry.field)


def as_written(mistake: Mistake, description: Description | None) -> Mistake:
    """A mistake with the keys of the campaign's own description."""
    if description is None or not description.devices:
        return mistake
    entries = {entry.key: entry for entry in _first(description)}
    rewritten = (_rewritten(old, entries, description) for old in mistake.changes)
    return replace(mistake, changes=tuple(new for each in rewritten for new in each))


def _rewritten(
    change: KeyChange, entries: Mapping[str, Entry], description: Description
) -> Iterator[KeyChange]:
    table, _, rest = change.key.partition(".")
    key, _, last = rest.rpartition(".")
    if table == "columns" and key in entries:
        entry = entries[key]
        for k, path in enumerate(entry.paths):
            stated, mended = change.stated, change.mended
            if last == "names" and len(entry.paths) > 1:
                stated, mended = [stated[k]], [mended[k]]
            if stated != mended:
                yield KeyChange(f"{path}.{last}", stated, mended)
    elif table == "wheels" and last == "momentum_sigma":
        # The noise stands beside the columns of the tachometers, or among the wheel's own keys.
        beside = entries["wheel_momentum"].columns.sigma is not None
        yield replace(change, key=f"actuators.{key}.momentum{'.' if beside else '_'}sigma")
    else:
        yield replace(change, key=in_words(change.key, description))


def in_words(text: str, description: Description | None) -> str:
    """A text in which keys are those of the campaign's own description."""
    if description is None or not description.devices:
        return text
    paths = {entry.key: _any_wheel(entry.paths) for entry in _first(description)}
    text = re.sub(r"\bcolumns\.(\w+)", lambda m: paths.get(m[1], m[1]), text)
    for old, new in description.devices.items():
        text = re.sub(rf"\b{re.escape(old)}\.", f"{new}.".replace("\\", r"\\"), text)
    return text


def _any_wheel(paths: Sequence[str]) -> str:
    """One key for those of all wheels."""
    if len(paths) == 1:
        return paths[0]
    return f"actuators.*.{paths[0].rpartition('.')[2]}"
