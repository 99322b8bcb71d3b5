"""Mistakes in what devices beside wheels were told: units, order, signs and frame of their inputs.

Each is the campaign with other inputs, or another record of the device, whose torques are told
anew when the mistake is tried. Rarities are those of `candidates`. A sign is written in `names`, as
a minus before a column.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

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
from bayes_inertia.campaign.description import Description
from bayes_inertia.campaign.schema import UNITS
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.campaign.slew_parts import INPUTS
from bayes_inertia.conventions.candidates import in_other_order, listed, signed
from bayes_inertia.conventions.reading import (
    KeyChange,
    Mistake,
    Reading,
    ToldTorque,
    ToldTorques,
    direction_sensors,
)
from bayes_inertia.errors import CampaignError


class _Columns(NamedTuple):
    """Key of some columns in the description, their quantity, unit and names."""

    path: str
    quantity: str
    unit: str
    names: list[str]


def device_mistakes(
    torques: ToldTorques, description: Description | None = None
) -> Iterator[Mistake]:
    """All single mistakes in the devices' inputs, and in the field that torquers act on."""
    campaign = torques.campaign
    for device in campaign.actuators:
        columns = _stated(f"{INPUTS}{device.name}", description) or _in_memory(device)
        # No thrust is negative.
        signs = not isinstance(device, Thruster)
        for matrix, tried in _of_columns(columns, device.name, signs=signs):
            yield replace(tried, mend=_told_by(_Input(device.name, matrix), torques))
        for record, tried in _of_record(device):
            yield replace(tried, mend=_told_by(_Record(record), torques))
    if any(isinstance(device, Magnetorquer) for device in campaign.actuators):
        yield from _of_field(torques, description)


def _of_field(torques: ToldTorques, description: Description | None) -> Iterator[Mistake]:
    """Mistakes in the field of the environment; another unit is one for magnetometers as well."""
    in_memory = _Columns("environment.field", "magnetic_field", "T", ["x", "y", "z"])
    columns = _stated(_FIELD, description) or in_memory
    looking = _looks_at_field(torques.campaign)
    for matrix, tried in _of_columns(columns, "the magnetic field"):
        size = np.cbrt(np.abs(np.linalg.det(matrix)))
        directions = np.where(looking, 1.0 / size, 1.0)[:, None, None]
        yield replace(tried, mend=_told_by(_Field(matrix), torques, directions))


_FIELD = "magnetic_field_N"


def _stated(field: str, description: Description | None) -> _Columns | None:
    """What the description says of the columns of a field of `Slew`."""
    for entry in () if description is None else description.entries:
        if entry.field == field:
            names = list(entry.columns.names)
            return _Columns(entry.path, entry.key, entry.columns.unit, names)
    return None


def _in_memory(device: Actuator) -> _Columns:
    told = DEVICE_INPUTS[type(device)]
    names = [f"{device.name}_{i + 1}" for i in range(device.columns)]
    return _Columns(f"actuators.{device.name}.{told.key}", told.quantity, told.unit, names)


class _Input(NamedTuple):
    """A device's input, whose values are others."""

    name: str
    matrix: np.ndarray

    def of(self, campaign: Campaign) -> Campaign:
        """The campaign with it."""

        def mended(slew: Slew) -> Slew:
            stream = (slew.inputs or {}).get(self.name)
            if stream is None:
                return slew
            changed = replace(stream, values=stream.values @ self.matrix.T)
            return replace(slew, inputs={**(slew.inputs or {}), self.name: changed})

        return replace(campaign, slews=tuple(map(mended, campaign.slews)))


class _Field(NamedTuple):
    """The magnetic field, whose values are others."""

    matrix: np.ndarray

    def of(self, campaign: Campaign) -> Campaign:
        """The campaign with it."""
        slews = (
            s
            if s.magnetic_field_N is None
            else replace(s, magnetic_field_N=s.magnetic_field_N @ self.matrix.T)
            for s in campaign.slews
        )
        return replace(campaign, slews=tuple(slews))


class _Record(NamedTuple):
    """Another record of a device."""

    device: Actuator

    def of(self, campaign: Campaign) -> Campaign:
        """The campaign with it."""
        others = (d if d.name != self.device.name else self.device for d in campaign.actuators)
        return replace(campaign, actuators=tuple(others))


def _told_by(
    changed: _Input | _Field | _Record, torques: ToldTorques, directions: np.ndarray | float = 1.0
) -> Callable[[Reading], Reading]:
    """From a reading to one whose torques a changed campaign tells.

    `directions` (sensors, 1, 1): factors on what the direction sensors read.
    """

    def teller(campaign: Campaign) -> Mapping[str, ToldTorque]:
        try:
            return torques.teller(changed.of(campaign))
        except CampaignError:  # Such as a pulse that is on when the next begins: no such mistake.
            return torques.by_slew

    told = ToldTorques(torques.campaign, teller)
    return lambda reading: replace(
        reading, torques=told, directions=reading.directions * directions
    )


def _looks_at_field(campaign: Campaign) -> np.ndarray:
    """Which direction sensors (sensors,) compare with the field of the environment."""
    given = {name for slew in campaign.slews for name in slew.inputs or {}}
    return np.array(
        [
            sensor.is_field and sensor.reference_N is None and name not in given
            for name, sensor in direction_sensors(campaign)
        ],
        dtype=bool,
    )


def _unmended(key: str, stated: Any, mended: Any, rarity: int, words: str) -> Mistake:
    """A mistake in one key that does not say yet how readings change with it."""
    return Mistake((KeyChange(key, stated, mended),), rarity, lambda reading: reading, words)


def _of_columns(
    columns: _Columns, what: str, *, signs: bool = True
) -> Iterator[tuple[np.ndarray, Mistake]]:
    """Other units, orders and signs of columns, as matrices (k, k) on their values."""
    path, quantity, stated, names = columns
    for unit, si in UNITS[quantity].items():
        if unit != stated:
            factor, words = si / UNITS[quantity][stated], f"{what} is in {unit}, not in {stated}"
            yield factor * np.eye(len(names)), _unmended(f"{path}.unit", stated, unit, 1, words)
    for other in (*in_other_order(names, what), *(signed(names, what) if signs else ())):
        tried = _unmended(f"{path}.names", names, other.names, other.rarity, other.words)
        yield other.matrix, tried


def _of_record(device: Actuator) -> Iterator[tuple[Actuator, Mistake]]:
    """Mistakes in the numbers of a device, and the device without them."""
    if isinstance(device, KnownTorque):
        other: Any = "inertial" if device.frame == "body" else "body"
        words = f"{device.name} is along {other} axes, not along {device.frame} axes"
        key = f"actuators.{device.name}.torque.frame"
        yield replace(device, frame=other), _unmended(key, device.frame, other, 4, words)
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
        yield mended, _unmended(path, listed(vectors), listed(mended), 3, words)
