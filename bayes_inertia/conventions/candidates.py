"""Every mistake in conventions that is tried, from the most common to the rarest.

Units, and the order and direction of a quaternion, are mistaken most often (rarity 1); then the
order of columns and a unit that two columns share (2); then the sign of one axis or wheel (3); then
frames (4). That is the prior over mistakes: it decides only between mistakes that explain the data
alike.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
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
    both,
    changed,
    direction_sensors,
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


def unmended(reading: Reading) -> Reading:
    """The reading as it is: that of a mistake which does not say yet how readings change."""
    return reading


def one_key(
    key: str,
    stated: Any,
    mended: Any,
    rarity: int,
    words: str,
    mend: Callable[[Reading], Reading] = unmended,
) -> Mistake:
    """A mistake in one key."""
    return Mistake((KeyChange(key, stated, mended),), rarity, mend, words)


def _stream_mistakes(columns: Columns) -> Iterator[Mistake]:
    """Other units of each stream and of time, and other orders of its columns."""
    for key, (name, field) in _NAMED.items():
        if key in columns:
            entry = columns[key]
            stated = Stated(f"columns.{key}", key, entry["unit"], list(entry["names"]))
            yield from of_columns(stated, name, partial(_preceding, field), signs=False)


def _preceding(field: str, matrix: np.ndarray) -> Callable[[Reading], Reading]:
    """A reading in which a matrix, as of columns in their order, precedes that of a field."""
    if field == "time":
        return changed(time=partial(np.multiply, float(matrix[0, 0])))
    return changed(**{field: lambda values: values @ matrix})


def _attitude_mistakes(columns: Columns) -> Iterator[Mistake]:
    if "attitude" not in columns:
        return
    stated: dict[str, str] = {key: columns["attitude"][key] for key in _ATTITUDE}
    as_written = np.linalg.inv(_from_columns(**stated))
    for values in product(*(allowed for allowed, _ in _ATTITUDE.values())):
        other = dict(zip(_ATTITUDE, values, strict=True))
        differ = [key for key in _ATTITUDE if other[key] != stated[key]]
        changes = (KeyChange(f"columns.attitude.{key}", stated[key], other[key]) for key in differ)
        said = (f"{_ATTITUDE[key][1]} {other[key]}, not {stated[key]}" for key in differ)
        words = ", and ".join(said).replace("_", " ")
        if differ:
            mend = changed(attitude=partial(np.matmul, _from_columns(**other) @ as_written))
            yield Mistake(tuple(changes), len(differ), mend, words)
    names = list(columns["attitude"]["names"])
    first = 1 if stated["scalar"] == "first" else 0
    for order in _OTHER_ORDERS:
        index = list(range(4))
        index[first : first + 3] = [first + k for k in order]
        other_order = _from_columns(**stated) @ np.eye(4)[index] @ as_written
        mend = changed(attitude=partial(np.matmul, other_order))
        words = "the quaternion's vector elements stand in another order"
        yield one_key("columns.attitude.names", names, [names[k] for k in index], 3, words, mend)


# Values of the keys that say what a quaternion is, and how they are said.
_ATTITUDE: Mapping[str, tuple[tuple[str, str], str]] = {
    "scalar": (("first", "last"), "the quaternion's scalar stands"),
    "maps": (("body_to_inertial", "inertial_to_body"), "the quaternion maps"),
}


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
    yield one_key(
        "columns.wheel_torque.acts_on", stated, other, 1, words, changed(torque=np.negative)
    )


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
    mend = changed(rate_axes_B=lambda _: mended)
    return one_key("rate_sensor.axes", listed(axes), listed(mended), rarity, words, mend)


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


def signed(names: Sequence[str], what: str, vector: bool = True) -> Iterator[OtherColumns]:
    """All columns of a quantity with the other sign, one of them, or two of a vector's three."""
    count = len(names)
    pairs = combinations(range(count), 2) if vector and count == 3 else ()
    flips = dict.fromkeys([tuple(range(count)), *combinations(range(count), 1), *pairs])
    for flipped in flips if count else ():
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
    axes_B, names = campaign.wheel_axes_B, [wheel.name for wheel in campaign.wheels]
    what = "the wheels' axes"
    for other in (*signed(names, what, vector=False), *in_other_order(names, what)):
        yield _axes_of_wheels(campaign, axes_B @ other.matrix.T, other.words)
    if "wheel_torque" in columns and {"wheel_momentum", "wheel_speed"} & set(columns):
        # The momentum alone has the other sign: all axes and the sense of the torque change.
        words = "the wheel momentum has the other sign (it is the body's)"
        all_axes = _axes_of_wheels(campaign, -axes_B, words)
        sense = next(_sense_of_torque(columns))
        yield replace(both(all_axes, sense), rarity=3, words=words)


