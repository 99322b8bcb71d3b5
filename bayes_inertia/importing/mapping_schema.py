"""The form of `mapping.toml`: what the columns of raw logs mean, and how to cut them into slews.

The hardware is described as in `campaign.toml`. Only noises may be left out: the import then says
what it measured at rest. What a file itself states (CCSDS AEM, rows of units) may be left out too.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, get_args

from annotated_types import Len
from pydantic import Field

from bayes_inertia.campaign import schema

MAPPING_FORMAT = "bayes-inertia-mapping/1"

Numbers = float | Annotated[list[float], Len(1)]


class MappedRateSensor(schema.RateSensorPart[schema.Matrix33, schema.OneOrThree]):
    """`[rate_sensor]`: `sigma` may be left out, to be told what the rests show."""

    sigma: schema.OneOrThree | None = None  # type: ignore[assignment]


class MappedStarTracker(schema.StarTrackerPart):
    """`[star_tracker]`: the sigmas may be left out, to be told what the rests show."""

    sigma_cross: float | None = None  # type: ignore[assignment]
    sigma_roll: float | None = None  # type: ignore[assignment]


class TimeStampPart(schema.Part):
    """`time` of a stream: the columns of its stamps and the clock that they are read from."""

    names: list[str] = Field(default=[], description='names = ["..."], the columns of the time')
    kind: str = ""
    epoch: str = ""
    # What each of several columns counts, such as "ns" or "s/65536"; else their names say it.
    units: list[str] = Field(default=[])
    # How dates are written, in directives of strptime; "" for the forms that are told.
    format: str = ""
    # How often GPS weeks of ten bits began anew.
    gps_rollovers: int | None = Field(default=None, ge=0, le=4)
    # Rows a second of a log without stamps.
    rate_hz: float | None = Field(default=None, gt=0.0)
    # Whether the sensor samples at regular times although the stamps jitter about them.
    regular: bool = False


class ValidRows(schema.Part):
    """`valid` of a stream: rows whose flag has another value hold no reading."""

    name: str = Field(description='name = "...", the column of the flag')
    equals: int | float | str | bool | Annotated[list[int | float | str], Len(1)] = Field(
        description="equals = the value of the flag, or a list of values, that mark a good reading"
    )


class TextFilePart(schema.Part):
    """`text` of a stream: how a text file is written, where it cannot be told from its content."""

    delimiter: str = ""
    decimal: Literal["", ".", ","] = ""
    encoding: str = ""
    comment: str = ""
    header_line: int = 0
    units_line: int = 0


_STREAM_OUT = "leave the [[streams]] of {holds} out of the mapping"
_WHEEL_OFF = "a wheel that is off: take it out of [[wheels]] and its columns out of every stream"
_OF_TACHOMETER = f"export it again; {_WHEEL_OFF}; one without tachometer: {_STREAM_OUT}"


class _StreamPart(schema.Part):
    # What an import writes: what the names of tables end with, columns ("{}": one a wheel), sense.
    suffix: ClassVar[str]
    columns: ClassVar[tuple[str, ...]]
    sense: ClassVar[Mapping[str, str]] = {}
    advice_if_empty: ClassVar[str] = f"export it again, or {_STREAM_OUT}"

    @classmethod
    def of_wheels(cls) -> bool:
        """Whether each wheel has a column, which may stand in a stream of its own."""
        return "{}" in cls.columns[0]

    files: Annotated[list[str], Len(1)] = Field(
        description='files = ["...", ...], names or patterns of the files, such as "gyro_*.csv"'
    )
    table: str = ""
    time: TimeStampPart = TimeStampPart()
    offset_s: float = 0.0
    valid: ValidRows | None = None
    # Numbers of the file, before `scale`, that mark "no reading" or "no solution", such as -9999.
    missing: Numbers | None = None
    text: TextFilePart = TextFilePart()


class _ReadingsPart(_StreamPart):
    """Readings with a unit; counts become readings by scale * count + offset."""

    unit: str = ""
    scale: Numbers = 1.0
    offset: Numbers = 0.0


class _WheelsPart(_ReadingsPart):
    names: schema.Names = Field(description='names = ["...", ...], one column a wheel')
    wheels: Annotated[list[str], Len(1)] | None = None


class RateStream(_ReadingsPart):
    """Rates of the body, along its axes or along those of the sensor."""

    suffix, columns = "rate", ("w1", "w2", "w3")
    advice_if_empty = (
        "export it again, or correct {where}.names: the rates of all three axes are needed"
    )
    holds: Literal["rate"]
    names: schema.Names3 = Field(description='names = ["...", "...", "..."], one column an axis')
    frame: Literal["body", "sensor"]
    mounting: schema.Matrix33 | None = None
    body_from_sensor: schema.Matrix33 | None = None


class TorqueStream(_WheelsPart):
    """Torque commands of the wheels."""

    suffix, columns, sense = "torque", ("u{}",), {"acts_on": "wheel"}
    advice_if_empty = f"export it again, or correct {{where}}.names; {_WHEEL_OFF}"
    holds: Literal["wheel_torque"]
    acts_on: Literal["wheel", "body"]


class MomentumStream(_WheelsPart):
    """Momentum of the wheels."""

    suffix, columns, sense = "momentum", ("h{}",), {"relative_to": "body"}
    advice_if_empty = _OF_TACHOMETER
    holds: Literal["wheel_momentum"]
    relative_to: Literal["body", "inertial"]


class SpeedStream(_WheelsPart):
    """Speed of the wheels."""

    suffix, columns, sense = "speed", ("speed{}",), {"relative_to": "body"}
    advice_if_empty = _OF_TACHOMETER
    holds: Literal["wheel_speed"]
    relative_to: Literal["body", "inertial"]


class AttitudeStream(_StreamPart):
    """Attitudes in any form; files of CCSDS AEM state most of it themselves."""

    suffix, columns = "tracker", ("q1", "q2", "q3", "q4")
    holds: Literal["attitude"]
    form: Literal["quaternion", "euler", "dcm", "mrp"] | None = None
    names: list[str] = Field(default=[])
    scalar: Literal["first", "last"] | None = None
    maps: Literal["inertial_to_body", "body_to_inertial"] | None = None
    scale: Numbers = 1.0
    sequence: str = ""
    turns: Literal["intrinsic", "extrinsic"] | None = None
    unit: str = ""
    frame: Literal["body", "tracker"] | None = None
    body_from_tracker: schema.Matrix33 | None = None


class _InertialPart(_ReadingsPart):
    sense: ClassVar[Mapping[str, str]] = {"frame": "inertial"}

    names: schema.Names3 = Field(
        description='names = ["...", "...", "..."], along the inertial axes'
    )
    frame: Literal["inertial"]


class MagneticFieldStream(_InertialPart):
    """The magnetic field along inertial axes."""

    suffix, columns = "field", ("Bx_N", "By_N", "Bz_N")
    holds: Literal["magnetic_field"]


class PositionStream(_InertialPart):
    """The position along inertial axes."""

    suffix, columns = "position", ("rx_N", "ry_N", "rz_N")
    holds: Literal["position"]


WheelStream = TorqueStream | MomentumStream | SpeedStream
STREAM_TYPES: dict[str, type[_StreamPart]] = {
    str(get_args(kind.model_fields["holds"].annotation)[0]): kind
    for kind in get_args(
        RateStream | WheelStream | AttitudeStream | MagneticFieldStream | PositionStream
    )
}
"""The form of each stream by what it holds, in the order of a mapping to be filled in."""
ReadingsStream = RateStream | WheelStream | MagneticFieldStream | PositionStream
MappedStream = Annotated[ReadingsStream | AttitudeStream, Field(discriminator="holds")]


class CutPart(schema.Part):
    """`[cut]`: how logs become slews. Every key has a default that the log gives."""

    by: Literal["rest", "files", "gaps"] | None = None
    rest_rate: float | None = Field(default=None, gt=0.0)
    before_s: float | None = Field(default=None, ge=0.0)
    after_s: float | None = Field(default=None, ge=0.0)
    min_rest_s: float | None = Field(default=None, gt=0.0)
    gap_s: float | None = Field(default=None, gt=0.0)
    longest_s: float | None = Field(default=None, gt=0.0)
    between_files_s: float | None = Field(default=None, gt=0.0)


class MappedSlew(schema.Part):
    """One `[[slews]]` of a mapping: a part of the log that the user names."""

    name: str = Field(description='name = "..."')
    start: str | float = Field(
        description='start = a UTC time such as "2026-03-01T12:00:00Z", or seconds on the '
        "clock of streams that count seconds"
    )
    end: str | float = Field(description="end = as start")
    axis: schema.Vector3 | None = None
    angle_deg: float | None = None


class MappingPart(schema.Part):
    """The whole of `mapping.toml`."""

    format: Literal["bayes-inertia-mapping/1"]
    name: str = Field(description='name = "..."')
    # Of streams that count from a zero of their own and state no `time.epoch`.
    epoch: str = ""
    inertia: schema.InertiaPart = Field(
        description="[inertia] with tensor, relative_sigma, product_sigma, includes_wheel_spin"
    )
    rate_sensor: MappedRateSensor = Field(
        description="[rate_sensor], as in campaign.toml; sigma may be left out"
    )
    streams: Annotated[list[MappedStream], Len(1)] = Field(
        description='one [[streams]] a quantity, at least one that holds = "rate"'
    )
    wheels: list[schema.WheelPart] = Field(default=[])
    star_tracker: MappedStarTracker | None = None
    cut: CutPart = CutPart()
    reduce: Literal["block_means"] | None = Field(
        default=None, description='reduce = "block_means", before the first table'
    )
    slews: list[MappedSlew] = Field(default=[])

    def wheels_of(self, stream: _StreamPart | None = None) -> list[str]:
        """Names of the wheels that a stream's columns are of, in their order; else of all."""
        stated = getattr(stream, "wheels", None)
        return list(stated) if stated else [wheel.name for wheel in self.wheels]
