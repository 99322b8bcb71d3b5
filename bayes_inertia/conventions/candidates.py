"""Every mistake in conventions that is tried, from the most common to the rarest.

Units, and the order and direction of a quaternion, are mistaken most often (rarity 1); then the
order of columns and a unit that two columns share (2); then the sign of one axis or wheel (3); then
frames (4). That is the prior over mistakes: it decides only between mistakes that explain the data
alike.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, permutations, product
from typing import Any

import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.schema import UNITS
from bayes_inertia.conventions.limits import LIMITS
from bayes_inertia.conventions.reading import KeyChange, Mistake

Columns = Mapping[str, Mapping[str, Any]]

# Units in which an inertia tensor is written by mistake, and what one is in kg m^2.
_INERTIA_UNITS = {
    "g m^2": 1e-3,
    "kg cm^2": 1e-4,
    "kg mm^2": 1e-6,
    "g cm^2": 1e-7,
    "g mm^2": 1e-9,
    "lb ft^2": 0.0421401,
    "lb in^2": 2.9263965e-4,
}


def mistakes(campaign: Campaign, columns: Columns) -> list[Mistake]:
    """All single mistakes that are tried for a campaign.

    `columns` [columns].
    """
    every = [
        *_unit_mistakes(columns),
        *_attitude_mistakes(columns),
        *_sense_of_torque(columns),
        *_rate_mistakes(campaign, columns),
        *_wheel_order(columns),
        *_wheel_axes(campaign, columns),
        *_shared_units(columns),
        *_inertia_mistakes(campaign),
        *_spin_inertias(campaign, columns),
    ]
    return sorted(every, key=lambda mistake: mistake.rarity)


def listed(values: np.ndarray) -> list:
    """An array as campaign.toml writes it.

    Examples
    --------
    >>> listed(-np.eye(2))
    [[-1.0, 0.0], [0.0, -1.0]]
    """
    if values.ndim > 1:
        return [listed(row) for row in values]
    # Twelve digits undo the rounding of a factor such as 1e-4.
    return [float(f"{value + 0.0:.12g}") for value in values.tolist()]


def _unit_mistakes(columns: Columns) -> Iterator[Mistake]:
    for quantity in ("time", "rate", "wheel_torque", "wheel_momentum", "wheel_speed"):
        if quantity not in columns:
            continue
        stated = columns[quantity]["unit"]
        for unit, si in UNITS[quantity].items():
            factor = si / UNITS[quantity][stated]
            if abs(factor - 1.0) < 1e-9:
                continue
            yield Mistake(
                (KeyChange(f"columns.{quantity}.unit", stated, unit),),
                1,
                _scaled(quantity, factor),
                f"{_PEOPLE[quantity]} is in {unit}, not in {stated}",
            )


_PEOPLE = {
    "time": "time",
    "rate": "the rate",
    "wheel_torque": "the wheel torque",
    "wheel_momentum": "the wheel momentum",
    "wheel_speed": "the wheel speed",
}
_FIELD = {
    "time": "time",
    "rate": "rate",
    "wheel_torque": "torque",
    "wheel_momentum": "momentum",
    "wheel_speed": "momentum",
}


def _scaled(quantity: str, factor: float):
    field = _FIELD[quantity]
    return lambda reading: replace(reading, **{field: getattr(reading, field) * factor})


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
        yield Mistake(changes, rarity, _reread(_from_columns(*columns_are) @ as_written), words)
    for order_ in list(permutations(range(3)))[1:]:
        first = 1 if scalar == "first" else 0
        index = list(range(4))
        index[first : first + 3] = [first + k for k in order_]
        names = [entry["names"][k] for k in index]
        written = np.eye(4)[index]
        yield Mistake(
            (KeyChange("columns.attitude.names", list(entry["names"]), names),),
            3,
            _reread(_from_columns(scalar, maps) @ written @ as_written),
            "the quaternion's vector elements stand in another order",
        )


def _said(maps: str) -> str:
    return maps.replace("_", " ")


def _reread(matrix: np.ndarray):
    return lambda reading: replace(reading, attitude=matrix @ reading.attitude)


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
    yield Mistake(
        (KeyChange("columns.wheel_torque.acts_on", stated, other),),
        1,
        _scaled("wheel_torque", -1.0),
        f"the torque is the one on the {other}, not on the {stated}",
    )


def _rate_mistakes(campaign: Campaign, columns: Columns) -> Iterator[Mistake]:
    if "rate" not in columns:
        return
    names = list(columns["rate"]["names"])
    for order in list(permutations(range(3)))[1:]:
        exchanged = [names[k] for k in order]
        yield Mistake(
            (KeyChange("columns.rate.names", names, exchanged),),
            2,
            _rates_read(np.eye(3)[list(order)]),
            "the rate's columns stand in another order",
        )
    axes = campaign.gyro.axes
    if not np.allclose(axes, axes.T, atol=1e-3):
        yield axes_mistake(axes, axes.T, 2, "the rate sensor's axes are written transposed")
    if not np.allclose(axes, np.eye(3), atol=1e-3):
        words = "the rates are along body axes already"
        yield axes_mistake(axes, np.eye(3), 2, words)
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            turned = np.diag(signs) @ np.eye(3)[list(order)]
            flipped = sum(sign < 0.0 for sign in signs)
            if not flipped:
                continue
            same_order = order == (0, 1, 2)
            if same_order and flipped == 1:
                words, rarity = f"rate sensor axis {signs.index(-1.0) + 1} has the other sign", 3
            elif same_order and flipped == 3:
                words, rarity = "all rates have the other sign", 3
            else:
                words, rarity = f"the rates are along the axes {_axes_in_words(turned)}", 4
            yield axes_mistake(axes, turned @ axes, rarity, words)


def _axes_in_words(turned: np.ndarray) -> str:
    """A signed permutation as (-y, x, z)."""
    named = [("-" if row.sum() < 0.0 else "") + "xyz"[int(abs(row).argmax())] for row in turned]
    return f"({', '.join(named)})"


def axes_mistake(axes: np.ndarray, mended: np.ndarray, rarity: int, words: str) -> Mistake:
    """The mistake that the rate sensor's axes are others than stated.

    `axes` and `mended` (3, 3).
    """
    change = KeyChange("rate_sensor.axes", listed(axes), listed(mended))
    back = np.linalg.inv(mended) @ axes
    return Mistake(
        (change,), rarity, lambda reading: replace(reading, rate=back @ reading.rate), words
    )


def _rates_read(matrix: np.ndarray):
    return lambda reading: replace(reading, rate=reading.rate @ matrix)


def _orders(count: int) -> Iterator[list[int]]:
    if count <= LIMITS.most_wheels_in_any_order:
        yield from (list(order) for order in list(permutations(range(count)))[1:])
        return
    for i, k in combinations(range(count), 2):
        order = list(range(count))
        order[i], order[k] = k, i
        yield order


def _wheel_order(columns: Columns) -> Iterator[Mistake]:
    for quantity in ("wheel_torque", "wheel_momentum", "wheel_speed"):
        if quantity not in columns:
            continue
        names = list(columns[quantity]["names"])
        for order in _orders(len(names)):
            exchanged = [names[k] for k in order]
            yield Mistake(
                (KeyChange(f"columns.{quantity}.names", names, exchanged),),
                2,
                _wheels_read(_FIELD[quantity], np.eye(len(names))[order]),
                f"the columns of {_PEOPLE[quantity]} stand in another order",
            )


def _wheels_read(field: str, matrix: np.ndarray):
    return lambda reading: replace(reading, **{field: getattr(reading, field) @ matrix})


def _wheel_axes(campaign: Campaign, columns: Columns) -> Iterator[Mistake]:
    wheels, axes_B = campaign.wheels, campaign.wheel_axes_B
    for k, wheel in enumerate(wheels):
        signs = np.ones(len(wheels))
        signs[k] = -1.0
        words = f"the axis of wheel {wheel.name} points the other way"
        yield _axes_of_wheels(campaign, axes_B * signs, 3, words)
    if len(wheels) > 1:
        words = "all wheel axes point the other way (or torque and momentum have the other sign)"
        yield _axes_of_wheels(campaign, -axes_B, 3, words)
    for order in _orders(len(wheels)):
        words = "wheels are exchanged: their axes belong to other columns"
        yield _axes_of_wheels(campaign, axes_B[:, order], 3, words)
    yield from _momentum_sign(campaign, columns)


def _momentum_sign(campaign: Campaign, columns: Columns) -> Iterator[Mistake]:
    """The momentum alone has the other sign: all axes and the sense of the torque change."""
    if "wheel_torque" in columns and {"wheel_momentum", "wheel_speed"} & set(columns):
        words = "the wheel momentum has the other sign (it is the body's)"
        flipped = _axes_of_wheels(campaign, -campaign.wheel_axes_B, 3, words)
        torque = next(_sense_of_torque(columns))
        yield Mistake(flipped.changes + torque.changes, 3, _scaled("wheel_momentum", -1.0), words)


def _axes_of_wheels(campaign: Campaign, axes_B: np.ndarray, rarity: int, words: str) -> Mistake:
    stated = campaign.wheel_axes_B
    changes = tuple(
        KeyChange(f"wheels.{wheel.name}.axis", listed(old), listed(new))
        for wheel, old, new in zip(campaign.wheels, stated.T, axes_B.T, strict=True)
        if not np.allclose(old, new)
    )
    return Mistake(changes, rarity, lambda reading: replace(reading, axes_B=axes_B), words)


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
        yield Mistake(
            (
                KeyChange("columns.wheel_torque.unit", torque, unit),
                KeyChange("columns.wheel_momentum.unit", momentum, with_time),
            ),
            2,
            _both_scaled(factor, other),
            f"torque and momentum are in {unit} and {with_time}, not in {torque} and {momentum}",
        )


def _both_scaled(torque: float, momentum: float):
    return lambda reading: replace(
        reading, torque=reading.torque * torque, momentum=reading.momentum * momentum
    )


def _inertia_mistakes(campaign: Campaign) -> Iterator[Mistake]:
    tensor = campaign.inertia.tensor
    for unit, factor in _INERTIA_UNITS.items():
        words = f"the inertia tensor is in {unit}, not in kg m^2"
        yield _tensor_mistake(tensor, tensor * factor, 3, words)
    for order in list(permutations(range(3)))[1:]:
        exchanged = tensor[np.ix_(order, order)]
        words = "the inertia tensor is along other axes"
        yield _tensor_mistake(tensor, exchanged, 4, words)


def _tensor_mistake(tensor: np.ndarray, mended: np.ndarray, rarity: int, words: str) -> Mistake:
    change = KeyChange("inertia.tensor", listed(tensor), listed(mended))
    return Mistake((change,), rarity, lambda reading: replace(reading, inertia=mended), words)


def _spin_inertias(campaign: Campaign, columns: Columns) -> Iterator[Mistake]:
    """Spin inertias in a wrong unit, where they turn wheel speed into momentum."""
    if "wheel_speed" not in columns:
        return
    for unit, factor in _INERTIA_UNITS.items():
        changes = _spin_changes(campaign.wheels, factor)
        yield Mistake(
            changes,
            2,
            _scaled("wheel_speed", factor),
            f"the wheels' spin inertia is in {unit}, not in kg m^2",
        )


def _spin_changes(wheels: Sequence[Any], factor: float) -> tuple[KeyChange, ...]:
    return tuple(
        KeyChange(f"wheels.{w.name}.spin_inertia", w.spin_inertia, w.spin_inertia * factor)
        for w in wheels
    )