def _axes_of_wheels(campaign: Campaign, axes_B: np.ndarray, words: str) -> Mistake:
    stated = campaign.wheel_axes_B
    changes = tuple(
        KeyChange(f"wheels.{wheel.name}.axis", listed(old), listed(new))
        for wheel, old, new in zip(campaign.wheels, stated.T, axes_B.T, strict=True)
        if not np.allclose(old, new)
    )
    return Mistake(changes, 3, changed(axes_B=lambda _: axes_B), words)


def _shared_units(columns: Columns) -> Iterator[Mistake]:
    """Torque and momentum both in thousandths: one mistake, two keys."""
    units = {f"{m.changes[0].key} {m.changes[0].mended}": m for m in _stream_mistakes(columns)}
    for unit in UNITS["wheel_torque"]:
        torque = units.get(f"columns.wheel_torque.unit {unit}")
        momentum = units.get(f"columns.wheel_momentum.unit {unit} s")
        if torque is not None and momentum is not None:
            yield both(torque, momentum)


def _inertia_mistakes(campaign: Campaign) -> Iterator[Mistake]:
    tensor = campaign.inertia.tensor
    for unit, factor in _INERTIA_UNITS.items():
        words = f"the inertia tensor is in {unit}, not in kg m^2"
        yield _tensor_mistake(tensor, tensor * factor, 3, words)
    for order in _OTHER_ORDERS:
        words = "the inertia tensor is along other axes"
        yield _tensor_mistake(tensor, tensor[np.ix_(order, order)], 4, words)


def _tensor_mistake(tensor: np.ndarray, mended: np.ndarray, rarity: int, words: str) -> Mistake:
    mend = changed(inertia=lambda _: mended)
    return one_key("inertia.tensor", listed(tensor), listed(mended), rarity, words, mend)


def _spin_inertias(campaign: Campaign, columns: Columns) -> Iterator[Mistake]:
    """Spin inertias in a wrong unit, where they turn wheel speed into momentum."""
    for unit, factor in _INERTIA_UNITS.items() if "wheel_speed" in columns else ():
        changes = tuple(
            KeyChange(f"wheels.{w.name}.spin_inertia", w.spin_inertia, w.spin_inertia * factor)
            for w in campaign.wheels
        )
        words = f"the wheels' spin inertia is in {unit}, not in kg m^2"
        yield Mistake(changes, 2, changed(momentum=partial(np.multiply, factor)), words)


class Stated(NamedTuple):
    """Key of some columns in the description, their quantity, unit (None: none) and names."""

    path: str
    quantity: str
    unit: str | None
    names: list[str]


def of_columns(
    stated: Stated,
    what: str,
    mended: Callable[[np.ndarray], Callable[[Reading], Reading]],
    *,
    signs: bool = True,
    turned_axes: bool = False,
    of_unit: int = 1,
    rarer: int = 0,
) -> Iterator[Mistake]:
    """Other units, orders and signs of columns; `mended`: by matrices (k, k) on their values.

    `of_unit`: rarity of another unit. `rarer`: added to the rarities of other orders and signs.
    """
    path, quantity, own, names = stated
    for unit, si in UNITS[quantity].items() if own else ():
        if unit != own:
            matrix = si / UNITS[quantity][str(own)] * np.eye(len(names))
            words = f"{what} is in {unit}, not in {own}"
            yield one_key(f"{path}.unit", own, unit, of_unit, words, mended(matrix))
    others = [*in_other_order(names, what), *(signed(names, what) if signs else ())]
    for other in (*others, *(along_other_axes(names, what) if turned_axes else ())):
        rarity, mend = other.rarity + rarer, mended(other.matrix)
        yield one_key(f"{path}.names", names, other.names, rarity, other.words, mend)


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
            mended = partial(_preceded, field, d)
            yield from of_columns(
                stated, what, mended, turned_axes=True, of_unit=of_unit, rarer=rarer
            )
        if sensor.reference_N is not None:
            constant = np.array(sensor.reference_N)
            factors = {f"{there} lies the other way": (-1.0, 3)}
            for unit, si in UNITS["magnetic_field"].items() if sensor.is_field else ():
                factors |= {f"{there} is in {unit}, not in T": (si, 2 if right else 1)}
            for words, (factor, rarity) in factors.items():
                key, mend = f"sensors.{name}.reference_N", _preceded("references", d, factor)
                if factor != 1.0:
                    other = listed(factor * constant)
                    yield one_key(key, listed(constant), other, rarity, words, mend)


def _preceded(field: str, d: int, matrix: np.ndarray | float) -> Callable[[Reading], Reading]:
    """A reading in which a matrix (3, 3) or factor stands before that of direction sensor `d`."""

    def with_one(matrices: np.ndarray) -> np.ndarray:
        one = matrices[d] @ (matrix * np.eye(3) if np.isscalar(matrix) else matrix)
        return np.concatenate([matrices[:d], one[None], matrices[d + 1 :]])

    return changed(**{field: with_one})
