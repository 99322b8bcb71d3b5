"""What several of the tests in `physics` use."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.hardware import InertiaPrior, RateSensor
from bayes_inertia.campaign.slew import Slew
from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import (
    by_name,
)
from bayes_inertia.physics.slew_context import State
from bayes_inertia.physics.slew_input import Start

J = np.array([[3.2, -0.02, 0.01], [-0.02, 2.2, 0.03], [0.01, 0.03, 1.9]])


def thrown_body() -> Campaign:
    """Two throws of a small body without wheels."""
    time = np.linspace(0.0, 0.5, 101)
    rate = np.stack([10.0 * np.cos(3.0 * time), 10.0 * np.sin(3.0 * time), np.full(101, 2.0)], -1)
    prior = InertiaPrior(1e-3 * np.diag([1.3, 1.1, 0.9]), 0.3, 1e-4)
    slews = tuple(Slew(f"throw {i}", 60.0 * i, time, rate=rate) for i in range(2))
    return Campaign("thrown", prior, (), RateSensor(sigma=0.01, bias_sigma=0.01), None, slews)


def effect_of(name: str) -> Effect:
    return by_name([name])[0]


def state_of(
    rate=(0.0, 0.0, 0.0),
    wheel=(0.0, 0.0, 0.0),
    q=(0.0, 0.0, 0.0, 1.0),
    field=(0.0, 0.0, 0.0),
    position=(7e6, 0.0, 0.0),
) -> State:
    arrays = [jnp.asarray(x, dtype=float) for x in (q, rate, wheel)]
    return State(
        *arrays,
        jnp.zeros(0),
        jnp.asarray(J),
        jnp.asarray(field, dtype=float),
        jnp.asarray(position, dtype=float),
    )


REST = Start(jnp.zeros(3), jnp.array([0.0, 0.0, 0.0, 1.0]), jnp.zeros(3))
