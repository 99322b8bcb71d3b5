"""What several of the tests in `inference` use."""

from __future__ import annotations

from pathlib import Path

import emcee
import numpy as np

from bayes_inertia.inference.settings import Settings

D = 9


SHORT = Settings(seed=3, ensembles=2, walkers=32, steps=12, max_steps=12)


def _chain(path: Path) -> tuple:
    """Everything that emcee keeps, as bytes."""
    backend = emcee.backends.HDFBackend(str(path), read_only=True)
    state = backend.random_state
    return (
        backend.get_chain().tobytes(),
        backend.get_log_prob().tobytes(),
        np.asarray(backend.accepted).tobytes(),
        state[1].tobytes(),
        state[2:],
    )
