"""Every mistake in conventions that is tried, from the most common to the rarest.

Units, and the order and direction of a quaternion, are mistaken most often (rarity 1); then the
order of columns and a unit that two columns share (2); then the sign of one axis or wheel (3); then
frames (4). That is the prior over mistakes: it decides only between mistakes that explain the data
alike.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, permutations, product
from typing import Any, NamedTuple

import numpy as np

from bayes_inertia.campaign.body_rates import reference_of
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.schema import UNITS
from bayes_inertia.conventions.limits import LIMITS
from bayes_inertia.conventions.reading import (
    STREAMS,
    Columns,
    KeyChange,
    Mistake,
    Reading,
    direction_sensors,
    reordered,
    scaled,
    turned,
)
from bayes_inertia.files import vocabulary
from bayes_inertia.tables.table import negated_name

# Units in which an inertia tensor is written by mistake, and what one is in kg m^2.
_INERTIA_UNITS: Mapping[str, float] = vocabulary("conventions")["inertia_units"]
# Names and field of `Reading` of what has a unit, or a column a wheel.
_NAMED = {"time": ("time", "time")} | {
    key: (stream.quantity, stream.field) for key, stream in STREAMS.items() if key != "attitude"
}
_OTHER_ORDERS = tuple(permutations(range(3)))[1:]


def mistakes(campaign: Campaign, columns: Columns) -> list[Mistake]:
    """All single mistakes that are tried for a campaign, the most common first."""
    every = [
        *_stream_mistakes(columns),
        *_attitude_mistakes(columns),
        *_sense_of_torque(columns),
        *_rate_mistakes(campaign, columns),
        *_wheel_axes(campaign, columns),
        *_shared_units(columns),
        *_inertia_mistakes(campaign),
        *_spin_inertias(campaign, columns),
        *_direction_mistakes(campaign, columns),
    ]
    return sorted(every, key=lambda mistake: mistake.rarity)


def listed(values: np.ndarray) -> list:
    """An array as campaign.toml writes it."""
    if values.ndim > 1:
        return [listed(row) for row in values]
    # Twelve digits undo the rounding of a factor such as 1e-4.
    return [float(f"{value + 0.0:.12g}") for value in values.tolist()]


def _one_key(key: str, stated: Any, mended: Any, rarity: int, mend: Any, words: str) -> Mistake:
    return Mistake((KeyChange(key, stated, mended),), rarity, mend, words)


def _stream_mistakes(columns: Columns) -> Iterator[Mistake]:
    """Other units of each stream and of time, and other orders of its columns."""
    for key, (name, field) in _NAMED.items():
        if key in columns:
            entry = columns[key]
            stated = Stated(f"columns.{key}", key, entry["unit"], list(entry["names"]))
            for matrix, tried in of_columns(stated, name, signs=False):
                factor = scaled(**{field: float(matrix[0, 0])})
                yield replace(tried, mend=factor if key == "time" else reordered(field, matrix))


def _attitude_mistakes(columns: Columns) -> Iterator[Mistake]:
    if "attitude" not in columns:
        return
    entry = columns["attitude"]
    scalar, maps = entry["scalar"], entry["maps"]
    other_scalar = "first" if scalar == "last" else "last"
    other_maps = "body_to_inertial" if maps == "inertial_to_body" else "inertial_to_body"
    change_scalar = KeyChange("columns.attitude.scalar", scalar, other_scalar)
    change_maps = KeyChange("columns.attitude.maps", maps, other_maps)
    as_written = np.linalg.inv(_from_columns(scalar, maps))
    order = f"the quaternion's scalar stands {other_scalar}, not {scalar}"
    sense = f"the quaternion maps {_said(other_maps)}, not {_said(maps)}"
    for changes, rarity, columns_are, words in (
        ((change_scalar,), 1, (other_scalar, maps), order),
        ((change_maps,), 1, (scalar, other_maps), sense),
        ((change_scalar, change_maps), 2, (other_scalar, other_maps), f"{order}, and {sense}"),
    ):
        mend = turned("attitude", _from_columns(*columns_are) @ as_written)
        yield Mistake(changes, rarity, mend, words)
    words = "the quaternion's vector elements stand in another order"
    for other in _OTHER_ORDERS:
        first = 1 if scalar == "first" else 0
        index = list(range(4))
        index[first : first + 3] = [first + k for k in other]
        stated = list(entry["names"])
        mend = turned("attitude", _from_columns(scalar, maps) @ np.eye(4)[index] @ as_written)
        names = [stated[k] for k in index]
        yield _one_key("columns.attitude.names", stated, names, 3, mend, words)


def _said(maps: str) -> str:
    return maps.replace("_", " ")


def _from_columns(scalar: str, maps: str) -> np.ndarray:
    """From four columns to a quaternion body from inertial, scalar last (4, 4)."""
    order = np.eye(4)[[1, 2, 3, 0]] if scalar == "first" else np.eye(4)
    sense = np.diag([-1.0, -1.0, -1.0, 1.0]) if maps == "body_to_inertial" else np.eye(4)
    return sense @ order


def _sense_of_torque(columns: Columns) -> Iterator[Mistake]:
    if "wheel_torque" not in columns:
        return
    stated = columns["wheel_torque"]["acts_on"]
    other = "body" if stated == "wheel" else "wheel"
    words = f"the torque is the one on the {other}, not on the {stated}"
    yield _one_key("columns.wheel_torque.acts_on", stated, other, 1, scaled(torque=-1.0), words)


def _rate_mistakes(campaign: Campaign, columns: Columns) -> Iterator[Mistake]:
    if "rate" not in columns:
        return
    axes, names = campaign.gyro.axes, columns["rate"]["names"]
    three = len(axes) == 3
    if three and not np.allclose(axes, axes.T, atol=1e-3):
        yield axes_mistake(axes, axes.T, 2, "the rate sensor's axes are written transposed")
    if three and not np.allclose(axes, np.eye(3), atol=1e-3):
        yield axes_mistake(axes, np.eye(3), 2, "the rates are along body axes already")
    for other in signed(names, "the rates"):
        yield axes_mistake(axes, other.matrix.T @ axes, other.rarity, other.words)
    for other in along_other_axes("xyz", "the rate sensor", not three):
        # Of other than three axes, in any order, it is the body's axes that are mistaken.
        mended = other.matrix.T @ axes if three else axes @ other.matrix
        yield axes_mistake(axes, mended, other.rarity, other.words)


def _flipped_signs() -> list[tuple[float, ...]]:
    """Signs of three axes, one flipped at least."""
    return list(product((1.0, -1.0), repeat=3))[1:]


def _axes_in_words(order: Sequence[int], signs: Sequence[float]) -> str:
    """Axes in an order and with signs, as (-y, x, z)."""
    named = ("-" * (s < 0.0) + "xyz"[k] for k, s in zip(order, signs, strict=True))
    return f"({', '.join(named)})"


def axes_mistake(axes: np.ndarray, mended: np.ndarray, rarity: int, words: str) -> Mistake:
    """The mistake that the rate sensor's axes (n, 3) are others than stated."""

    def mend(reading: Reading) -> Reading:
        return replace(reading, rate_axes_B=mended)

    return _one_key("rate_sensor.axes", listed(axes), listed(mended), rarity, mend, words)


