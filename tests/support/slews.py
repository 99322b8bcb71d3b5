"""What several of the tests in `maths` use."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from bayes_inertia.physics.effect import ActiveEffects
from bayes_inertia.physics.simulator import simulate_slew
from bayes_inertia.physics.slew_input import Start

J = np.array([[3.2, -0.2, 0.1], [-0.2, 2.2, 0.3], [0.1, 0.3, 1.9]])


WHEEL_SETS = {
    "orthogonal": np.eye(3),
    "one": np.array([[0.0], [0.6], [0.8]]),
    "four skewed": np.array([[0.8, -0.8, 0.0, 0.6], [0.6, 0.6, 0.6, -0.64], [0.0, 0.0, 0.8, 0.48]]),
}


SKEWED = WHEEL_SETS["four skewed"]


RATE = np.array([0.25, -0.3, 0.2])


ATTITUDE = np.array([0.5, -0.1, 0.3, np.sqrt(1.0 - 0.35)])


PAD = 400


EXTERNAL = {
    "test_torque": {
        "constant": jnp.array([0.02, -0.03, 0.01]),
        "damping": jnp.array([0.05, 0.02, 0.1]),
    }
}


_run = jax.jit(simulate_slew, static_argnums=4)


def run(slew, start, J_B=J, effects=(), values=None, drive="commanded"):
    """The trajectory; slews are padded as in campaigns, to a few lengths, so that they share
    compiled code.
    """
    n = len(slew.context.time)
    spare = -n % PAD

    def longer(rows):
        rows = np.asarray(rows)
        return np.concatenate([rows, np.repeat(rows[-1:], spare, axis=0)])

    context = slew.context._replace(
        time=longer(slew.context.time),
        step=longer(slew.context.step),
        torque=longer(slew.context.torque),
    )
    slew = type(slew)(context, *jax.tree.map(longer, tuple(slew[1:])))
    flown = _run(slew, start, jnp.asarray(J_B), ActiveEffects(effects, values or {}), drive)[0]
    return jax.tree.map(lambda rows: np.asarray(rows)[:n], flown)


def start_with(wheels, rate=RATE, attitude=ATTITUDE):
    return Start(
        jnp.asarray(rate), jnp.asarray(attitude), jnp.asarray(0.3 * np.cos(np.arange(wheels) + 1.0))
    )


def torques(n, wheels, seed=0, size=0.05):
    return size * np.random.default_rng(seed).normal(size=(n, wheels))


def _skew(v):
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
