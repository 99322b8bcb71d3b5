"""Normal equations of a fit with Student-t noise or noise of sampled scale.

Each reading pulls with the slope of its own log density, so that outliers hardly pull; each
channel's normal matrix is that of Gaussian noise times the mean curvature of its log density.
Scale and degrees of freedom have the Fisher information of a Student-t distribution, and none
across to J, K and the nuisances (Lange, Little and Taylor 1989).
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bayes_inertia.inference.channel_rows import measured
from bayes_inertia.inference.likelihood import (
    Information,
    Residuals,
    Sensitivities,
    padded_sensitivities,
    residuals,
)
from bayes_inertia.inference.noise_model import Whitening, n_data
from bayes_inertia.inference.noise_parameters import NoiseRules, channel_rules, noise_values
from bayes_inertia.inference.objective import prior_rows
from bayes_inertia.inference.point import Point
from bayes_inertia.inference.student_t import (
    heavy_tail,
    location_information,
    log_norm,
    scale_information,
    tail_of,
)
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.maths.values import array_dataclass
from bayes_inertia.physics.forward_model import Model

# The mean curvature is taken for no less than this share of what the distribution lets expect.
LEAST_CURVATURE = 0.3


@array_dataclass
class NoiseTask:
    """What a descent with this noise needs beside the point.

    Parameters
    ----------
    model : Model
        Its noise is not as stated.
    stated : Whitening
        The noise as the campaign states it.
    lost : (3,) array
        By how much fitting lowered each channel's sum of weighted squares.
    inflation : (3,) array
        Factors on the scales, above 1 while a descent begins among outliers.
    """

    model: Model
    stated: Whitening
    lost: np.ndarray
    inflation: np.ndarray

    @property
    def rules(self) -> NoiseRules:
        """The noise of each channel."""
        return channel_rules(self.model)

    def values(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Scales (inflated) and degrees of freedom of the channels.

        `theta` (d,). Returns `scales, degrees` (3,).
        """
        scales, degrees = noise_values(self.rules, theta)
        return np.array(scales, float) * self.inflation, np.array(degrees, float)


@partial(jax.jit, static_argnums=0)
def _losses(heavy: tuple[bool, ...], r: Residuals, scales: Array, degrees: Array) -> Array:
    return jnp.stack(
        [
            jnp.sum(tail_of(h, z / s, nu).loss)
            for h, z, s, nu in zip(heavy, r, scales, degrees, strict=True)
        ]
    )


def objective(task: NoiseTask, point: Point) -> float:
    """Minus the log posterior of everything, up to a constant.

    Log-normal parameters count by the density of their logarithm.
    """
    model = task.model
    if not bool(inertia_tensor.is_physical(jnp.asarray(point.theta[:6]))):
        return np.inf
    scales, degrees = task.values(point.theta)
    heavy = tuple(rule.heavy for rule in task.rules)
    r = residuals(model.structure, point, model.data, task.stated)
    losses = np.asarray(_losses(heavy, r, jnp.asarray(scales), jnp.asarray(degrees)))
    numbers = n_data(task.stated).sum(0)
    norms = np.array([log_norm(nu) if h else 0.0 for h, nu in zip(heavy, degrees, strict=True)])
    noise = losses + (numbers - task.lost) * np.log(scales) + numbers * norms
    _, distance = prior_rows(model, point.theta)
    priors = distance @ distance + point.bias @ point.bias + np.sum(point.local**2)
    return float(noise.sum() + 0.5 * priors)


@partial(jax.jit, static_argnums=0)
def _of_location(
    heavy: tuple[bool, ...],
    s: Sensitivities,
    valid: Residuals,
    scales: Array,
    degrees: Array,
) -> tuple[Array, ...]:
    """Matrix, gradient, weighted squares and slope towards the degrees, by slew and channel."""
    columns = []
    for h, z, J, ok, scale, nu in zip(heavy, *s, valid, scales, degrees, strict=True):
        y = z / scale
        tail = tail_of(h, y, nu)
        curvature = jnp.sum(jnp.where(ok, tail.curvature, 0.0)) / jnp.maximum(jnp.sum(ok), 1)
        curvature = jnp.maximum(
            curvature, LEAST_CURVATURE * (location_information(nu) if h else 1.0)
        )
        along = (
            jax.jvp(lambda a, y=y: jnp.sum(heavy_tail(y, a).loss, -1), (nu,), (1.0,))[1]
            if h
            else jnp.zeros(len(z))
        )
        columns.append(
            (
                curvature / scale**2 * jnp.einsum("snp,snq->spq", J, J),
                jnp.einsum("snp,sn->sp", J, tail.slope) / scale,
                jnp.sum(tail.slope * y, -1),
                along,
                jnp.broadcast_to(curvature, (len(z),)),
            )
        )
    return tuple(jnp.stack(parts, 1) for parts in zip(*columns, strict=True))


def information(task: NoiseTask, point: Point, free: np.ndarray) -> tuple[Information, np.ndarray]:
    """Normal equations of every slew and channel, and what a reading counts.

    `free` (f,). Returns `information`: its `chi2` are weighted squares in stated sigmas, times the
    factor below; `factor` (slews, 3): information of a reading over that of Gaussian noise of the
    stated sigma.
    """
    model, rules = task.model, task.rules
    scales, degrees = task.values(point.theta)
    s = padded_sensitivities(model, point, task.stated, free)
    valid = Residuals(*(jnp.asarray(v.reshape(len(v), -1)) for v in measured(model)))
    heavy = tuple(rule.heavy for rule in rules)
    parts = _of_location(heavy, s, valid, jnp.asarray(scales), jnp.asarray(degrees))
    matrix, gradient, squares, along, curvature = (np.array(part) for part in parts)
    p = len(free) + 3 + model.structure.n_local
    matrix, gradient = matrix[..., :p, :p].copy(), gradient[..., :p].copy()
    numbers = n_data(task.stated)
    place = {int(index): i for i, index in enumerate(free)}
    for c, rule in enumerate(rules):
        indices = (rule.scale_at, rule.degrees_at)
        kept = [i for i, index in enumerate(indices) if index is not None and index in place]
        if not kept:
            continue
        slope, fisher = _of_noise(
            rule.heavy,
            scales[c],
            degrees[c],
            numbers[:, c],
            task.lost[c],
            squares[:, c],
            along[:, c],
        )
        columns = np.array([place[indices[i] or 0] for i in kept])
        gradient[:, c, columns] += slope[:, kept]
        matrix[:, c, columns[:, None], columns] += fisher[:, kept][:, :, kept]
    factor = curvature / scales**2
    chi2 = factor * squares * scales**2
    return Information(matrix, gradient, chi2, numbers, np.asarray(free)), factor


def _of_noise(
    heavy: bool,
    scale: float,
    degrees: float,
    numbers: np.ndarray,
    lost: float,
    squares: np.ndarray,
    along: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Slope (slews, 2) and Fisher information (slews, 2, 2) of scale and degrees of freedom."""
    kept = numbers * (1.0 - lost / max(numbers.sum(), 1))
    of_norm = float(jax.grad(log_norm)(degrees)) if heavy else 0.0
    slope = np.stack([(kept - squares) / scale, along + numbers * of_norm], -1)
    unit = scale_information(degrees) if heavy else np.diag([2.0, 0.0])
    unit = unit / np.outer([scale, 1.0], [scale, 1.0])
    return slope, kept[:, None, None] * unit
