"""Compile what will be needed while something else runs.

The first evaluation of a model with all candidate effects compiles for some seconds; the compiler needs no interpreter lock.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from bayes_inertia.diagnosis.torque_response import tangents
from bayes_inertia.inference.likelihood import padded_sensitivities, residuals, whitening
from bayes_inertia.inference.objective import N_BIAS
from bayes_inertia.inference.point import Point
from bayes_inertia.physics.forward_model import Model


def compile_ahead(model: Model) -> None:
    """Evaluate a model once where all its effects are at their null, so that later calls find their code compiled.

    To be waited for before the model is used: two threads that call the same new function compile it twice.
    """
    theta, local = model.space.nulls, jnp.zeros((model.n_slews, model.structure.n_local))
    point, white = Point(theta, jnp.zeros(N_BIAS), local), whitening(model, theta)
    jax.block_until_ready(
        (
            padded_sensitivities(model, point, white, np.arange(9)),
            tangents(model.structure, jnp.asarray(theta), local, model.data),
            residuals(model.structure, point, model.data, white),
        )
    )
