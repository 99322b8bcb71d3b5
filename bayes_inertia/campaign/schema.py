"""The form of `campaign.toml`: its keys, their types, and what to write where one is missing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

from annotated_types import Len
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from bayes_inertia.campaign.units import UNITS

FORMAT = "bayes-inertia-campaign/1"


def _spread(value: Any) -> Any:
    return [value] * 3 if isinstance(value, int | float) and not isinstance(value, bool) else value


Vector3 = Annotated[list[float], Len(3, 3)]
Matrix33 = Annotated[list[Vector3], Len(3, 3)]
OneOrThree = Annotated[Vector3, BeforeValidator(_spread)]
Names = Annotated[list[str], Len(1)]
Names1 = Annotated[list[str], Len(1, 1)]
Names3 = Annotated[list[str], Len(3, 3)]
Names4 = Annotated[list[str], Len(4, 4)]
# The accepted units are those of the table, so that adding one there is enough.
if TYPE_CHECKING:  # A type checker cannot evaluate a table.
    type TimeUnit = str
    type TorqueUnit = str
    type MomentumUnit = str
    type SpeedUnit = str
    type RateUnit = str
    type FieldUnit = str
    type PositionUnit = str
else:
    TimeUnit = Literal[tuple(UNITS["time"])]
    TorqueUnit = Literal[tuple(UNITS["wheel_torque"])]
    MomentumUnit = Literal[tuple(UNITS["wheel_momentum"])]
    SpeedUnit = Literal[tuple(UNITS["wheel_speed"])]
    RateUnit = Literal[tuple(UNITS["rate"])]
    FieldUnit = Literal[tuple(UNITS["magnetic_field"])]
    PositionUnit = Literal[tuple(UNITS["position"])]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


class MissionPart(_Part):
    """`[mission]`: what reports are filed under; nothing is computed from it."""

    name: str | None = None
    spacecraft: str | None = None
    operator: str | None = None
    document: str | None = None


class InertiaPart(_Part):
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


class WheelPart(_Part):
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


class RateSensorPart(_Part):
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


class StarTrackerPart(_Part):
    """`[star_tracker]`."""

    boresight: Vector3 = Field(description="boresight = a unit vector in body axes")
    sigma_cross: float = Field(description="sigma_cross = the noise across the boresight [rad]")
    sigma_roll: float = Field(description="sigma_roll = the noise about the boresight [rad]")
    low_frequency_sigma: float | None = None


class TimeColumn(_Part):
    """`time` of `[columns]`, and of an entry that has its own."""

    names: Names1 = Field(description='names = ["..."], one column')
    unit: TimeUnit
    offset_s: float = 0.0
    # Whether the sensor samples at regular times although the stamps jitter about them.
    regular: bool = False


class _Stream(_Part):
    """What every entry of `[columns]` may have: its own clock.

    The true time of a reading is its stamp plus `offset_s` [s], of the entry and of its time.
    """

    offset_s: float = 0.0
    time: TimeColumn | None = None


class TorqueColumns(_Stream):
    """`wheel_torque` of `[columns]`: one column a wheel."""

    names: Names = Field(description='names = ["...", ...], one column a wheel')
    unit: TorqueUnit
    acts_on: Literal["wheel", "body"]


class MomentumColumns(_Stream):
    """`wheel_momentum` of `[columns]`: one column a wheel."""

    names: Names = Field(description='names = ["...", ...], one column a wheel')
    unit: MomentumUnit
    relative_to: Literal["body"]


class SpeedColumns(_Stream):
    """`wheel_speed` of `[columns]`: one column a wheel."""

    names: Names = Field(description='names = ["...", ...], one column a wheel')
    unit: SpeedUnit
    relative_to: Literal["body"]


class RateColumns(_Stream):
    """`rate` of `[columns]`: one column a sensor axis."""

    names: Names3 = Field(description='names = ["...", "...", "..."], one column a sensor axis')
    unit: RateUnit


class AttitudeColumns(_Stream):
    """`attitude` of `[columns]`: a quaternion, with the place of its scalar and its sense."""

    names: Names4 = Field(
        description='names = ["...", "...", "...", "..."], the four elements of the quaternion'
    )
    scalar: Literal["first", "last"]
    maps: Literal["inertial_to_body", "body_to_inertial"]


class MagneticFieldColumns(_Stream):
    """`magnetic_field` of `[columns]`."""

    names: Names3 = Field(description='names = ["...", "...", "..."], along the inertial axes')
    unit: FieldUnit
    frame: Literal["inertial"]


class PositionColumns(_Stream):
    """`position` of `[columns]`."""

    names: Names3 = Field(description='names = ["...", "...", "..."], along the inertial axes')
    unit: PositionUnit
    frame: Literal["inertial"]


class ColumnsPart(_Part):
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


class FilesPart(_Part):
    """`files` of one of `[[slews]]`: the table of each entry of `[columns]`."""

    rate: str = Field(description='rate = the table of the rates, such as "slew_01_rate.csv"')
    wheel_torque: str | None = None
    wheel_momentum: str | None = None
    wheel_speed: str | None = None
    attitude: str | None = None
    magnetic_field: str | None = None
    position: str | None = None


class SlewPart(_Part):
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

    def tables(self) -> list[str]:
        """The tables of the slew, each once, in the order of `[columns]`."""
        files = [self.file_of(key) for key in FilesPart.model_fields]
        return list(dict.fromkeys(file for file in files if file is not None))


class CampaignPart(_Part):
    """The whole of `campaign.toml`."""

    format: Literal["bayes-inertia-campaign/1"]
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
