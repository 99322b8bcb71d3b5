"""A second simulator, in plain numpy and scipy, and disturbances that the library does not hold.

Nothing of the package's dynamics is used: J w' + w x (J w + G H) = -G u + tau in rates, with
H' = u, attitude by scipy's rotations, integrated by DOP853 from one telemetry row to the next. The
commands are those of a flight without disturbance, replayed: a command is a known input wherever it
came from.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.flight.plan_flight import Flight


class Instant(NamedTuple):
    """What a disturbance may follow, at one instant or in all rows (n, ...)."""

    t: float  # on the campaign's clock, and from the slew's beginning [s]
    since: float
    rate_B: np.ndarray  # (3,) [rad/s]
    momentum: np.ndarray  # (wheels,) of the wheels relative to the body [N m s]
    command: np.ndarray  # (wheels,) torque command [N m]
    attitude: Rotation  # from body to inertial axes
    field_B: np.ndarray  # (3,) magnetic field [T]
    wheel_axes_B: np.ndarray  # (3, wheels) spin axes


@dataclass(frozen=True)
class Disturbance:
    """Nothing; subclasses change one thing. Times are those of the campaign [s]; `slew` is the
    slew's number.
    """

    size: float

    def body_torque(self, t: float, since: float, rate_B: np.ndarray) -> np.ndarray:
        """On the body (3,) [N m], `since` the slew's beginning [s]."""
        return np.zeros(3)

    def motor_torque(self, torque: np.ndarray) -> np.ndarray:
        """What the motors do (wheels,) [N m] when told `torque`."""
        return torque

    def rate_error(self, t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """On the readings (n, 3) [rad/s]."""
        return np.zeros((len(t), 3))

    def tracker_error(self, late: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Rotation vectors (n, 3) [rad] of the fixes' errors, `late` for those after the slew."""
        return np.zeros((len(late), 3))

    def torques(self, now: Instant) -> tuple[np.ndarray, np.ndarray]:
        """On the body from outside (3,) and between body and wheels, on these (wheels,) [N m]."""
        return self.body_torque(now.t, now.since, now.rate_B), np.zeros(len(now.momentum))

    def reading_errors(self, rows: Instant) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of rates (n, 3) [rad/s], attitudes (n, 3) [rad], wheel momenta (n, wheels) [N m s]."""
        n = len(rows.rate_B)
        return np.zeros((n, 3)), np.zeros((n, 3)), np.zeros_like(rows.momentum)


class Swirl(Disturbance):
    """A torque that turns about z once in 50 s on the campaign's clock: a spinning antenna's
    imbalance.
    """

    def body_torque(self, t, since, rate_B):
        phase = 2.0 * np.pi * t / 50.0
        return self.size * np.array([np.cos(phase), np.sin(phase), 0.0])


class Leak(Disturbance):
    """A thruster leaks for about ten seconds in the middle of each slew."""

    def body_torque(self, t, since, rate_B):
        return self.size * np.array([0.3, -1.0, 0.0]) * np.exp(-(((since - 50.0) / 6.0) ** 2))


class RateSquared(Disturbance):
    """A torque about x and z that grows with the square of the rate: fuel pressed into one side of
    a tank.
    """

    def body_torque(self, t, since, rate_B):
        return self.size * np.array([1.0, 0.0, 0.5]) * (rate_B @ rate_B) * 1e4


class Ripple(Disturbance):
    """The rate sensor reads a 0.05 Hz ripple too much: a beat with its sampling."""

    def rate_error(self, t, rng):
        return self.size * np.sin(2.0 * np.pi * 0.05 * t)[:, None] * np.array([1.0, 0.7, -0.4])


class Deadband(Disturbance):
    """The motors ignore commands below `size` [N m]."""

    def motor_torque(self, torque):
        return np.where(np.abs(torque) < self.size, 0.0, torque)


class Wander(Disturbance):
    """The star tracker is off by another random angle after every slew."""

    def tracker_error(self, late, rng):
        return np.where(late[:, None], rng.normal(size=3) * self.size, 0.0)


def replayed(flight: Flight, disturbance: Disturbance, rng: np.random.Generator) -> Campaign:
    """The campaign that a flight's commands give in this simulator, with new noise."""
    slews = [_replayed_slew(flight, i, disturbance, rng) for i in range(len(flight.campaign.slews))]
    return replace(flight.campaign, slews=tuple(slews))


def _replayed_slew(flight: Flight, i: int, disturbance: Disturbance, rng: np.random.Generator):
    craft, slew, truth = flight.spacecraft, flight.campaign.slews[i], flight.truth[i]
    G, spin = craft.wheel_axes_B, np.array([w.spin_inertia for w in craft.wheels])
    torque = np.array([disturbance.motor_torque(u) for u in np.asarray(slew.wheel_torque)])
    # scipy's quaternion of a rotation is that of body-to-inertial; the campaign's maps inertial to
    # body by C(q) of the same numbers.
    start = Rotation.from_quat(np.asarray(truth.attitude[0]))
    flown = _Flown(craft.inertia_B, G, spin, torque, slew, start)
    rate, H, turned = _motion(flown, truth, disturbance)
    attitude = start * Rotation.from_quat(turned)
    seen = disturbance.reading_errors(flown.at(slew.time, rate, H, turned, torque))
    sensor, tracker, n = craft.rate_sensor, craft.star_tracker, len(slew.time)
    readings = (rate @ np.asarray(sensor.axes).T + np.asarray(craft.bias)) / np.asarray(
        craft.scale_factor
    )
    readings = (
        readings
        + disturbance.rate_error(slew.start + slew.time, rng)
        + seen[0]
        + np.asarray(sensor.sigma) * rng.normal(size=(n, 3))
    )
    late = slew.time > 0.5 * slew.time[-1]
    sigma = np.where(
        np.abs(tracker.boresight_B) > 0.5, tracker.sigma_roll, tracker.sigma_cross
    )  # boresight along a body axis
    error = Rotation.from_rotvec(
        disturbance.tracker_error(late, rng) + seen[1]
    ) * Rotation.from_rotvec(sigma * rng.normal(size=(n, 3)))
    fixes = np.where(np.isfinite(slew.attitude), (attitude * error).as_quat(), np.nan)
    momentum = (
        H
        - spin * (rate @ G)
        + seen[2]
        + np.array([w.momentum_sigma for w in craft.wheels]) * rng.normal(size=H.shape)
    )
    return replace(slew, rate=readings, attitude=fixes, wheel_momentum=momentum)


def state_slope(
    state: np.ndarray,
    inertia: np.ndarray,
    inverse: np.ndarray,
    axes_B: np.ndarray,
    motor_torque: np.ndarray,
    body_torque: np.ndarray,
) -> np.ndarray:
    """Derivative of rate, wheels' total spin momentum and attitude (scalar last) in time.

    `state` (7 + wheels,): [rad/s], [N m s], quaternion. `inertia`, `inverse` (3, 3): of everything
    except the wheels' spin [kg m^2], and its inverse. `axes_B` (3, wheels): spin axes.
    `motor_torque` (wheels,): on the wheels [N m]. `body_torque` (3,): from outside [N m]. Returns
    (7 + wheels,): per second.
    """
    rate, momentum, vector, scalar = state[:3], state[3:-4], state[-4:-1], state[-1]
    gyroscopic = np.cross(rate, inertia @ rate + axes_B @ momentum)
    acceleration = inverse @ (-gyroscopic - axes_B @ motor_torque + body_torque)
    turning = 0.5 * (np.cross(vector, rate) + scalar * rate)
    return np.concatenate([acceleration, motor_torque, turning, [-0.5 * (vector @ rate)]])


@dataclass(frozen=True)
class _Flown:
    """A slew of a spacecraft, and what acts at a state of it."""

    inertia_B: np.ndarray
    wheel_axes_B: np.ndarray
    spin_inertia: np.ndarray
    torque: np.ndarray
    slew: Slew
    start: Rotation

    def at(self, since, rate_B, momentum, turned, command) -> Instant:
        """The instant of a state; `momentum` holds the spin of the body too."""
        attitude = self.start * Rotation.from_quat(turned)
        rows = self.slew.magnetic_field_N
        if rows is None:
            field_N = np.zeros((*np.shape(since), 3))
        else:
            time = self.slew.time
            field_N = np.stack([np.interp(since, time, rows[:, i]) for i in range(3)], -1)
        return Instant(
            self.slew.start + since,
            since,
            rate_B,
            momentum - self.spin_inertia * (rate_B @ self.wheel_axes_B),
            command,
            attitude,
            attitude.inv().apply(field_N),
            self.wheel_axes_B,
        )


def _motion(flown: _Flown, truth, disturbance):
    """Rate (n, 3), wheels' total spin momentum (n, wheels), and the rotation since the start (n, 4;
    scalar last).
    """
    w0, slew, G = np.asarray(truth.rate_B[0]), flown.slew, flown.wheel_axes_B
    spin = flown.spin_inertia * (w0 @ G)
    x = np.concatenate([w0, np.asarray(truth.wheel_momentum[0]) + spin, [0.0, 0.0, 0.0, 1.0]])
    wheels, inverse, rows = G.shape[1], np.linalg.inv(flown.inertia_B), []
    for k, t in enumerate(slew.time):
        rows.append(x)
        if k + 1 == len(slew.time):
            break

        def slope(since, y, u=flown.torque[k]):
            now = flown.at(since, y[:3], y[3:-4], y[-4:] / np.linalg.norm(y[-4:]), u)
            tau, further = disturbance.torques(now)
            return state_slope(y, flown.inertia_B, inverse, G, u + further, tau)

        x = solve_ivp(slope, (t, slew.time[k + 1]), x, method="DOP853", rtol=1e-8, atol=1e-10).y[
            :, -1
        ]
    rows = np.array(rows)
    return rows[:, :3], rows[:, 3 : 3 + wheels], rows[:, -4:]
