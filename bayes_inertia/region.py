"""The slews that may be flown: which rates, angles and accelerations, how to draw them, and what they violate.

A slew is five numbers: axis times angle [rad], and rate and acceleration as fractions of the largest.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.constraints import Hardware, Limits, demands
from bayes_inertia.motion import Body, Motion, Slews, Times

# Shortest ramp [s] and smallest angle [rad]: shorter ones are over before the controller has settled into them.
_SHORTEST_RAMP = 4.0
_LEAST_ANGLE = math.radians(10.0)
_DEFAULT_RATE = math.radians(1.0)
# Smallest fractions of rate and acceleration.
LEAST = (0.15, 0.03)


class Region(NamedTuple):
    """Where designs are searched; what is not limited is infinite.

    `rate` [rad/s], `acceleration` [rad/s^2] : largest that a plan may ask for. `angles` : smallest and largest [rad].
    `torque`, `momentum` (wheels,) : what it may ask of each wheel [N m], [N m s]. `time` : longest campaign [s].
    `cones_N` (c, 3), `half_angles` (c,), `boresight_B` (3,) : what the star tracker must not see.
    """

    rate: float
    acceleration: float
    angles: tuple[float, float]
    torque: np.ndarray
    momentum: np.ndarray
    time: float
    cones_N: np.ndarray
    half_angles: np.ndarray
    boresight_B: np.ndarray


def region_of(limits: Limits, own: Hardware, fastest: float | None = None) -> Region:
    """The region that limits leave, with their reserves; `fastest` [rad/s] where they name no rate (1 deg/s by default)."""
    rate = min((1.0 - limits.rate_reserve) * (limits.rate or math.inf), (1.0 - limits.rate_reserve) * own.range)
    rate = rate if math.isfinite(rate) else fastest or _DEFAULT_RATE
    acceleration = min(limits.acceleration or math.inf, rate / _SHORTEST_RAMP)
    keep = 1.0 - limits.wheel_reserve
    return Region(
        rate=rate,
        acceleration=acceleration,
        angles=(min(_LEAST_ANGLE, 0.5 * (limits.angle or math.pi)), min(limits.angle or math.pi, math.pi)),
        torque=keep * own.torque,
        momentum=keep * own.momentum,
        time=limits.total_time or math.inf,
        cones_N=np.array([c.direction_N for c in limits.keep_out]).reshape(-1, 3),
        half_angles=np.array([c.half_angle for c in limits.keep_out]),
        boresight_B=own.boresight_B,
    )


def slews_at(x: Array, region: Region) -> Slews:
    """Slews of a vector of numbers (n, 5); JAX can differentiate it."""
    no = jnp.zeros(len(x))
    return Slews(x[:, :3], x[:, 3] * region.rate, x[:, 4] * region.acceleration, no > 1.0, no)


def overhead(times: Times, n: int) -> float:
    """Time [s] of n slews without their motion; each may last up to one telemetry period longer than its parts."""
    return n * (times.rest_before + times.settle + times.rest_after + times.telemetry_period) + (n - 1) * times.pause


def draw(rng: np.random.Generator, n: int, slews: int, region: Region, times: Times, body: Body) -> np.ndarray:
    """Random plans (n, slews, 5): directions of all kinds, angles that use the time there is, hard and soft ramps.

    Wheel torques are within their limits by construction but for the gyroscopic part; momentum and keep-out are not.
    """
    axis = rng.normal(size=(n, slews, 3))
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    low, high = region.angles
    rate = rng.uniform(0.5, 1.0, (n, slews)) ** 0.25 * region.rate
    needed = np.abs(axis @ np.asarray(body.inertia_B) @ np.asarray(body.allocation).T)
    strongest = np.minimum(0.9 * np.min(region.torque / needed, axis=-1), region.acceleration)
    acceleration = strongest * rng.uniform(0.1, 1.0, (n, slews))
    angle = rng.uniform(low, high, (n, slews))
    spare = region.time - overhead(times, slews)
    if math.isfinite(spare):
        # The time of a slew is its angle over its rate and a ramp: share what there is among them.
        coasting = np.maximum(spare - (rate / acceleration).sum(1), 0.02 * spare)
        share = coasting / np.sum(angle / rate, axis=1)
        angle = np.clip(angle * np.minimum(1.0, share)[:, None], low, high)
    return np.concatenate([axis * angle[..., None], (rate / region.rate)[..., None], (acceleration / region.acceleration)[..., None]], -1)


def room(motion: Motion, slews: Slews, region: Region, times: Times) -> Array:
    """What is left of every limit (k,), as a fraction of it; negative where violated. For search and gradients."""
    used = demands(motion, slews.turn_B, slews.acceleration, region.boresight_B, region.cones_N)
    parts = [1.0 - used["torque"] / region.torque, 1.0 - used["momentum"] / region.momentum]
    parts += [1.0 - used["angle"] / region.angles[1], used["angle"] / region.angles[0] - 1.0]
    # Durations are rounded up to whole samples.
    parts.append(1.0 - used["time"] / (region.time - len(slews.rate) * times.telemetry_period))
    parts.append(used["distance"] / region.half_angles - 1.0)
    return jnp.concatenate([jnp.ravel(jnp.asarray(part)) for part in parts])
