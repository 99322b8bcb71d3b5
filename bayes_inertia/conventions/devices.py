"""Mistakes in what devices beside wheels were told: units, order, signs and frame of their inputs.

Each is the campaign with other inputs, or another record of the device, whose torques are told
anew when the mistake is tried. Rarities are those of `candidates`. A sign is written in `names`, as
a minus before a column.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from bayes_inertia.campaign.actuators import (
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
from bayes_inertia.conventions.candidates import listed, orders
from bayes_inertia.conventions.reading import (
    KeyChange,
    Mistake,
    Reading,
    ToldTorques,
    direction_sensors,
)
from bayes_inertia.errors import CampaignError
from bayes_inertia.tables.table import negated_name


class _Columns(NamedTuple):
    """Key of some columns in the description, their quantity, unit and names."""

    path: str
    quantity: str
    unit: str
    names: list[str]


_OF_KIND: Mapping[type, tuple[str, str]] = {
    KnownTorque: ("torque", "wheel_torque"),
    Magnetorquer: ("dipole", "dipole"),
    Thruster: ("level", "level"),
    GimballedRotors: ("gimbal_angle", "angle"),
}
"""Key and quantity of each device's input."""
_FIELD = "magnetic_field_N"


def device_mistakes(
    torques: ToldTorques, description: Description | None = None
) -> Iterator[Mistake]:
    """All single mistakes in the devices' inputs, and in the field that torquers act on."""
    campaign = torques.campaign
    for device in campaign.actuators:
        columns = _stated(f"{INPUTS}{device.name}", description) or _in_memory(device)
        for mend, changes, rarity, words in (
            *_of_columns(columns, device.name, signs=not isinstance(device, Thruster)),
            *_of_record(device),
        ):
            changed = mend if isinstance(mend, _Record) else _Input(device.name, mend)
            yield _mistake(torques, changed, changes, rarity, words)
    if any(isinstance(device, Magnetorquer) for device in campaign.actuators):
        field = _stated(_FIELD, description)
        columns = field or _Columns("environment.field", "magnetic_field", "T", ["x", "y", "z"])
        for matrix, changes, rarity, words in _of_columns(columns, "the magnetic field"):
            yield _mistake(torques, _Field(matrix), changes, rarity, words)


def _stated(field: str, description: Description | None) -> _Columns | None:
    """What the description says of the columns of a field of `Slew`."""
    for entry in () if description is None else description.entries:
        if entry.field == field:
            names = list(entry.columns.names)
            return _Columns(entry.path, entry.key, entry.columns.unit, names)
    return None


def _in_memory(device: Actuator) -> _Columns:
    key, quantity = _OF_KIND[type(device)]
    names = [f"{device.name}_{i + 1}" for i in range(device.columns)]
    return _Columns(f"actuators.{device.name}.{key}", quantity, next(iter(UNITS[quantity])), names)


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


_Tried = tuple[Any, tuple[KeyChange, ...], int, str]
"""What changes, the keys that mend it, rarity, words."""


def _mistake(
    torques: ToldTorques,
    changed: _Input | _Field | _Record,
    changes: tuple[KeyChange, ...],
    rarity: int,
    words: str,
) -> Mistake:
    def teller(campaign: Campaign) -> Mapping[str, Any]:
        try:
            return torques.teller(changed.of(campaign))
        except CampaignError:  # Such as a pulse that is on when the next begins: no such mistake.
            return torques.by_slew

    told = ToldTorques(torques.campaign, teller)
    size = _size_of_field(changed.matrix) if isinstance(changed, _Field) else 1.0
    looking = np.where(_looks_at_field(torques.campaign), size, 1.0)[:, None, None]

    def mend(reading: Reading) -> Reading:
        return replace(reading, torques=told, directions=reading.directions / looking)

    return Mistake(changes, rarity, mend, words)


def _size_of_field(matrix: np.ndarray) -> float:
    """By how much a matrix makes the field larger."""
    return float(np.abs(np.linalg.det(matrix)) ** (1.0 / 3.0))


def _looks_at_field(campaign: Campaign) -> np.ndarray:
    """Which direction sensors compare with the field of the environment, in its unit."""
    return np.array(
        [
            sensor.is_field
            and sensor.reference_N is None
            and not any(name in (slew.inputs or {}) for slew in campaign.slews)
            for name, sensor in direction_sensors(campaign)
        ],
        dtype=bool,
    )


def _of_columns(columns: _Columns, what: str, *, signs: bool = True) -> Iterator[_Tried]:
    """Other units, orders and signs of columns, as matrices (k, k) on their values."""
    path, quantity, stated, names = columns
    same = np.eye(len(names))
    for unit, si in UNITS[quantity].items():
        if unit != stated:
            change = KeyChange(f"{path}.unit", stated, unit)
            words = f"{what} is in {unit}, not in {stated}"
            yield same * si / UNITS[quantity][stated], (change,), 1, words
    for order in orders(len(names)):
        change = KeyChange(f"{path}.names", names, [names[k] for k in order])
        yield same[order], (change,), 2, f"the columns of {what} stand in another order"
    for flipped in _flips(len(names)) if signs else ():
        sign = np.where(np.isin(np.arange(len(names)), flipped), -1.0, 1.0)
        mended = [negated_name(n) if s < 0.0 else n for n, s in zip(names, sign, strict=True)]
        which = (
            "all columns" if len(flipped) == len(names) else " and ".join(names[k] for k in flipped)
        )
        words = f"{which} of {what} {'have' if len(flipped) > 1 else 'has'} the other sign"
        change = KeyChange(f"{path}.names", names, mended)
        yield np.diag(sign), (change,), 3 if len(flipped) in (1, len(names)) else 4, words


def _flips(count: int) -> Iterator[tuple[int, ...]]:
    """Columns whose signs may be wrong together: all, one, or two of a vector."""
    yield tuple(range(count))
    if count > 1:
        yield from combinations(range(count), 1)
    if count == 3:
        yield from combinations(range(count), 2)


def _of_record(device: Actuator) -> Iterator[_Tried]:
    """Mistakes in the numbers of a device."""
    key = f"actuators.{device.name}"
    if isinstance(device, KnownTorque):
        other: Any = "inertial" if device.frame == "body" else "body"
        change = KeyChange(f"{key}.torque.frame", device.frame, other)
        words = f"{device.name} is along {other} axes, not along {device.frame} axes"
        yield _Record(replace(device, frame=other)), (change,), 4, words
    elif isinstance(device, Thruster):
        for change, mended, words in _negated_vectors(key, "torques", device.torque_B):
            yield _Record(replace(device, torque_B=mended)), (change,), 3, f"{words} {device.name}"
    elif isinstance(device, GimballedRotors):
        spin = device.spin_axes_at_zero_B
        for change, mended, words in _negated_vectors(key, "spin_axes_at_zero", spin):
            record = replace(device, spin_axes_at_zero_B=mended)
            yield _Record(record), (change,), 3, f"{words} {device.name}"


def _negated_vectors(
    key: str, field: str, vectors: np.ndarray
) -> Iterator[tuple[KeyChange, np.ndarray, str]]:
    """All vectors (k, 3) with the other sign, or one."""
    count = len(vectors)
    for which in (range(count), *([k] for k in range(count if count > 1 else 0))):
        mended = vectors.copy()
        mended[list(which)] *= -1.0
        change = KeyChange(f"{key}.{field}", listed(vectors), listed(mended))
        said = "all" if len(which) == count else f"number {which[0] + 1} of"
        yield change, mended, f"{said} {field.replace('_', ' ')} point the other way:"
