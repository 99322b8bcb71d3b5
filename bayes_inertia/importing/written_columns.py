"""How the streams of an import stand in `[columns]` of its campaign.

Units and senses are those of the mapping, as far as the campaign format knows them. So the numbers
in the tables are those of the logs, and what `doctor` says of a key of `[columns]` holds for the
same key of the mapping.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from bayes_inertia.campaign.units import UNITS
from bayes_inertia.importing.mapping import streams_that_hold
from bayes_inertia.importing.mapping_schema import AttitudeStream, MappingPart, TorqueStream
from bayes_inertia.importing.unit_factors import unit_factor

_SI: Mapping[str, str] = MappingProxyType(
    {
        "rate": "rad/s",
        "wheel_torque": "N m",
        "wheel_momentum": "N m s",
        "wheel_speed": "rad/s",
        "magnetic_field": "T",
        "position": "m",
    }
)
# Suffix of the tables, and columns; "{}" stands for the number of the wheel.
_NAMES: Mapping[str, tuple[str, tuple[str, ...]]] = MappingProxyType(
    {
        "rate": ("rate", ("w1", "w2", "w3")),
        "wheel_torque": ("torque", ("u{}",)),
        "wheel_momentum": ("momentum", ("h{}",)),
        "wheel_speed": ("speed", ("speed{}",)),
        "attitude": ("tracker", ("q1", "q2", "q3", "q4")),
        "magnetic_field": ("field", ("Bx_N", "By_N", "Bz_N")),
        "position": ("position", ("rx_N", "ry_N", "rz_N")),
    }
)


@dataclass(frozen=True)
class WrittenColumns:
    """How one stream is written.

    Parameters
    ----------
    suffix : str
        What the names of its tables end with.
    names : tuple of str
        The columns.
    sense : dict of str to str
        Unit and sense, as its entry in `[columns]` states them.
    order : tuple of int
        Which element of the stream stands in each column.
    factors : tuple of float
        What each column is multiplied by.
    """

    suffix: str
    names: tuple[str, ...]
    sense: dict[str, str]
    order: tuple[int, ...]
    factors: tuple[float, ...]

    def cells(self, values: np.ndarray) -> np.ndarray:
        """The columns of a stream's values.

        `values` (n, width). Returns (n, columns).
        """
        return values[:, list(self.order)] * np.array(self.factors)


def written_columns(mapping: MappingPart) -> dict[str, WrittenColumns]:
    """How each stream is written, by the key of `[columns]`.

    Returns: in the order of `[columns]`, whether or not the mapping has the stream.
    """
    written = {}
    for key, (suffix, templates) in _NAMES.items():
        names = templates
        if "{}" in templates[0]:
            names = tuple(templates[0].format(k + 1) for k in range(len(mapping.wheels)))
        if key == "attitude":
            written[key] = _attitude(mapping, suffix)
            continue
        unit = _unit(mapping, key)
        sense = {"unit": unit}
        sign = 1.0
        if key == "wheel_torque":
            sense["acts_on"], sign = _acts_on(mapping)
        elif key.startswith("wheel"):
            sense["relative_to"] = "body"
        elif key != "rate":
            sense["frame"] = "inertial"
        factors = (sign / UNITS[key][unit],) * len(names)
        written[key] = WrittenColumns(suffix, names, sense, tuple(range(len(names))), factors)
    return written


def _unit(mapping: MappingPart, key: str) -> str:
    """The unit that the mapping states, spelled as the campaign format does; else SI."""
    stated = {getattr(stream, "unit", "") for stream in streams_that_hold(mapping, key)}
    if len(stated) != 1 or "" in stated:
        return _SI[key]
    factor = unit_factor(key, stated.pop())
    known = (unit for unit, size in UNITS[key].items() if math.isclose(size, factor, rel_tol=1e-9))
    return next(known, _SI[key])


def _acts_on(mapping: MappingPart) -> tuple[str, float]:
    """The sense of torques, and their sign in it."""
    streams = streams_that_hold(mapping, "wheel_torque")
    senses = {stream.acts_on for stream in streams if isinstance(stream, TorqueStream)}
    return ("body", -1.0) if senses == {"body"} else ("wheel", 1.0)


def _attitude(mapping: MappingPart, suffix: str) -> WrittenColumns:
    """Quaternions of the body with the scalar and the direction that the mapping states."""
    scalar, maps = "last", "inertial_to_body"
    for stream in streams_that_hold(mapping, "attitude"):
        if isinstance(stream, AttitudeStream) and stream.frame == "body":
            scalar = stream.scalar or scalar
            maps = stream.maps or maps
    order = (3, 0, 1, 2) if scalar == "first" else (0, 1, 2, 3)
    names = tuple(f"q{k}" for k in ((0, 1, 2, 3) if scalar == "first" else (1, 2, 3, 4)))
    sign = -1.0 if maps == "body_to_inertial" else 1.0
    factors = tuple(1.0 if element == 3 else sign for element in order)
    return WrittenColumns(suffix, names, {"scalar": scalar, "maps": maps}, order, factors)
