"""The slews that may be flown: which rates, angles and accelerations, how to draw them, and what they violate.

A slew is five numbers: axis times angle [rad], and rate and acceleration as fractions of the largest.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.design.limits import Hardware, Limits, demands
from bayes_inertia.design.planned_motion import Body, Motion, Slews, Times

# Shortest ramp [s] and smallest angle [rad]: shorter ones are over before the controller has settled into them.
_SHORTEST_RAMP = 4.0
_LEAST_ANGLE = math.radians(5.0)
_DEFAULT_RATE = math.radians(1.0)
# How many sds of the scale factors keep-out cones are widened by.
_SIGMAS = 2.5
# Smallest fractions of rate and acceleration.
LEAST = (0.15, 0.03)


class Region(NamedTuple):
    """Where designs are searched; what is not limited is infinite.

    `rate` [rad/s], `acceleration` [rad/s^2] : largest that a plan may ask for. `angles` : smallest and largest [rad].
    `torque`, `momentum` (wheels,) : what it may ask of each wheel [N m], [N m s]. `time` : longest campaign [s].
    `cones_N` (c, 3), `half_angles` (c,), `boresight_B` (3,) : what the star tracker must not see. `swing` : how far a slew may miss its
    target, as a fraction of its angle, before it is corrected.
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
    swing: float


def region_of(
    limits: Limits, own: Hardware, *, fastest: float | None = None, scale_factor_sigma: float = 0.0
) -> Region:
    """The region that limits leave, with their reserves.

    Parameters
    ----------
    fastest : largest rate [rad/s] where the limits name none (1 deg/s by default).
    scale_factor_sigma : largest sd of a scale factor that the controller does not know: a slew misses its target by that share of its angle.
    """
    rate = min(
        (1.0 - limits.rate_reserve) * (limits.rate or math.inf),
        (1.0 - limits.rate_reserve) * own.range,
    )
    rate = rate if math.isfinite(rate) else fastest or _DEFAULT_RATE
    acceleration = min(limits.acceleration or math.inf, rate / _SHORTEST_RAMP)
    keep = 1.0 - limits.wheel_reserve
    return Region(
        rate=rate,
        acceleration=acceleration,
        angles=(
            min(_LEAST_ANGLE, 0.5 * (limits.angle or math.pi)),
            min(limits.angle or math.pi, math.pi),
        ),
        torque=keep * own.torque,
        momentum=keep * own.momentum,
        time=limits.total_time or math.inf,
        cones_N=np.array([c.direction_N for c in limits.keep_out]).reshape(-1, 3),
        half_angles=np.array([c.half_angle for c in limits.keep_out]),
        boresight_B=own.boresight_B,
        swing=_SIGMAS * scale_factor_sigma,
    )


def slews_at(x: Array, region: Region) -> Slews:
    """Slews of a vector of numbers (n, 5); JAX can differentiate it."""
    no = jnp.zeros(len(x))
    return Slews(x[:, :3], x[:, 3] * region.rate, x[:, 4] * region.acceleration, no > 1.0, no)


def overhead(times: Times, n: int) -> float:
    """Time [s] of n slews without their motion; each may last up to one telemetry period longer than its parts."""
    return (
        n * (times.rest_before + times.settle + times.rest_after + times.telemetry_period)
        + (n - 1) * times.pause
    )


def draw(
    rng: np.random.Generator, n: int, slews: int, region: Region, times: Times, body: Body
) -> np.ndarray:
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
    # Some plans of slews that are alike, some of a few long ones and others as short as may be.
    angle = low + (high - low) * rng.uniform(0.0, 1.0, (n, slews)) ** rng.choice(
        [1.0, 3.0, 6.0], (n, 1)
    )
    spare = region.time - overhead(times, slews)
    if math.isfinite(spare):
        # The time of a slew is its angle over its rate and a ramp: share what there is among them.
        coasting = np.maximum(spare - (rate / acceleration).sum(1), 0.02 * spare)
        share = coasting / np.sum(angle / rate, axis=1)
        angle = np.clip(angle * share[:, None], low, high)
    return np.concatenate(
        [
            axis * angle[..., None],
            (rate / region.rate)[..., None],
            (acceleration / region.acceleration)[..., None],
        ],
        -1,
    )


def room(motion: Motion, slews: Slews, region: Region, times: Times) -> dict[str, Array]:
    """What is left of every limit, as a fraction of it; negative where violated. For search and gradients."""
    used = demands(motion, slews.turn_B, slews.acceleration, region.boresight_B, region.cones_N)
    missed = jnp.concatenate([jnp.zeros(1), region.swing * used["angle"]])[:, None]
    return {
        "wheel torque": 1.0 - used["torque"] / region.torque,
        "wheel momentum": 1.0 - used["momentum"] / region.momentum,
        "rate": 1.0 - used["rate"] / region.rate,
        "angle": 1.0 - used["angle"] / region.angles[1],
        "least angle": used["angle"] / region.angles[0] - 1.0,
        # Durations are rounded up to whole samples.
        "total time": 1.0 - used["time"] / (region.time - len(slews.rate) * times.telemetry_period),
        "keep-out": (used["distance"] - missed) / region.half_angles - 1.0,
    }


def in_a_row(parts: dict[str, Array]) -> Array:
    """All of `room` in one row (k,).

    >>> in_a_row({"a": jnp.ones((2, 2)), "b": jnp.zeros(())}).shape
    (5,)
    """
    return jnp.concatenate([jnp.ravel(part) for part in parts.values()])
