"""Wheels that are mounted slightly tilted."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import jax.numpy as jnp

from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects.scales import per_wheel
from bayes_inertia.physics.parameters import Normal


@dataclass(frozen=True)
class WheelMisalignment(Effect):
    """Each wheel's spin axis g is tilted by two small angles.

    It becomes g + tilt_1 e1 + tilt_2 e2, normalised.

    e1 is the body axis that makes the largest angle with g, made perpendicular to it; e2 = g x
    e1. A tilt common to all wheels turns the wheels' frame: it is a rotation of the body frame
    that J, rate sensor and star tracker are counted in, and only one of the three can be told
    from the others.

    Parameters
    ----------
    sigma : float, optional
        Prior sd of each angle [rad]; 3e-3 (0.2 deg) is common for wheels that were bolted, not
        surveyed.

    Examples
    --------
    >>> WheelMisalignment().sigma
    0.003
    """

    name = "wheel_misalignment"
    sigma: float = 3e-3

    def parameters(self, campaign):
        tilt = partial(per_wheel, campaign, unit="rad", prior=Normal(0.0, self.sigma))
        return (*tilt("tilt_1"), *tilt("tilt_2"))

    def wheel_axes(self, p, slew, axes_B):
        if not p:
            return axes_B
        nominal = slew.wheel_axes_B
        farthest = jnp.eye(3)[jnp.argmin(jnp.abs(nominal), axis=0)].T
        first = farthest - nominal * jnp.sum(nominal * farthest, axis=0)
        first = first / jnp.linalg.norm(first, axis=0)
        second = jnp.cross(nominal, first, axis=0)
        length = jnp.sqrt(1.0 + p["tilt_1"] ** 2 + p["tilt_2"] ** 2)
        return (axes_B + p["tilt_1"] * first + p["tilt_2"] * second) / length
