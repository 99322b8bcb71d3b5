"""The form of `campaign.toml`: keys, units, and what contradicts each other.

An explicit table, not a units library: each quantity accepts a handful of spellings, so that a
wrong one is an error which lists them all.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, NoReturn

import numpy as np
from annotated_types import Len
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field
from pydantic_core import core_schema

from bayes_inertia.errors import CampaignError

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
        "deg/h": math.pi / 180.0 / 3600.0,
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


def _spread(value: Any) -> Any:
    """One number as three, anything else as it is."""
    return [value] * 3 if isinstance(value, int | float) and not isinstance(value, bool) else value


Vector3 = Annotated[list[float], Len(3, 3)]
Matrix33 = Annotated[list[Vector3], Len(3, 3)]
OneOrThree = Annotated[Vector3, BeforeValidator(_spread)]
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


class MissionPart(Part):
    """`[mission]`: what reports are filed under; nothing is computed from it."""

    name: str | None = None
    spacecraft: str | None = None
    operator: str | None = None
    document: str | None = None


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


class WheelPart(Part):
    """One `[[wheels]]`."""

    name: str = Field(description='name = "..."')
    axis: Vector3 = Field(
        description="axis = the unit spin axis in body axes, such as [1.0, 0.0, 0.0]"
    )
    spin_inertia: float = Field(
        description="spin_inertia = the inertia about the spin axis [kg m^2]"
    )
    max_torque: float | None = None
    max_momentum: float | None = None
    momentum_sigma: float | None = None


class RateSensorPart(Part):
    """`[rate_sensor]`: only `sigma` has no default."""

    sigma: OneOrThree = Field(
        description="sigma = the white noise per sample [rad/s], one number or three"
    )
    axes: Matrix33 | None = None
    range: float | None = None
    scale_factor: OneOrThree | None = None
    scale_factor_sigma: OneOrThree | None = None
    bias: OneOrThree | None = None
    bias_sigma: OneOrThree | None = None
    rate_random_walk: float | None = None
    bias_instability: float | None = None
    bias_instability_time: float | None = None


class StarTrackerPart(Part):
    """`[star_tracker]`."""

    boresight: Vector3 = Field(description="boresight = a unit vector in body axes")
    sigma_cross: float = Field(description="sigma_cross = the noise across the boresight [rad]")
    sigma_roll: float = Field(description="sigma_roll = the noise about the boresight [rad]")
    low_frequency_sigma: float | None = None


class TimeColumn(Part):
    """`time` of `[columns]`, and of an entry that has its own."""

    names: Names1 = Field(description='names = ["..."], one column')
    unit: Annotated[str, UnitOf("time")]
    offset_s: float = 0.0
    # Whether the sensor samples at regular times although the stamps jitter about them.
    regular: bool = False


class StreamColumns(Part):
    """Keys of every entry of `[columns]`: its own clock.

    The true time of a reading is its stamp plus `offset_s` [s], of the entry and of its time.
    """

    offset_s: float = 0.0
    time: TimeColumn | None = None


class TorqueColumns(StreamColumns):
    """`wheel_torque` of `[columns]`: one column a wheel."""

    names: Names = Field(description='names = ["...", ...], one column a wheel')
    unit: Annotated[str, UnitOf("wheel_torque")]
    acts_on: Literal["wheel", "body"]


class MomentumColumns(StreamColumns):
    """`wheel_momentum` of `[columns]`: one column a wheel."""

    names: Names = Field(description='names = ["...", ...], one column a wheel')
    unit: Annotated[str, UnitOf("wheel_momentum")]
    relative_to: Literal["body"]


class SpeedColumns(StreamColumns):
    """`wheel_speed` of `[columns]`: one column a wheel."""

    names: Names = Field(description='names = ["...", ...], one column a wheel')
    unit: Annotated[str, UnitOf("wheel_speed")]
    relative_to: Literal["body"]


class RateColumns(StreamColumns):
    """`rate` of `[columns]`: one column a sensor axis."""

    names: Names3 = Field(description='names = ["...", "...", "..."], one column a sensor axis')
    unit: Annotated[str, UnitOf("rate")]


class AttitudeColumns(StreamColumns):
    """`attitude` of `[columns]`: a quaternion, with the place of its scalar and its sense."""

    names: Names4 = Field(
        description='names = ["...", "...", "...", "..."], the four elements of the quaternion'
    )
    scalar: Literal["first", "last"]
    maps: Literal["inertial_to_body", "body_to_inertial"]


class MagneticFieldColumns(StreamColumns):
    """`magnetic_field` of `[columns]`."""

    names: Names3 = Field(description='names = ["...", "...", "..."], along the inertial axes')
    unit: Annotated[str, UnitOf("magnetic_field")]
    frame: Literal["inertial"]


class PositionColumns(StreamColumns):
    """`position` of `[columns]`."""

    names: Names3 = Field(description='names = ["...", "...", "..."], along the inertial axes')
    unit: Annotated[str, UnitOf("position")]
    frame: Literal["inertial"]


class ColumnsPart(Part):
    """`[columns]`: which columns of the tables hold what, in which unit and sense."""

    time: TimeColumn = Field(description='time = { names = ["..."], unit = "s" }')
    rate: RateColumns = Field(
        description='rate = { names = ["...", "...", "..."], unit = "rad/s" }'
    )
    wheel_torque: TorqueColumns | None = None
    wheel_momentum: MomentumColumns | None = None
    wheel_speed: SpeedColumns | None = None
    attitude: AttitudeColumns | None = None
    magnetic_field: MagneticFieldColumns | None = None
    position: PositionColumns | None = None

    def given(self) -> dict[str, Any]:
        """The entries that the campaign has, by key."""
        return {
            key: entry
            for key in type(self).model_fields
            if (entry := getattr(self, key)) is not None
        }


class FilesPart(Part):
    """`files` of one of `[[slews]]`: the table of each entry of `[columns]`."""

    rate: str = Field(description='rate = the table of the rates, such as "slew_01_rate.csv"')
    wheel_torque: str | None = None
    wheel_momentum: str | None = None
    wheel_speed: str | None = None
    attitude: str | None = None
    magnetic_field: str | None = None
    position: str | None = None


class SlewPart(Part):
    """One `[[slews]]`; either `file` or `files` is given."""

    name: str = Field(description='name = "..."')
    file: str | None = Field(
        default=None, description='file = the table of the slew, such as "slew_01.csv"'
    )
    files: FilesPart | None = None
    start: float = Field(description="start = the time of the first row in the campaign [s]")
    axis: Vector3 | None = None
    angle_deg: float | None = None

    def file_of(self, key: str) -> str | None:
        """The table that holds an entry of `[columns]`; None if this slew has none."""
        return self.file if self.files is None else getattr(self.files, key)


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


class CampaignPart(Part):
    """The whole of `campaign.toml`."""

    # What to do with a key of the other format.
    other_format: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("actuators", "sensors", "environment", "changes", "time"),
        f'it is of format 2: write format = "{FORMAT_2}", and [[sensors]], [[actuators]] in place '
        "of [columns]",
    )

    # A file of format 2 has another form; here its name stands for messages.
    format: Literal["bayes-inertia-campaign/1", "bayes-inertia-campaign/2"]
    name: str = Field(description='name = "..."')
    inertia: InertiaPart = Field(
        description="[inertia] with tensor, relative_sigma, product_sigma, includes_wheel_spin"
    )
    rate_sensor: RateSensorPart = Field(description="[rate_sensor] with at least sigma")
    columns: ColumnsPart = Field(description="[columns] with at least time and rate")
    slews: Annotated[list[SlewPart], Len(1)] = Field(
        description="one [[slews]] a slew, with name, file, start"
    )
    wheels: list[WheelPart] = Field(default=[])
    star_tracker: StarTrackerPart | None = None
    mission: MissionPart | None = None
    prior: PriorPart | None = None


_WHEEL_KEYS = ("wheel_torque", "wheel_momentum", "wheel_speed")


def check_consistency(campaign: CampaignPart, label: str) -> None:
    """Refuse entries that contradict each other or the hardware."""
    _check_wheels(campaign, label)
    given = campaign.columns.given()
    if "attitude" in given and campaign.star_tracker is None:
        what = "attitude columns without a star tracker"
        advice = "add [star_tracker] with its sigmas, or leave the columns out"
        refuse(label, "columns.attitude", what, advice)
    for slew in campaign.slews:
        _check_files(slew, campaign, label)


def refuse(label: str, key: str, what: str, advice: str) -> NoReturn:
    """Raise an error that names a key of the description in the file `label`."""
    raise CampaignError(what, where=f"{label}, key {key}", advice=advice)


def _check_wheels(campaign: CampaignPart, label: str) -> None:
    """One column a wheel."""
    given = campaign.columns.given()
    for key in _WHEEL_KEYS:
        if key in given and len(given[key].names) != len(campaign.wheels):
            what = f"{len(given[key].names)} column(s) for {len(campaign.wheels)} [[wheels]]"
            advice = "name one column a wheel, in the same order"
            refuse(label, f"columns.{key}.names", what, advice)


def _check_files(slew: SlewPart, campaign: CampaignPart, label: str) -> None:
    """Either `file` or `files`, and only tables of entries that `[columns]` has."""
    place = f"slews.{slew.name}"
    if slew.file is None and slew.files is None:
        advice = 'add file = the table of the slew, such as "slew_01.csv"'
        refuse(label, f"{place}.file", "missing key", f"{advice}, or files = {{ rate = ... }}")
    if slew.file is not None and slew.files is not None:
        what = "file is given too"
        advice = "keep file (one table) or files (one table for each entry of [columns])"
        refuse(label, f"{place}.files", what, advice)
    for key in () if slew.files is None else type(slew.files).model_fields:
        if slew.file_of(key) is not None and key not in campaign.columns.given():
            what = f"[columns] has no {key}"
            advice = f"say under columns.{key} which columns hold it"
            refuse(label, f"{place}.files.{key}", what, advice)
