"""The negative log posterior of all unknowns together: its value, its normal equations, and steps that stay among physical tensors.

The unknowns are the model's parameters theta, the rate bias, and every slew's own nuisances (start state, tachometer
noise), all with Gaussian priors. J moves in its log-Cholesky chart.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from bayes_inertia.inference.likelihood import Information, Whitening, residuals
from bayes_inertia.inference.point import Point
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import prior_residual

N_BIAS = 3
# No closer than this to a body without thickness (second moment over trace): beyond, rounding rules.
_THINNEST = 1e-7


def negative_log_posterior(model: Model, point: Point, white: Whitening) -> float:
    """Half the sum of all whitened squares, priors included; infinite outside the physical tensors."""
    if not bool(_is_physical(point.theta[:6])):
        return np.inf
    r = residuals(model.structure, point, model.data, white)
    with np.errstate(over="ignore"):  # A step too far gives an infinite objective.
        chi2 = sum(float(np.sum(np.square(channel))) for channel in r)
    own = np.asarray(_prior_residual(model.space.constants(), point.theta))
    return 0.5 * (
        chi2 + float(own @ own) + float(point.bias @ point.bias) + float(np.sum(point.local**2))
    )


def normal_equations(
    model: Model, point: Point, info: Information, weights: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Hessian and gradient of the negative log posterior for (theta, bias, all local nuisances), priors included.

    Parameters
    ----------
    weights : (slews,) multiplies each slew's information (0 leaves it out).
    """
    f, m = len(info.free), point.local.shape[1]
    size = f + N_BIAS + point.local.size
    hessian, gradient = np.zeros((size, size)), np.zeros(size)
    for s, (block, pull) in enumerate(zip(info.matrix, info.gradient, strict=True)):
        index = block_index(f + N_BIAS, m, s)
        weight = 1.0 if weights is None else weights[s]
        hessian[np.ix_(index, index)] += weight * block.sum(0)
        gradient[index] += weight * pull.sum(0)
    slope, distance = (rows[info.free] for rows in prior_rows(model, point.theta))
    hessian[np.arange(size), np.arange(size)] += np.concatenate([slope**2, np.ones(size - f)])
    gradient += np.concatenate([slope * distance, point.bias, point.local.ravel()])
    return hessian, gradient


def prior_rows(model: Model, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivative (d,) and value (d,) of the whitened distance of theta from its prior."""
    constants = model.space.constants()
    return np.asarray(_prior_slope(constants, theta)), np.asarray(_prior_residual(constants, theta))


def block_index(shared: int, n_local: int, s: int) -> np.ndarray:
    """Where the shared unknowns and the local nuisances of slew s stand in the joint vector.

    >>> block_index(2, 3, 1).tolist()
    [0, 1, 5, 6, 7]
    """
    return np.concatenate(
        [np.arange(shared), np.arange(shared + s * n_local, shared + (s + 1) * n_local)]
    )


def moved(model: Model, point: Point, step: np.ndarray, free: np.ndarray) -> Point:
    """The point after a step (free + 3 + slews n_local,) whose first six components are in the chart of J."""
    f = len(free)
    theta = point.theta.copy()
    theta[free] += step[:f]
    chart = np.array(_to_chart(point.theta[:6])) + step[:6]
    chart[:3] = np.maximum(chart[:3], 0.5 * np.log(_THINNEST * np.sum(point.theta[:3])))
    theta[:6] = np.asarray(_from_chart(chart))
    span = 1e-9 * model.space.sd
    theta[6:] = np.clip(theta, model.space.lower + span, model.space.upper - span)[6:]
    return Point(
        theta,
        point.bias + step[f : f + N_BIAS],
        point.local + step[f + N_BIAS :].reshape(point.local.shape),
    )


def in_chart(
    point: Point, hessian: np.ndarray, gradient: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations whose first six unknowns are J's elements, for the steps that `moved` takes."""
    turn = np.eye(len(gradient))
    turn[:6, :6] = np.asarray(_chart_slope(_to_chart(point.theta[:6])))
    return turn.T @ hessian @ turn, turn.T @ gradient


_is_physical = jax.jit(inertia_tensor.is_physical)
_to_chart = jax.jit(inertia_tensor.to_chart)
_from_chart = jax.jit(inertia_tensor.from_chart)
_chart_slope = jax.jit(jax.jacfwd(inertia_tensor.from_chart))
_prior_residual = jax.jit(prior_residual)
_prior_slope = jax.jit(jax.grad(lambda c, x: jnp.sum(prior_residual(c, x)), argnums=1))