def orders(count: int) -> Iterator[list[int]]:
    """Other orders of columns: all, or of many columns those with two exchanged."""
    if count <= LIMITS.most_wheels_in_any_order:
        yield from (list(order) for order in list(permutations(range(count)))[1:])
        return
    for i, k in combinations(range(count), 2):
        order = list(range(count))
        order[i], order[k] = k, i
        yield order


class OtherColumns(NamedTuple):
    """Columns in another order or with other signs: their names, and what it does to the values."""

    names: list[str]
    matrix: np.ndarray  # (k, k): on the values as stated
    rarity: int
    words: str


def in_other_order(names: Sequence[str], what: str) -> Iterator[OtherColumns]:
    """Columns of a quantity in other orders."""
    words = f"the columns of {what} stand in another order"
    for order in orders(len(names)):
        yield OtherColumns([names[k] for k in order], np.eye(len(names))[order], 2, words)


def signed(names: Sequence[str], what: str) -> Iterator[OtherColumns]:
    """All columns of a quantity with the other sign, one of them, or two of a vector."""
    count = len(names)
    flips = [*(combinations(range(count), 1) if count > 1 else ())]
    flips += combinations(range(count), 2) if count == 3 else ()
    for flipped in (tuple(range(count)), *flips):
        sign = np.where(np.isin(np.arange(count), flipped), -1.0, 1.0)
        other = [negated_name(n) if s < 0.0 else n for n, s in zip(names, sign, strict=True)]
        which = "all columns" if len(flipped) == count else " and ".join(names[k] for k in flipped)
        words = f"{which} of {what} {'have' if len(flipped) > 1 else 'has'} the other sign"
        yield OtherColumns(other, np.diag(sign), 3 if len(flipped) in (1, count) else 4, words)


