"""Every mistake in conventions that is tried, from the most common to the rarest.

Of columns: each other value of a key that changes what the campaign's reader makes of them (unit,
place of a scalar, sense), and other orders and signs of their names. So what a new kind of sensor
states of its columns is tried without a word here. Of hardware: signs, orders and frames of axes.

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
from typing import Any, Literal, NamedTuple, get_args, get_origin

import numpy as np

from bayes_inertia.campaign.actuators import (
    Actuator,
    GimballedRotors,
    KnownTorque,
    Magnetorquer,
    Thruster,
)
from bayes_inertia.campaign.body_rates import reference_of
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.description import Entry
from bayes_inertia.campaign.schema import UNITS, TimeColumn
from bayes_inertia.campaign.sensors import BY_KEY, MOMENTUM, RATE
from bayes_inertia.campaign.slew_parts import INPUTS, MORE
from bayes_inertia.campaign.streams import Stream, StreamRows, inputs_of, stream_from_table
from bayes_inertia.conventions.limits import LIMITS
from bayes_inertia.conventions.reading import (
    FIELD,
    TORQUE,
    KeyChange,
    Mend,
    Mistake,
    Reading,
    Stated,
    both,
    direction_sensors,
    followed,
    key_changes,
    preceded,
    readings_of,
    said_of,
)
from bayes_inertia.files import vocabulary
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.tables.table import Table, negated_name

# Units in which an inertia tensor is written by mistake, and what one is in kg m^2.
_INERTIA_UNITS: Mapping[str, float] = vocabulary("conventions")["inertia_units"]
_OTHER_ORDERS = tuple(permutations(range(3)))[1:]
# What a wrong value of a key means: the other value, and the stated one.
_WORDS: Mapping[str, str] = {
    "unit": "{what} is in {other}, not in {stated}",
    "scalar": "the quaternion's scalar stands {other}, not {stated}",
    "maps": "the quaternion maps {other}, not {stated}",
    "acts_on": "the torque is the one on the {other}, not on the {stated}",
}
_OF_ANY_KEY = "{key} of {what} is {other}, not {stated}"


def mistakes(campaign: Campaign, stated: Stated, own_axes: int, directions: bool) -> list[Mistake]:
    """All single mistakes that are tried for a campaign, the most common first.

    `own_axes`: of the rate sensor; none where its readings do not count. `directions`: whether
    direction sensors are held against a law.
    """
    columns = _tried(campaign, stated, directions)
    tried = [each for each in columns if own_axes or each.entry.field != RATE.field]
    every = [
        *(mistake for each in tried for mistake in _of_columns(each)),
        *(_of_rate_axes(campaign, stated) if own_axes else ()),
        *_of_wheel_axes(campaign, stated, tried),
        *_of_shared_units(tried),
        *_of_inertia(campaign),
        *_of_spin_inertias(campaign, stated),
        *(_of_constant_references(campaign) if directions else ()),
        *(mistake for device in campaign.actuators for mistake in _of_record(device)),
    ]
    return sorted(every, key=lambda mistake: mistake.rarity)


@array_dataclass
class Tried:
    """Columns of which mistakes are tried."""

    entry: Entry
    spin_inertias: np.ndarray  # (wheels,) of the campaign [kg m^2]
    what: str  # What they are called
    sign: bool = False  # Whether a name may lack its sign
    axes: bool = False  # Whether they are a vector that may be along other axes
    of_unit: int = 1  # Rarity of another unit
    rarer: int = 0  # What is added to the rarities of other orders and signs

    def matrix(self, columns: Any) -> np.ndarray:
        """(k, k) from columns, as keys state them, to what `Slew` has: unit vectors, once read."""
        names = [str(k) for k in range(len(self.entry.columns.names))]
        rows = {"t": 1e9 * np.arange(1.0, len(names) + 1.0)}
        table = Table.of("unit vectors", rows | dict(zip(names, np.eye(len(names)), strict=True)))
        if self.entry.field == "time":
            read = stream_from_table(table, Stream("", _clock(columns.unit), 0.0, ()), np.zeros(0))
            return np.array([[read["time"][0] / rows["t"][0]]])
        entry = replace(self.entry, columns=columns.model_copy(update={"names": names}))
        stream = Stream("", _clock("s"), 0.0, (entry,))
        if entry.field.startswith(INPUTS):
            (given,) = inputs_of([StreamRows(0, stream, table, ())]).values()
            return given.values.T
        values = stream_from_table(table, stream, self.spin_inertias)[entry.field]
        return (values[:, list(entry.wheels)] if entry.wheels else values).T

    def mend(self, how: Callable[[str, np.ndarray], Mend], matrix: np.ndarray) -> Mend:
        """A reading in which a matrix (k, k) follows or precedes that of the columns."""
        wheels = list(self.entry.wheels)
        if wheels:
            whole = np.eye(len(self.spin_inertias))
            whole[np.ix_(wheels, wheels)] = matrix
            matrix = whole
        return how(self.entry.field, matrix)


def _clock(unit: str) -> TimeColumn:
    return TimeColumn(names=["t"], unit=unit)


def _tried(campaign: Campaign, stated: Stated, directions: bool) -> Iterator[Tried]:
    """Columns that laws depend on, and what of them is mistaken."""
    devices = {f"{INPUTS}{device.name}": device for device in campaign.actuators}
    read = {name for slew in campaign.slews for name in slew.more or ()}
    sensors = {n: s for n, s in direction_sensors(campaign) if directions and n in read}
    # Of a field as read and as looked at, that is in another unit which no planet has.
    right = {name: _looks_at_earth(campaign, name) for name in sensors}
    counts = any(isinstance(device, Magnetorquer) for device in campaign.actuators) or any(
        sensor.reference_N is None and not stated.of(f"{INPUTS}{name}")
        for name, sensor in sensors.items()
    )
    first = {entry.field for entry in stated.held} | {"time"}
    for entry in stated.entries:
        name = entry.field.removeprefix(MORE).removeprefix(INPUTS)
        tried = partial(Tried, entry, campaign.spin_inertias)
        if entry.field in first:
            yield tried(said_of(entry.key)[0])
        elif device := devices.get(entry.field):
            # No thrust is negative.
            signs, vector = not isinstance(device, Thruster), isinstance(device, KnownTorque)
            yield tried(device.name, signs, vector)
        elif entry.field == FIELD and counts and (given := readings_of(campaign, FIELD)):
            of_unit = 2 if is_of_earth(given) else 1
            yield tried("the magnetic field", True, of_unit=of_unit, rarer=1)
        elif entry.field == f"{INPUTS}{name}" and name in sensors:
            of_unit = 2 if right[name] else 1
            yield tried(f"what the {name} looks at", True, True, of_unit, 1)
        elif entry.field == f"{MORE}{name}" and name in sensors:
            seen = f"the field that the {name} reads" if sensors[name].is_field else f"the {name}"
            yield tried(seen, True, True, 1 if right[name] else 2)


def _of_columns(tried: Tried) -> Iterator[Mistake]:
    """Other values of keys, and other orders and signs of names."""
    entry, form = tried.entry, tried.entry.columns
    as_read = tried.matrix(form)
    back = np.linalg.inv(as_read)
    for other in _other_keys(tried, as_read):
        matrix = tried.matrix(form.model_copy(update=other)) @ back
        words = [
            _WORDS.get(key, _OF_ANY_KEY).format(
                key=key, what=tried.what, other=value, stated=getattr(form, key)
            )
            for key, value in other.items()
        ]
        changes = [change for item in other.items() for change in key_changes(entry, *item)]
        rarity = tried.of_unit if "unit" in other else len(other)
        said = ", and ".join(words)
        said = said if "unit" in other else said.replace("_", " ")
        yield Mistake(tuple(changes), rarity, tried.mend(followed, matrix), said)
    for renamed in _other_names(tried):
        mend = tried.mend(preceded, as_read @ renamed.matrix @ back)
        rarity = renamed.rarity + tried.rarer
        yield Mistake(key_changes(entry, "names", renamed.names), rarity, mend, renamed.words)


def _other_keys(tried: Tried, as_read: np.ndarray) -> Iterator[dict[str, str]]:
    """Other values of the keys that say what columns mean: of the unit, and of all others."""
    form, senses = tried.entry.columns, {}
    for key, field in type(form).model_fields.items():
        values = get_args(field.annotation) if get_origin(field.annotation) is Literal else ()
        others = [form.model_copy(update={key: value}) for value in values]
        if any(not np.array_equal(tried.matrix(other), as_read) for other in others):
            senses[key] = values
    quantity = "magnetic_field" if tried.entry.key == "direction" else tried.entry.key
    for unit in UNITS[quantity] if getattr(form, "unit", None) else ():
        if unit != form.unit:
            yield {"unit": unit}
    for values in product(*senses.values()):
        other = dict(zip(senses, values, strict=True))
        differ = {key: value for key, value in other.items() if value != getattr(form, key)}
        if differ:
            yield differ


def _other_names(tried: Tried) -> Iterator[OtherColumns]:
    """Other orders and signs of columns, as far as they are mistaken."""
    names, what = list(tried.entry.columns.names), tried.what
    kind = BY_KEY.get(tried.entry.key)
    which = range(len(names)) if kind is None else kind.exchangeable(tried.entry.columns)
    yield from in_other_order(names, what, which)
    if tried.sign or len(which) < len(names):
        yield from signed(names, what, which=which)
    if tried.axes:
        yield from along_other_axes(names, what)


def _looks_at_earth(campaign: Campaign, name: str) -> bool:
    """Whether the field that a direction sensor is said to look at has the size of the Earth's."""
    sensor = dict(direction_sensors(campaign))[name]
    reading = [slew for slew in campaign.slews if name in (slew.more or {})]
    return is_of_earth([reference_of(name, sensor, slew)[1] for slew in reading])


