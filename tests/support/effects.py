"""What several of the tests in `physics` use."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effects import (
    by_name,
)
from bayes_inertia.physics.slew_context import State
from bayes_inertia.physics.slew_input import Start

J = np.array([[3.2, -0.02, 0.01], [-0.02, 2.2, 0.03], [0.01, 0.03, 1.9]])


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
