"""What several of the tests in `inference` use."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from bayes_inertia.inference.likelihood import whitened
from bayes_inertia.inference.marginal_posterior import Marginal
from bayes_inertia.inference.noise_model import whitening
from bayes_inertia.inference.point import Point
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.prediction import predict_all

DRIVES = ("commanded", "measured")


def frozen_at_prior_mean(model: Model) -> Marginal:
    """A marginal posterior without a fit: sensitivities at the prior mean, by differences."""
    d, k = model.space.size, model.structure.n_local
    theta, white = jnp.asarray(model.space.mean), whitening(model, model.space.mean)
    nothing = jnp.zeros((model.n_slews, k))

    @jax.jit
    @jax.vmap
    def residuals(bias, local):
        every = jnp.broadcast_to(local, nothing.shape)
        prediction = predict_all(model.structure, theta, every, bias, model.data)
        return whitened(model.structure, prediction, model.data.arrays.telemetry, white)

    small = 1e-5 * np.eye(3 + k)
    moved, still = (residuals(x[:, :3], x[:, 3:]) for x in (small, 0.0 * small))
    columns = [np.moveaxis(a - b, 0, -1) / 1e-5 for a, b in zip(moved, still, strict=True)]
    size = max(np.abs(c).max(initial=0.0) for c in columns)
    return Marginal(
        optimum=Point(theta, jnp.zeros(3), nothing),
        ridge_bias=jnp.zeros((3, d)),
        ridge_local=jnp.zeros((model.n_slews, k, d)),
        columns=tuple(map(jnp.asarray, columns)),
        root=jnp.eye(3 + nothing.size) / size,
        prior=model.space.constants(),
        data=model.data,
        white=white,
    )
