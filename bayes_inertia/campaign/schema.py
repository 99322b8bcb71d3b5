"""The form of `campaign.toml`: keys, units, and what contradicts each other.

The units a campaign may be written in, and their factors to SI units and radians.

An explicit table, not a units library: each quantity accepts a handful of spellings, so that a
wrong one is an error which lists them all.

The form of `campaign.toml`: its keys, their types, and what to write where one is missing.

From the text of `campaign.toml` to its checked content, with errors that name the key.

What keys of `campaign.toml` demand of each other; each key alone is checked by its type.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

import numpy as np
from annotated_types import Len
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from bayes_inertia.campaign.checked_toml import parse_toml
from bayes_inertia.errors import CampaignError

UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
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
    }
)
"""For each quantity of `[columns]`, the factor from each accepted unit to SI."""
DEGREE = UNITS["rate"]["deg/s"]  # [rad]


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
    """Keys of every entry of `[columns]`: its own clock.

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


class InflatePart(_Part):
    """What may have changed since a former result."""

    relative: float = Field(description="inflate = { relative = ... }")


class PriorPart(_Part):
    """`[prior]`: a former result in place of other knowledge."""

    model_config = ConfigDict(validate_by_alias=True)

    from_: str = Field(alias="from", description='from = "RUN" or a JSON file')
    inflate: InflatePart | None = None


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
    prior: PriorPart | None = None


def parse_description(text: str, label: str) -> CampaignPart:
    """The content of a `campaign.toml`, every key checked.

    Parameters
    ----------
    text : str
        The content of the file.
    label : str
        The file, as messages name it.

    Returns
    -------
    CampaignPart
        What the file says.

    Raises
    ------
    CampaignError
        If it is no TOML (naming the line), or a key is unknown, missing, or of a wrong type or
        value (naming the key).

    Examples
    --------
    >>> parse_description('format = "bayes-inertia-campaign/1"\\nnmae = "x"', "campaign.toml")
    Traceback (most recent call last):
    bayes_inertia.errors.CampaignError: campaign.toml, key nmae: unknown key; did you mean "name"?
    """
    parsed = parse_toml(text, label, CampaignPart)
    check_consistency(parsed, label)
    return parsed


_WHEEL_KEYS = ("wheel_torque", "wheel_momentum", "wheel_speed")


def check_consistency(campaign: CampaignPart, label: str) -> None:
    """Refuse entries that contradict each other or the hardware."""
    _check_wheels(campaign, label)
    given = campaign.columns.given()
    if "attitude" in given and campaign.star_tracker is None:
        _refuse(
            label,
            "columns.attitude",
            "attitude columns without a star tracker",
            "add [star_tracker] with its sigmas, or leave the columns out",
        )
    for slew in campaign.slews:
        _check_files(slew, campaign, label)
        _check_names(slew, campaign, label)


def _refuse(label: str, key: str, what: str, advice: str) -> NoReturn:
    raise CampaignError(what, where=f"{label}, key {key}", advice=advice)


def _check_wheels(campaign: CampaignPart, label: str) -> None:
    """One measurement of the wheels, one column a wheel."""
    given = campaign.columns.given()
    if "wheel_momentum" in given and "wheel_speed" in given:
        _refuse(
            label,
            "columns.wheel_speed",
            "wheel_momentum is given too",
            "keep one of the two, they are the same measurement",
        )
    for key in _WHEEL_KEYS:
        if key in given and len(given[key].names) != len(campaign.wheels):
            _refuse(
                label,
                f"columns.{key}.names",
                f"{len(given[key].names)} column(s) for {len(campaign.wheels)} [[wheels]]",
                "name one column a wheel, in the same order",
            )


def _check_files(slew: SlewPart, campaign: CampaignPart, label: str) -> None:
    """Either `file` or `files`, and only tables of entries that `[columns]` has."""
    place = f"slews.{slew.name}"
    if slew.file is None and slew.files is None:
        advice = 'add file = the table of the slew, such as "slew_01.csv"'
        _refuse(label, f"{place}.file", "missing key", f"{advice}, or files = {{ rate = ... }}")
    if slew.file is not None and slew.files is not None:
        _refuse(
            label,
            f"{place}.files",
            "file is given too",
            "keep file (one table) or files (one table for each entry of [columns])",
        )
    for key in () if slew.files is None else type(slew.files).model_fields:
        if slew.file_of(key) is not None and key not in campaign.columns.given():
            _refuse(
                label,
                f"{place}.files.{key}",
                f"[columns] has no {key}",
                f"say under columns.{key} which columns hold it",
            )


def _check_names(slew: SlewPart, campaign: CampaignPart, label: str) -> None:
    """In one table each column has one meaning; only columns of time may be shared."""
    used: dict[tuple[str | None, str], str] = {}
    times: dict[tuple[str | None, str], str] = {}
    columns = campaign.columns
    for key, entry in columns.given().items():
        if key == "time":
            continue
        file = slew.file_of(key)
        own = entry.time is not None
        clock = entry.time if own else columns.time
        times[file, clock.names[0]] = f"{key}.time" if own else "time"
        for name in entry.names:
            if (file, name) in used:
                _refuse(
                    label,
                    f"columns.{key}.names",
                    f"the column {name!r} is already used by {used[file, name]}",
                    "name each column once",
                )
            used[file, name] = key
    for place, key in times.items():
        if place in used:
            _refuse(
                label,
                f"columns.{used[place]}.names",
                f"the column {place[1]!r} is already used by {key}",
                "name each column once",
            )
