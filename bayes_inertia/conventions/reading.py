"""Readings of telemetry under stated or supposed conventions, and a supposed mistake.

Every convention acts linearly on what was read: units are factors, orders permutations, signs
signs, frames rotations. So a wrong convention is undone without reading the files again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from bayes_inertia.campaign.actuators import Actuator, Magnetorquer
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.description import FIELDS
from bayes_inertia.campaign.hardware import DirectionSensor, axes_to_body
from bayes_inertia.campaign.sensors.attitude import ATTITUDE
from bayes_inertia.campaign.sensors.rate import RATE
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.campaign.slew_parts import INPUTS, MORE
from bayes_inertia.errors import CampaignError

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


def with_values(**values: Any) -> Mend:
    """A reading with other values of some of its fields."""
    return lambda reading: replace(reading, **values)


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