def is_of_earth(fields: Sequence[np.ndarray]) -> bool:
    """Whether magnetic fields (n, 3) [T] have the size of that in an orbit of the Earth."""
    size = float(np.nanmedian(np.linalg.norm(np.concatenate(fields), axis=1)))
    return LIMITS.weakest_field < size < LIMITS.strongest_field


def listed(values: np.ndarray) -> list:
    """An array as campaign.toml writes it."""
    if values.ndim > 1:
        return [listed(row) for row in values]
    # Twelve digits undo the rounding of a factor such as 1e-4.
    return [float(f"{value + 0.0:.12g}") for value in values.tolist()]


def _of_array(
    key: str, stated: np.ndarray, mended: np.ndarray, rarity: int, mend: Mend, words: str
) -> Mistake:
    """A mistake in an array of one key."""
    return Mistake((KeyChange(key, listed(stated), listed(mended)),), rarity, mend, words)


class OtherColumns(NamedTuple):
    """Columns in another order or with other signs: their names, and what it does to the values."""

    names: list[str]
    matrix: np.ndarray  # (k, k): on the values as stated
    rarity: int
    words: str


def orders(which: Sequence[int]) -> Iterator[list[int]]:
    """Other orders of columns: all, or of many columns those with two exchanged."""
    if len(which) <= LIMITS.most_wheels_in_any_order:
        yield from (list(order) for order in list(permutations(which))[1:])
        return
    for i, k in combinations(range(len(which)), 2):
        order = list(which)
        order[i], order[k] = which[k], which[i]
        yield order


