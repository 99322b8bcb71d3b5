"""A small campaign of known truth, to try effects on."""

from __future__ import annotations

from functools import cache

import jax.numpy as jnp
import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import InertiaPrior, RateSensor, StarTracker, Wheel
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.maths import quaternion
from bayes_inertia.maths.jax_settings import require_usable_jax
from bayes_inertia.physics.simulator import simulate_slew
from bayes_inertia.physics.slew_input import Start, idle_slew


@cache
def small_campaign() -> Campaign:
    """Three slews of a microsatellite without noise.

    Three wheels with tachometers, star-tracker fixes in all rows, magnetic field and position.
    The truth is the prior mean, K = 1 and no bias.

    Examples
    --------
    >>> [len(slew.time) for slew in small_campaign().slews]
    [64, 64, 64]
    """
    require_usable_jax()
    tensor = np.array([[3.2, -0.02, 0.01], [-0.02, 2.2, 0.03], [0.01, 0.03, 1.9]])
    axes = np.eye(3)
    wheels = tuple(
        Wheel(n, tuple(g), 1e-3, 0.02, 0.3, 5e-6) for n, g in zip("xyz", axes, strict=True)
    )
    pushes = np.array([[3e-3, -1e-3, 0.5e-3], [-1e-3, 3e-3, 1e-3], [1e-3, 0.5e-3, -3e-3]])
    slews = tuple(_small_slew(i, push, tensor, axes) for i, push in enumerate(pushes))
    sensor = RateSensor(sigma=(2e-5,) * 3, bias_sigma=(2e-6,) * 3)
    prior, tracker = InertiaPrior(tensor, 0.04, 0.03), StarTracker((0.0, 0.0, 1.0), 2.4e-5, 1.4e-4)
    return Campaign("small", prior, wheels, sensor, tracker, slews)


def _small_slew(index: int, push: np.ndarray, tensor: np.ndarray, axes: np.ndarray) -> Slew:
    """Turn up, coast, and turn down, with some ripple on the torques."""
    time, start = np.arange(64.0), 300.0 * index
    up, down = ((time >= first) & (time < first + 16) for first in (8, 38))
    profile = up.astype(float) - down
    torque = push * profile[:, None] * (1.0 + 0.1 * np.sin(0.7 * time[:, None] + np.arange(3)))
    slew = idle_slew(time, wheel_axes_B=axes, spin_inertia=np.full(3, 1e-3), torque=torque)
    first = Start(
        jnp.array([2e-4, -1e-4, 3e-4]),
        quaternion.exp(jnp.array([0.3, -0.2, 0.1 * index])),
        jnp.array([0.05, -0.04, 0.06]),
    )
    path = simulate_slew(slew, first, jnp.asarray(tensor))[0]
    angle = (start + time) * 1.08e-3  # at the rate of a low Earth orbit [rad/s]
    in_orbit = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1)
    direction_N = in_orbit @ np.array([[0.9, 0.3, -0.3], [-0.3, 0.2, -0.93], [0, 0, 0]])
    return Slew(
        f"slew {index + 1}",
        start,
        time,
        rate=np.array(path.rate_B),
        attitude=np.array(path.attitude),
        wheel_torque=torque,
        wheel_momentum=np.array(path.wheel_momentum),
        magnetic_field_N=3e-5 * np.roll(direction_N, 1, axis=1) + 1e-5,
        position_N=7.0e6 * direction_N,
    )
