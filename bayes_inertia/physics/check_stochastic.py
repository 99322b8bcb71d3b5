"""What `check_effect` asks of effects without a fixed shape: the prior of their coefficients."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import block_diag

from bayes_inertia.physics.effect import Effect
from bayes_inertia.physics.effect_declaration import guarded, require_of_effect
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.numerics import NUMERICS
from bayes_inertia.physics.random_inputs import prior_blocks
from bayes_inertia.physics.stochastic_effect import StochasticEffect


def coefficient_draw(model: Model) -> np.ndarray:
    """Whitened nuisances with coefficients to try an effect with.

    Returns (slews, n_local): zero but for the coefficients, which are standard normal.
    """
    structure = model.structure
    local = np.zeros((model.n_slews, structure.n_local))
    draw = np.random.default_rng(NUMERICS.coefficient_seed).standard_normal(local.shape)
    local[:, structure.n_start :] = draw[:, structure.n_start :]
    return local


def check_coefficients(effect: Effect, model: Model, points: np.ndarray) -> None:
    """Check the prior covariance of an effect's coefficients.

    `points` (n, d): parameter vectors: the null first, then draws of the prior.
    """
    if not isinstance(effect, StochasticEffect):
        return
    require_of_effect(
        bool(model.structure.coefficients),
        effect,
        "coefficient_count(campaign) is 0",
        "pass a campaign in which it acts",
    )
    roots = guarded(effect, "coefficient_root(p, slew, count)", lambda: _roots(model, points))
    count = roots.shape[-1]
    has_parameters = points.shape[1] > model.space.slice_of("").stop
    require_of_effect(
        not has_parameters or not np.any(roots[0]),
        effect,
        "at its null values the covariance of the coefficients is not zero",
        "let the root vanish there",
    )
    for k, root in enumerate(roots[1:].reshape(-1, count, count)):
        require_of_effect(
            bool(np.isfinite(root).all()),
            effect,
            f"coefficient_root is not finite (draw {k} of the prior)",
            "keep it finite over the whole prior",
        )
        require_of_effect(
            _is_definite(root @ root.T),
            effect,
            "the covariance of the coefficients is not positive definite",
            "leave out coefficients that others determine, or give each a variance",
        )
    _check_across_slews(effect, model, points[-1])


def _check_across_slews(effect: StochasticEffect, model: Model, theta: np.ndarray) -> None:
    """Check the covariance of all slews, where the effect has one."""
    structure, slews = model.structure, model.data.arrays.slews.context
    active = structure.active_effects(jnp.asarray(theta))
    ((_, p),) = active
    given = guarded(
        effect,
        "covariance_across_slews(p, slews)",
        lambda: effect.covariance_across_slews(p, slews),
    )
    if given is None:
        return
    covariance = np.asarray(given)
    (blocks,) = jax.vmap(lambda slew: prior_blocks(active, structure.coefficients, slew))(slews)
    size = blocks.shape[0] * blocks.shape[-1]
    require_of_effect(
        covariance.shape == (size, size),
        effect,
        f"covariance_across_slews has the shape {covariance.shape}",
        f"return {size} rows and columns: the coefficients of one block, slew by slew",
    )
    scale = max(float(np.abs(covariance).max()), 1e-300)
    rounding = NUMERICS.covariance_rounding * scale
    symmetric = np.abs(covariance - covariance.T).max() <= rounding
    require_of_effect(
        bool(symmetric and np.linalg.eigvalsh(covariance).min() >= -rounding * size),
        effect,
        "covariance_across_slews is no covariance",
        "return a symmetric matrix without negative eigenvalues",
    )


def _roots(model: Model, points: np.ndarray) -> np.ndarray:
    """Roots (points, slews, k, k)."""
    structure, contexts = model.structure, model.data.arrays.slews.context

    def of_point(theta):
        active = structure.active_effects(theta)

        def of_slew(slew):
            blocks = prior_blocks(active, structure.coefficients, slew)
            return block_diag(*(root for effect in blocks for root in effect))

        return jax.vmap(of_slew)(contexts)

    return np.array(jax.jit(jax.vmap(of_point))(points))


def _is_definite(covariance: np.ndarray) -> bool:
    """Whether a covariance (k, k) has full rank, whatever the units of its rows."""
    sd = np.sqrt(np.diag(covariance))
    if not np.all(sd > 0.0):
        return False
    smallest = np.linalg.eigvalsh(covariance / np.outer(sd, sd)).min()
    return bool(smallest > NUMERICS.zero_eigenvalue)