def in_other_order(
    names: Sequence[str], what: str, which: Sequence[int] | None = None
) -> Iterator[OtherColumns]:
    """Columns of a quantity in other orders, or `which` of them."""
    whole = list(range(len(names)))
    which = whole if which is None else list(which)
    words = f"the columns of {what} stand in another order"
    for order in orders(which):
        index = list(whole)
        for place, k in zip(which, order, strict=True):
            index[place] = k
        # Of a part of the columns, such as a quaternion's vector, it is a rarer mistake.
        rarity = 2 if len(which) == len(whole) else 3
        yield OtherColumns([names[k] for k in index], np.eye(len(names))[index], rarity, words)


def signed(
    names: Sequence[str], what: str, vector: bool = True, which: Sequence[int] | None = None
) -> Iterator[OtherColumns]:
    """All columns of a quantity with the other sign, one of them, or two of a vector's three.

    `which`: those that may lack it; of a part of the columns, such as a quaternion's vector, one.
    """
    count = len(names)
    which = range(count) if which is None else which
    pairs = combinations(range(count), 2) if vector and count == 3 else ()
    every = [tuple(which)] if len(which) == count else []
    for flipped in dict.fromkeys([*every, *combinations(which, 1), *pairs]) if count else ():
        sign = np.where(np.isin(np.arange(count), flipped), -1.0, 1.0)
        other = [negated_name(n) if s < 0.0 else n for n, s in zip(names, sign, strict=True)]
        named = " and ".join(names[k] for k in flipped)
        named = "all columns" if len(flipped) == count > 1 else named
        words = f"{named} of {what} {'have' if len(flipped) > 1 else 'has'} the other sign"
        yield OtherColumns(other, np.diag(sign), 3 if len(flipped) in (1, count) else 4, words)


