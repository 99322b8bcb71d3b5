"""The form of `campaign.toml`: actuators, sensors and environment, each a stream."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from annotated_types import Len
from pydantic import Field

from bayes_inertia.campaign import schema
from bayes_inertia.campaign.hardware import WheelState


class OfStream(schema.Part):
    """Columns of a stream, or of the one table of a slew; their own clock.

    The true time of a reading is its stamp plus `offset_s` [s], of the columns and of their time.
    """

    stream: str | None = None
    offset_s: float = 0.0
    time: schema.TimeColumn | None = None


class OfWheel(OfStream):
    """The column of one wheel."""

    names: schema.Names1 = Field(description='names = ["..."], the column of this wheel')


class WheelTorque(OfWheel):
    """`torque` of a wheel."""

    unit: Annotated[str, schema.UnitOf("wheel_torque")]
    acts_on: Literal["wheel", "body"]


class WheelMomentum(OfWheel):
    """`momentum` of a wheel by its tachometer."""

    unit: Annotated[str, schema.UnitOf("wheel_momentum")]
    relative_to: Literal["body"]
    sigma: float | None = None  # noise of a reading [N m s]


class WheelSpeed(OfWheel):
    """`speed` of a wheel by its tachometer."""

    unit: Annotated[str, schema.UnitOf("wheel_speed")]
    relative_to: Literal["body"]
    sigma: float | None = None  # noise of a reading [rad/s]


class WheelDevice(schema.WheelPart):
    """One of `[[actuators]]`: a reaction or momentum wheel."""

    type: Literal["wheel"]
    state: WheelState | None = None
    torque: WheelTorque | None = None
    momentum: WheelMomentum | None = None
    speed: WheelSpeed | None = None


Held = Literal["hold", "line", "mean"]
_NAMES = 'names = ["...", ...], '


class InputColumns(OfStream):
    """What a device was told to do, or did: its stream, and what it did between the readings."""

    between: Held = "hold"


class TorqueInput(InputColumns):
    """`torque` of a known torque."""

    names: schema.Names3 = Field(description=_NAMES + "the three components")
    unit: Annotated[str, schema.UnitOf("wheel_torque")]
    frame: Literal["body", "inertial"]


class GainedDevice(schema.NamedPart):
    """One of `[[actuators]]` beside wheels, of a gain that may be uncertain."""

    gain_sigma: float = 0.0


class TorqueDevice(GainedDevice):
    """One of `[[actuators]]`: a torque that telemetry tells, whatever makes it."""

    type: Literal["torque"]
    torque: TorqueInput = Field(
        description='torque = { names = [...], unit = "N m", frame = "body" }'
    )


class DipoleInput(InputColumns):
    """`dipole` of magnetorquers."""

    names: schema.Names = Field(description=_NAMES + "one column a torquer")
    unit: Annotated[str, schema.UnitOf("dipole")]


class MagnetorquerDevice(GainedDevice):
    """One of `[[actuators]]`: magnetorquers of one gain."""

    type: Literal["magnetorquer"]
    dipole: DipoleInput = Field(description='dipole = { names = [...], unit = "A m^2" }')
    axes: schema.Vectors | None = None


class LevelInput(InputColumns):
    """`level` of thrusters: shares of full thrust."""

    names: schema.Names = Field(description=_NAMES + "one column a thruster")
    unit: Annotated[str, schema.UnitOf("level")]


class OnTimeInput(OfStream):
    """`on_time` of thrusters: how long each is on from the time of its row."""

    names: schema.Names = Field(description=_NAMES + "one column a thruster")
    unit: Annotated[str, schema.UnitOf("time")]
    between: Literal["on_time"] = "on_time"


class ThrusterDevice(GainedDevice):
    """One of `[[actuators]]`: thrusters, by their torques at full thrust."""

    type: Literal["thruster"]
    torques: schema.Vectors = Field(
        description="torques = the torque of each thruster at full thrust about the centre of "
        "mass, body axes [N m], such as [[0.05, 0.0, 0.0], ...]"
    )
    on_time: OnTimeInput | None = None
    level: LevelInput | None = None
    each_gain_sigma: float = 0.0
    direction_sigma: float = 0.0


class GimbalInput(InputColumns):
    """`gimbal_angle` of gimballed rotors, with the noise of a reading."""

    names: schema.Names = Field(description=_NAMES + "one column a gimbal")
    unit: Annotated[str, schema.UnitOf("angle")]
    between: Held = "line"
    sigma: float = 0.0  # [rad]


class RotorsDevice(GainedDevice):
    """One of `[[actuators]]`: rotors of constant speed on gimbals (control-moment gyros)."""

    type: Literal["gimballed_rotors"]
    momentum: schema.OneOrMore = Field(
        description="momentum = the momentum of each rotor [N m s], one number or one a rotor"
    )
    gimbal_axes: schema.Vectors = Field(
        description="gimbal_axes = the unit vector of each gimbal's axis, body axes"
    )
    spin_axes_at_zero: schema.Vectors = Field(
        description="spin_axes_at_zero = the unit vector of each spin axis at gimbal angle zero"
    )
    gimbal_angle: GimbalInput = Field(description='gimbal_angle = { names = [...], unit = "rad" }')


class RateColumns(OfStream):
    """`rate` of a rate sensor."""

    names: schema.Names = Field(description=_NAMES + "one column a sensor axis")
    unit: Annotated[str, schema.UnitOf("rate")]


class ReferenceDevice(schema.NamedPart):
    """One of `[[sensors]]` whose axes may be those of the body."""

    mounting_sigma: float | None = None
    reference: bool = False  # of frames


class RateDevice(ReferenceDevice, schema.RateSensorPart[schema.Vectors, schema.OneOrMore]):
    """One of `[[sensors]]`: a rate sensor of one axis or more."""

    type: Literal["rate"]
    rate: RateColumns = Field(
        description='rate = { names = ["...", ...], unit = "rad/s" }, one column a sensor axis'
    )


class AttitudeColumns(OfStream):
    """`attitude` of a star tracker: a quaternion, with the place of its scalar and its sense."""

    names: schema.Names4 = Field(description=_NAMES + "the four elements of the quaternion")
    scalar: Literal["first", "last"]
    maps: Literal["inertial_to_body", "body_to_inertial"]


class AttitudeDevice(ReferenceDevice, schema.StarTrackerPart):
    """One of `[[sensors]]`: a star tracker. That of a file of format 1 may have no columns."""

    type: Literal["attitude"]
    attitude: AttitudeColumns | None = Field(
        description='attitude = { names = ["q1", "q2", "q3", "q4"], scalar = ..., maps = ... }'
    )


class DirectionColumns(OfStream):
    """`direction` of a sensor: three components in body axes; a field has a unit."""

    names: schema.Names3 = Field(description=_NAMES + "three components in body axes")
    frame: Literal["body"]
    unit: Annotated[str, schema.UnitOf("magnetic_field")] | None = None


class ReferenceColumns(OfStream):
    """`reference` of a direction that changes: three components in inertial axes."""

    names: schema.Names3 = Field(description=_NAMES + "three components in inertial axes")
    frame: Literal["inertial"]
    unit: Annotated[str, schema.UnitOf("magnetic_field")] | None = None
    between: Literal["line"] = "line"


class DirectionDevice(schema.NamedPart):
    """One of `[[sensors]]`: a Sun sensor, magnetometer or horizon sensor."""

    type: Literal["direction"]
    sigma: schema.OneOrMore = Field(
        description="sigma = the white noise of a reading: of a direction [rad], of a field [T]"
    )
    direction: DirectionColumns = Field(
        description='direction = { names = ["...", "...", "..."], '
        'frame = "body" }, of a field with unit = "T"'
    )
    reference_N: schema.Vector3 | None = None
    reference: ReferenceColumns | None = None
    offset_sigma: float | None = None
    scale_sigma: float | None = None
    soft_iron_sigma: float | None = None
    mounting_sigma: float | None = None


class InertialVector(OfStream):
    """`vector` of the environment."""

    names: schema.Names3 = Field(description=_NAMES + "along the inertial axes")
    frame: Literal["inertial"]


class FieldVector(InertialVector):
    """`vector` of a magnetic field."""

    unit: Annotated[str, schema.UnitOf("magnetic_field")]


class PositionVector(InertialVector):
    """`vector` of a position."""

    unit: Annotated[str, schema.UnitOf("position")]


class FieldDevice(schema.Part):
    """One of `[[environment]]`: the magnetic field along the inertial axes."""

    type: Literal["magnetic_field"]
    name: str = "magnetic field"
    vector: FieldVector = Field(
        description='vector = { names = ["...", "...", "..."], unit = "T", frame = "inertial" }'
    )


class PositionDevice(schema.Part):
    """One of `[[environment]]`: the position of the spacecraft."""

    type: Literal["position"]
    name: str = "position"
    vector: PositionVector = Field(
        description='vector = { names = ["...", "...", "..."], unit = "m", frame = "inertial" }'
    )


class OrbitDevice(schema.Part):
    """One of `[[environment]]`: position and magnetic field of two-line elements."""

    type: Literal["orbit"]
    name: str = "orbit"
    tle: str = Field(description='tle = a file of two-line elements, such as "orbit.tle"')
    epoch: str = Field(
        description='epoch = UTC at time zero of the campaign, such as "2023-09-04T14:48:23"'
    )


class ValuesColumns(InputColumns):
    """`values` of what a disturbance may follow, taken as they are."""

    names: schema.Names = Field(description=_NAMES + "one number, or x, y, z of a vector")
    unit: None = None


class InputDevice(schema.NamedPart):
    """One of `[[environment]]`: a temperature, or whatever else a disturbance may follow."""

    type: Literal["input"]
    values: ValuesColumns = Field(description='values = { names = ["..."], between = "line" }')


OtherActuator = TorqueDevice | MagnetorquerDevice | ThrusterDevice | RotorsDevice
Actuator = Annotated[WheelDevice | OtherActuator, Field(discriminator="type")]
Sensor = Annotated[RateDevice | AttitudeDevice | DirectionDevice, Field(discriminator="type")]
Environment = Annotated[
    FieldDevice | PositionDevice | OrbitDevice | InputDevice, Field(discriminator="type")
]


class ChangePart(schema.NamedPart):
    """One of `[[changes]]`: what changed, and when; either `slew` or `time` is given."""

    part: Literal["inertia"]
    slew: str | None = None
    time: float | None = None
    sigma_fraction: float = 0.03


class SlewPart(schema.NamedPart):
    """One `[[slews]]`; either `file` or `files` is given."""

    file: str | None = None
    files: str | dict[str, str] | None = None
    start: float = Field(description="start = the time of the first row in the campaign [s]")
    axis: schema.Vector3 | None = None
    angle_deg: float | None = None

    def file_of(self, columns: OfStream) -> str | None:
        """The table that holds some columns; None if this slew has none."""
        if isinstance(self.files, dict):
            return self.files.get(columns.stream or "")
        return self.file or (self.files or "").replace("{stream}", columns.stream or "")


class CampaignPart(schema.NamedPart):
    """The whole of `campaign.toml`."""

    # What to do with a key of the other format.
    other_format: ClassVar[Mapping[str, str]] = {
        "wheels": 'in format 2 each is one of [[actuators]] with type = "wheel"',
        "rate_sensor": 'in format 2 it is one of [[sensors]] with type = "rate"',
        "star_tracker": 'in format 2 it is one of [[sensors]] with type = "attitude"',
        "columns": "in format 2 each device names its own, such as "
        'rate = { stream = "gyro", names = [...], unit = "rad/s" }; time is [time]',
    }

    format: Literal["bayes-inertia-campaign/2"]
    inertia: schema.InertiaPart = Field(
        description="[inertia] with tensor, relative_sigma, product_sigma, includes_wheel_spin"
    )
    time: schema.TimeColumn = Field(description='[time] with names = ["..."] and unit = "s"')
    sensors: Annotated[list[Sensor], Len(1)] = Field(
        description="one [[sensors]] a sensor, with name, type and its stream"
    )
    slews: Annotated[list[SlewPart], Len(1)] = Field(
        description='one [[slews]] a slew, with name, start and files = "slew_01_{stream}.csv"'
    )
    actuators: list[Actuator] = Field(default=[])
    environment: list[Environment] = Field(default=[])
    changes: list[ChangePart] = Field(default=[])
    mission: schema.MissionPart | None = None
    prior: schema.PriorPart | None = None