def along_other_axes(
    names: Sequence[str], what: str, every: bool = False
) -> Iterator[OtherColumns]:
    """Columns of a vector along turned axes: in another order and with other signs, or either."""
    turned_axes = product(_OTHER_ORDERS, _flipped_signs())
    if every:
        turned_axes = product(permutations(range(3)), product((1.0, -1.0), repeat=3))
        next(turned_axes)  # As they are
    for order, signs in turned_axes:
        other = list(names)
        for name, k, sign in zip(names, order, signs, strict=True):
            other[k] = name if sign > 0.0 else negated_name(name)
        words = f"{what} is along the axes {_axes_in_words(order, signs)}"
        yield OtherColumns(other, (np.diag(signs) @ np.eye(3)[list(order)]).T, 4, words)


def _wheel_axes(campaign: Campaign, columns: Columns) -> Iterator[Mistake]:
    wheels, axes_B = campaign.wheels, campaign.wheel_axes_B
    for k, wheel in enumerate(wheels):
        signs = np.ones(len(wheels))
        signs[k] = -1.0
        words = f"the axis of wheel {wheel.name} points the other way"
        yield _axes_of_wheels(campaign, axes_B * signs, words)
    if len(wheels) > 1:
        words = "all wheel axes point the other way (or torque and momentum have the other sign)"
        yield _axes_of_wheels(campaign, -axes_B, words)
    for order in orders(len(wheels)):
        words = "wheels are exchanged: their axes belong to other columns"
        yield _axes_of_wheels(campaign, axes_B[:, order], words)
    if "wheel_torque" in columns and {"wheel_momentum", "wheel_speed"} & set(columns):
        # The momentum alone has the other sign: all axes and the sense of the torque change.
        words = "the wheel momentum has the other sign (it is the body's)"
        flipped, torque = _axes_of_wheels(campaign, -axes_B, words), next(_sense_of_torque(columns))
        yield Mistake(flipped.changes + torque.changes, 3, scaled(momentum=-1.0), words)


def _axes_of_wheels(campaign: Campaign, axes_B: np.ndarray, words: str) -> Mistake:
    stated = campaign.wheel_axes_B
    changes = tuple(
        KeyChange(f"wheels.{wheel.name}.axis", listed(old), listed(new))
        for wheel, old, new in zip(campaign.wheels, stated.T, axes_B.T, strict=True)
        if not np.allclose(old, new)
    )
    return Mistake(changes, 3, lambda reading: replace(reading, axes_B=axes_B), words)


def _shared_units(columns: Columns) -> Iterator[Mistake]:
    """Torque and momentum both in thousandths: one mistake, two keys."""
    if "wheel_torque" not in columns or "wheel_momentum" not in columns:
        return
    torque, momentum = columns["wheel_torque"]["unit"], columns["wheel_momentum"]["unit"]
    for unit, si in UNITS["wheel_torque"].items():
        with_time = f"{unit} s"
        factor = si / UNITS["wheel_torque"][torque]
        other = UNITS["wheel_momentum"].get(with_time, 0.0) / UNITS["wheel_momentum"][momentum]
        if other == 0.0 or abs(factor - 1.0) < 1e-9 or abs(other - 1.0) < 1e-9:
            continue
        changes = (
            KeyChange("columns.wheel_torque.unit", torque, unit),
            KeyChange("columns.wheel_momentum.unit", momentum, with_time),
        )
        words = f"torque and momentum are in {unit} and {with_time}, not in {torque} and {momentum}"
        yield Mistake(changes, 2, scaled(torque=factor, momentum=other), words)


def _inertia_mistakes(campaign: Campaign) -> Iterator[Mistake]:
    tensor = campaign.inertia.tensor
    for unit, factor in _INERTIA_UNITS.items():
        words = f"the inertia tensor is in {unit}, not in kg m^2"
        yield _tensor_mistake(tensor, tensor * factor, 3, words)
    for order in _OTHER_ORDERS:
        words = "the inertia tensor is along other axes"
        yield _tensor_mistake(tensor, tensor[np.ix_(order, order)], 4, words)


def _tensor_mistake(tensor: np.ndarray, mended: np.ndarray, rarity: int, words: str) -> Mistake:
    def mend(reading: Any) -> Any:
        return replace(reading, inertia=mended)

    return _one_key("inertia.tensor", listed(tensor), listed(mended), rarity, mend, words)