def along_other_axes(
    names: Sequence[str], what: str, every: bool = False
) -> Iterator[OtherColumns]:
    """Columns of a vector along turned axes: in another order and with other signs, or either."""
    signs_of_axes = list(product((1.0, -1.0), repeat=3))
    turned_axes = product(_OTHER_ORDERS, signs_of_axes[1:])
    if every:
        turned_axes = product(permutations(range(3)), signs_of_axes)
        next(turned_axes)  # As they are
    for order, signs in turned_axes:
        other = list(names)
        for name, k, sign in zip(names, order, signs, strict=True):
            other[k] = name if sign > 0.0 else negated_name(name)
        axes = ", ".join("-" * (s < 0.0) + "xyz"[k] for k, s in zip(order, signs, strict=True))
        words = f"{what} is along the axes ({axes})"
        yield OtherColumns(other, (np.diag(signs) @ np.eye(3)[list(order)]).T, 4, words)


def _of_rate_axes(campaign: Campaign, stated: Stated) -> Iterator[Mistake]:
    axes = campaign.gyro.axes
    names = [name for entry in stated.of(RATE.field) for name in entry.columns.names]
    three = len(axes) == 3
    mistake = partial(axes_mistake, stated, axes)
    if three and not np.allclose(axes, axes.T, atol=1e-3):
        yield mistake(axes.T, 2, "the rate sensor's axes are written transposed")
    if three and not np.allclose(axes, np.eye(3), atol=1e-3):
        yield mistake(np.eye(3), 2, "the rates are along body axes already")
    for other in signed(names, "the rates"):
        yield mistake(other.matrix.T @ axes, other.rarity, other.words)
    for other in along_other_axes("xyz", "the rate sensor", not three):
        # Of other than three axes, in any order, it is the body's axes that are mistaken.
        mended = other.matrix.T @ axes if three else axes @ other.matrix
        yield mistake(mended, other.rarity, other.words)


def axes_mistake(
    stated: Stated, axes: np.ndarray, mended: np.ndarray, rarity: int, words: str
) -> Mistake:
    """The mistake that the rate sensor's axes (n, 3) are others than stated."""
    key = stated.key("rate_sensor", "axes")
    return _of_array(key, axes, mended, rarity, partial(replace, rate_axes_B=mended), words)


def _of_wheel_axes(campaign: Campaign, stated: Stated, tried: Sequence[Tried]) -> Iterator[Mistake]:
    axes_B, names = campaign.wheel_axes_B, [wheel.name for wheel in campaign.wheels]
    what = "the wheels' axes"

    def mistake(mended_B: np.ndarray, words: str) -> Mistake:
        changes = tuple(
            KeyChange(stated.key("wheels", name, "axis"), listed(old), listed(new))
            for name, old, new in zip(names, axes_B.T, mended_B.T, strict=True)
            if not np.allclose(old, new)
        )
        return Mistake(changes, 3, partial(replace, axes_B=mended_B), words)

    others = [*signed(names, what, vector=False), *in_other_order(names, what)]
    mended = [(axes_B @ other.matrix.T, other.words) for other in others]
    # A component of all axes, which wheels may lack; of a wheel along it that is its own sign.
    mended += [(other.matrix @ axes_B, other.words) for other in signed("xyz", what, vector=False)]
    once = {(axes + 0.0).tobytes(): (axes, words) for axes, words in reversed(mended)}
    once.pop((axes_B + 0.0).tobytes(), None)
    yield from (mistake(*each) for each in reversed(once.values()))
    commands = [each for each in tried if each.entry.field == TORQUE]
    if commands and stated.of(MOMENTUM.field):
        # The momentum alone has the other sign: all axes and the sense of the torque change.
        words = "the wheel momentum has the other sign (it is the body's)"
        every = mistake(-axes_B, words)
        for each in commands:
            every = both(every, next(m for m in _of_columns(each) if "acts_on" in m.changes[0].key))
        yield replace(every, rarity=3, words=words)


