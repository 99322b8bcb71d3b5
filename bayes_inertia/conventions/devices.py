"""Mistakes in what devices beside wheels were told: units, order, signs and frame of their inputs.

Each is the campaign with other inputs, or another record of the device, whose torques are told
anew when the mistake is tried. Rarities are those of `candidates`. A sign is written in `names`, as
a minus before a column.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from bayes_inertia.campaign.actuators import (
    DEVICE_INPUTS,
    Actuator,
    GimballedRotors,
    KnownTorque,
    Magnetorquer,
    Thruster,
)
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.description import FIELDS, Description
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.campaign.slew_parts import INPUTS
from bayes_inertia.conventions.candidates import (
    Stated,
    is_of_earth,
    listed,
    of_columns,
    unmended,
)
from bayes_inertia.conventions.reading import (
    Columns,
    Mistake,
    Reading,
    ToldTorque,
    ToldTorques,
    direction_sensors,
)
from bayes_inertia.errors import CampaignError


def device_mistakes(
    torques: ToldTorques, columns: Columns, description: Description | None = None
) -> Iterator[Mistake]:
    """All single mistakes in the devices' inputs, and in the field of the environment."""
    campaign = torques.campaign
    for device in campaign.actuators:
        stated = _stated(f"{INPUTS}{device.name}", description) or _in_memory(device)
        # No thrust is negative.
        signs = not isinstance(device, Thruster)
        vector = isinstance(device, KnownTorque)
        for matrix, tried in of_columns(stated, device.name, signs=signs, turned_axes=vector):
            yield replace(tried, mend=_told_by(_with_input(device.name, matrix), torques))
        for record, tried in _of_record(device):
            yield replace(tried, mend=_told_by(_with_record(record), torques))
    yield from _of_field(torques, columns, description)


def _of_field(
    torques: ToldTorques, columns: Columns, description: Description | None
) -> Iterator[Mistake]:
    """Mistakes in the field of the environment, one for torquers and all that look at it."""
    campaign, field = torques.campaign, FIELDS["magnetic_field"]
    given = [s.magnetic_field_N for s in campaign.slews if s.magnetic_field_N is not None]
    in_memory = Stated("environment.field", "magnetic_field", "T", ["x", "y", "z"])
    # The field of an orbit is in no column.
    stated = in_memory if description is None else _stated(field, description)
    looking = _looks_at_field(campaign, columns)
    turns = any(isinstance(device, Magnetorquer) for device in campaign.actuators)
    if stated is None or not given or not (turns or looking.any()):
        return
    of_unit = 2 if is_of_earth(given) else 1
    for matrix, tried in of_columns(stated, "the magnetic field", of_unit=of_unit, rarer=1):
        told = _told_by(_with_other_field(matrix), torques) if turns else tried.mend
        yield replace(tried, mend=_with_field(matrix, looking, told))


def _with_field(
    matrix: np.ndarray, looking: np.ndarray, told: Callable[[Reading], Reading]
) -> Callable[[Reading], Reading]:
    """From a reading to one with another field for some direction sensors, and told torques."""

    def mend(reading: Reading) -> Reading:
        references = np.array(reading.references)
        references[looking] = references[looking] @ matrix
        return told(replace(reading, references=references))

    return mend


def _stated(field: str, description: Description | None) -> Stated | None:
    """What the description says of the columns of a field of `Slew`."""
    for entry in () if description is None else description.entries:
        if entry.field == field:
            names = list(entry.columns.names)
            return Stated(entry.path, entry.key, entry.columns.unit, names)
    return None


def _in_memory(device: Actuator) -> Stated:
    told = DEVICE_INPUTS[type(device)]
    names = [f"{device.name}_{i + 1}" for i in range(device.columns)]
    return Stated(f"actuators.{device.name}.{told.key}", told.quantity, told.unit, names)


# From a campaign to the same with a mistake undone.
_Undone = Callable[[Campaign], Campaign]


def _with_input(name: str, matrix: np.ndarray) -> _Undone:
    """A device's input has other values."""

    def mended(slew: Slew) -> Slew:
        stream = (slew.inputs or {}).get(name)
        if stream is None:
            return slew
        changed = replace(stream, values=stream.values @ matrix.T)
        return replace(slew, inputs={**(slew.inputs or {}), name: changed})

    return lambda campaign: replace(campaign, slews=tuple(map(mended, campaign.slews)))


def _with_other_field(matrix: np.ndarray) -> _Undone:
    """The magnetic field has other values."""

    def mended(slew: Slew) -> Slew:
        field_N = slew.magnetic_field_N
        return slew if field_N is None else replace(slew, magnetic_field_N=field_N @ matrix.T)

    return lambda campaign: replace(campaign, slews=tuple(map(mended, campaign.slews)))


def _with_record(device: Actuator) -> _Undone:
    """A device has another record."""

    def undone(campaign: Campaign) -> Campaign:
        others = (d if d.name != device.name else device for d in campaign.actuators)
        return replace(campaign, actuators=tuple(others))

    return undone


def _told_by(undone: _Undone, torques: ToldTorques) -> Callable[[Reading], Reading]:
    """From a reading to one whose torques a changed campaign tells."""

    def teller(campaign: Campaign) -> Mapping[str, ToldTorque]:
        try:
            return torques.teller(undone(campaign))
        except CampaignError:  # Such as a pulse that is on when the next begins: no such mistake.
            return torques.by_slew

    told = ToldTorques(torques.campaign, teller)
    return lambda reading: replace(reading, torques=told)


def _looks_at_field(campaign: Campaign, columns: Columns) -> np.ndarray:
    """Which direction sensors (sensors,) that a law holds look at the field of the environment."""
    return np.array(
        [
            f"sensors.{name}.direction" in columns
            and f"sensors.{name}.reference" not in columns
            and sensor.reference_N is None
            for name, sensor in direction_sensors(campaign)
        ],
        dtype=bool,
    )


def _of_record(device: Actuator) -> Iterator[tuple[Actuator, Mistake]]:
    """Mistakes in the numbers of a device, and the device without them."""
    if isinstance(device, KnownTorque):
        other: Any = "inertial" if device.frame == "body" else "body"
        words = f"{device.name} is along {other} axes, not along {device.frame} axes"
        key = f"actuators.{device.name}.torque.frame"
        yield replace(device, frame=other), unmended(key, device.frame, other, 4, words)
    elif isinstance(device, Thruster):
        for torque_B, tried in _negated(device.name, "torques", device.torque_B):
            yield replace(device, torque_B=torque_B), tried
    elif isinstance(device, GimballedRotors):
        for spin_B, tried in _negated(device.name, "spin_axes_at_zero", device.spin_axes_at_zero_B):
            yield replace(device, spin_axes_at_zero_B=spin_B), tried


def _negated(name: str, key: str, vectors: np.ndarray) -> Iterator[tuple[np.ndarray, Mistake]]:
    """All vectors (k, 3) of a device with the other sign, or one."""
    count = len(vectors)
    for which in (range(count), *([k] for k in range(count if count > 1 else 0))):
        mended = vectors.copy()
        mended[list(which)] *= -1.0
        said = "all" if len(which) == count else f"number {which[0] + 1} of"
        words = f"{said} {key.replace('_', ' ')} point the other way: {name}"
        path = f"actuators.{name}.{key}"
        yield mended, unmended(path, listed(vectors), listed(mended), 3, words)
