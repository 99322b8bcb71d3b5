"""The form of `campaign.toml`: keys, units, and what contradicts each other.

An explicit table, not a units library: each quantity accepts a handful of spellings, so that a
wrong one is an error which lists them all.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from annotated_types import Len
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field
from pydantic_core import core_schema

UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
    "wheel_torque": {"N m": 1.0, "mN m": 1e-3, "uN m": 1e-6},
    "wheel_momentum": {"N m s": 1.0, "mN m s": 1e-3, "uN m s": 1e-6},
    "wheel_speed": {
        "rad/s": 1.0,
        "deg/s": math.pi / 180.0,
        "rpm": 2.0 * math.pi / 60.0,
        "Hz": 2.0 * math.pi,  # turns
    },
    "rate": {
        "rad/s": 1.0,
        "mrad/s": 1e-3,
        "deg/s": math.pi / 180.0,
        "mdeg/s": math.pi / 180.0 / 1e3,
        "deg/h": math.pi / 180.0 / 3600.0,  # and arcsec/s
        "rpm": 2.0 * math.pi / 60.0,
    },
    "magnetic_field": {"T": 1.0, "mT": 1e-3, "uT": 1e-6, "nT": 1e-9, "G": 1e-4},
    "position": {"m": 1.0, "km": 1e3},
    "dipole": {"A m^2": 1.0, "mA m^2": 1e-3},
    "angle": {"rad": 1.0, "deg": math.pi / 180.0},
    "level": {"1": 1.0, "%": 0.01},
}
"""For each quantity of a table, the factor from each accepted unit to SI; that of SI is first."""
DEGREE = UNITS["rate"]["deg/s"]  # [rad]


def to_si(values: np.ndarray, quantity: str, unit: str) -> np.ndarray:
    """Values of a quantity in SI units and radians; infinite where that overflows."""
    # An overflow becomes infinite, which the campaign refuses by name.
    with np.errstate(over="ignore"):
        return np.asarray(values, dtype=float) * UNITS[quantity][unit]


FORMAT = "bayes-inertia-campaign/1"
FORMAT_2 = "bayes-inertia-campaign/2"


def _one(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


Vector3 = Annotated[list[float], Len(3, 3)]
Vectors = Annotated[list[Vector3], Len(1)]
Matrix33 = Annotated[list[Vector3], Len(3, 3)]
OneOrThree = Annotated[Vector3, BeforeValidator(lambda x: [x] * 3 if _one(x) else x)]
OneOrMore = Annotated[list[float], Len(1), BeforeValidator(lambda x: [x] if _one(x) else x)]
End = Annotated[float, Field(allow_inf_nan=True)]
Names = Annotated[list[str], Len(1)]
Names1 = Annotated[list[str], Len(1, 1)]
Names3 = Annotated[list[str], Len(3, 3)]
Names4 = Annotated[list[str], Len(4, 4)]


@dataclass(frozen=True)
class UnitOf:
    """A unit of a quantity, one of those of the table, so that adding one there is enough."""

    quantity: str

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        return core_schema.literal_schema(list(UNITS[self.quantity]))


class Part(BaseModel):
    """A table of keys of the description: no other keys, no other types."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


class NamedPart(Part):
    """One of several tables of keys."""

    name: str = Field(description='name = "..."')


class MissionPart(Part):
    """`[mission]`: what reports are filed under, and when the campaign's clock was zero (UTC)."""

    name: str | None = None
    spacecraft: str | None = None
    operator: str | None = None
    document: str | None = None
    epoch: str | None = None


class InertiaPart(Part):
    """`[inertia]`: what was known before flight."""

    tensor: Matrix33 = Field(description="tensor = three rows of three numbers [kg m^2]")
    relative_sigma: float = Field(
        description="relative_sigma = the sd of each diagonal element, as a fraction of it, "
        "such as 0.04"
    )
    product_sigma: float = Field(
        description="product_sigma = the sd of each product of inertia [kg m^2]"
    )
    includes_wheel_spin: bool = Field(
        description="includes_wheel_spin = true if the tensor includes the wheels' spin inertia, "
        "false if not"
    )


class WheelPart(NamedPart):
    """One `[[wheels]]`."""

    axis: Vector3 = Field(
        description="axis = the unit spin axis in body axes, such as [1.0, 0.0, 0.0]"
    )
    spin_inertia: float = Field(
        description="spin_inertia = the inertia about the spin axis [kg m^2]"
    )
    max_torque: float | None = None
    max_momentum: float | None = None
    momentum_sigma: float | None = None


class RateSensorPart[Axes, Numbers](Part):
    """A rate sensor, by its rows of axes and its numbers an axis: only `sigma` has no default."""

    sigma: Numbers = Field(
        description="sigma = the white noise per sample [rad/s], one number or one an axis"
    )
    axes: Axes | None = None
    range: float | None = None
    scale_factor: Numbers | None = None
    scale_factor_sigma: Numbers | None = None
    bias: Numbers | None = None
    bias_sigma: Numbers | None = None
    rate_random_walk: float | None = None
    bias_instability: float | None = None
    bias_instability_time: float | None = None


class StarTrackerPart(Part):
    """A star tracker."""

    boresight: Vector3 = Field(description="boresight = a unit vector in body axes")
    sigma_cross: float = Field(description="sigma_cross = the noise across the boresight [rad]")
    sigma_roll: float = Field(description="sigma_roll = the noise about the boresight [rad]")
    low_frequency_sigma: float | None = None


class TimeColumn(Part):
    """`[time]` of a campaign, and `time` of columns that have their own."""

    names: Names1 = Field(description='names = ["..."], one column')
    unit: Annotated[str, UnitOf("time")]
    offset_s: float = 0.0
    # Whether the sensor samples at regular times although the stamps jitter about them.
    regular: bool = False


class InflatePart(Part):
    """What may have changed since a former result."""

    relative: float = Field(description="inflate = { relative = ... }")


class PriorPart(Part):
    """`[prior]` in place of other knowledge: a former result, principal moments, or a Gaussian."""

    model_config = ConfigDict(validate_by_alias=True)

    from_: str | None = Field(default=None, alias="from")
    inflate: InflatePart | None = None
    principal_moments: Vector3 | None = None
    relative_sd: OneOrThree | None = None
    axes_sd_deg: float | None = None
    axes_B: Matrix33 | None = None
    scale_factors: list[float] | None = None
    scale_factors_sd: float | list[float] | None = None
    names: list[str] | None = None
    mean: list[float] | None = None
    covariance: list[list[float]] | None = None
    lower: list[End] | None = None
    upper: list[End] | None = None
    logarithmic: list[str] | None = None

    def stated(self) -> dict[str, Any]:
        """What stands here itself, not in another file."""
        return self.model_dump(exclude={"from_", "inflate"}, exclude_none=True)
