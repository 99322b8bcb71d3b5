"""Small campaigns of spacecraft without wheels, without a gyro, or with other sensors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_inertia.campaign.actuators import GimballedRotors, Thruster
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import DirectionSensor, RateSensor
from bayes_inertia.campaign.inputs import InputStream
from bayes_inertia.physics.small_campaign import small_campaign

# Torque of six thrusters, two about nearly each body axis [N m].
THRUSTERS = np.array([s * axis for axis in np.eye(3) for s in (1.0, -1.0)]) + 0.02
# Gimbal axes of a pyramid of rotors.
ROTORS = np.array(
    [[0.8165, 0, 0.5774], [0, 0.8165, 0.5774], [-0.8165, 0, 0.5774], [0, -0.8165, 0.5774]]
)
SPIN_AXES = np.array([[0.0, 1, 0], [-1, 0, 0], [0, -1, 0], [1, 0, 0]])


def by_thrusters() -> Campaign:
    """Thrusters turn it; their levels are zero."""
    return _by(Thruster("jets", THRUSTERS, gain_sigma=0.02))


def by_rotors() -> Campaign:
    """Four rotors on gimbals turn it; their angles are zero."""
    return _by(GimballedRotors("cmg", 1.0, ROTORS, SPIN_AXES, angle_sigma=2e-5))


def gyroless() -> Campaign:
    """Three wheels, and a star tracker alone, with fixes throughout."""
    campaign = small_campaign()
    return replace(
        campaign,
        rate_sensor=None,
        slews=tuple(replace(slew, rate=None) for slew in campaign.slews),
    )


def two_axes_and_vectors() -> Campaign:
    """A gyro of two axes, a Sun sensor and a magnetometer, without a star tracker."""
    campaign = small_campaign()
    sensor = RateSensor(sigma=2e-5, axes=np.eye(3)[:2], bias_sigma=2e-6)
    sun = DirectionSensor(0.01, (0.5, 0.7, 0.51))
    field = DirectionSensor(2e-7, unit="T")
    more = {"sun": np.tile([0.5, 0.7, 0.51], (64, 1)), "field": np.full((64, 3), 2e-5)}
    return replace(
        campaign,
        rate_sensor=sensor,
        star_tracker=None,
        more_sensors=(("sun", sun), ("field", field)),
        slews=tuple(
            replace(slew, rate=slew.rate[:, :2], attitude=None, more=more)
            for slew in campaign.slews
        ),
    )


def _by(device) -> Campaign:
    campaign = small_campaign()
    still = {device.name: InputStream(np.zeros(1), np.zeros((1, device.columns)))}
    return replace(
        campaign,
        wheels=(),
        actuators=(device,),
        slews=tuple(
            replace(slew, wheel_torque=None, wheel_momentum=None, inputs=still)
            for slew in campaign.slews
        ),
    )