def _of_shared_units(tried: Sequence[Tried]) -> Iterator[Mistake]:
    """Torque and momentum both in thousandths: one mistake, two keys."""
    units = {
        (each.entry.key, mistake.changes[0].mended): mistake
        for each in tried
        if each.entry.wheels
        for mistake in _of_columns(each)
        if mistake.changes[0].key.endswith(".unit")
    }
    for unit in UNITS[TORQUE]:
        torque = units.get(("wheel_torque", unit))
        momentum = units.get(("wheel_momentum", f"{unit} s"))
        if torque is not None and momentum is not None:
            yield both(torque, momentum)


def _of_inertia(campaign: Campaign) -> Iterator[Mistake]:
    tensor = campaign.inertia.tensor
    others = [
        (tensor * factor, 3, f"the inertia tensor is in {unit}, not in kg m^2")
        for unit, factor in _INERTIA_UNITS.items()
    ]
    words = "the inertia tensor is along other axes"
    others += [(tensor[np.ix_(order, order)], 4, words) for order in _OTHER_ORDERS]
    for mended, rarity, words in others:
        mend = partial(replace, inertia=mended)
        yield _of_array("inertia.tensor", tensor, mended, rarity, mend, words)


def _of_spin_inertias(campaign: Campaign, stated: Stated) -> Iterator[Mistake]:
    """Spin inertias in a wrong unit, where they turn wheel speed into momentum."""
    speeds = any(entry.key == "wheel_speed" for entry in stated.entries)
    for unit, factor in _INERTIA_UNITS.items() if speeds else ():
        changes = stated.spin_inertias([(w, w.spin_inertia * factor) for w in campaign.wheels])
        words = f"the wheels' spin inertia is in {unit}, not in kg m^2"
        mend = followed(MOMENTUM.field, factor * np.eye(len(campaign.wheels)))
        yield Mistake(changes, 2, mend, words)


def _of_constant_references(campaign: Campaign) -> Iterator[Mistake]:
    """What a direction sensor is said to look at, where that does not change."""
    for name, sensor in direction_sensors(campaign):
        if sensor.reference_N is None:
            continue
        there, constant = f"what the {name} looks at", np.array(sensor.reference_N)
        factors = {f"{there} lies the other way": (-1.0, 3)}
        of_unit = 2 if sensor.is_field and _looks_at_earth(campaign, name) else 1
        for unit, si in UNITS["magnetic_field"].items() if sensor.is_field else ():
            factors |= {f"{there} is in {unit}, not in T": (si, of_unit)}
        for words, (factor, rarity) in factors.items():
            if factor != 1.0:
                key = f"sensors.{name}.reference_N"
                mend = followed(f"{MORE}{name}.reference_N", factor * np.eye(3))
                yield _of_array(key, constant, factor * constant, rarity, mend, words)


def _of_record(device: Actuator) -> Iterator[Mistake]:
    """Mistakes in the numbers of a device."""
    if isinstance(device, KnownTorque):
        other: Any = "inertial" if device.frame == "body" else "body"
        words = f"{device.name} is along {other} axes, not along {device.frame} axes"
        change = KeyChange(f"actuators.{device.name}.torque.frame", device.frame, other)
        yield Mistake((change,), 4, _with_record(replace(device, frame=other)), words)
    elif isinstance(device, Thruster | GimballedRotors):
        field = "torque_B" if isinstance(device, Thruster) else "spin_axes_at_zero_B"
        key = "torques" if isinstance(device, Thruster) else "spin_axes_at_zero"
        vectors, path = getattr(device, field), f"actuators.{device.name}.{key}"
        numbers = [f"number {k + 1}" for k in range(len(vectors))]
        for signs in signed(numbers, f"{key.replace('_', ' ')}: {device.name}", vector=False):
            record: dict[str, Any] = {field: signs.matrix @ vectors}
            mend = _with_record(replace(device, **record))
            yield _of_array(path, vectors, record[field], 3, mend, signs.words)


def _with_record(device: Actuator) -> Mend:
    """A device has another record."""

    def mended(reading: Reading) -> Reading:
        devices = tuple(device if d.name == device.name else d for d in reading.actuators)
        return replace(reading, actuators=devices)

    return mended
