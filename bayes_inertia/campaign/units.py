"""The units a campaign may be written in, and their factors to SI units and radians.

An explicit table, not a units library: each quantity accepts a handful of spellings, so that a
wrong one is an error which lists them all.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

DEGREE = math.pi / 180.0  # [rad]

UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
        "wheel_torque": {"N m": 1.0, "mN m": 1e-3, "uN m": 1e-6},
        "wheel_momentum": {"N m s": 1.0, "mN m s": 1e-3, "uN m s": 1e-6},
        "wheel_speed": {"rad/s": 1.0, "deg/s": DEGREE, "rpm": 2.0 * math.pi / 60.0},
        "rate": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": DEGREE, "deg/h": DEGREE / 3600.0},
        "magnetic_field": {"T": 1.0, "mT": 1e-3, "uT": 1e-6, "nT": 1e-9, "G": 1e-4},
        "position": {"m": 1.0, "km": 1e3},
    }
)
"""For each quantity of `[columns]`, the factor from each accepted unit to SI."""


def to_si(values: np.ndarray, quantity: str, unit: str) -> np.ndarray:
    """Convert values of a quantity to SI units and radians.

    Returns: the same in SI units; infinite where that overflows.

    Examples
    --------
    >>> to_si(np.array([1.5]), "time", "min").tolist()
    [90.0]
    """
    # An overflow becomes infinite, which the campaign refuses by name.
    with np.errstate(over="ignore"):
        return np.asarray(values, dtype=float) * UNITS[quantity][unit]