def _spin_inertias(campaign: Campaign, columns: Columns) -> Iterator[Mistake]:
    """Spin inertias in a wrong unit, where they turn wheel speed into momentum."""
    for unit, factor in _INERTIA_UNITS.items() if "wheel_speed" in columns else ():
        changes = tuple(
            KeyChange(f"wheels.{w.name}.spin_inertia", w.spin_inertia, w.spin_inertia * factor)
            for w in campaign.wheels
        )
        words = f"the wheels' spin inertia is in {unit}, not in kg m^2"
        yield Mistake(changes, 2, scaled(momentum=factor), words)


class Stated(NamedTuple):
    """Key of some columns in the description, their quantity, unit (None: none) and names."""

    path: str
    quantity: str
    unit: str | None
    names: list[str]


def of_columns(
    stated: Stated,
    what: str,
    *,
    signs: bool = True,
    turned_axes: bool = False,
    of_unit: int = 1,
    rarer: int = 0,
) -> Iterator[tuple[np.ndarray, Mistake]]:
    """Other units, orders and signs of columns, as matrices (k, k) on their values.

    `of_unit`: rarity of another unit. `rarer`: added to the rarities of other orders and signs.
    """
    path, quantity, own, names = stated
    for unit, si in UNITS[quantity].items() if own else ():
        if unit != own:
            factor, words = si / UNITS[quantity][str(own)], f"{what} is in {unit}, not in {own}"
            tried = unmended(f"{path}.unit", own, unit, of_unit, words)
            yield factor * np.eye(len(names)), tried
    others = [*in_other_order(names, what), *(signed(names, what) if signs else ())]
    for other in (*others, *(along_other_axes(names, what) if turned_axes else ())):
        rarity = other.rarity + rarer
        yield other.matrix, unmended(f"{path}.names", names, other.names, rarity, other.words)


def unmended(key: str, stated: Any, mended: Any, rarity: int, words: str) -> Mistake:
    """A mistake in one key that does not say yet how readings change with it."""
    return _one_key(key, stated, mended, rarity, lambda reading: reading, words)


def is_of_earth(fields: Sequence[np.ndarray]) -> bool:
    """Whether magnetic fields (n, 3) [T] have the size of that in an orbit of the Earth."""
    size = float(np.nanmedian(np.linalg.norm(np.concatenate(fields), axis=1)))
    return LIMITS.weakest_field < size < LIMITS.strongest_field


def _direction_mistakes(campaign: Campaign, columns: Columns) -> Iterator[Mistake]:
    for d, (name, sensor) in enumerate(direction_sensors(campaign)):
        if f"sensors.{name}.direction" not in columns:
            continue
        reading = [slew for slew in campaign.slews if name in (slew.more or {})]
        # Of a field as read and as looked at, that is in another unit which no planet has.
        right = is_of_earth([reference_of(name, sensor, slew)[1] for slew in reading])
        seen = f"the field that the {name} reads" if sensor.is_field else f"the {name}"
        there = f"what the {name} looks at"
        for key, field, what, of_unit, rarer in (
            ("direction", "directions", seen, 1 if right else 2, 0),
            ("reference", "references", there, 2 if right else 1, 1),
        ):
            entry = columns.get(f"sensors.{name}.{key}")
            if entry is None:
                continue
            stated = Stated(entry["path"], "magnetic_field", entry["unit"], list(entry["names"]))
            for matrix, tried in of_columns(
                stated, what, turned_axes=True, of_unit=of_unit, rarer=rarer
            ):
                yield replace(tried, mend=_preceded(field, d, matrix))
        if sensor.reference_N is not None:
            constant = np.array(sensor.reference_N)
            factors = {f"{there} lies the other way": (-1.0, 3)}
            for unit, si in UNITS["magnetic_field"].items() if sensor.is_field else ():
                factors |= {f"{there} is in {unit}, not in T": (si, 2 if right else 1)}
            for words, (factor, rarity) in factors.items():
                key, mend = f"sensors.{name}.reference_N", _preceded("references", d, factor)
                mended = listed(factor * constant)
                if factor != 1.0:
                    yield _one_key(key, listed(constant), mended, rarity, mend, words)


def _preceded(field: str, d: int, matrix: np.ndarray | float) -> Callable[[Reading], Reading]:
    """A reading in which a matrix (3, 3) or factor stands before that of direction sensor `d`."""

    def mend(reading: Reading) -> Reading:
        matrices = np.array(getattr(reading, field))
        matrices[d] = matrices[d] @ (matrix * np.eye(3) if np.isscalar(matrix) else matrix)
        changed: dict[str, Any] = {field: matrices}
        return replace(reading, **changed)

    return mend
