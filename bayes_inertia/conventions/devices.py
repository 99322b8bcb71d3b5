"""Mistakes in what devices beside wheels were told: units, order, signs and frame of their inputs.

Each is the campaign with other inputs, or another record of the device, whose torques are told
anew when the mistake is tried. Rarities are those of `candidates`. A sign is written in `names`, as
a minus before a column.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
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
    one_key,
    signed,
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
        mended = partial(_with_input, torques, device.name)
        yield from of_columns(stated, device.name, mended, signs=signs, turned_axes=vector)
        for record, tried in _of_record(device):
            yield replace(tried, mend=_with_record(torques, record))
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

    def mended(matrix: np.ndarray) -> Callable[[Reading], Reading]:
        told = _with_other_field(torques, matrix) if turns else unmended

        def mend(reading: Reading) -> Reading:
            references = np.array(reading.references)
            references[looking] = references[looking] @ matrix
            return told(replace(reading, references=references))

        return mend

    yield from of_columns(stated, "the magnetic field", mended, of_unit=of_unit, rarer=1)


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


# From a reading to one without a mistake.
_Mend = Callable[[Reading], Reading]


def _with_input(torques: ToldTorques, name: str, matrix: np.ndarray) -> _Mend:
    """A device's input has other values."""

    def mended(slew: Slew) -> Slew:
        inputs = slew.inputs or {}
        if name not in inputs:
            return slew
        changed = replace(inputs[name], values=inputs[name].values @ matrix.T)
        return replace(slew, inputs={**inputs, name: changed})

    return _told_by(torques, lambda slews: {"slews": tuple(map(mended, slews))})


def _with_other_field(torques: ToldTorques, matrix: np.ndarray) -> _Mend:
    """The magnetic field has other values."""

    def mended(slew: Slew) -> Slew:
        field_N = slew.magnetic_field_N
        return slew if field_N is None else replace(slew, magnetic_field_N=field_N @ matrix.T)

    return _told_by(torques, lambda slews: {"slews": tuple(map(mended, slews))})


def _with_record(torques: ToldTorques, device: Actuator) -> _Mend:
    """A device has another record."""
    every = (d if d.name != device.name else device for d in torques.campaign.actuators)
    changed = {"actuators": tuple(every)}
    return _told_by(torques, lambda _: changed)


def _told_by(torques: ToldTorques, changed: Callable[[Sequence[Slew]], dict[str, Any]]) -> _Mend:
    """From a reading to one whose torques a changed campaign tells."""

    def teller(campaign: Campaign) -> Mapping[str, ToldTorque]:
        try:
            return torques.teller(replace(campaign, **changed(campaign.slews)))
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
        yield replace(device, frame=other), one_key(key, device.frame, other, 4, words)
    elif isinstance(device, Thruster | GimballedRotors):
        field = "torque_B" if isinstance(device, Thruster) else "spin_axes_at_zero_B"
        key = "torques" if isinstance(device, Thruster) else "spin_axes_at_zero"
        vectors, path = getattr(device, field), f"actuators.{device.name}.{key}"
        numbers = [f"number {k + 1}" for k in range(len(vectors))]
        what = f"{key.replace('_', ' ')}: {device.name}"
        for signs in signed(numbers, what, vector=False):
            changed: dict[str, Any] = {field: signs.matrix @ vectors}
            tried = one_key(path, listed(vectors), listed(changed[field]), 3, signs.words)
            yield replace(device, **changed), tried
