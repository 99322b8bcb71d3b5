"""One log without a pause: slews and the rests between them, all made by the same physics.

A spacecraft with the hardware of a given campaign, but with an inertia tensor, scale factors and a
bias drawn from its prior, is flown in closed loop by plain numpy and scipy: J w' + w x (J w + G H)
= -G u, H' = u, commands held from row to row. Its controller believes the prior and reads the
sensors, so that it leaves small rates at rest, as every spacecraft does. Each slew of the campaign
that comes back reaches from `REST` before its motion to `REST` after it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from analyses.imports.foreign_logs import noisy_fixes
from analyses.naming.second_simulator import state_slope
from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.slew import Slew

STEP = 0.25  # Of telemetry and of commands [s].
REST = 120.0  # Kept beside a motion [s].
BETWEEN = 2.0 * REST + 20.0  # From the end of a motion to the beginning of the next [s].
_ATTITUDE_GAIN, _RATE_GAIN = 0.04, 0.4  # [1/s^2], [1/s]
_MOTIONS = (  # Axis in the body frame, angle [deg], duration [s].
    ((1.0, 0.0, 0.0), 60.0, 70.0),
    ((0.0, 1.0, 0.2), 60.0, 80.0),
    ((0.0, 0.1, 1.0), -70.0, 70.0),
    ((1.0, 1.0, 0.0), 70.0, 90.0),
    ((1.0, -0.5, 1.0), -80.0, 90.0),
)


@dataclass(frozen=True)
class _Spacecraft:
    """The truth: tensor [kg m^2], axes (3, wheels), spin inertias, scale factors, bias [rad/s]."""

    inertia: np.ndarray
    axes_B: np.ndarray
    spin: np.ndarray
    scale_factor: np.ndarray
    bias: np.ndarray


def continuous_log(template: Campaign, seed: int = 1) -> tuple[Campaign, Campaign]:
    """Fly slews and rests without a pause.

    `template`: hardware and prior; it needs wheels with tachometers and a star tracker. `seed`: of
    truth and noise. Returns: the whole log as one slew, and the slews with `REST` seconds about
    each motion.
    """
    rng = np.random.default_rng(seed)
    craft = _drawn(template, rng)
    log = _flown(template, craft, rng)
    whole = replace(template, name="one log without a pause", slews=(log,))
    cut = tuple(_window(log, k) for k in range(len(_MOTIONS)))
    return whole, replace(whole, name="the same log, cut as flown", slews=cut)


def _drawn(template: Campaign, rng: np.random.Generator) -> _Spacecraft:
    """A spacecraft from within the prior."""
    prior, sensor = template.inertia, template.rate_sensor
    tensor = np.array(prior.tensor) * (1.0 + 0.5 * prior.relative_sigma * rng.normal())
    turn = Rotation.from_rotvec(0.01 * rng.normal(size=3)).as_matrix()
    return _Spacecraft(
        inertia=turn @ tensor @ turn.T,
        axes_B=np.array([wheel.axis_B for wheel in template.wheels]).T,
        spin=np.array(template.spin_inertias),
        scale_factor=sensor.scale_factor
        + np.asarray(sensor.scale_factor_sigma) * rng.normal(size=3),
        bias=np.asarray(sensor.bias) + np.asarray(sensor.bias_sigma) * rng.normal(size=3),
    )


def _begins(k: int) -> float:
    """When motion k begins [s]; after the last one, when the last rest ends."""
    return BETWEEN + sum(duration + BETWEEN for _, _, duration in _MOTIONS[:k])


def _reference(time: float) -> tuple[Rotation, np.ndarray, np.ndarray]:
    """Attitude, rate [rad/s] and acceleration [rad/s^2] wanted at a time, in body axes."""
    attitude = Rotation.identity()
    for k, (axis, angle, duration) in enumerate(_MOTIONS):
        since = time - _begins(k)
        if since <= 0.0:
            break
        direction = np.radians(angle) * np.array(axis) / np.linalg.norm(axis)
        share = min(since / duration, 1.0)
        turned = share - np.sin(2.0 * np.pi * share) / (2.0 * np.pi)
        attitude = attitude * Rotation.from_rotvec(turned * direction)
        if share < 1.0:
            phase = 2.0 * np.pi * share
            rate = direction * (1.0 - np.cos(phase)) / duration
            return attitude, rate, direction * 2.0 * np.pi * np.sin(phase) / duration**2
    return attitude, np.zeros(3), np.zeros(3)


def _command(state: np.ndarray, time: float, template: Campaign, axes_B: np.ndarray) -> np.ndarray:
    """Motor torques on the wheels (wheels,) [N m] by a controller that believes the prior."""
    wanted, rate, acceleration = _reference(time)
    error = (wanted.inv() * Rotation.from_quat(state[-4:])).as_rotvec()
    body = -_ATTITUDE_GAIN * error - _RATE_GAIN * (state[:3] - rate) + acceleration
    inertia = np.array(template.inertia.tensor)
    wheels = axes_B @ state[3:-4]
    torque = inertia @ body + np.cross(state[:3], inertia @ state[:3] + wheels)
    return -np.linalg.pinv(axes_B) @ torque


def _flown(template: Campaign, craft: _Spacecraft, rng: np.random.Generator) -> Slew:
    """The log."""
    time = np.arange(0.0, _begins(len(_MOTIONS)), STEP)
    wheels = craft.axes_B.shape[1]
    momentum_0 = np.full(wheels, 0.02)
    state = np.concatenate([np.zeros(3), momentum_0, [0.0, 0.0, 0.0, 1.0]])
    states, torques = [], []
    body = (craft.inertia, np.linalg.inv(craft.inertia), craft.axes_B)

    def slope(_: float, state: np.ndarray, torque: np.ndarray) -> np.ndarray:
        return state_slope(state, *body, torque, np.zeros(3))

    for moment in time:
        torque = _command(state, moment, template, craft.axes_B)
        states.append(state)
        torques.append(torque)
        state = solve_ivp(
            slope, (0.0, STEP), state, "DOP853", rtol=1e-10, atol=1e-12, args=(torque,)
        ).y[:, -1]
    return _telemetry(time, np.array(states), np.array(torques), template, craft, rng)


def _telemetry(
    time: np.ndarray,
    states: np.ndarray,
    torques: np.ndarray,
    template: Campaign,
    craft: _Spacecraft,
    rng: np.random.Generator,
) -> Slew:
    """What the sensors read: fixes once a second at rest, tachometers at every second row."""
    sensor, star = template.rate_sensor, template.star_tracker
    assert star is not None
    rows, rate = len(time), states[:, :3]
    noise = np.asarray(sensor.sigma) * rng.normal(size=(rows, 3))
    fixes = noisy_fixes(states[:, -4:], star, rng)
    fixes[(np.arange(rows) % 4 > 0) | _in_motion(time)] = np.nan
    momentum = states[:, 3:-4] - craft.spin * (rate @ craft.axes_B)
    sigma = np.array([wheel.momentum_sigma or 0.0 for wheel in template.wheels])
    momentum = momentum + sigma * rng.normal(size=momentum.shape)
    momentum[1::2] = np.nan
    return Slew(
        "log",
        0.0,
        time,
        rate=(rate @ np.asarray(sensor.axes).T + craft.bias) / craft.scale_factor + noise,
        attitude=fixes,
        wheel_torque=torques,
        wheel_momentum=momentum,
    )


def _in_motion(time: np.ndarray) -> np.ndarray:
    moving = np.zeros(len(time), dtype=bool)
    for k, (_, _, duration) in enumerate(_MOTIONS):
        moving |= (time >= _begins(k)) & (time <= _begins(k) + duration)
    return moving


def _window(log: Slew, k: int) -> Slew:
    """Motion k of the log with its rests."""
    axis, angle, duration = _MOTIONS[k]
    begin, end = _begins(k) - REST, _begins(k) + duration + REST
    rows = slice(round(begin / STEP), round(end / STEP) + 1)
    assert log.rate is not None
    return Slew(
        f"slew {k + 1}",
        float(log.time[rows][0]),
        log.time[rows] - log.time[rows][0],
        rate=log.rate[rows],
        attitude=np.asarray(log.attitude)[rows],
        wheel_torque=np.asarray(log.wheel_torque)[rows],
        wheel_momentum=np.asarray(log.wheel_momentum)[rows],
        axis_B=np.sign(angle) * np.array(axis) / np.linalg.norm(axis),
        angle=float(np.radians(abs(angle))),
    )
