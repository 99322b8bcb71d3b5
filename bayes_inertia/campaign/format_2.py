"""The form of `campaign.toml` of format 2: actuators, sensors and environment, each a stream."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from annotated_types import Len
from pydantic import BeforeValidator, Field

from bayes_inertia.campaign import schema
from bayes_inertia.campaign.hardware import WheelState


def _listed(value: Any) -> Any:
    return [value] if isinstance(value, int | float) and not isinstance(value, bool) else value


OneOrMore = Annotated[list[float], Len(1), BeforeValidator(_listed)]


class OfStream(schema.StreamColumns):
    """Columns of a stream; of the one table of a slew where no stream is named."""

    stream: str | None = None


class OfWheel(OfStream):
    """The column of one wheel."""

    names: schema.Names1 = Field(description='names = ["..."], the column of this wheel')


class WheelTorque(OfWheel, schema.TorqueColumns):
    """`torque` of a wheel."""


class WheelMomentum(OfWheel, schema.MomentumColumns):
    """`momentum` of a wheel by its tachometer."""

    sigma: float | None = None  # noise of a reading [N m s]


class WheelSpeed(OfWheel, schema.SpeedColumns):
    """`speed` of a wheel by its tachometer."""

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


class TorqueDevice(schema.Part):
    """One of `[[actuators]]`: a torque that telemetry tells, whatever makes it."""

    type: Literal["torque"]
    name: str = Field(description='name = "..."')
    torque: TorqueInput = Field(
        description='torque = { stream = "...", names = [...], unit = "N m", frame = "body" }'
    )
    gain_sigma: float = 0.0


class DipoleInput(InputColumns):
    """`dipole` of magnetorquers."""

    names: schema.Names = Field(description=_NAMES + "one column a torquer")
    unit: Annotated[str, schema.UnitOf("dipole")]


class MagnetorquerDevice(schema.Part):
    """One of `[[actuators]]`: magnetorquers of one gain."""

    type: Literal["magnetorquer"]
    name: str = Field(description='name = "..."')
    dipole: DipoleInput = Field(
        description='dipole = { stream = "...", names = [...], unit = "A m^2" }'
    )
    axes: Annotated[list[schema.Vector3], Len(1)] | None = None
    gain_sigma: float = 0.0


class LevelInput(InputColumns):
    """`level` of thrusters: shares of full thrust."""

    names: schema.Names = Field(description=_NAMES + "one column a thruster")
    unit: Annotated[str, schema.UnitOf("level")]


class OnTimeInput(OfStream):
    """`on_time` of thrusters: how long each is on from the time of its row."""

    names: schema.Names = Field(description=_NAMES + "one column a thruster")
    unit: Annotated[str, schema.UnitOf("time")]
    between: Literal["on_time"] = "on_time"


class ThrusterDevice(schema.Part):
    """One of `[[actuators]]`: thrusters, by their torques at full thrust."""

    type: Literal["thruster"]
    name: str = Field(description='name = "..."')
    torques: Annotated[list[schema.Vector3], Len(1)] = Field(
        description="torques = the torque of each thruster at full thrust about the centre of "
        "mass, body axes [N m], such as [[0.05, 0.0, 0.0], ...]"
    )
    on_time: OnTimeInput | None = None
    level: LevelInput | None = None
    gain_sigma: float = 0.0
    each_gain_sigma: float = 0.0
    direction_sigma: float = 0.0


class GimbalInput(InputColumns):
    """`gimbal_angle` of gimballed rotors, with the noise of a reading."""

    names: schema.Names = Field(description=_NAMES + "one column a gimbal")
    unit: Annotated[str, schema.UnitOf("angle")]
    between: Held = "line"
    sigma: float = 0.0  # [rad]


class RotorsDevice(schema.Part):
    """One of `[[actuators]]`: rotors of constant speed on gimbals (control-moment gyros)."""

    type: Literal["gimballed_rotors"]
    name: str = Field(description='name = "..."')
    momentum: OneOrMore = Field(
        description="momentum = the momentum of each rotor [N m s], one number or one a rotor"
    )
    gimbal_axes: Annotated[list[schema.Vector3], Len(1)] = Field(
        description="gimbal_axes = the unit vector of each gimbal's axis, body axes"
    )
    spin_axes_at_zero: Annotated[list[schema.Vector3], Len(1)] = Field(
        description="spin_axes_at_zero = the unit vector of each spin axis at gimbal angle zero"
    )
    gimbal_angle: GimbalInput = Field(
        description='gimbal_angle = { stream = "...", names = [...], unit = "rad" }'
    )
    gain_sigma: float = 0.0


class DeviceRate(OfStream, schema.RateColumns):
    """`rate` of a rate sensor."""

    names: schema.Names = Field(description='names = ["...", ...], one column a sensor axis')


class RateDevice(schema.Part):
    """One of `[[sensors]]`: a rate sensor of one axis or more."""

    type: Literal["rate"]
    name: str = Field(description='name = "..."')
    rate: DeviceRate = Field(
        description='rate = { stream = "...", names = ["...", ...], unit = "rad/s" }'
    )
    sigma: OneOrMore = Field(
        description="sigma = the white noise per sample [rad/s], one number or one an axis"
    )
    axes: Annotated[list[schema.Vector3], Len(1)] | None = None
    range: float | None = None
    scale_factor: OneOrMore | None = None
    scale_factor_sigma: OneOrMore | None = None
    bias: OneOrMore | None = None
    bias_sigma: OneOrMore | None = None
    rate_random_walk: float | None = None
    bias_instability: float | None = None
    bias_instability_time: float | None = None
    mounting_sigma: float | None = None
    reference: bool = False  # of frames


class DeviceAttitude(OfStream, schema.AttitudeColumns):
    """`attitude` of a star tracker."""


class AttitudeDevice(schema.StarTrackerPart):
    """One of `[[sensors]]`: a star tracker."""

    type: Literal["attitude"]
    name: str = Field(description='name = "..."')
    attitude: DeviceAttitude = Field(
        description='attitude = { stream = "...", names = ["q1", "q2", "q3", "q4"], scalar = ..., '
        "maps = ... }"
    )
    mounting_sigma: float | None = None
    reference: bool = False


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


class DirectionDevice(schema.Part):
    """One of `[[sensors]]`: a Sun sensor, magnetometer or horizon sensor."""

    type: Literal["direction"]
    name: str = Field(description='name = "..."')
    sigma: OneOrMore = Field(
        description="sigma = the white noise of a reading: of a direction [rad], of a field [T]"
    )
    direction: DirectionColumns = Field(
        description='direction = { stream = "...", names = ["...", "...", "..."], '
        'frame = "body" }, of a field with unit = "T"'
    )
    reference_N: schema.Vector3 | None = None
    reference: ReferenceColumns | None = None
    offset_sigma: float | None = None
    scale_sigma: float | None = None
    soft_iron_sigma: float | None = None
    mounting_sigma: float | None = None


class FieldVector(OfStream, schema.MagneticFieldColumns):
    """`vector` of a magnetic field."""


class PositionVector(OfStream, schema.PositionColumns):
    """`vector` of a position."""


class FieldDevice(schema.Part):
    """One of `[[environment]]`: the magnetic field along the inertial axes."""

    type: Literal["magnetic_field"]
    name: str = "magnetic field"
    vector: FieldVector = Field(
        description='vector = { stream = "...", names = ["...", "...", "..."], unit = "T", '
        'frame = "inertial" }'
    )


class PositionDevice(schema.Part):
    """One of `[[environment]]`: the position of the spacecraft."""

    type: Literal["position"]
    name: str = "position"
    vector: PositionVector = Field(
        description='vector = { stream = "...", names = ["...", "...", "..."], unit = "m", '
        'frame = "inertial" }'
    )


class OrbitDevice(schema.Part):
    """One of `[[environment]]`: position and magnetic field of two-line elements."""

    type: Literal["orbit"]
    name: str = "orbit"
    tle: str = Field(description='tle = a file of two-line elements, such as "orbit.tle"')
    epoch: str = Field(
        description='epoch = UTC at time zero of the campaign, such as "2023-09-04T14:48:23"'
    )


OtherActuator = TorqueDevice | MagnetorquerDevice | ThrusterDevice | RotorsDevice
Actuator = Annotated[WheelDevice | OtherActuator, Field(discriminator="type")]
Sensor = Annotated[RateDevice | AttitudeDevice | DirectionDevice, Field(discriminator="type")]
Environment = Annotated[FieldDevice | PositionDevice | OrbitDevice, Field(discriminator="type")]


class ChangePart(schema.Part):
    """One of `[[changes]]`: what changed, and when; either `slew` or `time` is given."""

    name: str = Field(description='name = "..."')
    part: Literal["inertia"]
    slew: str | None = None
    time: float | None = None
    sigma_fraction: float = 0.03


class Slew2Part(schema.Part):
    """One `[[slews]]`; either `file` or `files` is given."""

    name: str = Field(description='name = "..."')
    start: float = Field(description="start = the time of the first row in the campaign [s]")
    file: str | None = None
    files: str | dict[str, str] | None = None
    axis: schema.Vector3 | None = None
    angle_deg: float | None = None


class Campaign2Part(schema.Part):
    """The whole of `campaign.toml` of format 2."""

    # What to do with a key of the other format.
    other_format: ClassVar[Mapping[str, str]] = {
        "wheels": 'in format 2 each is one of [[actuators]] with type = "wheel"',
        "rate_sensor": 'in format 2 it is one of [[sensors]] with type = "rate"',
        "star_tracker": 'in format 2 it is one of [[sensors]] with type = "attitude"',
        "columns": "in format 2 each device names its own, such as "
        'rate = { stream = "gyro", names = [...], unit = "rad/s" }; time is [time]',
    }

    format: Literal["bayes-inertia-campaign/2"]
    name: str = Field(description='name = "..."')
    inertia: schema.InertiaPart = Field(
        description="[inertia] with tensor, relative_sigma, product_sigma, includes_wheel_spin"
    )
    time: schema.TimeColumn = Field(description='[time] with names = ["..."] and unit = "s"')
    sensors: Annotated[list[Sensor], Len(1)] = Field(
        description="one [[sensors]] a sensor, with name, type and its stream"
    )
    slews: Annotated[list[Slew2Part], Len(1)] = Field(
        description='one [[slews]] a slew, with name, start and files = "slew_01_{stream}.csv"'
    )
    actuators: list[Actuator] = Field(default=[])
    environment: list[Environment] = Field(default=[])
    changes: list[ChangePart] = Field(default=[])
    mission: schema.MissionPart | None = None
    prior: schema.PriorPart | None = None
