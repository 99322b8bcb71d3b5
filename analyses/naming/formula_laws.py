"""Laws that no effect of the library describes: twenty kinds, each in proportion to something."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from analyses.naming.second_simulator import Disturbance, Instant

_TORQUE, _RATE, _TURN = 1e-6, 1e-5, 1e-4  # sizes from which the wanted ones are scaled, SI units
_SPEED, _MOMENTUM, _COMMAND = 0.01, 0.05, 1e-3  # typical of these campaigns, SI units


class Law(NamedTuple):
    """One law of size 1."""

    place: str  # the keys of the formula that is right
    driver: str
    # What acts at an instant, SI units; in all rows (n, ...) of errors of sensors.
    value: Callable[[Instant], np.ndarray]
    # Drivers that are the same in these campaigns, whose wheels lie along the body axes.
    also: tuple[str, ...] = ()


@dataclass(frozen=True)
class Lawful(Disturbance):
    """A disturbance that follows a law."""

    law: str = ""

    def torques(self, now):
        nothing = np.zeros(3), np.zeros(len(now.momentum))
        law = LAWS[self.law]
        if law.place in ("body_torque", "inertial_torque"):
            return self.size * law.value(now), nothing[1]
        if law.place == "wheel_torque":
            return nothing[0], self.size * law.value(now)
        return nothing

    def reading_errors(self, rows):
        errors = list(super().reading_errors(rows))
        places = ("rate_error", "attitude_error", "tachometer_error")
        law = LAWS[self.law]
        if law.place in places:
            errors[places.index(law.place)] = self.size * law.value(rows)
        return tuple(errors)


def _speed(x: Instant) -> np.ndarray:
    return np.linalg.norm(x.rate_B, axis=-1, keepdims=True) / _SPEED


def _rates(x: Instant) -> np.ndarray:
    return x.rate_B / _SPEED


_AXIS = np.array([0.6, -0.3, 0.74])
_SKEW = np.array([[1.0, 0.5, 0.0], [-0.3, 0.6, 0.4], [0.2, 0.0, 1.4]])
_FIELD = 3e-5

LAWS: Mapping[str, Law] = {
    "torque in the square of the speed": Law(
        "body_torque", "speed_squared", lambda x: _TORQUE * _speed(x) ** 2 * _AXIS
    ),
    "quadratic drag": Law(
        "body_torque", "rate_times_speed", lambda x: -_TORQUE * _speed(x) * _rates(x)
    ),
    "misaligned drag": Law(
        "body_torque", "rate", lambda x: -_TORQUE * (_SKEW @ _rates(x)), ("wheel_rates",)
    ),
    "eddy currents": Law(
        "body_torque",
        "eddy",
        lambda x: _TORQUE * np.cross(x.field_B, np.cross(_rates(x), x.field_B)) / _FIELD**2,
    ),
    "torque along the turning field": Law(
        "body_torque",
        "field_change",
        lambda x: _TORQUE * np.cross(_rates(x), x.field_B) / _FIELD,
    ),
    "dipole of a wheel's current": Law(
        "body_torque",
        "command_times_field",
        lambda x: _TORQUE * x.command[1] / _COMMAND * np.cross(_AXIS, x.field_B) / _FIELD,
    ),
    "dipole of a wheel's speed": Law(
        "body_torque",
        "momentum_times_field",
        lambda x: _TORQUE * x.momentum[0] / _MOMENTUM * np.cross(_AXIS, x.field_B) / _FIELD,
    ),
    "torque of a wheel's speed": Law(
        "body_torque",
        "wheel_momenta",
        lambda x: _TORQUE * x.momentum[2] / _MOMENTUM * _AXIS,
        ("momentum",),
    ),
    "torque in the square of a wheel's speed": Law(
        "body_torque",
        "wheel_squares",
        lambda x: _TORQUE * (x.momentum[0] / _MOMENTUM) ** 2 * _AXIS,
    ),
    "momentum times rate": Law(
        "body_torque",
        "momentum_times_rate",
        lambda x: _TORQUE * x.momentum[1] / _MOMENTUM * _rates(x),
    ),
    "gyroscopic torque along a fixed axis": Law(
        "body_torque",
        "gyroscopic",
        lambda x: (
            _TORQUE
            * np.cross(_rates(x), x.wheel_axes_B @ x.momentum)[0]
            / _MOMENTUM
            * np.array([0.0, 1.0, 0.0])
        ),
    ),
    "torque that grows in each slew": Law(
        "body_torque", "time_in_slew", lambda x: _TORQUE * x.since / 50.0 * _AXIS
    ),
    "torque that grows through the campaign": Law(
        "body_torque", "campaign_time", lambda x: _TORQUE * (x.t - 1000.0) / 1000.0 * _AXIS
    ),
    "push from a fixed direction": Law(
        "inertial_torque", "constant", lambda x: _TORQUE * x.attitude.inv().apply(_AXIS)
    ),
    "windage of the wheels": Law(
        "wheel_torque",
        "wheel_signed_squares",
        lambda x: -_TORQUE * np.abs(x.momentum) * x.momentum / _MOMENTUM**2,
    ),
    "motors that lose in proportion to effort": Law(
        "wheel_torque", "wheel_efforts", lambda x: -_TORQUE * np.abs(x.command) / _COMMAND
    ),
    "rate error of the motors' current": Law(
        "rate_error",
        "wheel_commands",
        lambda x: _RATE * x.command[:, :1] / _COMMAND * _AXIS,
        ("command",),
    ),
    "rate error of a wheel's speed": Law(
        "rate_error",
        "wheel_speeds",
        lambda x: _RATE * np.abs(x.momentum[:, 2:]) / _MOMENTUM * _AXIS,
    ),
    "rate error in products of rates": Law(
        "rate_error",
        "rate_products",
        lambda x: (
            _RATE
            * np.stack([_rates(x)[:, 1] * _rates(x)[:, 2]] * 3, -1)
            * np.array([1.0, 0.0, 0.5])
        ),
    ),
    "thermal twist in each slew": Law(
        "attitude_error", "time_in_slew", lambda x: _TURN * x.since[:, None] / 100.0 * _AXIS
    ),
}
