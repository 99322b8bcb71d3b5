"""Spacecraft drawn at random, so that a judgement does not rest on a handful of them.

Moments of inertia from 0.01 to 1000 kg m^2, wheels along any axes, a gyro mounted anyhow, telemetry
from 10 Hz to one row in 10 s, good and bad sensors. All have as many rows, so that the simulator is
compiled once for each number of wheels.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from analyses.imports.conventions_spacecraft import Craft
from bayes_inertia.campaign.hardware import InertiaPrior, RateSensor, StarTracker, Wheel
from bayes_inertia.flight.mission import Mission
from bayes_inertia.flight.orbit import Orbit
from bayes_inertia.flight.plan import Plan, PlannedSlew
from bayes_inertia.flight.spacecraft import Controller, Spacecraft

# Rows of telemetry in which the longest motion, the rests and the settling take place.
_MOTION, _REST_BEFORE, _SETTLE, _REST_AFTER = 140, 40, 60, 24
# Bandwidth of the controller times the telemetry period.
_BANDWIDTH = 0.085


@cache
def random_craft(seed: int) -> tuple[Craft, Controller]:
    """A spacecraft with its plan, and a controller that can fly it."""
    rng = np.random.default_rng([seed, 16])
    period = float(10.0 ** rng.uniform(-1.0, 1.0))
    J = _tensor(rng)
    angle = math.radians(rng.uniform(15.0, 120.0))
    peak = angle / (0.7 * _MOTION * period)
    acceleration = peak / (0.25 * _MOTION * period)
    sensor = _gyro(rng, peak, period)
    sigma = peak * period * float(10.0 ** rng.uniform(-3.5, -1.5))
    tracker = StarTracker(_direction(rng), sigma, sigma * rng.uniform(1.0, 8.0))
    scale = float(np.linalg.eigvalsh(J)[-1])
    wheels = _wheels(rng, scale, peak, acceleration)
    axes = [_direction(rng) for _ in range(4)]
    slews = tuple(PlannedSlew(axis, angle, peak, acceleration) for axis in axes)
    plan = Plan(
        f"random spacecraft {seed}",
        slews,
        start_attitude=tuple(Rotation.random(random_state=seed).as_quat().tolist()),
        wheel_momentum=tuple((scale * peak * rng.uniform(-0.6, 0.6, len(wheels))).tolist()),
        telemetry_period=period,
        rest_before=_REST_BEFORE * period,
        first_fix=0.4 * _REST_BEFORE * period,
        fix_spacing=2.0 * period,
        settle=_SETTLE * period,
        rest_after=_REST_AFTER * period,
        pause=300.0 * period,
        orbit=Orbit(),
    )
    spread = float(rng.choice([0.02, 0.05, 0.1]))
    prior = InertiaPrior(J, spread, 0.3 * spread * scale)
    spacecraft = Spacecraft(J, (1.0, 1.0, 1.0), wheels, sensor, tracker)
    controller = Controller(
        J,
        bandwidth=_BANDWIDTH / period,
        snapshot_time=20.0 * period,
        rest_rate_sigma=1e-3 * peak,
        rest_attitude_sigma=sigma,
    )
    name = f"random {seed}, {1.0 / period:.2g} Hz, {scale:.2g} kg m^2, {len(wheels)} wheels"
    angles = (0.5 * angle, angle)
    return Craft(name, Mission(spacecraft, prior), plan, angles), controller


def _direction(rng: np.random.Generator) -> tuple[float, float, float]:
    x, y, z = rng.normal(size=3)
    norm = math.sqrt(x * x + y * y + z * z)
    return (x / norm, y / norm, z / norm)


def _tensor(rng: np.random.Generator) -> np.ndarray:
    """A tensor whose moments differ by at least an eighth, along axes up to 6 degrees off."""
    a, b = np.sort(rng.uniform(0.45, 0.9, 2))
    moments = np.array([1.0, max(b, a + 0.125, 1.1 - a), a])
    moments = float(10.0 ** rng.uniform(-2.0, 3.0)) * rng.permutation(moments)
    turn = Rotation.from_rotvec(rng.uniform(-0.06, 0.06, 3)).as_matrix()
    return turn @ np.diag(moments) @ turn.T


def _gyro(rng: np.random.Generator, peak: float, period: float) -> RateSensor:
    """A gyro with a noise of 0.02 to 1 % of the peak rate, every other one mounted anyhow."""
    sigma = peak * float(10.0 ** rng.uniform(-3.7, -2.0))
    axes = np.eye(3)
    if rng.random() < 0.5:
        axes = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
    return RateSensor(
        sigma=(sigma,) * 3,
        axes=axes,
        bias_sigma=(sigma * rng.uniform(0.1, 3.0),) * 3,
        scale_factor_sigma=(float(rng.choice([0.003, 0.01, 0.03])),) * 3,
    )


def _wheels(
    rng: np.random.Generator, scale: float, peak: float, acceleration: float
) -> tuple[Wheel, ...]:
    """Three wheels along turned axes, or a turned pyramid of four."""
    axes = np.eye(3)
    if rng.random() < 0.5:
        c = 1.0 / math.sqrt(3.0)
        axes = np.array([[c, c, c], [-c, c, c], [-c, -c, c], [c, -c, c]])
    if rng.random() < 0.5:
        axes = axes @ Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
    momentum = scale * peak
    limits = {"max_torque": 8.0 * scale * acceleration, "max_momentum": 8.0 * momentum}
    given = limits if rng.random() < 0.7 else {}
    noise = momentum * float(10.0 ** rng.uniform(-4.0, -2.5))
    return tuple(
        Wheel(f"wheel-{i + 1}", tuple(axis), 4e-4 * scale, momentum_sigma=noise, **given)
        for i, axis in enumerate(axes.tolist())
    )
