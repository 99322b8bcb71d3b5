"""Compile the model with all candidate effects while the plain model is fitted.

The first evaluation of the large model compiles for some seconds. The compiler needs no interpreter
lock, so that it can work beside the optimizer.
"""

from __future__ import annotations

import numpy as np

from bayes_inertia.diagnosis.torque_response import tangents
from bayes_inertia.inference.likelihood import padded_sensitivities, residuals
from bayes_inertia.inference.noise_model import whitening
from bayes_inertia.inference.point import N_BIAS, Point
from bayes_inertia.physics.forward_model import Model


def precompile(model: Model) -> None:
    """Evaluate a model once, all its effects at their null, so that later calls find compiled code.

    Wait for it before the model is used: two threads that call the same new function compile it
    twice.

    Parameters
    ----------
    model : Model
        The model with all candidate effects.
    """
    theta, local = model.space.nulls, np.zeros((model.n_slews, model.structure.n_local))
    point, white = Point(theta, np.zeros(N_BIAS), local), whitening(model, theta)
    padded_sensitivities(model, point, white, np.arange(9))
    tangents(model.structure, theta, local, model.data)
    residuals(model.structure, point, model.data, white)
