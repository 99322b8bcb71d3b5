"""The negative log posterior of all unknowns together: value, normal equations, steps.

The unknowns are the model's parameters theta, the rate bias, and every slew's own nuisances
(start state, tachometer noise), all with Gaussian priors. J moves in its log-Cholesky chart.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from bayes_inertia.inference.likelihood import Information, Point, information_blocks, residuals
from bayes_inertia.inference.limits import LIMITS
from bayes_inertia.inference.noise_model import Whitenings, measured
from bayes_inertia.inference.slew_shares import eliminated
from bayes_inertia.maths import inertia_tensor
from bayes_inertia.physics.forward_model import Model
from bayes_inertia.physics.parameters import prior_residual


def negative_log_posterior(model: Model, point: Point, white: Whitenings) -> float:
    """Half the sum of all whitened squares (losses, of other densities), priors included."""
    if not inertia_tensor.is_physical(point.theta[:6]):
        return np.inf
    r = residuals(model.structure, point, model.data, white)
    valid = measured(model)
    with np.errstate(over="ignore"):  # A step too far gives an infinite objective.
        chi2 = sum(
            float(np.sum(np.square(z)))
            if noise.density is None
            else 2.0 * noise.density.loss(z, ok.reshape(z.shape), point.theta)
            for z, noise, ok in zip(r, white, valid, strict=True)
        )
    prior = np.asarray(_prior_residual(model.space.constants(), point.theta))
    nuisances = float(point.bias @ point.bias), float(np.sum(point.local**2))
    return 0.5 * (chi2 + float(prior @ prior) + nuisances[0] + nuisances[1])


def normal_equations(
    model: Model, point: Point, information: Information, weights: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Hessian and gradient of the negative log posterior, priors included.

    `weights` (slews, channels): multiplies the information of each slew and channel; 0 leaves it
    out. Returns `hessian` (unknowns, unknowns): for (theta[free], bias, all local nuisances),
    Gauss-Newton; `gradient` (unknowns,).
    """
    f, b, m = len(information.free), len(point.bias), point.n_local
    size = f + b + point.local.size
    hessian = np.zeros((size, size))
    weights = np.ones(information.chi2.shape) if weights is None else weights
    for s, weight in enumerate(weights):
        index = block_index(f + b, m, s)
        hessian[np.ix_(index, index)] += (weight[:, None, None] * information.matrix[s]).sum(0)
    precision, slope = prior_equations(model, point.theta, information.free)
    hessian[:f, :f] += precision
    hessian[np.arange(f, size), np.arange(f, size)] += 1.0
    weighted = weights[..., None] * information.gradient
    return hessian, whole_gradient(point, slope, weighted)


