"""Angle and rate of a slew over time.

They are written in `jax.numpy`, so that a slew's consequences can be differentiated with respect
to its axis, angle and rate.
"""

from __future__ import annotations

import math
from typing import Literal

import jax.numpy as jnp
from jax import Array

Profile = Literal["trapezoid", "smooth"]


def ramp_factor(profile: Profile) -> float:
    """Ramp time times acceleration limit over peak rate.

    Examples
    --------
    >>> ramp_factor("trapezoid")
    1.0
    """
    return math.pi / 2.0 if profile == "smooth" else 1.0


def angle_and_rate(
    angle: Array, rate: Array, acceleration: Array, smooth: Array, t: Array
) -> tuple[Array, Array]:
    """Angle turned and rate of a slew; all arguments broadcast.

    A slew too short for `rate` has a lower peak and no coast.

    `angle` [rad]; `rate` [rad/s]; `acceleration` [rad/s^2]; `t` [s]. Returns `angle` [rad]; `rate`
    [rad/s].

    Examples
    --------
    >>> t = jnp.array([-1.0, 16.0, 99.0])
    >>> [x.tolist() for x in angle_and_rate(2.0, 2.0**-5, 2.0**-10, False, t)]
    [[0.0, 0.125, 2.0], [0.0, 0.015625, 0.0]]
    """
    factor = jnp.where(smooth, math.pi / 2.0, 1.0)
    peak = jnp.minimum(rate, jnp.sqrt(acceleration * angle / factor))
    ramp = factor * peak / acceleration
    down = angle / peak  # the ramp down begins when ramp and coast have passed, which is this long

    def risen(t):
        """The ramp from 0 to 1 beginning at t = 0, and its integral over time."""
        x = jnp.clip(t / ramp, 0.0, 1.0)
        value = jnp.where(smooth, 0.5 * (1.0 - jnp.cos(math.pi * x)), x)
        integral = jnp.where(smooth, 0.5 * x - jnp.sin(math.pi * x) / (2.0 * math.pi), 0.5 * x**2)
        return value, ramp * integral + jnp.maximum(t - ramp, 0.0)

    (up, turned), (fallen, missing) = risen(t), risen(t - down)
    return peak * (turned - missing), peak * (up - fallen)