def whole_gradient(point: Point, slope: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Gradient (unknowns,) of the negative log posterior, priors included.

    `slope` (f,) of the prior of parameters; `gradient` (slews, channels, p) of the data.
    """
    shared = len(slope) + len(point.bias)
    whole = np.zeros(shared + point.local.size)
    for s, of_slew in enumerate(gradient):
        whole[block_index(shared, point.n_local, s)] += of_slew.sum(0)
    return whole + np.concatenate([slope, point.bias, point.local.ravel()])


def prior_rows(model: Model, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The prior of each parameter alone as whitened residuals.

    `theta` (d,). Returns `slope` (d,): derivative of the whitened distance of each parameter from
    its prior mean; `distance` (d,): the distance itself [prior sd].
    """
    alone = model.space.marginals()
    return np.asarray(_prior_slope(alone, theta)), np.asarray(_prior_residual(alone, theta))


def normal_prior(model: Model, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means and sds (d,) of the normal distributions that slope and bend as the priors do here.

    Each alone; of a parameter whose logarithm is normal they depend on `theta` (d,).
    """
    slope, distance = prior_rows(model, theta)
    return theta - distance / slope, 1.0 / slope


def prior_root(model: Model, theta: np.ndarray) -> np.ndarray:
    """Derivatives (d, d) of the prior's independent residuals: R, with R^T R its precision."""
    slope, _ = prior_rows(model, theta)
    whitening = model.space.whitening
    return np.diag(slope) if whitening is None else whitening * slope


def prior_equations(
    model: Model, theta: np.ndarray, free: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations of the prior, for parameters that may move.

    `theta` (d,); `free` (f,). Returns `precision` (f, f); `gradient` (f,).
    """
    slope, distance = prior_rows(model, theta)
    whitening = model.space.whitening
    if whitening is None:
        return np.diag(slope[free] ** 2), slope[free] * distance[free]
    root = prior_root(model, theta)[:, free]
    return root.T @ root, root.T @ (whitening @ distance)


def block_index(n_shared: int, n_local: int, slew: int) -> np.ndarray:
    """Where the unknowns of one slew stand in the joint vector.

    Returns (n_shared + n_local,).

    Examples
    --------
    >>> block_index(2, 3, 1).tolist()
    [0, 1, 5, 6, 7]
    """
    begin = n_shared + slew * n_local
    return np.concatenate([np.arange(n_shared), np.arange(begin, begin + n_local)])


def moved(model: Model, point: Point, step: np.ndarray, free: np.ndarray) -> Point:
    """The point after a step that stays among the physical tensors and within the priors' support.

    `free` (f,). `step` (f + n_bias + slews n_local,): its first six components are in the
    chart of J, see `in_chart`.
    """
    f, b = len(free), len(point.bias)
    theta = point.theta.copy()
    theta[free] += step[:f]
    chart = np.array(_to_chart(point.theta[:6])) + step[:6]
    chart[:3] = np.maximum(
        chart[:3], 0.5 * np.log(LIMITS.smallest_second_moment * np.sum(point.theta[:3]))
    )
    theta[:6] = np.asarray(_from_chart(chart))
    margin = LIMITS.support_margin * model.space.sd
    return Point(
        np.clip(theta, model.space.lower + margin, model.space.upper - margin),
        point.bias + step[f : f + b],
        point.local + step[f + b :].reshape(point.local.shape),
    )


def step_sizes(model: Model, point: Point, free: np.ndarray) -> np.ndarray:
    """A step of each coordinate of `moved` that is neither large nor small.

    `free` (f,). Returns (f + n_bias + slews n_local,): one in the chart of J (a factor e) and for
    what is whitened by its prior; for a parameter its prior mean or sd, whichever is larger.
    """
    sizes = np.maximum(np.abs(model.space.mean), model.space.sd)[np.asarray(free)]
    sizes[:6] = 1.0
    return np.concatenate([sizes, np.ones(len(point.bias) + np.size(point.local))])


def in_chart(
    point: Point, hessian: np.ndarray, gradient: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations in the chart of J, for the steps that `moved` takes.

    `hessian` (unknowns, unknowns); `gradient` (unknowns,). Returns `hessian` (unknowns, unknowns);
    `gradient` (unknowns,).
    """
    turn = np.asarray(_chart_slope(_to_chart(point.theta[:6])))
    # Only J is turned: thousands of nuisances stay as they are.
    hessian = hessian.copy()
    hessian[:6] = turn.T @ hessian[:6]
    hessian[:, :6] = hessian[:, :6] @ turn
    return hessian, gradient_in_chart(point, gradient)


def gradient_in_chart(point: Point, gradient: np.ndarray) -> np.ndarray:
    """A gradient (unknowns,) in the chart of J at a point, see `in_chart`."""
    turn = np.asarray(_chart_slope(_to_chart(point.theta[:6])))
    return np.concatenate([turn.T @ gradient[:6], gradient[6:]])


def marginal_information(
    model: Model, point: Point, white: Whitenings, parameters: np.ndarray
) -> np.ndarray:
    """What the data tell of some parameters and the bias, the slews' nuisances integrated out.

    At any point of any model of the campaign, not only at a fit's optimum.

    `parameters` (k,). Returns (k + n_bias, k + n_bias): information matrix, without the priors of
    parameters and bias.
    """
    information = information_blocks(model, point, white, parameters)
    parts = eliminated(information, point.local, len(parameters) + len(point.bias))
    return parts.matrix.sum(0)


_to_chart = jax.jit(inertia_tensor.to_chart)
_from_chart = jax.jit(inertia_tensor.from_chart)
_chart_slope = jax.jit(jax.jacfwd(inertia_tensor.from_chart))
_prior_residual = jax.jit(prior_residual)
_prior_slope = jax.jit(jax.grad(lambda c, x: jnp.sum(prior_residual(c, x)), argnums=1))
